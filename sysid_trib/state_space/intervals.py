"""The motion from each sample to the next, exact and with its derivatives, over all intervals at once.

Each interval starts at a state that is given (multiple shooting, Bock 1981), so that none waits for another.
An explicit Runge-Kutta step advances state, derivatives and diffusion together; where it passes a switching
surface it is cut there (`switching`).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.integrate import DOP853, RK45
from scipy.optimize import elementwise

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.errors import SimulationError
from sysid_trib.simulation.model import Model
from sysid_trib.state_space.steps import Steps
from sysid_trib.state_space.switching import Front, crossed, passed_surface, settled, sides
from sysid_trib.state_space.vector_field import Instants, VectorField

# Longest substep in tau.
SUBSTEP = 0.16
# By so little (rad) a motion may be on the wrong side of a surface that it touches, for rounding.
TOUCHED = 1e-14
# In an interval, and in each unit of tau of a long one.
MOST_SWITCHINGS = 60


def steps_between(
    model: Model, time: Array, states: Array, names: tuple[str, ...] = (), *, frequency: bool = False
) -> Steps:
    """Exact motion over each interval between samples.

    Parameters
    ----------
    model : Model
        Forces with coefficient zero are followed too.
    time : (sample,) array of float, s
        Increasing, with steps of any length.
    states : (sample, state) array of float
        x, v (rad), internal states and memory at each sample, from which the motion starts anew.
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
    field = VectorField(model, names, frequency)
    return steps_over(field, w * (time[:-1] - time[0]), w * np.diff(time), states)


