"""Integrals of a force over a steady cycle x = a cos phi, v = -a sin phi, exact to rounding.

A cycle is cut where the force changes branch and integrated between. Memory is iterated over its replacements
at the reversals until it repeats itself; states are solved as a periodic system.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import elementwise

from sysid_trib.averaging.collocation import Array, Index, Panels, solve_states
from sysid_trib.errors import LibraryError
from sysid_trib.forces.force import Force
from sysid_trib.forces.formulas import Formula

Pieces = tuple[Index, Array, Array]
QUARTER = 0.5 * np.pi
# On half a cycle: odd, so that the quarter point, where x changes sign, is one of them.
HALF_CYCLE_POINTS = 97
# A piece is accepted when doubling its nodes changes it by less than this part of the mean of |h|.
INTEGRAL_TOLERANCE = 3e-13
# So much of an average may be rounding of its formula,
ROUNDING_ERROR = 1e-6
# plus this part of the amplitude: at small ones sin(x) - x is rounding of x.
CANCELLATION = 1e-14
# Part of the mean of |h| below which an average is rounding.
NEGLIGIBLE = 1e-14
MAX_BISECTIONS = 60
MAX_PIECES = 20_000
MAX_CYCLES = 500
START_PANELS = 4


def cycle_averages(
    force: Force, a: Array, time: Array, shape_values: Mapping[str, float]
) -> tuple[Array, Array]:
    """Averages over the steady cycle at each amplitude.

    Parameters
    ----------
    force : Force
    a : (amplitude,) array of float, rad
    time : (amplitude,) array of float, s
        Held during a cycle.
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
    # Rows are half cycles, the first of each amplitude (v < 0) before all the second ones (v > 0).
    rows: dict[str, Any] = {"a": np.tile(a, 2), "t": np.tile(time, 2)}
    turns: dict[str, Array] = {}
    held: dict[str, Array] = {}
    for _ in range(MAX_CYCLES):
        before, held = held, _steady_memory(force, a, time, shape_values, turns)
        pieces = _pieces(force, rows | held, shape_values)
        if not force.state:
            sums = _integrals(force, rows | held, pieces, shape_values)
            break
        sums, turns = _state_integrals(force, rows | held, pieces, shape_values)
        if not held or (before and all(_close(held[k], before[k], 1e-13) for k in held)):
            break
    else:
        raise LibraryError(f"Force '{force.symbol}': memory and states settle to no steady cycle.")
    means = (sums[: a.size] + sums[a.size :]) / (2 * np.pi)
    # What symmetry makes zero is zero, so that nobody takes rounding for a signature.
    means[np.abs(means) < NEGLIGIBLE * means[:, 2:]] = 0.0
    return means[:, 0], means[:, 1]


def _close(first: Array, second: Array, tolerance: float) -> bool:
    return bool(np.allclose(first, second, rtol=tolerance, atol=1e-15))


def _steady_memory(
    force: Force, a: Array, time: Array, shape_values: Mapping[str, float], turns: Mapping[str, Array]
) -> dict[str, Array]:
    """Values that the memory holds in each half of the steady cycle, after x = a and after x = -a.

    `turns` holds the states at the beginning of each half, zero if not known yet.
    """
    if not force.memory:
        return {}
    states = {k: turns.get(k, np.zeros(2 * a.size)) for k in force.state}
    here: dict[str, Any] = {"v": np.zeros_like(a), "t": time, **shape_values}
    ends = [here | {"x": x} | {k: z[half] for k, z in states.items()} for x, half in _halves(a)]
    start = force.start_values(ends[0])
    held = {k: start[k] * np.ones_like(a) for k in force.memory}

    def replaced(held: Mapping[str, Array], end: Mapping[str, Array]) -> dict[str, Array]:
        return {k: np.broadcast_to(f.evaluate({**end, **held}), a.shape) for k, f in force.memory.items()}

    for _ in range(MAX_CYCLES):
        first = replaced(held, ends[0])
        second = replaced(first, ends[1])
        if all(_close(second[k], held[k], 1e-15) for k in held):
            return {k: np.concatenate((first[k], second[k])) for k in held}
        held = second
    raise LibraryError(
        f"Force '{force.symbol}': its memory settles to no steady cycle, so it has no signature."
    )


def _halves(a: Array) -> tuple[tuple[Array, slice], tuple[Array, slice]]:
    """The angle at which each half of the cycle begins, and the half's rows."""
    return (a, slice(a.size)), (-a, slice(a.size, None))


def _state_integrals(
    force: Force, rows: Mapping[str, Array], pieces: Pieces, shape_values: Mapping[str, float]
) -> tuple[Array, dict[str, Array]]:
    """Integrals over the steady cycle of the states, and the states where each half begins."""
    half = np.repeat(pieces[0], START_PANELS)
    edges = np.linspace(pieces[1], pieces[2], START_PANELS + 1, axis=1)
    low, high = edges[:, :-1].ravel(), edges[:, 1:].ravel()
    count = rows["a"].size // 2
    order = np.lexsort((low, half % count))
    half, low, high = half[order], low[order], high[order]
    states = solve_states(
        force, Panels(half % count, half, low, high), lambda half, phi: _names(rows, half, phi, shape_values)
    )
    half = states.panels.segment
    names = _names(rows, half[:, None], states.tau, shape_values) | states.named(force)
    h = states.weights * force.formula.evaluate(names)
    terms = _terms(h, states.tau).sum(axis=1)
    sums = np.stack([np.bincount(half, term, 2 * count) for term in terms.T], axis=-1)
    begins = np.concatenate(([True], half[1:] != half[:-1]))
    turns = np.empty((2 * count, len(force.state)))
    turns[half[begins]] = states.at_low[begins]
    return np.asarray(sums), dict(zip(force.state, turns.T, strict=True))


