"""Steps of a motion from given states, exact or expected.

Each interval starts at a given state (multiple shooting, Bock 1981), and the compiled engine integrates it.

If a force switches with the speed, the linear model about one path contains only one branch, although the
other may be the true one; for a body that friction nearly holds, it claims that no force moves it. The best
linear step over the distribution of the state has the mean of the ends and, because the ends are continuous
in the state, the mean of their derivatives (Stein 1981). This is statistical linearisation (Gelb 1974;
Garcia-Fernandez, Svensson and Sarkka 2017).
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from sysid_trib.arrays import Array, Index
from sysid_trib.records.roles import INPUT
from sysid_trib.simulation.model import FREQUENCY, Model, Motion, motion_of
from sysid_trib.simulation.motions import run
from sysid_trib.simulation.trajectory import bends_of, polynomials_of
from sysid_trib.simulation.under_way import MOTION_ENDS, STATE_PART, Given

# Most switchings in an interval, and most steps per unit of tau.
SWITCHINGS_ALLOWED, STEPS_ALLOWED = 60, 3000
GAUSS_POINTS, GAUSS_WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(3))
GAUSS_POINTS = GAUSS_POINTS + 0.5


class Steps(NamedTuple):
    """Exact motion over intervals, from given states at their beginnings.

    The state is x, v (rad), then the internal states of the forces, then their memory (`Motion.hidden`).

    Attributes
    ----------
    end : (step, state) array of float
        State at the end of each interval.
    transition : (step, state, start) array of float
        Derivative of the end by the beginning.
    sensitivity : (step, state, parameter) array of float
        Derivative of the end by the given parameters, at a fixed beginning (x, v, ...).
    diffusion : (step, state, state) array of float
        Covariance of the end due to a white acceleration that increases the variance of v by one per unit of
        tau; zero if not requested.
    """

    end: Array
    transition: Array
    sensitivity: Array
    diffusion: Array

    def then(self, further: "Steps") -> "Steps":
        """Return these steps followed by further ones."""
        onward = further.transition
        return Steps(
            further.end,
            onward @ self.transition,
            onward @ self.sensitivity + further.sensitivity,
            onward @ self.diffusion @ onward.swapaxes(1, 2) + further.diffusion,
        )


def steps_of(
    model: Model,
    spans: tuple[Array, Array],
    states: Array,
    by: tuple[str, ...] = (),
    *,
    diffuses: bool = False,
    by_start: int | None = None,
) -> Steps:
    """Compute a motion over intervals, each from a given state.

    Parameters
    ----------
    model : Model
        Model; the states of forces with coefficient zero are computed too.
    spans : two (interval,) arrays of float
        Beginning and length of each interval in tau.
    states : (interval, state) array of float
        States at the beginnings.
    by : tuple of str
        Parameters of the derivatives, as in `integrate`.
    diffuses : bool
        Whether the diffusion is computed: that of impulses within the interval, propagated to its end by the
        same derivatives, at Gauss's points.
    by_start : int, optional
        Number of first components of the beginnings by which the ends are differentiated; by default all.

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    tau, length = spans
    places = GAUSS_POINTS if diffuses else np.empty(0)
    motion = motion_of(model.forces, forced=INPUT in model.inputs, paced=FREQUENCY in by)
    size = 2 + len(motion.hidden)
    starts = size if by_start is None else by_start
    first = starts + len(by)
    # The start of each interval is given, with the derivatives there.
    columns = ("",) * starts + by + ("",) * len(places)
    knots, marks, points = _knots(tau, length, model.reference_frequency * bends_of(model), places)
    impulses = np.zeros((len(knots), len(columns)))
    inside = np.flatnonzero(points >= 0)
    impulses[inside, first + points[inside]] = np.sqrt(GAUSS_WEIGHTS)[points[inside]]
    given = Given(
        knots=knots,
        drives=polynomials_of(model, knots),
        increments=np.zeros((len(knots), 2)),
        marks=marks,
        impulses=impulses,
        starts=states.astype(float),
        slopes=np.pad(np.eye(size, starts), ((0, 0), (0, len(columns) - starts))),
        grid=tau + length,
        until=np.arange(1, len(tau) + 1),
    )
    values, slopes = motion.start(model, 0.0, 0.0, columns)
    whole = np.sum(1.0 + length)
    limits = int(SWITCHINGS_ALLOWED * whole), int(STEPS_ALLOWED * whole), STATE_PART
    rows, tangents, *_ = run(motion, model, columns, (values[size:], slopes[size:]), given, limits)
    by_begin, by_names, by_impulses = np.split(tangents[:, :size], [starts, first], axis=2)
    random = by_impulses * np.sqrt(length)[:, None, None]
    return Steps(rows[:, :size], by_begin, by_names, random @ random.swapaxes(1, 2))


