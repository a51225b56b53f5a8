"""Averages of a force over one cycle x = a cos phi, v = -a sin phi, exact to rounding.

The cycle of a memoryless force is cut where the force changes branch, and integrated between the cuts. A
history-dependent force is integrated until its states and memory repeat after a period; the compiled engine
integrates the cycles of all amplitudes one after another. The start of a steady cycle is found by Newton's
method on the map of a period, whose derivatives the engine provides (shooting).
"""

import ast
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, TypeAlias

import numpy as np
from scipy.optimize import elementwise

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import LibraryError, SimulationError
from sysid_trib.forces.force import Force, ShapeValues
from sysid_trib.forces.formulas import Formula
from sysid_trib.simulation.internal_states import FROZEN, begun_with, history_on_cycle, watched
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.steps import Steps, steps_of

QUARTER = 0.5 * np.pi
# Relative rounding error of the average of a formula, plus
ROUNDING_ERROR = 1e-6
# this fraction of the amplitude: at small amplitudes, sin(x) - x is the rounding error of x.
CANCELLATION = 1e-14
MAX_PIECES = 20_000
# Phase at which a cycle begins and ends: neither the angle nor its rate is zero there.
FIRST_PHASE = 1.0
PERIOD = 2.0 * np.pi
# Variables of the formulas as functions of half cycles and angles.
NamesAt: TypeAlias = Callable[[Index, Array], dict[str, Any]]


def cycle_averages(
    force: Force, a: Array, time: Array, shape_values: Mapping[str, float]
) -> tuple[Array, Array]:
    """Return averages over the steady cycle at each amplitude.

    Parameters
    ----------
    force : Force
    a : (amplitude,) array of float, rad
    time : (amplitude,) array of float, s
        Time of each cycle, constant during the cycle.
    shape_values : mapping of str to float
        Value of each shape parameter by its name in the formula.

    Returns
    -------
    sine, cosine : (amplitude,) array of float, rad
        <h sin phi> and <h cos phi>.

    Raises
    ------
    LibraryError
        The force is not finite, too rough, or has no steady cycle.
    """
    if force.memoryless:
        # Without its force, the coefficient of another force is zero.
        numbers = {**dict.fromkeys(force.uses, 0.0), **shape_values}
        means = _integrals(force, a, partial(_at_phases, a, time, numbers)) / (2 * np.pi)
    else:
        shapes = {f"{force.symbol}.{k}": float(value) for k, value in shape_values.items()}
        means = np.zeros((len(a), 3))
        for rows, _, integrals in cycles_at(force, a, time, shapes):
            means[rows] = integrals / (2 * np.pi)
        # Use the root mean square of h in place of the mean of |h|.
        means[:, 2] = np.sqrt(means[:, 2])
    # Averages that vanish by symmetry are rounding errors: set them to zero below this fraction of the mean
    # of |h|.
    means[np.abs(means) < 1e-14 * means[:, 2:]] = 0.0
    return means[:, 0], means[:, 1]


def _at_phases(
    a: Array, time: Array, shape_values: Mapping[str, float], row: Index, phi: Array
) -> dict[str, Any]:
    """Return the variables of the formulas at the angles `phi` of half cycles (same shapes, or broadcast).

    Rows are half cycles, the first of each amplitude (v < 0) before all the second ones (v > 0).
    """
    cosine, sine = np.cos(phi), np.sin(phi)
    # The surfaces x and v are crossed exactly at the quarter points: no root finding is needed there.
    cosine[np.abs(cosine) < 1e-15], sine[np.abs(sine) < 1e-15] = 0.0, 0.0
    row = row % a.size
    return {"t": time[row], "x": a[row] * cosine, "v": -a[row] * sine, **shape_values}