def _names(
    rows: Mapping[str, Array], index: Index, phi: Array, shape_values: Mapping[str, float]
) -> dict[str, Any]:
    """Variables of the formulas at the angles `phi` of the rows `index` (same shapes, or broadcast)."""
    names: dict[str, Any] = {k: value[index] for k, value in rows.items()}
    a = names.pop("a")
    cosine, sine = np.cos(phi), np.sin(phi)
    # A surface x or v is crossed exactly at the quarter points: no root has to be sought there.
    cosine[np.abs(cosine) < 1e-15], sine[np.abs(sine) < 1e-15] = 0.0, 0.0
    return names | {"x": a * cosine, "v": -a * sine, **shape_values}


def _pieces(force: Force, rows: Mapping[str, Array], shape_values: Mapping[str, float]) -> Pieces:
    """Cut each row at its quarter point and where a switching surface is crossed: (row, low, high)."""
    halves = np.repeat((0.0, np.pi), rows["a"].size // 2)
    phi = halves[:, None] + np.linspace(0.0, np.pi, HALF_CYCLE_POINTS)
    every = np.arange(halves.size)
    names = _names(rows, every[:, None], phi, shape_values)
    cut_row, cut_at = [every, every, every], [halves, halves + QUARTER, halves + np.pi]
    for surface in force.surfaces:
        # Where a state switches is not known before it is solved; its panels close in on it.
        if surface.names & set(force.state):
            continue
        sides = np.sign(np.broadcast_to(surface.evaluate(names), phi.shape))
        row, before = np.nonzero(sides[:, :-1] * sides[:, 1:] < 0)
        if row.size:
            cut_row.append(row)
            bracket = (phi[row, before], phi[row, before + 1])
            cut_at.append(_crossings(surface, rows, row, bracket, shape_values))
    row, at = np.concatenate(cut_row), np.concatenate(cut_at)
    order = np.lexsort((at, row))
    row, at = row[order], at[order]
    inside = (row[:-1] == row[1:]) & (at[:-1] < at[1:])
    return row[:-1][inside], at[:-1][inside], at[1:][inside]


def _crossings(
    surface: Formula,
    rows: Mapping[str, Array],
    row: Index,
    bracket: tuple[Array, Array],
    shape_values: Mapping[str, float],
) -> Array:
    def side(phi: Array, row: Array) -> Array:
        return np.asarray(surface.evaluate(_names(rows, row.astype(int), phi, shape_values)))

    exact = {"xatol": 1e-15, "xrtol": 1e-15}
    return np.asarray(elementwise.find_root(side, bracket, args=(row.astype(float),), tolerances=exact).x)


@lru_cache(maxsize=1)
def _nodes() -> tuple[Array, Array]:
    """Tanh-sinh nodes and weights on (0, 1); every second node makes the rule of half as many.

    The nodes crowd at both ends, where |v|^p, a sharp Stribeck peak or a logarithm is singular
    (Takahasi and Mori 1974).
    """
    step = 1.0 / 16.0
    s = step * np.arange(-54, 55)
    u = QUARTER * np.sinh(s)
    return 1.0 / (1.0 + np.exp(-2.0 * u)), 0.5 * step * QUARTER * np.cosh(s) / np.cosh(u) ** 2


def _terms(h: Array, phi: Array) -> Array:
    return np.stack((h * np.sin(phi), h * np.cos(phi), np.abs(h)), axis=-1)


def _integrals(
    force: Force,
    rows: Mapping[str, Array],
    pieces: Pieces,
    shape_values: Mapping[str, float],
) -> Array:
    """Integrals of (h sin phi, h cos phi, |h|) over each row, pieces being halved until they are exact."""
    nodes, weights = _nodes()
    row, low, high = pieces
    total = np.zeros((rows["a"].size, 3))
    before = np.full(len(total), np.inf)
    for turn in range(MAX_BISECTIONS):
        phi = low[:, None] + (high - low)[:, None] * nodes
        h = force.formula.evaluate(_names(rows, row[:, None], phi, shape_values))
        terms = _terms(np.broadcast_to(h, phi.shape) * (weights * (high - low)[:, None]), phi)
        fine, coarse = terms.sum(axis=1), 2.0 * terms[:, ::2].sum(axis=1)
        if not np.all(np.isfinite(fine)):
            worst = rows["a"][row[~np.isfinite(fine).all(axis=1)]].min()
            raise LibraryError(
                f"Force '{force.symbol}' is not finite on a cycle of amplitude {worst:.6g} rad."
            )
        # The size is seen anew at every turn: the first one may miss a narrow peak.
        size = total[:, 2] + np.bincount(row, fine[:, 2], len(total))
        error = np.abs(fine - coarse)[:, :2].max(axis=1)
        done = error <= INTEGRAL_TOLERANCE * size[row]
        remaining = np.bincount(row[~done], error[~done], len(total))
        # Halving does not lessen the rounding of a formula that cancels, as log(1 + v/s) at small v does.
        rounding = remaining < ROUNDING_ERROR * size + CANCELLATION * rows["a"]
        rounding &= (remaining > 0.6 * before) & (turn > 2)
        done, before = done | rounding[row], remaining
        np.add.at(total, row[done], fine[done])
        if done.all():
            return total
        if done.size > MAX_PIECES:
            break
        row, low, high = (np.repeat(side[~done], 2) for side in (row, low, high))
        middle = 0.5 * (low + high)
        low[1::2], high[::2] = middle[1::2], middle[::2]
    raise LibraryError(f"Force '{force.symbol}' is too rough to be averaged over a cycle.")
