"""Solid and viscous friction from the decay of the energy (Rigaud et al. 2010)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.classical import identified, law_of_forces, needed, one_record

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EnergyDecay:
    """Solid friction lambda (rad) and damping ratio zeta from dE/dt, E = a^2/2, and the frequency.

    Parameters
    ----------
    correct : whether the bias of half-sines and averaging is removed (see `indirect.find`).

    Notes
    -----
    dE/dt = -(2/pi) w lambda sqrt(2 E) - 2 w zeta E.
    """

    ASSUMES: ClassVar[str] = "weak solid and viscous friction and a linear spring, nothing else"

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
        decay = one_record(decay, "Energy decay")
        wanted = [needed(library, formula, "Energy decay") for formula in ("sign(v)", "2*v")]
        asked = library.select(force.symbol for force in wanted)
        return identified(self, decay, asked, law_of_forces(asked, _energy_rates, _values), library)


def _energy_rates(extremum: Array, time: Array) -> tuple[Array, Array]:
    before, after = extremum[:-2], extremum[2:]
    twice = 0.25 * (before + after) ** 2
    rate = 0.5 * (after**2 - before**2) / (time[2:] - time[:-2])
    return np.stack([-2.0 / np.pi * np.sqrt(twice), -twice], axis=1), rate


def _values(unknown: Array) -> Array:
    """From w lambda, w zeta and half a period (s) to lambda, zeta, w."""
    w = float(np.hypot(np.pi / unknown[2], unknown[1]))
    return np.array([unknown[0] / w, unknown[1] / w, w])
