"""Signatures of forces: their averages <h sin phi> and <h cos phi> over a cycle x = a cos phi, v = -a sin phi.

The first drives the envelope, the second the frequency (Le Bot et al. 2019, Appendix).
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import elementwise

from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces import Force
from sysid_trib.formulas import evaluate_tree

Array = NDArray[np.float64]
QUARTER = 0.5 * np.pi
# On half a cycle: odd, so that the quarter point, where x changes sign, is one of them.
SAMPLES = 97
# A piece is accepted when doubling its nodes changes it by less than this part of the mean of |h|.
ACCEPTED = 3e-13
MAX_ROUNDS = 60
MAX_PIECES = 20_000
# Amplitudes averaged at once, to bound the memory used.
CHUNK = 128
MAX_CYCLES = 1000


def signature(
    force: Force,
    amplitude: ArrayLike,
    shapes: Mapping[str, float] | None = None,
    *,
    time: ArrayLike = 0.0,
) -> xr.Dataset:
    """Averages of a force over a cycle, by which it acts on envelope and frequency.

    Parameters
    ----------
    force : a force or sensor of a library.
    amplitude : a (rad), a number or one row of them, not negative.
    shapes : shape parameters, `{"dahl.s": 0.02}`; defaults where left out.
    time : t of the formula (s), one or as many as amplitudes; held during the cycle.

    Returns
    -------
    Dataset with `sine` = <h sin phi> and `cosine` = <h cos phi> (rad), over `amplitude` if it is a row.
    da/d(w t) = coefficient * sine; relative frequency shift = coefficient * cosine / a. A force with a past
    is averaged over its steady cycle.

    Raises
    ------
    UsageError
        An amplitude that is not a finite angle >= 0.
    LibraryError
        The force is not finite on the cycle, or has no steady cycle.
    """
    a = np.asarray(amplitude, dtype=float)
    if a.ndim > 1:
        raise UsageError("The amplitude of a signature must be a number or one row of numbers.")
    sine, cosine = averages(force, np.atleast_1d(a), shapes, time)
    dims = ("amplitude",) * a.ndim
    values = {"sine": sine.reshape(a.shape), "cosine": cosine.reshape(a.shape)}
    names = {"sine": "mean of h sin phi", "cosine": "mean of h cos phi"}
    return xr.Dataset(
        {k: (dims, value, {"units": "rad", "long_name": names[k]}) for k, value in values.items()},
        {"amplitude": (dims, a, {"units": "rad", "long_name": "amplitude of the cycle"})},
        {"force": force.symbol, "formula": force.formula.text},
    )


def averages(
    force: Force,
    amplitude: Array,
    shapes: Mapping[str, float] | None = None,
    time: ArrayLike = 0.0,
) -> tuple[Array, Array]:
    """`signature` on plain arrays: (sine, cosine), each as long as `amplitude` (rad)."""
    a = np.asarray(amplitude, dtype=float)
    if not (np.all(np.isfinite(a)) and np.all(a >= 0)):
        raise UsageError(f"Force '{force.symbol}': amplitudes must be finite angles >= 0 (rad).")
    if force.degree is not None:
        unit = _unit_averages(force)
        scale = a**force.degree
        return unit[0] * scale, unit[1] * scale
    shape_values = force.shape_values(shapes)
    times = np.broadcast_to(np.asarray(time, dtype=float), a.shape)
    cuts = range(CHUNK, a.size, CHUNK)
    parts = [_averages(force, *rows, shape_values) for rows in zip(np.split(a, cuts), np.split(times, cuts), strict=True)]
    sine, cosine = zip(*parts, strict=True)
    return np.concatenate(sine), np.concatenate(cosine)


def lost_power(
    force: Force,
    amplitude: ArrayLike,
    shapes: Mapping[str, float] | None = None,
    *,
    time: ArrayLike = 0.0,
) -> Array:
    """Mean power <h v> = -a <h sin phi> (rad^2) taken from the cycle by a unit coefficient; >0 is a loss."""
    a = np.atleast_1d(np.asarray(amplitude, dtype=float))
    return np.asarray(-a * averages(force, a, shapes, time)[0]).reshape(np.shape(amplitude))


@lru_cache(maxsize=1024)
def _unit_averages(force: Force) -> tuple[float, float]:
    """Averages at a = 1, from which those of a homogeneous force follow by scaling."""
    sine, cosine = _averages(force, np.ones(1), np.zeros(1), {})
    return float(sine[0]), float(cosine[0])


def _averages(force: Force, a: Array, time: Array, shape_values: Mapping[str, float]) -> tuple[Array, Array]:
    hidden = _steady_memory(force, a, time, shape_values)
    # Rows are half cycles, the first of each amplitude (v < 0) before all the second ones (v > 0).
    rows: dict[str, Any] = {"a": np.tile(a, 2), "t": np.tile(time, 2), **hidden}
    halves = np.repeat((0.0, np.pi), a.size)
    piece, low, high = _pieces(force, rows, halves, shape_values)
    sums = _integrals(force, rows, (piece, low, high), shape_values)
    mean = (sums[: a.size] + sums[a.size :]) / (2 * np.pi)
    return mean[:, 0], mean[:, 1]


def _steady_memory(
    force: Force, a: Array, time: Array, shape_values: Mapping[str, float]
) -> dict[str, Array]:
    """Values that the memory holds in each half of the steady cycle, after x = a and after x = -a."""
    if not force.memory:
        return {}
    here: dict[str, Any] = {"x": a, "v": np.zeros_like(a), "t": time, **shape_values}
    held = dict.fromkeys(force.memory, np.zeros_like(a))
    held |= {k: np.broadcast_to(f.evaluate(here), a.shape) for k, f in force.start.items()}

    def replaced(held: dict[str, Array], x: Array) -> dict[str, Array]:
        names = here | {"x": x} | held
        return {k: np.broadcast_to(f.evaluate(names), a.shape) for k, f in force.memory.items()}

    for _ in range(MAX_CYCLES):
        first = replaced(held, a)
        second = replaced(first, -a)
        if all(np.allclose(second[k], held[k], rtol=1e-15, atol=1e-15) for k in held):
            return {k: np.concatenate((first[k], second[k])) for k in held}
        held = second
    raise LibraryError(f"Force '{force.symbol}': its memory never settles to a steady cycle; it has no signature.")


def _names(
    rows: Mapping[str, Array], index: NDArray[np.intp], phi: Array, shape_values: Mapping[str, float]
) -> dict[str, Any]:
    """Variables of the formulas at the angles `phi` of the rows `index` (same shapes, or broadcast)."""
    names: dict[str, Any] = {k: value[index] for k, value in rows.items()}
    a = names.pop("a")
    cosine, sine = np.cos(phi), np.sin(phi)
    # A surface x or v is crossed exactly at the quarter points: no root has to be sought there.
    cosine[np.abs(cosine) < 1e-15], sine[np.abs(sine) < 1e-15] = 0.0, 0.0
    return names | {"x": a * cosine, "v": -a * sine, **shape_values}


def _pieces(
    force: Force, rows: Mapping[str, Array], halves: Array, shape_values: Mapping[str, float]
) -> tuple[NDArray[np.intp], Array, Array]:
    """Cut each row at its quarter point and where a switching surface is crossed: (row, low, high)."""
    phi = halves[:, None] + np.linspace(0.0, np.pi, SAMPLES)
    every = np.arange(halves.size)
    names = _names(rows, every[:, None], phi, shape_values)
    cut_row, cut_at = [every, every, every], [halves, halves + QUARTER, halves + np.pi]
    for surface in force.surfaces:
        with np.errstate(all="ignore"):
            sides = np.sign(np.broadcast_to(evaluate_tree(surface.tree, names), phi.shape))
        row, left = np.nonzero(sides[:, :-1] * sides[:, 1:] < 0)
        if row.size:
            cut_row.append(row)
            bracket = (phi[row, left], phi[row, left + 1])
            cut_at.append(_crossings(surface.tree, rows, row, bracket, shape_values))
    row, at = np.concatenate(cut_row), np.concatenate(cut_at)
    order = np.lexsort((at, row))
    row, at = row[order], at[order]
    inside = (row[:-1] == row[1:]) & (at[:-1] < at[1:])
    return row[:-1][inside], at[:-1][inside], at[1:][inside]


def _crossings(
    tree: Any,
    rows: Mapping[str, Array],
    row: NDArray[np.intp],
    bracket: tuple[Array, Array],
    shape_values: Mapping[str, float],
) -> Array:
    def side(phi: Array, row: Array) -> Array:
        return np.asarray(evaluate_tree(tree, _names(rows, row.astype(int), phi, shape_values)))

    found = elementwise.find_root(side, bracket, args=(row.astype(float),))
    return np.asarray(found.x)


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


def _integrals(
    force: Force,
    rows: Mapping[str, Array],
    pieces: tuple[NDArray[np.intp], Array, Array],
    shape_values: Mapping[str, float],
) -> Array:
    """Integrals of (h sin phi, h cos phi) over each row, pieces being halved until they are exact."""
    nodes, weights = _nodes()
    row, low, high = pieces
    total = np.zeros((rows["a"].size, 2))
    size, settled = np.zeros((2, rows["a"].size))
    for _ in range(MAX_ROUNDS):
        phi = low[:, None] + (high - low)[:, None] * nodes
        with np.errstate(all="ignore"):
            h = force.formula.evaluate(_names(rows, row[:, None], phi, shape_values))
        h = np.broadcast_to(h, phi.shape) * (weights * (high - low)[:, None])
        terms = np.stack((h * np.sin(phi), h * np.cos(phi)), axis=-1)
        fine, coarse = terms.sum(axis=1), 2.0 * terms[:, ::2].sum(axis=1)
        if not np.all(np.isfinite(fine)):
            worst = rows["a"][row[~np.isfinite(fine).all(axis=1)]].min()
            raise LibraryError(f"Force '{force.symbol}' is not finite on a cycle of amplitude {worst:.6g} rad.")
        # Seen anew at every turn: the first one may miss a narrow peak.
        size = np.maximum(size, settled + np.bincount(row, np.abs(h).sum(axis=1), size.size))
        done = np.all(np.abs(fine - coarse) <= ACCEPTED * size[row, None], axis=1)
        np.add.at(total, row[done], fine[done])
        settled += np.bincount(row[done], np.abs(h[done]).sum(axis=1), size.size)
        if done.all():
            return total
        if done.size > MAX_PIECES:
            break
        row, low, high = (np.repeat(side[~done], 2) for side in (row, low, high))
        middle = 0.5 * (low + high)
        low[1::2], high[::2] = middle[1::2], middle[::2]
    raise LibraryError(f"Force '{force.symbol}' is too rough to be averaged over a cycle.")