def _pieces(force: Force, count: int, names: NamesAt) -> tuple[Index, Array, Array]:
    """Return half cycles at amplitudes, cut at their middle and at switching surfaces: (row, low, high)."""
    halves = np.repeat((0.0, np.pi), count)
    # Points of half a cycle: an odd number, so that the quarter point, where x changes sign, is one of them.
    phi = halves[:, None] + np.linspace(0.0, np.pi, 97)
    every = np.arange(halves.size)
    there = names(every[:, None], phi)
    cut_row, cut_at = [every, every, every], [halves, halves + QUARTER, halves + np.pi]
    exact = {"xatol": 1e-15, "xrtol": 1e-15}
    for surface in force.surfaces:

        def side(phi: Array, row: Array, surface: Formula = surface) -> Array:
            return np.asarray(surface.evaluate(names(row.astype(int), phi)))

        sides = np.sign(np.broadcast_to(surface.evaluate(there), phi.shape))
        row, before = np.nonzero(sides[:, :-1] * sides[:, 1:] < 0)
        if row.size:
            ends = phi[row, before], phi[row, before + 1]
            root = elementwise.find_root(side, ends, args=(row.astype(float),), tolerances=exact)
            cut_row.append(row)
            cut_at.append(np.asarray(root.x))
    row, at = np.concatenate(cut_row), np.concatenate(cut_at)
    order = np.lexsort((at, row))
    row, at = row[order], at[order]
    inside = (row[:-1] == row[1:]) & (at[:-1] < at[1:])
    return row[:-1][inside], at[:-1][inside], at[1:][inside]


def _integrals(force: Force, a: Array, names: NamesAt) -> Array:
    """Return the integrals of (h sin phi, h cos phi, |h|) over the cycle at each amplitude, (amplitude, 3).

    Pieces are halved until their integrals are exact.
    """
    nodes, weights = _nodes()
    row, low, high = _pieces(force, a.size, names)
    total = np.zeros((2 * a.size, 3))
    before = np.full(len(total), np.inf)
    for turn in range(60):
        phi = low[:, None] + (high - low)[:, None] * nodes
        h = force.formula.evaluate(names(row[:, None], phi))
        h = np.broadcast_to(h, phi.shape) * (weights * (high - low)[:, None])
        terms = np.stack((h * np.sin(phi), h * np.cos(phi), np.abs(h)), axis=-1)
        fine, coarse = terms.sum(axis=1), 2.0 * terms[:, ::2].sum(axis=1)
        _check_finite(force, fine, a[row % a.size])
        # Compute the size again in each round: the first may miss a narrow peak.
        size = total[:, 2] + np.bincount(row, fine[:, 2], len(total))
        error = np.abs(fine - coarse)[:, :2].max(axis=1)
        # Doubling the nodes changes an accepted piece by at most this fraction of the mean of |h|.
        done = error <= 3e-13 * size[row]
        remaining = np.bincount(row[~done], error[~done], len(total))
        # Halving does not reduce the rounding error of a formula with cancellation, such as log(1 + v/s) at
        # small v.
        rounding = remaining < ROUNDING_ERROR * size + CANCELLATION * np.tile(a, 2)
        rounding &= (remaining > 0.6 * before) & (turn > 2)
        done, before = done | rounding[row], remaining
        np.add.at(total, row[done], fine[done])
        if done.all():
            return total[: a.size] + total[a.size :]
        if done.size > MAX_PIECES:
            break
        row, low, high = (np.repeat(side[~done], 2) for side in (row, low, high))
        middle = 0.5 * (low + high)
        low[1::2], high[::2] = middle[1::2], middle[::2]
    raise LibraryError(f"Force '{force.symbol}' is too rough to be averaged over a cycle.")


def _check_finite(force: Force, values: Array, amplitude: Array) -> None:
    """Raise an error for values that are not finite, with the smallest amplitude that has them."""
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        least = f"{amplitude[bad].min():.6g} rad"
        raise LibraryError(f"Force '{force.symbol}' is not finite on a cycle of amplitude {least}.")


@lru_cache(maxsize=1)
def _nodes() -> tuple[Array, Array]:
    """Return the tanh-sinh nodes and weights on (0, 1); every second node gives the rule with half as many.

    The nodes are dense at both ends, where |v|^p, a sharp Stribeck peak or a logarithm is singular (Takahasi
    and Mori 1974).
    """
    step = 1.0 / 16.0
    s = step * np.arange(-54, 55)
    u = QUARTER * np.sinh(s)
    return 1.0 / (1.0 + np.exp(-2.0 * u)), 0.5 * step * QUARTER * np.cosh(s) / np.cosh(u) ** 2


