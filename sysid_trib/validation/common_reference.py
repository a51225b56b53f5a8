"""Identifications at a common reference frequency, in the quantities in which they are compared."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.results import models
from sysid_trib.results.frequencies import asymptotic_frequency
from sysid_trib.results.models import forces_in_model
from sysid_trib.results.references import stated_covariance

ASYMPTOTIC_FREQUENCY = "asymptotic frequency"


def comparable(*results: xr.Dataset) -> list[str]:
    """Return the symbols of the forces in which identifications are compared, in the first's order.

    All have these forces in their models, and at least one leaves them free: values that are fixed, tied or
    at a bound contribute no difference.
    """
    in_models = [forces_in_model(result) for result in results]
    constrained = [_constrained(result) for result in results]
    return [
        symbol
        for symbol in results[0].force.values.tolist()
        if all(symbol in forces for forces in in_models)
        and not all(symbol in forces for forces in constrained)
    ]


def held(result: xr.Dataset) -> Mask:
    """Return true if a coefficient is fixed, (force,): it is the same at every reference frequency."""
    if "constraint" not in result.coords:
        return np.zeros(result.sizes["force"], dtype=bool)
    return np.asarray(result.constraint.values == "fixed", dtype=bool)


def _constrained(result: xr.Dataset) -> list[str]:
    """Return forces whose coefficient is fixed, tied or at a bound."""
    if "constraint" not in result.coords:
        return []
    return [str(symbol) for symbol in result.force.values[result.constraint.values != ""]]


def comparison_values(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Return coefficients at one reference frequency, and the asymptotic frequency.

    Parameters
    ----------
    result : Dataset
        An identification.
    kept : sequence of str
        Symbols of the forces.
    frequency : float, rad/s
        The reference frequency.
    """
    factors = reference_factors(result, kept, frequency)
    coefficients = result.coefficient.sel(force=list(kept)).values * factors
    return np.append(coefficients, result.asymptotic_frequency.item())


def comparison_slopes(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Return the derivatives of `comparison_values` by the coefficients and the reference frequency.

    Parameters
    ----------
    result, kept, frequency
        As in `comparison_values`.

    Returns
    -------
    (quantity, force + 1) array of float
        Derivatives by the forces in the model (see `forces_in_model`), in order, and by the frequency.
    """
    symbols = forces_in_model(result)
    coefficients = result.coefficient.sel(force=symbols).values
    w = result.reference_frequency.item()
    factors = reference_factors(result, kept, frequency)
    powers = np.nan_to_num(2.0 - result.speed_degree.sel(force=list(kept)).values)
    places = [symbols.index(symbol) for symbol in kept]
    slopes = np.zeros((len(kept) + 1, len(symbols) + 1))
    slopes[np.arange(len(kept)), places] = factors
    slopes[:-1, -1] = powers * factors * coefficients[places] / w
    acting = models.library_of(result).select(symbols)
    slopes[-1] = asymptotic_frequency(acting, coefficients, w)[1]
    return slopes


def reference_factors(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Return the factors of coefficients for a reference frequency (rad/s); 1 for forces with their own.

    See `rescaling_factors`.
    """
    degrees = result.speed_degree.sel(force=list(kept)).values
    factors = (result.reference_frequency.item() / frequency) ** (2.0 - degrees)
    return np.asarray(np.where(np.isnan(degrees), 1.0, factors))


def comparison_covariance(result: xr.Dataset, kept: Sequence[str], frequency: float) -> Array:
    """Return the covariance of `comparison_values`; conversion adds the frequency's error."""
    factors = reference_factors(result, kept, frequency)
    count = len(kept)
    jacobian = np.diag(np.append(factors, 1.0))
    if result.reference_frequency_standard_error.item() > 0.0:
        power = np.nan_to_num(2.0 - result.speed_degree.sel(force=list(kept)).values)
        converted = factors * result.coefficient.sel(force=list(kept)).values
        # The reference and the asymptotic frequency change together.
        jacobian[:count, count] = power * converted / result.asymptotic_frequency.item()
    return np.asarray(jacobian @ stated_covariance(result, kept) @ jacobian.T)
