"""The numbers of an identification in which it is compared: coefficients at one reference, and w_inf."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.results.schema import library_of
from sysid_trib.simulation.model import rescaling_factors

Array = NDArray[np.float64]

ASYMPTOTIC_FREQUENCY = "asymptotic frequency"


def in_model(result: xr.Dataset, symbol: str) -> bool:
    """Whether a coefficient refers to the identification's own reference frequency."""
    return bool(np.isclose(result.refers_to.sel(force=symbol), result.reference_frequency, rtol=1e-12))


def quantities(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Coefficients at the reference `frequency`, and the asymptotic frequency (rad/s)."""
    return np.append(
        result.coefficient.sel(force=list(kept)).values * factors(result, kept, frequency),
        result.asymptotic_frequency.item(),
    )


def factors(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Factors to the reference `frequency`; 1 for forces that keep their own (`rescaling_factors`)."""
    found = rescaling_factors(
        library_of(result).select(kept).forces, result.reference_frequency.item(), frequency
    )
    return np.asarray(np.where(np.isnan(found), 1.0, found))


def stated_covariance(result: xr.Dataset, kept: Sequence[str]) -> Array:
    """Covariance that a method states, of the coefficients and the asymptotic frequency."""
    count = len(kept)
    found = np.empty((count + 1, count + 1))
    found[:count, :count] = result.covariance.sel(force=list(kept), other_force=list(kept))
    found[count, :count] = found[:count, count] = result.frequency_covariance.sel(force=list(kept))
    found[count, count] = result.asymptotic_frequency_standard_error.item() ** 2
    return found