def cycles_at(
    force: Force, a: Array, time: Array, shapes: ShapeValues | None
) -> Iterator[tuple[Index, list[Force], Array]]:
    """Yield steady cycles at nonzero amplitudes, each at a constant `t`: their rows, and `steady_cycles`."""
    moves = a > 0.0
    held = time if force.holds_time else np.zeros_like(a)
    for instant in np.unique(held[moves]).tolist():
        rows = np.flatnonzero(moves & (held == instant))
        yield rows, *steady_cycles(force.counted_from(instant), a[rows], shapes)


def history_over(
    force: Force, amplitude: float, points: int, shapes: ShapeValues | None
) -> tuple[Array, dict[str, Array]]:
    """Return the phases of a steady cycle, (point,), and states and memory of a force there."""
    phase = FIRST_PHASE + PERIOD * np.arange(points) / points
    return phase, history_on_cycle(force, phase, amplitude, shapes)


def steady_cycles(force: Force, a: Array, shapes: ShapeValues | None) -> tuple[list[Force], Array]:
    """Return the periodic cycles x = a cos phi, v = -a sin phi of a history-dependent force.

    Parameters
    ----------
    force : Force
        A history-dependent force, at `t` = 0.
    a : (amplitude,) array of float, rad
        Positive amplitudes.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`.

    Returns
    -------
    begun : list of Force
        The force at each amplitude, with the states and memory that the cycle has at `FIRST_PHASE`.
    integrals : (amplitude, 3) array of float
        Integrals of h sin phi, h cos phi and h^2 over a cycle.

    Raises
    ------
    LibraryError
        The force has no steady cycle, or is not finite on one.
    """
    # Names with a space cannot be names of the force.
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
    # Derivatives of the map of a period by the states; by the memory too if there is any.
    last, by_start = np.full(len(a), np.inf), begin.shape[1] if force.memory else first
    for _ in range(60):
        begin[:, sums] = 0.0
        ends = _followed(force, model, begin, PERIOD, by_start)
        shift = ends.end[:, of_history] - begin[:, of_history]
        step = _newton_step(ends.transition[:, of_history][:, :, of_history], shift)
        size = np.maximum(np.abs(ends.end[:, of_history]).max(axis=1), a)
        change, drift = (np.abs(part).max(axis=1) / size for part in (step, shift))
        # A cycle is steady if states and memory return to their start within the first fraction of their
        # size. A state that hardly depends on its start has a larger rounding error: accept it if the
        # iteration no longer improves and the state drifts by less than the second fraction.
        if np.all((np.maximum(change, drift) <= 1e-13) | ((change >= 0.5 * last) & (drift <= 1e-9))):
            scale = np.stack([a, a, np.ones_like(a)], axis=1)
            starts = [dict(zip(names, row, strict=True)) for row in begin[:, of_history].tolist()]
            return [begun_with(force, start) for start in starts], ends.end[:, sums] / scale
        # Without an improvement by Newton's step, continue with the end of the cycle.
        begin[:, of_history] += np.where((change < last)[:, None], step, shift)
        last = change
    raise LibraryError(
        f"Force '{force.symbol}' drifts in each cycle, so it has no steady cycle and no signature."
    )


def _followed(force: Force, model: Model, begin: Array, length: float, by_start: int) -> Steps:
    """Integrate the cycles one after another."""
    spans = np.zeros(len(begin)), np.full(len(begin), length)
    try:
        ends = steps_of(model, spans, begin, by_start=by_start)
    except SimulationError:
        raise LibraryError(f"Force '{force.symbol}': its cycle could not be followed.") from None
    _check_finite(force, ends.end, np.hypot(*begin[:, :2].T))
    return ends


def _newton_step(map_: Array, shift: Array) -> Array:
    """Return the Newton step to a state that a period does not change, (amplitude, state)."""
    left, sizes, right = np.linalg.svd(np.eye(map_.shape[-1]) - map_)
    # Ignore states that a period changes by no more than this fraction.
    inverse = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 1e-12)
    return np.asarray(np.einsum("rji,rj,rkj,rk->ri", right, inverse, left, shift))


def _product(force: Force, name: str | None = None, factor: float = 1.0) -> Formula:
    """Return the formula of the force times x or v and a number, or of its square."""
    tree = force.formula.tree
    other = tree if name is None else ast.BinOp(ast.Constant(factor), ast.Mult(), ast.Name(name))
    return Formula(f"({force.formula.text}) times {name or 'itself'}", ast.BinOp(tree, ast.Mult(), other))
