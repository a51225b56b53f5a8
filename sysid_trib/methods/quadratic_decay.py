"""Quadratic friction from the hyperbolic decay (Majdoub et al. 2015)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.classical import identified, law_of_forces, needed, one_record

Array = NDArray[np.float64]


@dataclass(frozen=True)
class QuadraticDecay:
    """Quadratic friction delta from the linear growth of 1/a, and the frequency.

    Parameters
    ----------
    correct : whether the bias of half-sines and averaging is removed (see `indirect.find`).

    Notes
    -----
    d(1/a)/dt = (4/(3 pi)) w delta.
    """

    ASSUMES: ClassVar[str] = "weak quadratic friction and a linear spring, nothing else"

    correct: bool = True

    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the force of formula `v*abs(v)` of `library` from a decay with `angle(time)`.

        Raises
        ------
        DecayError
            The library lacks that force, or the decay has too few half periods.
        UsageError
            Several decays.
        """
        decay = one_record(decay, "Quadratic decay")
        drag = needed(library, "v*abs(v)", "Quadratic decay")
        asked = library.select([drag.symbol])
        return identified(self, decay, asked, law_of_forces(asked, _growth, _values), library)


def _growth(extremum: Array, time: Array) -> tuple[Array, Array]:
    return 4.0 / (3.0 * np.pi) * np.diff(time)[:, None], np.diff(1.0 / extremum)


def _values(unknown: Array) -> Array:
    """From w delta and half a period (s) to delta and w."""
    w = np.pi / unknown[1]
    return np.array([unknown[0] / w, w])
