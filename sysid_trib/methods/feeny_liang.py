"""Simultaneous decrement of solid and viscous friction (Feeny & Liang 1996, Liang & Feeny 1998)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.classical import identified, law_of_forces, needed, one_record

Array = NDArray[np.float64]

# tanh(pi beta/2) of a damping ratio near one, at which nothing swings any more.
LARGEST = 1.0 - 1e-12


@dataclass(frozen=True)
class FeenyLiang:
    """Solid friction lambda (rad) and damping ratio zeta from turning points, and the frequency.

    Parameters
    ----------
    correct : whether the bias of the half-sines is removed (see `indirect.find`).

    Notes
    -----
    |X_i+1| = q |X_i| - lambda (1 + q) with q = exp(-pi beta), beta = zeta/sqrt(1 - zeta^2), is exact; it is
    solved as |X_i| - |X_i+1| = tanh(pi beta/2) (|X_i| + |X_i+1|) + 2 lambda, where the noise of a difference
    has nothing in common with that of the sum.
    """

    ASSUMES: ClassVar[str] = "solid and viscous friction and a linear spring, nothing else"

    correct: bool = True

    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of formulas `sign(v)` and `2*v` of `library` from a decay with `angle(time)`.

        Raises
        ------
        DecayError
            The library lacks one of them, or the decay has too few half periods.
        UsageError
            Several decays.
        """
        decay = one_record(decay, "Feeny and Liang's decrement")
        wanted = [needed(library, formula, "Feeny and Liang's decrement") for formula in ("sign(v)", "2*v")]
        asked = library.select(force.symbol for force in wanted)
        return identified(self, decay, asked, law_of_forces(asked, _decrements, _values), library)


def feeny_liang_decrement(turning_points: ArrayLike) -> tuple[float, float]:
    """Solid friction lambda (rad) and damping ratio zeta from exact turning points.

    Parameters
    ----------
    turning_points : (turn,) rad, angles about the equilibrium at which the motion turns; signed or not.

    Returns
    -------
    lambda (rad) and zeta.

    Raises
    ------
    DecayError
        Fewer than three, or they do not decay as these two forces have it.
    """
    extremum = np.abs(np.asarray(turning_points, dtype=float))
    if len(extremum) < 3:
        raise DecayError(f"{len(extremum)} turning points cannot decide two forces; give at least three.")
    design, target = _decrements(extremum, np.arange(len(extremum), dtype=float))
    unknown = np.linalg.lstsq(design, target, rcond=None)[0]
    if not abs(unknown[1]) < LARGEST:
        raise DecayError("The turning points do not decay as solid and viscous friction have it.")
    solid, viscous, _ = _values(np.append(unknown, 1.0))
    return float(solid), float(viscous)


def _decrements(extremum: Array, time: Array) -> tuple[Array, Array]:
    both = extremum[:-1] + extremum[1:]
    return np.column_stack([np.full(len(both), 2.0), both]), -np.diff(extremum)


def _values(unknown: Array) -> Array:
    """From lambda, tanh(pi beta/2) and half a period (s) to lambda, zeta, w."""
    beta = 2.0 / np.pi * np.arctanh(np.clip(unknown[1], -LARGEST, LARGEST))
    stretch = np.hypot(1.0, beta)
    return np.array([unknown[0], beta / stretch, np.pi / unknown[2] * stretch])
