"""Logarithmic decrement (Rayleigh 1877, art. 46): viscous friction from the ratio of successive extrema."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.classical import identified, law_of_forces, needed, one_record

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LogarithmicDecrement:
    """Damping ratio zeta from ln |X_i/X_i+1| = pi zeta/sqrt(1 - zeta^2), and the frequency.

    Parameters
    ----------
    correct : whether the bias of the half-sines is removed (see `indirect.find`).
    """

    ASSUMES: ClassVar[str] = "viscous friction and a linear spring, nothing else"

    correct: bool = True

    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the force of formula `2*v` of `library` from a decay with `angle(time)`.

        Raises
        ------
        DecayError
            The library lacks that force, or the decay has too few half periods.
        UsageError
            Several decays.
        """
        decay = one_record(decay, "Logarithmic decrement")
        viscous = needed(library, "2*v", "Logarithmic decrement")
        asked = library.select([viscous.symbol])
        return identified(self, decay, asked, law_of_forces(asked, _decrements, _values), library)


def _decrements(extremum: Array, time: Array) -> tuple[Array, Array]:
    return np.full((len(time) - 1, 1), np.pi), -np.diff(np.log(extremum))


def _values(unknown: Array) -> Array:
    """From zeta/sqrt(1 - zeta^2) and half a period (s) to zeta and w."""
    stretch = np.hypot(1.0, unknown[0])
    return np.array([unknown[0] / stretch, np.pi / unknown[1] * stretch])