def _knots(tau: Array, length: Array, bends: Array, places: Array) -> tuple[Array, Index, Index]:
    """Return tau and mark of each knot, and the index of its Gauss point in an interval, or -1.

    Knots are at the beginning and end of each interval, at the Gauss points, and where an input changes its
    polynomial.
    """
    count, many = len(tau), len(places)
    fractions = np.concatenate([[0.0], places, [1.0]])
    marks = np.full((count, many + 2), -1)
    marks[:, 0], marks[:, -1] = np.arange(count), MOTION_ENDS
    points = np.tile([-1, *range(many), -1], (count, 1))
    at = np.repeat(np.arange(count), many + 2)
    knots = (tau[:, None] + length[:, None] * fractions).ravel()
    first, last = np.searchsorted(bends, tau, "right"), np.searchsorted(bends, tau + length, "left")
    bent = np.maximum(last - first, 0)
    within = np.arange(bent.sum()) - np.repeat(np.cumsum(bent) - bent, bent)
    of_bend = np.repeat(np.arange(count), bent)
    at, none = np.concatenate([at, of_bend]), np.full(len(of_bend), -1)
    knots = np.concatenate([knots, bends[first[of_bend] + within]])
    marks, points = np.concatenate([marks.ravel(), none]), np.concatenate([points.ravel(), none])
    order = np.lexsort((marks == MOTION_ENDS, marks < 0, knots, at))
    return knots[order], marks[order], points[order]


def steps_over(model: Model, tau: Array, length: Array, states: Array, by: tuple[str, ...] = ()) -> Steps:
    """Return the exact motion over intervals of any length, with the diffusion (see `steps_of`).

    Parameters
    ----------
    model : Model
    tau, length : (interval,) array of float
        Beginning and length of each interval.
    states : (interval, state) array of float
        States at the beginnings.
    by : tuple of str
        Parameters of the derivatives.

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    # Limit in tau; longer intervals are divided.
    parts = np.maximum(1, np.ceil(length / 0.5).astype(int))
    whole = steps_of(model, (tau, length / parts), states, by, diffuses=True)
    for done in range(1, int(parts.max(initial=1))):
        at = np.flatnonzero(parts > done)
        part = length[at] / parts[at]
        further = steps_of(model, (tau[at] + done * part, part), whole.end[at], by, diffuses=True)
        before = Steps(*(table[at] for table in whole))
        for table, longer in zip(whole, before.then(further), strict=True):
            table[at] = longer
    return whole


# Number of speeds of equal probability that represent the normal distribution.
SPEEDS = 8
_QUANTILES = ndtri((np.arange(SPEEDS) + 0.5) / SPEEDS)
NORMAL = _QUANTILES / np.sqrt(np.mean(_QUANTILES**2))
# A speed has a certain sign if it is more than this number of standard errors from zero.
ONE_SIGN = 4.0


def expected_steps(
    model: Model, time: Array, states: Array, rate_error: Array | float, by: tuple[str, ...] = ()
) -> Steps:
    """Return the motion over each interval between samples, with v known only to a standard error.

    Parameters
    ----------
    model : Model
        Model; the states of forces with coefficient zero are computed too.
    time : (sample,) array of float, s
        Increasing times, with steps of any length.
    states : (sample, state) array of float
        x, v (rad), internal states and memory at each sample, where each interval starts.
    rate_error : float or (sample,) array of float, rad
        Standard error of v at each sample; 0 if v is known.
    by : tuple of str
        Parameters of the derivatives.

    Raises
    ------
    SimulationError
        The motion diverges between two samples, or switches without end.
    """
    w = model.reference_frequency
    tau, length = w * (time[:-1] - time[0]), w * np.diff(time)
    steps = steps_over(model, tau, length, states[:-1], by)
    if not np.any(rate_error) or "v" not in Motion(model.forces).switches:
        return steps
    v, error = states[:, 1], np.broadcast_to(rate_error, len(states))
    near = np.minimum(np.abs(v[:-1]), np.abs(v[1:])) < ONE_SIGN * error[:-1]
    unsure = np.flatnonzero(near | (v[:-1] * v[1:] <= 0.0))
    begun = np.repeat(states[None, unsure], SPEEDS, axis=0)
    begun[:, :, 1] += np.multiply.outer(NORMAL, error[unsure])
    several = np.tile(unsure, SPEEDS)
    drawn = steps_over(model, tau[several], length[several], begun.reshape(-1, states.shape[1]), by)
    for certain, tables in zip(steps, drawn, strict=True):
        certain[unsure] = np.mean(tables.reshape(SPEEDS, len(unsure), *tables.shape[1:]), axis=0)
    return steps
