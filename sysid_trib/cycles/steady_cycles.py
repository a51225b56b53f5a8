"""The steady cycle of a force that depends on history: its states and memory repeat after a period.

Cycles of all amplitudes are followed one after the other by the compiled engine. What begins a steady one is
found by Newton's method on the map of a period, whose derivatives the engine gives (shooting).
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import LibraryError, SimulationError
from sysid_trib.forces.force import Force, ShapeValues
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.library import force_counted_from
from sysid_trib.simulation.internal_states import FROZEN, begun_with, history_on_cycle, watched
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.steps import Steps, steps_of

# Where a cycle begins and ends: not where the angle or its rate is zero.
FIRST_PHASE = 1.0
PERIOD = 2.0 * np.pi


@dataclass(frozen=True)
class SteadyCycles:
    """Cycles x = a cos phi, v = -a sin phi that repeat themselves, `t` held.

    Attributes
    ----------
    force : Force
    a : (amplitude,) array of float, rad
    shapes : mapping of str to float, or None
    begin : dict of str to (amplitude,) array of float
        States and memory at `FIRST_PHASE`.
    integrals : (amplitude, 3) array of float
        Over a cycle, of h sin phi, h cos phi and h^2.
    """

    force: Force
    a: Array
    shapes: ShapeValues | None
    begin: dict[str, Array]
    integrals: Array

    def along(self, points: int) -> Iterator[tuple[Array, dict[str, Array]]]:
        """Phases and states and memory there, (point,) each, over the cycle of each amplitude."""
        phase = FIRST_PHASE + PERIOD * np.arange(points) / points
        for i, a in enumerate(self.a.tolist()):
            force = begun_with(self.force, {k: float(values[i]) for k, values in self.begin.items()})
            yield phase, history_on_cycle(force, phase, a, self.shapes)


def cycles_at(
    force: Force, a: Array, time: Array, shapes: ShapeValues | None
) -> Iterator[tuple[Index, SteadyCycles]]:
    """Steady cycles at amplitudes that are not zero, each with `t` held: their rows, and the cycles."""
    moves = a > 0.0
    if not force.holds_time:
        if moves.any():
            yield np.flatnonzero(moves), steady_cycles(force, a[moves], shapes)
        return
    for instant in np.unique(time[moves]).tolist():
        rows = np.flatnonzero(moves & (time == instant))
        yield rows, steady_cycles(force_counted_from(force, instant), a[rows], shapes)


def steady_cycles(force: Force, a: Array, shapes: ShapeValues | None) -> SteadyCycles:
    """Steady cycles of a force that depends on history.

    Parameters
    ----------
    force : Force
        Its `t` is 0.
    a : (amplitude,) array of float, rad
        Positive.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`.

    Raises
    ------
    LibraryError
        It has no steady cycle, or is not finite on one.
    """
    # Names with a space are no force's own.
    integrals = {"h sin phi": _product(force, "v", -1.0), "h cos phi": _product(force, "x", 1.0)}
    integrals["h squared"] = _product(force)
    model = watched(replace(force, state={**force.state, **integrals}), shapes, FROZEN)
    names, first = [*force.state, *force.memory], 2 + len(force.state)
    sums = np.arange(first, first + len(integrals))
    of_history = np.delete(np.arange(2, 2 + len(names) + len(sums)), sums - 2)
    values = force.start_values({"x": a, "v": 0.0 * a, "t": 0.0, **force.shape_values(shapes)})
    begin = np.zeros((len(a), 2 + len(names) + len(sums)))
    begin[:, 0] = a
    begin[:, of_history] = np.stack([np.broadcast_to(values[name], a.shape) for name in names], axis=1)
    begin = _followed(force, model, begin, PERIOD + FIRST_PHASE, 0).end
    begin[:, :2] = np.outer(a, [np.cos(FIRST_PHASE), -np.sin(FIRST_PHASE)])
    # What a period does of a small change: of a memory the columns are the last.
    last, by_start = np.full(len(a), np.inf), begin.shape[1] if force.memory else first
    for _ in range(60):
        begin[:, sums] = 0.0
        ends = _followed(force, model, begin, PERIOD, by_start)
        shift = ends.end[:, of_history] - begin[:, of_history]
        step = _newton_step(ends.transition[:, of_history][:, :, of_history], shift)
        size = np.maximum(np.abs(ends.end[:, of_history]).max(axis=1), a)
        change, drift = (np.abs(part).max(axis=1) / size for part in (step, shift))
        # What hardly forgets its start is known to rounding over what it forgets.
        # A cycle repeats itself where its states and memory come back to this part of their size.
        # A state that still moves by this part of its size after so many cycles drifts.
        if np.all((np.maximum(change, drift) <= 1e-13) | ((change >= 0.5 * last) & (drift <= 1e-9))):
            scale = np.stack([a, a, np.ones_like(a)], axis=1)
            starts = dict(zip(names, begin[:, of_history].T, strict=True))
            return SteadyCycles(force, a, shapes, starts, ends.end[:, sums] / scale)
        # Where Newton's step did no good the cycle itself goes on.
        begin[:, of_history] += np.where((change < last)[:, None], step, shift)
        last = change
    raise LibraryError(
        f"Force '{force.symbol}': it drifts at each cycle and has no steady one, no signature."
    )


def _followed(force: Force, model: Model, begin: Array, length: float, by_start: int) -> Steps:
    """One cycle after the other."""
    spans = np.zeros(len(begin)), np.full(len(begin), length)
    try:
        ends = steps_of(model, spans, begin, by_start=by_start)
    except SimulationError:
        raise LibraryError(f"Force '{force.symbol}': its cycle could not be followed.") from None
    bad = ~np.isfinite(ends.end).all(axis=1)
    if bad.any():
        amplitude = np.hypot(*begin[bad, :2].T).min()
        raise LibraryError(
            f"Force '{force.symbol}' is not finite on a cycle of amplitude {amplitude:.6g} rad."
        )
    return ends


def _newton_step(map_: Array, shift: Array) -> Array:
    """Step to what a period does not move, (amplitude, state), the least where it is not unique."""
    left, sizes, right = np.linalg.svd(np.eye(map_.shape[-1]) - map_)
    # What a period changes by no more than this part is kept as it is.
    inverse = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 1e-12)
    return np.asarray(np.einsum("rji,rj,rkj,rk->ri", right, inverse, left, shift))


def _product(force: Force, name: str | None = None, factor: float = 1.0) -> Formula:
    """The force times x or v and a number, or squared."""
    tree = force.formula.tree
    other = tree if name is None else ast.BinOp(ast.Constant(factor), ast.Mult(), ast.Name(name))
    return Formula(f"({force.formula.text}) times {name or 'itself'}", ast.BinOp(tree, ast.Mult(), other))
