"""Steps of a motion from sample to sample, exact or expected, with coloured noise as further states.

Each interval starts at a state that is given (multiple shooting, Bock 1981), and is followed by the compiled
engine. What a random force adds is the covariance of impulses within the interval, carried to its end by the
same derivatives, at Gauss's points.

Where a force switches with the speed, the step about one path holds one branch, though either may be the
true one; of a body that friction nearly holds it claims that nothing moves it. The best linear step over the
law of the state has the mean of the ends and, as they are continuous in the state, the mean of their
derivatives (Stein 1981): statistical linearisation (Gelb 1974; Garcia-Fernandez, Svensson and Sarkka 2017).
"""

from dataclasses import dataclass, fields

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.special import ndtri

from sysid_trib.arrays import Array
from sysid_trib.simulation.integrate import FREQUENCY
from sysid_trib.simulation.model import Model, Motion
from sysid_trib.simulation.motions import ends_of


@dataclass(frozen=True)
class Steps:
    """Exact motion over each interval between samples, from states that are given at its beginning.

    The state is x, v (rad), then the internal states of the forces, then their memory (`Motion.variables`,
    `Motion.memory`).

    Attributes
    ----------
    end : (step, state) array of float
        State at the end of each interval.
    transition : (step, state, state) array of float
        Derivative of the end by the beginning.
    sensitivity : (step, state, parameter) array of float
        Derivative of the end by the parameters that were asked for, the beginning (x, v, ...) held.
    diffusion : (step, state, state) array of float
        Covariance of the end by a white acceleration that makes the variance of v grow by one a unit of tau.
    """

    end: Array
    transition: Array
    sensitivity: Array
    diffusion: Array


GAUSS_POINTS, GAUSS_WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(3))
GAUSS_POINTS = GAUSS_POINTS + 0.5


def steps_over(model: Model, tau: Array, length: Array, states: Array, by: tuple[str, ...] = ()) -> Steps:
    """Exact motion over any intervals.

    Parameters
    ----------
    model : Model
    tau, length : (interval,) array of float
        Beginning and length of each.
    states : (interval, state) array of float
        At the beginnings.
    by : tuple of str
        Parameters by which the ends are derived.

    Returns
    -------
    Steps

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    # In tau; longer intervals are followed in parts.
    parts = np.maximum(1, np.ceil(length / 0.5).astype(int))
    whole = _followed(model, tau, length / parts, states, by)
    for done in range(1, int(parts.max(initial=1))):
        at = np.flatnonzero(parts > done)
        part = length[at] / parts[at]
        further = _followed(model, tau[at] + done * part, part, whole.end[at], by)
        onward = further.transition
        whole.end[at] = further.end
        whole.transition[at] = onward @ whole.transition[at]
        whole.sensitivity[at] = onward @ whole.sensitivity[at] + further.sensitivity
        whole.diffusion[at] = onward @ whole.diffusion[at] @ onward.swapaxes(1, 2) + further.diffusion
    return whole


def _followed(model: Model, tau: Array, length: Array, states: Array, by: tuple[str, ...]) -> Steps:
    """Steps of short intervals, one after the other."""
    ends = ends_of(model, (tau, length), states, by, (GAUSS_POINTS, np.sqrt(GAUSS_WEIGHTS)))
    stochastic = ends.impulses * np.sqrt(length)[:, None, None]
    return Steps(ends.end, ends.transition, ends.sensitivity, stochastic @ stochastic.swapaxes(1, 2))


# Speeds of equal probability that stand for the normal law.
SPEEDS = 8
_QUANTILES = ndtri((np.arange(SPEEDS) + 0.5) / SPEEDS)
NORMAL = _QUANTILES / np.sqrt(np.mean(_QUANTILES**2))
# A speed so many standard errors from zero has one sign.
ONE_SIGN = 4.0


def expected_steps(
    model: Model,
    time: Array,
    states: Array,
    rate_error: Array | float,
    names: tuple[str, ...] = (),
    *,
    frequency: bool = False,
) -> Steps:
    """The motion over each interval between samples, of which v is known to a standard error alone.

    Parameters
    ----------
    model : Model
        Forces with coefficient zero are followed too.
    time : (sample,) array of float, s
        Increasing, with steps of any length.
    states : (sample, state) array of float
        x, v (rad), internal states and memory at each sample, from which the motion starts anew.
    rate_error : float or (sample,) array of float, rad
        Standard error of v at each sample; 0 where it is known.
    names : tuple of str
        Coefficients and shape parameters by which the end is derived.
    frequency : bool
        Whether it is derived by the reference frequency too, which comes last.

    Returns
    -------
    Steps

    Raises
    ------
    SimulationError
        The motion diverges between two samples, or switches without end.
    """
    w = model.reference_frequency
    by = (*names, FREQUENCY) if frequency else names
    tau, length = w * (time[:-1] - time[0]), w * np.diff(time)
    steps = steps_over(model, tau, length, states[:-1], by)
    if not np.any(rate_error) or not any(switch.key == "v" for switch in Motion(model.forces).switches):
        return steps
    v, error = states[:, 1], np.broadcast_to(rate_error, len(states))
    near = np.minimum(np.abs(v[:-1]), np.abs(v[1:])) < ONE_SIGN * error[:-1]
    unsure = np.flatnonzero(near | (v[:-1] * v[1:] <= 0.0))
    begun = np.repeat(states[None, unsure], SPEEDS, axis=0)
    begun[:, :, 1] += np.multiply.outer(NORMAL, error[unsure])
    several = np.tile(unsure, SPEEDS)
    drawn = steps_over(model, tau[several], length[several], begun.reshape(-1, states.shape[1]), by)

    def averaged(certain: Array, drawn: Array) -> Array:
        whole = certain.copy()
        whole[unsure] = np.mean(drawn.reshape(SPEEDS, len(unsure), *drawn.shape[1:]), axis=0)
        return whole

    parts = [field_.name for field_ in fields(Steps)]
    return Steps(**{name: averaged(getattr(steps, name), getattr(drawn, name)) for name in parts})


@dataclass(frozen=True)
class SensorNoise:
    """Autoregressive noise of the sensor as further states: its last values, in units of its innovations.

    White noise has none.

    Attributes
    ----------
    filter_ : (order + 1,) array of float
        Whitens it.
    """

    filter_: Array

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.filter_) - 1

    @property
    def shown(self) -> Array:
        """What the sensor shows of the states, (order,)."""
        return np.eye(1, self.order)[0]

    @property
    def transition(self) -> Array:
        """Companion matrix (order, order)."""
        return np.concatenate([-self.filter_[None, 1:], np.eye(self.order)[:-1]])[: self.order]

    @property
    def driven(self) -> Array:
        """Covariance that each step adds, (order, order)."""
        return np.outer(self.shown, self.shown)

    @property
    def first(self) -> Array:
        """Covariance at the first sample: the stationary one, (order, order)."""
        if not self.order:
            return self.driven
        return np.asarray(solve_discrete_lyapunov(self.transition, self.driven))

    def behind(self, vectors: Array, further: Array) -> Array:
        """Vectors of states (..., state), with entries of these states behind them."""
        return np.concatenate([vectors, np.broadcast_to(further, (*vectors.shape[:-1], self.order))], axis=-1)

    def block_diagonal(self, matrices: Array, further: Array) -> Array:
        """Matrices of states (..., state, state), with a block of these states."""
        if not self.order:
            return matrices
        size = matrices.shape[-1]
        whole = np.zeros((*matrices.shape[:-2], size + self.order, size + self.order))
        whole[..., :size, :size] = matrices
        whole[..., size:, size:] = further
        return whole
