"""Internal states of history-dependent forces along a given motion, a record's or a model's.

Memory is replaced at the reversals of the motion. States follow by Radau collocation to a given accuracy.
Where the rate of a state is linear in it, fixed steps serve for many values of the shape parameters at once.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.linalg.lapack import dtbtrs

from sysid_trib.averaging.collocation import Array, Index, Panels, solve_states
from sysid_trib.errors import DecayError, LibraryError
from sysid_trib.forces.force import Force

COLLOCATION_NODES = 4
# Below this the error of the interpolated motion rules.
STATE_TOLERANCE = 1e-8
# Radau's method of order 3 (Hairer and Wanner 1996, IV.5): stages at a third and at the end of a step. It is
# stiffly accurate: a state that follows at once is followed.
RADAU_STAGES = (1.0 / 3.0, 1.0)
RADAU_WEIGHTS = ((5.0 / 12.0, -1.0 / 12.0), (3.0 / 4.0, 1.0 / 4.0))


class GivenMotion:
    """A motion made continuous by cubics, and its reversals.

    Parameters
    ----------
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau.
    time : (sample,) array of float, s
        The `t` of formulas.
    """

    def __init__(self, tau: Array, x: Array, v: Array, time: Array) -> None:
        self.tau, self.time = tau, time
        self.x, self.v = CubicHermiteSpline(tau, x, v), CubicSpline(tau, v)
        zeros = self.v.roots(extrapolate=False)
        # Not the release itself: there the start values hold.
        self.reversals = np.unique(zeros[np.isfinite(zeros) & (zeros > tau[0] + 1e-9)])

    def names(self, tau: Array) -> dict[str, Any]:
        """Variables of the formulas that the motion gives."""
        return {"x": self.x(tau), "v": self.v(tau), "t": np.interp(tau, self.tau, self.time)}

    def segment(self, tau: Array) -> Index:
        """Number of reversals before each instant."""
        return np.searchsorted(self.reversals, tau)


def states_along(
    force: Force,
    tau: ArrayLike,
    x: ArrayLike,
    v: ArrayLike,
    shapes: Mapping[str, float] | None = None,
    *,
    time: ArrayLike = 0.0,
) -> dict[str, Array]:
    """States and memory of a force along a given motion.

    Parameters
    ----------
    force : Force
        One that does not depend on history gives an empty mapping.
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`; defaults where left out.
    time : (sample,) array of float, s
        The `t` of formulas.

    Returns
    -------
    dict of str to (sample,) array
        To be given to `Force.value` as `hidden`. The motion is interpolated by cubics; memory is replaced at
        the zeros of v so found. The first sample holds the force's `start`, else zero.

    Raises
    ------
    DecayError
        Fewer than four samples, unequal lengths, not finite, or tau not increasing.
    LibraryError
        The states or memory are not finite along this motion.
    """
    if force.memoryless:
        return {}
    tau, x, v = (np.asarray(a, dtype=float) for a in (tau, x, v))
    good = tau.ndim == 1 and tau.shape == x.shape == v.shape and tau.size >= 4
    if not (good and np.all(np.isfinite([tau, x, v])) and np.all(np.diff(tau) > 0)):
        raise DecayError(
            f"Force '{force.symbol}' depends on history: give at least four finite samples of tau, x and v, "
            "all of equal length and in order of time."
        )
    motion = GivenMotion(tau, x, v, np.broadcast_to(np.asarray(time, dtype=float), tau.shape))
    values = force.shape_values(shapes)
    start = {k: float(z) for k, z in _start(motion, force, values).items()}
    states = {k: np.full(motion.reversals.size, start[k]) for k in force.state}
    # A memory may take the value of a state, and a state may depend on the memory: each round settles at
    # least one more half period.
    for _ in range(motion.reversals.size + 2):
        memory = _memory(motion, force, values, start, states)
        if not all(np.all(np.isfinite(m)) for m in memory.values()):
            raise LibraryError(f"Force '{force.symbol}': its memory is not finite along the motion.")
        at_samples, at_reversals = _collocated(motion, force, values, start, memory)
        before, states = states, at_reversals
        settled = all(np.allclose(states[k], before[k], rtol=1e-9, atol=1e-12) for k in states)
        if settled or not (force.state and force.memory):
            break
    segment = motion.segment(tau)
    return at_samples | {k: m[segment] for k, m in memory.items()}


def values_along(motion: GivenMotion, force: Force, shapes: Sequence[Mapping[str, float]]) -> Array | None:
    """Values of a history-dependent force along a motion for many values of its shape parameters, fast.

    Parameters
    ----------
    motion : GivenMotion
        Densely sampled: a sample is a step.
    force : Force
        With states or memory.
    shapes : sequence of mapping of str to float
        Values of its shape parameters, as `{"dahl.s": 0.02}`, for each column.

    Returns
    -------
    (sample, column) array of float, or None
        None unless `is_linear_in_state`.
    """
    if not is_linear_in_state(force):
        return None
    values = {k: np.array([column[f"{force.symbol}.{k}"] for column in shapes]) for k in force.shape}
    with np.errstate(all="ignore"):
        start = {k: np.broadcast_to(z, len(shapes)) for k, z in _start(motion, force, values).items()}
        segment = motion.segment(motion.tau)
        hidden = {k: m[segment] for k, m in _memory(motion, force, values, start, {}).items()}
        for name in force.state:
            hidden[name] = _stepped(motion, force, values, start[name], hidden)
        h = force.formula.evaluate(_columns(motion, motion.tau) | values | hidden)
    return np.broadcast_to(h, (motion.tau.size, len(shapes)))


@lru_cache(maxsize=1024)
def is_linear_in_state(force: Force) -> bool:
    """Whether `values_along` can follow a force, by its formulas.

    It has at most one state, whose rate is linear in it, and no memory that depends on the state.
    """
    if len(force.state) > 1 or any(f.names & set(force.state) for f in force.memory.values()):
        return False
    for name, rate in force.state.items():
        here = force.test_points[name]
        none, first, second = (rate.evaluate(force.test_points | {name: p * here}) for p in (0.0, 1.0, -2.0))
        if not np.allclose(second - none, -2.0 * (first - none), rtol=1e-9, atol=1e-12):
            return False
    return True


def _columns(motion: GivenMotion, tau: Array) -> dict[str, Any]:
    return {k: value[:, None] for k, value in motion.names(tau).items()}


def _start(motion: GivenMotion, force: Force, shapes: dict[str, Any]) -> dict[str, Any]:
    here = {k: value[0] for k, value in motion.names(motion.tau[:1]).items()}
    return force.start_values(here | shapes)


def _memory(
    motion: GivenMotion,
    force: Force,
    shapes: dict[str, Any],
    start: Mapping[str, Any],
    states: Mapping[str, Array],
) -> dict[str, Array]:
    """Memory in each segment of the motion, (segment, ...), given the states at the reversals."""
    given = motion.names(motion.reversals) | {"v": np.zeros(motion.reversals.size)} | dict(states)
    rows = [{k: start[k] for k in force.memory}]
    for i in range(motion.reversals.size if force.memory else 0):
        names = {k: value[i] for k, value in given.items()} | shapes | rows[-1]
        rows.append({k: formula.evaluate(names) for k, formula in force.memory.items()})
    return {k: np.stack(np.broadcast_arrays(*(row[k] for row in rows))) for k in force.memory}


def _collocated(
    motion: GivenMotion,
    force: Force,
    shapes: dict[str, Any],
    start: Mapping[str, float],
    memory: Mapping[str, Array],
) -> tuple[dict[str, Array], dict[str, Array]]:
    """States at the samples and at the reversals, given the memory of each segment."""
    if not force.state:
        return {}, {}
    edges = np.unique(np.concatenate((motion.tau, motion.reversals)))
    segment = motion.segment(0.5 * (edges[:-1] + edges[1:]))
    panels = Panels(np.zeros(segment.size, dtype=np.intp), segment, edges[:-1], edges[1:])

    def names_at(segment: Index, tau: Array) -> dict[str, Any]:
        return motion.names(tau) | shapes | {k: m[segment] for k, m in memory.items()}

    first = np.array([[start[k] for k in force.state]])
    solution = solve_states(
        force, panels, names_at, start=first, nodes=COLLOCATION_NODES, tolerance=STATE_TOLERANCE
    )
    edges = np.append(solution.panels.low, solution.panels.high[-1])
    values = np.concatenate((solution.at_low, solution.values[-1:, -1]))
    sample, reversal = (np.searchsorted(edges, tau) for tau in (motion.tau, motion.reversals))
    columns = dict(zip(force.state, values.T, strict=True))
    return {k: z[sample] for k, z in columns.items()}, {k: z[reversal] for k, z in columns.items()}


def _stepped(
    motion: GivenMotion,
    force: Force,
    shapes: dict[str, Any],
    start: Array,
    memory: Mapping[str, Array],
) -> Array:
    """The only state of a force at the samples, (sample, column), by linear steps."""
    step = np.diff(motion.tau)
    ((name, rate),) = force.state.items()
    push, pull = [], []
    for part in RADAU_STAGES:
        names = (
            _columns(motion, motion.tau[:-1] + part * step) | shapes | {k: m[1:] for k, m in memory.items()}
        )
        none, unit = (rate.evaluate(names | {name: value}) for value in (0.0, 1.0))
        push.append(step[:, None] * none)
        pull.append(step[:, None] * (unit - none))
    # The rates of both stages hold both: two equations with two unknowns, of which the second ends the step.
    (a, b), (c, d) = RADAU_WEIGHTS
    first, second = a * push[0] + b * push[1], c * push[0] + d * push[1]
    diagonal, below = 1.0 - a * pull[0], c * pull[0]
    determinant = diagonal * (1.0 - d * pull[1]) - b * pull[1] * below
    factor = (diagonal + below) / determinant
    added = (diagonal * second + below * first) / determinant
    shape = (len(step), len(start))
    # Column by column: what is not finite in one leaves the others alone.
    columns = zip(start, np.broadcast_to(factor, shape).T, np.broadcast_to(added, shape).T, strict=True)
    return np.column_stack([_recurrence(*column) for column in columns])


def _recurrence(start: float, factor: Array, added: Array) -> Array:
    """y with y[0] = start and y[n + 1] = factor[n] y[n] + added[n], a triangular banded system."""
    band = np.ones((2, len(factor) + 1))
    band[1, :-1] = -factor
    solution, _ = dtbtrs(band, np.append(start, added)[:, None], uplo="L", diag="U")
    return np.asarray(solution[:, 0])
