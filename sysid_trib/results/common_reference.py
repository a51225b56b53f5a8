"""The numbers of an identification in which it is compared: coefficients at one reference, and w_inf."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array

ASYMPTOTIC_FREQUENCY = "asymptotic frequency"


def in_model(result: xr.Dataset, symbol: str) -> bool:
    """Whether a coefficient refers to the identification's own reference frequency."""
    return bool(np.isclose(result.refers_to.sel(force=symbol), result.reference_frequency, rtol=1e-12))


def is_constrained(result: xr.Dataset, symbol: str) -> bool:
    """Whether a coefficient is fixed, tied or at a bound: it adds no difference of its own."""
    return "constraint" in result.coords and bool(result.constraint.sel(force=symbol).item())


def comparable(*results: xr.Dataset) -> list[str]:
    """Symbols of the forces in which identifications are compared, in the first's order.

    Each has them in its model, and one at least leaves them free.
    """
    return [
        symbol
        for symbol in results[0].force.values.tolist()
        if all(symbol in r.force and in_model(r, symbol) for r in results)
        and not all(is_constrained(r, symbol) for r in results)
    ]


def comparison_values(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Coefficients at one reference frequency, and the asymptotic frequency.

    Parameters
    ----------
    result : Dataset
        An identification.
    kept : sequence of str
        Symbols of the forces.
    frequency : float, rad/s
        The reference frequency.
    """
    coefficients = result.coefficient.sel(force=list(kept)).values
    return np.append(
        coefficients * reference_factors(result, kept, frequency), result.asymptotic_frequency.item()
    )


def reference_factors(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Factors of coefficients to a reference frequency (rad/s); 1 for forces that keep their own.

    See `rescaling_factors`.
    """
    degrees = result.speed_degree.sel(force=list(kept)).values
    factors = (result.reference_frequency.item() / frequency) ** (2.0 - degrees)
    return np.asarray(np.where(np.isnan(degrees), 1.0, factors))


def stated_covariance(result: xr.Dataset, kept: Sequence[str]) -> Array:
    """Covariance that a method states, of the coefficients and the asymptotic frequency."""
    symbols, count = list(kept), len(kept)
    covariance = np.empty((count + 1, count + 1))
    covariance[:count, :count] = result.covariance.sel(force=symbols, other_force=symbols)
    covariance[count, :count] = covariance[:count, count] = result.frequency_covariance.sel(force=symbols)
    covariance[count, count] = result.asymptotic_frequency_standard_error.item() ** 2
    return covariance


def comparison_covariance(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Covariance of `comparison_values`: a coefficient that is converted has the frequency's error too."""
    factors, count = reference_factors(result, kept, frequency), len(kept)
    jacobian = np.diag(np.append(factors, 1.0))
    if result.reference_frequency_standard_error.item() > 0.0:
        power = np.nan_to_num(2.0 - result.speed_degree.sel(force=list(kept)).values)
        converted = factors * result.coefficient.sel(force=list(kept)).values
        # The reference and the asymptotic frequency change together.
        jacobian[:count, count] = power * converted / result.asymptotic_frequency.item()
    return np.asarray(jacobian @ stated_covariance(result, kept) @ jacobian.T)
