"""The motion from each sample to the next, exact and with its derivatives.

Each interval starts at a state that is given (multiple shooting, Bock 1981), and is followed by the compiled
engine. What a random force adds is the covariance of impulses within the interval, carried to its end by the
same derivatives, at Gauss's points.
"""

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.simulation.engine_state import INTERVAL_ENDS, Given
from sysid_trib.simulation.integrate import DIVERGED, FREQUENCY, begun, run
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.program import PUSH_NUMBERS, program_of
from sysid_trib.simulation.pushes import polynomials_of
from sysid_trib.state_space.steps import Steps

# In tau; longer intervals are followed in parts.
LONGEST_INTERVAL = 0.5
GAUSS_POINTS, GAUSS_WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(3))
GAUSS_POINTS = GAUSS_POINTS + 0.5
# In an interval, and in each unit of tau of it.
SWITCHINGS_ALLOWED, STEPS_ALLOWED = 60, 3000


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
    w, by = model.reference_frequency, (*names, FREQUENCY) if frequency else names
    return steps_over(model, w * (time[:-1] - time[0]), w * np.diff(time), states[:-1], by)


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
    parts = np.maximum(1, np.ceil(length / LONGEST_INTERVAL).astype(int))
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
    """The same of short intervals, one after the other."""
    w, known = model.reference_frequency, model.known_input
    motion, program = program_of(model.forces, pushed=known is not None, paced=FREQUENCY in by)
    size, count = program.states + program.memory, len(tau)
    columns = size + len(by) + len(GAUSS_POINTS)
    at, knots, marks, points = _knots(tau, length, np.empty(0) if known is None else w * known.elapsed)
    impulses = np.zeros((len(knots), columns))
    inside = np.flatnonzero(points >= 0)
    impulses[inside, size + len(by) + points[inside]] = np.sqrt(
        GAUSS_WEIGHTS[points[inside]] * length[at[inside]]
    )
    polynomials = np.zeros((len(knots), PUSH_NUMBERS)) if known is None else polynomials_of(known, knots, w)
    # Where each interval begins is given, and so are the derivatives there.
    state = begun((motion, program), model, (0.0, 0.0), by, places=(size, columns))
    rows = np.empty((count, size + 1))
    tangents = np.empty((count, size + 1, columns))
    kicks = np.zeros((len(knots), 2))
    given = Given(tau, knots, polynomials, kicks, impulses, marks, states.astype(float), rows, tangents)
    budget = int(SWITCHINGS_ALLOWED * np.sum(1.0 + length)), int(STEPS_ALLOWED * np.sum(1.0 + length))
    if count:
        run(program, given, state, (DIVERGED, *budget), w)
    kept = np.delete(np.arange(size + 1), program.states)
    table = tangents[:, kept]
    diffusion = table[:, :, size + len(by) :]
    return Steps(
        rows[:, kept],
        table[:, :, :size].copy(),
        table[:, :, size : size + len(by)].copy(),
        diffusion @ diffusion.swapaxes(1, 2),
    )


def _knots(tau: Array, length: Array, bends: Array) -> tuple[Index, Array, Index, Index]:
    """Of each knot its interval, tau, mark, and which of Gauss's points it is, or -1.

    A knot begins and ends each interval; between are Gauss's points, and where an input bends.
    """
    count, many = len(tau), len(GAUSS_POINTS)
    fractions = np.concatenate([[0.0], GAUSS_POINTS, [1.0]])
    marks = np.full((count, many + 2), -1)
    marks[:, 0], marks[:, -1] = np.arange(count), INTERVAL_ENDS
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
    order = np.lexsort((marks == INTERVAL_ENDS, marks < 0, knots, at))
    return at[order], knots[order], marks[order], points[order]
