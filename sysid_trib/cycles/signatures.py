"""Signatures of forces: averages <h sin phi> and <h cos phi> over a cycle x = a cos phi, v = -a sin phi.

The first drives the envelope, the second the frequency (Le Bot et al. 2019, Appendix). Together they are the
describing function of the force (Krylov-Bogoliubov averages). They are exact to rounding: a cycle is cut
where a force without history changes branch and integrated between; one with history is followed
(`steady_cycles`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.optimize import elementwise

from sysid_trib.arrays import Array, Index
from sysid_trib.cycles.steady_cycles import cycles_at
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.force import Force, ShapeValues
from sysid_trib.forces.formulas import Formula
from sysid_trib.results.variables import variable

QUARTER = 0.5 * np.pi
# So much of an average may be rounding of its formula,
ROUNDING_ERROR = 1e-6
# plus this part of the amplitude: at small ones sin(x) - x is rounding of x.
CANCELLATION = 1e-14
MAX_PIECES = 20_000


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
    if force.memoryless:
        means = _Cycles(force, a, time, shape_values).integrals() / (2 * np.pi)
    else:
        shapes = {f"{force.symbol}.{k}": float(value) for k, value in shape_values.items()}
        means = np.zeros((len(a), 3))
        for rows, cycles in cycles_at(force, a, time, shapes):
            means[rows] = cycles.integrals / (2 * np.pi)
        # The root mean square of h in the place of the mean of |h|.
        means[:, 2] = np.sqrt(means[:, 2])
    # What symmetry makes zero is zero, so that nobody takes rounding for a signature.
    # Part of the mean of |h| below which an average is rounding.
    means[np.abs(means) < 1e-14 * means[:, 2:]] = 0.0
    return means[:, 0], means[:, 1]


@dataclass
class _Cycles:
    """Cycles of a force at some amplitudes.

    Rows are half cycles, the first of each amplitude (v < 0) before all the second ones (v > 0).
    """

    force: Force
    a: Array
    time: Array
    shape_values: Mapping[str, float]

    def names(self, row: Index, phi: Array) -> dict[str, Any]:
        """Variables of the formulas at the angles `phi` of the rows (same shapes, or broadcast)."""
        a, time = self.a[row % self.a.size], self.time[row % self.a.size]
        cosine, sine = np.cos(phi), np.sin(phi)
        # A surface x or v is crossed exactly at the quarter points: no root has to be sought there.
        cosine[np.abs(cosine) < 1e-15], sine[np.abs(sine) < 1e-15] = 0.0, 0.0
        return {"t": time, "x": a * cosine, "v": -a * sine, **self.shape_values}

    def pieces(self) -> tuple[Index, Array, Array]:
        """Rows, cut at the quarter point and where a switching surface is crossed: (row, low, high)."""
        halves = np.repeat((0.0, np.pi), self.a.size)
        # On half a cycle: odd, so that the quarter point, where x changes sign, is one of them.
        phi = halves[:, None] + np.linspace(0.0, np.pi, 97)
        every = np.arange(halves.size)
        names = self.names(every[:, None], phi)
        cut_row, cut_at = [every, every, every], [halves, halves + QUARTER, halves + np.pi]
        for surface in self.force.surfaces:
            sides = np.sign(np.broadcast_to(surface.evaluate(names), phi.shape))
            row, before = np.nonzero(sides[:, :-1] * sides[:, 1:] < 0)
            if row.size:
                cut_row.append(row)
                cut_at.append(self.crossings(surface, row, phi[row, before], phi[row, before + 1]))
        row, at = np.concatenate(cut_row), np.concatenate(cut_at)
        order = np.lexsort((at, row))
        row, at = row[order], at[order]
        inside = (row[:-1] == row[1:]) & (at[:-1] < at[1:])
        return row[:-1][inside], at[:-1][inside], at[1:][inside]

    def crossings(self, surface: Formula, row: Index, low: Array, high: Array) -> Array:
        """Where a surface is crossed in a row between two angles."""

        def side(phi: Array, row: Array) -> Array:
            return np.asarray(surface.evaluate(self.names(row.astype(int), phi)))

        exact = {"xatol": 1e-15, "xrtol": 1e-15}
        root = elementwise.find_root(side, (low, high), args=(row.astype(float),), tolerances=exact)
        return np.asarray(root.x)

    def integrals(self) -> Array:
        """Integrals of (h sin phi, h cos phi, |h|) over the cycle at each amplitude, (amplitude, 3).

        Pieces are halved until they are exact.
        """
        nodes, weights = _nodes()
        row, low, high = self.pieces()
        total = np.zeros((2 * self.a.size, 3))
        before = np.full(len(total), np.inf)
        for turn in range(60):
            phi = low[:, None] + (high - low)[:, None] * nodes
            h = self.force.formula.evaluate(self.names(row[:, None], phi))
            h = np.broadcast_to(h, phi.shape) * (weights * (high - low)[:, None])
            terms = np.stack((h * np.sin(phi), h * np.cos(phi), np.abs(h)), axis=-1)
            fine, coarse = terms.sum(axis=1), 2.0 * terms[:, ::2].sum(axis=1)
            self.check_finite(fine, row)
            # The size is computed anew at every turn: the first may miss a narrow peak.
            size = total[:, 2] + np.bincount(row, fine[:, 2], len(total))
            error = np.abs(fine - coarse)[:, :2].max(axis=1)
            # A piece is accepted when doubling its nodes changes it by less than this part of the mean of
            # |h|.
            done = error <= 3e-13 * size[row]
            remaining = np.bincount(row[~done], error[~done], len(total))
            # Halving does not lessen the rounding of a formula that cancels, as log(1 + v/s) at small v does.
            rounding = remaining < ROUNDING_ERROR * size + CANCELLATION * np.tile(self.a, 2)
            rounding &= (remaining > 0.6 * before) & (turn > 2)
            done, before = done | rounding[row], remaining
            np.add.at(total, row[done], fine[done])
            if done.all():
                return total[: self.a.size] + total[self.a.size :]
            if done.size > MAX_PIECES:
                break
            row, low, high = (np.repeat(side[~done], 2) for side in (row, low, high))
            middle = 0.5 * (low + high)
            low[1::2], high[::2] = middle[1::2], middle[::2]
        raise LibraryError(f"Force '{self.force.symbol}' is too rough to be averaged over a cycle.")

    def check_finite(self, integrals: Array, row: Index) -> None:
        """Refuse an integral that is not finite, with the smallest amplitude at which that is so."""
        bad = ~np.isfinite(integrals).all(axis=1)
        if bad.any():
            worst = self.a[row[bad] % self.a.size].min()
            raise LibraryError(
                f"Force '{self.force.symbol}' is not finite on a cycle of amplitude {worst:.6g} rad."
            )


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


# Amplitudes averaged at once, to bound the memory used.
CHUNK = 128


def signature(
    force: Force, amplitude: ArrayLike, shapes: ShapeValues | None = None, *, time: ArrayLike = 0.0
) -> xr.Dataset:
    """Averages of a force over a cycle, by which it acts on envelope and frequency.

    Parameters
    ----------
    force : Force
        A force or sensor of a library.
    amplitude : float or (amplitude,) array of float, rad
        Not negative.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`; defaults where left out.
    time : float or (amplitude,) array of float, s
        t of the formula, held during the cycle.

    Returns
    -------
    Dataset
        `sine` = <h sin phi> and `cosine` = <h cos phi> (rad), over `amplitude` if it is a row.
        da/d(w t) = coefficient * sine; relative frequency shift = coefficient * cosine / a. A
        history-dependent force is averaged over its steady cycle. Inputs are zero.

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
    data = {
        "sine": variable(dims, sine.reshape(a.shape), "mean of h sin phi", "rad"),
        "cosine": variable(dims, cosine.reshape(a.shape), "mean of h cos phi", "rad"),
    }
    at = {"amplitude": variable(dims, a, "amplitude of the cycle", "rad")}
    return xr.Dataset(data, at, {"force": force.symbol, "formula": force.formula.text})


def averages(
    force: Force, amplitude: Array, shapes: ShapeValues | None = None, time: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """`signature` on plain arrays: (sine, cosine), each as long as `amplitude` (rad)."""
    a = np.asarray(amplitude, dtype=float)
    if not (np.all(np.isfinite(a)) and np.all(a >= 0)):
        raise UsageError(f"Force '{force.symbol}': amplitudes must be finite angles >= 0 (rad).")
    if a.size == 0:
        return np.zeros(0), np.zeros(0)
    if force.degree is not None:
        unit = _unit_averages(force)
        scale = a**force.degree
        return unit[0] * scale, unit[1] * scale
    # NumPy's numbers: a shape parameter of zero gives a value that is not finite, not an exception.
    shape_values = {k: np.float64(value) for k, value in force.shape_values(shapes).items()}
    # What drives is at rest.
    shape_values |= {channel.name: np.float64(0.0) for channel in force.channels}
    times = np.broadcast_to(np.asarray(time, dtype=float), a.shape)
    cuts = range(CHUNK, a.size, CHUNK)
    with np.errstate(all="ignore"):
        parts = [
            cycle_averages(force, *rows, shape_values)
            for rows in zip(np.split(a, cuts), np.split(times, cuts), strict=True)
        ]
    sine, cosine = zip(*parts, strict=True)
    return np.concatenate(sine), np.concatenate(cosine)


def dissipated_power(
    force: Force, amplitude: ArrayLike, shapes: ShapeValues | None = None, *, time: ArrayLike = 0.0
) -> Array:
    """Mean power <h v> = -a <h sin phi> (rad^2) taken from the cycle by a unit coefficient; >0 is a loss."""
    a = np.atleast_1d(np.asarray(amplitude, dtype=float))
    return np.asarray(-a * averages(force, a, shapes, time)[0]).reshape(np.shape(amplitude))


@lru_cache(maxsize=1024)
def _unit_averages(force: Force) -> tuple[float, float]:
    """Averages at a = 1, from which those of a homogeneous force follow by scaling."""
    sine, cosine = cycle_averages(force, np.ones(1), np.zeros(1), {})
    return float(sine[0]), float(cosine[0])
