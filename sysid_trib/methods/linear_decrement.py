"""Linear decrement (Lorenz 1924, Kimball 1929): solid friction from the difference of successive extrema."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.classical import identified, law_of_forces, needed, one_record

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinearDecrement:
    """Solid friction lambda (rad) from |X_i| - |X_i+1| = 2 lambda, and the frequency.

    Parameters
    ----------
    correct : whether the bias of the half-sines is removed (see `indirect.find`).
    """

    ASSUMES: ClassVar[str] = "solid friction and a linear spring, nothing else"

    correct: bool = True

    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the force of formula `sign(v)` of `library` from a decay with `angle(time)`.

        Raises
        ------
        DecayError
            The library lacks that force, or the decay has too few half periods.
        UsageError
            Several decays.
        """
        decay = one_record(decay, "Linear decrement")
        solid = needed(library, "sign(v)", "Linear decrement")
        asked = library.select([solid.symbol])
        return identified(self, decay, asked, law_of_forces(asked, _decrements, _values), library)


def _decrements(extremum: Array, time: Array) -> tuple[Array, Array]:
    return np.full((len(time) - 1, 1), 2.0), -np.diff(extremum)


def _values(unknown: Array) -> Array:
    """From lambda and half a period (s) to lambda and w, which solid friction does not change."""
    return np.array([unknown[0], np.pi / unknown[1]])