def steps_over(
    field: VectorField, tau: Array, length: Array, states: Array, *, longest: float = SUBSTEP
) -> Steps:
    """Exact motion over any intervals.

    Parameters
    ----------
    field : VectorField
    tau, length : (interval,) array of float
        Beginning and length of each.
    states : (interval, state) array of float
        At the beginnings; one more where the intervals follow each other.
    longest : float
        Longest substep in tau.

    Returns
    -------
    Steps

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    size, count = field.size, len(tau)
    front = _begin(field, states[:count].T.astype(float), tau)
    remaining = length.copy()
    density = np.maximum(1.0 / longest, _stiffness(field, states, count))
    substep = length / np.maximum(1.0, np.ceil(density * length))
    switchings = np.zeros(count, int)
    moving = np.arange(count)
    whole = front
    waiting = np.zeros(count, bool)
    while len(moving):
        # Those that pass a surface wait for the others: a search for many crossings takes as long as for one.
        crossing = bool(waiting[moving].all())
        at = moving if crossing else moving[~waiting[moving]]
        step = np.minimum(substep[at], remaining[at])
        part = whole.at(at) if len(at) < count else whole
        if crossing:
            step = _first_crossing(field, part.here, step)
            ahead = crossed(field, _step(field, part, step))
            switchings[at] += 1
            waiting[at] = False
        else:
            ahead = _step(field, part, step)
            passed = passed_surface(field, ahead.here)
            if passed.any():
                waiting[at[passed]] = True
                free = np.flatnonzero(~passed)
                at, step, ahead = at[free], step[free], ahead.at(free)
        whole = _with(whole, at, ahead) if len(at) < count else ahead
        remaining[at] -= step
        if not np.all(np.isfinite(ahead.here.y)) or np.any(switchings > MOST_SWITCHINGS * (1.0 + length)):
            raise SimulationError(
                "The motion between two samples diverges or switches without end; mind negative damping and "
                "forces that are singular where it goes."
            )
        moving = moving[remaining[moving] > 1e-14]
    return Steps(
        whole.here.y.T,
        np.moveaxis(whole.derivative[:, :size], -1, 0),
        np.moveaxis(whole.derivative[:, size:], -1, 0),
        np.moveaxis(whole.diffusion, -1, 0),
    )


def _stiffness(field: VectorField, states: Array, count: int) -> Array:
    """Fastest rate at which internal states relax in each interval, per unit of tau.

    By the states at its beginning, and at its end where they are known: that is where the next one begins.
    """
    memory = slice(2, len(field.motion.variables))
    if memory.stop == 2:
        return np.zeros(count)
    at_samples = Instants(states.T.astype(float), np.zeros(len(states)), *_no_side(field, len(states)))
    _, by_state, _ = field.derivatives(settled(field, at_samples, np.ones(len(states), bool)))
    rates = np.max(np.abs(by_state[memory, memory]), axis=(0, 1))
    return np.maximum(rates[:count], rates[-count:])


def _no_side(field: VectorField, count: int) -> tuple[Array, Mask]:
    """Signs and sticking of instants of which nothing is known yet."""
    return np.zeros((len(field.motion.switches), count)), np.zeros(count, bool)


def _begin(field: VectorField, y: Array, tau: Array) -> Front:
    size, count = field.size, len(tau)
    here = settled(field, Instants(y, tau, *_no_side(field, count)), np.ones(count, bool))
    derivative = np.zeros((size, size + len(field.names) + field.frequency, count))
    derivative[range(size), range(size)] = 1.0
    # What friction holds has no speed, whatever it had.
    derivative[1, 1, here.stuck] = 0.0
    return Front(here, derivative, np.zeros((size, size, count)))


def _step(field: VectorField, front: Front, step: Array) -> Front:
    """One step: of order eight for the state, five for derivatives and diffusion.

    An error of the state, 1e-9 a radian with order five, turns the phase of a long record by more than its
    many samples leave open; of the derivatives it is of no account.
    """
    size, here = field.size, front.here
    start = np.concatenate([here.y[:, None], front.derivative, front.diffusion], axis=1)

    def slopes(table: Array, part: float) -> Array:
        at = replace(here, y=table[:, 0], tau=here.tau + part * step)
        rates, by_state, by_parameter = field.derivatives(at)
        slope = np.empty_like(table)
        slope[:, 0] = rates
        slope[:, 1:] = np.einsum("abn,bcn->acn", by_state, table[:, 1:])
        slope[:, 1 + size : -size] += by_parameter
        slope[:, -size:] += slope[:, -size:].swapaxes(0, 1).copy()
        slope[1, -size + 1] += ~here.stuck
        return slope

    end = _runge_kutta(RK45, slopes, start, step)
    return Front(_stepped_state(field, here, step), end[:, 1:-size], end[:, -size:])


def _stepped_state(field: VectorField, here: Instants, step: Array) -> Instants:
    """The state alone, by the same step."""

    def rates(y: Array, part: float) -> Array:
        return field.rates(replace(here, y=y, tau=here.tau + part * step))

    return replace(here, y=_runge_kutta(DOP853, rates, here.y, step), tau=here.tau + step)


def _runge_kutta(
    method: type[RK45] | type[DOP853], slope: Callable[[Array, float], Array], start: Array, step: Array
) -> Array:
    """One explicit step (Hairer, Norsett and Wanner 1993) of values (..., instant); `slope(values, part)`."""
    stages = method.n_stages
    slopes = np.empty((stages, start.size))
    for i in range(stages):
        ahead = (method.A[i, :i] @ slopes[:i]).reshape(start.shape)
        slopes[i] = slope(start + step * ahead, method.C[i]).ravel()
    return np.asarray(start + step * (method.B @ slopes).reshape(start.shape))


def _first_crossing(field: VectorField, here: Instants, step: Array) -> Array:
    """Length of the step just beyond the first surface that it passes."""

    def side(part: Array, at: Array) -> Array:
        start = here.at(at.astype(int))
        value = np.min(sides(field, _stepped_state(field, start, part)), axis=0) + TOUCHED
        # A motion that starts on a surface has not passed it there.
        return np.asarray(np.where(part == 0.0, np.maximum(value, TOUCHED), value))

    numbers = np.arange(len(step), dtype=float)
    crossing = elementwise.find_root(
        side, (np.zeros_like(step), step), args=(numbers,), tolerances={"xatol": 1e-15}
    )
    return np.asarray(crossing.bracket[1])


def _with(front: Front, at: Index, part: Front) -> Front:
    """The front with some intervals replaced."""
    here, new = front.here, part.here
    y, tau, signs, stuck = here.y.copy(), here.tau.copy(), here.signs.copy(), here.stuck.copy()
    y[:, at], tau[at], signs[:, at], stuck[at] = new.y, new.tau, new.signs, new.stuck
    derivative, diffusion = front.derivative.copy(), front.diffusion.copy()
    derivative[..., at], diffusion[..., at] = part.derivative, part.diffusion
    return Front(Instants(y, tau, signs, stuck), derivative, diffusion)
