"""Reference frequency of coefficients: a common one for comparison, and that without contact."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import UsageError
from sysid_trib.forces.notation import signal_powers
from sysid_trib.results import kinds, models, schema, variables
from sysid_trib.results.frequencies import asymptotic_frequency
from sysid_trib.results.models import forces_in_model as forces_in_model, in_model as in_model

Result = TypeVar("Result", xr.Dataset, xr.DataTree)
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


def stated_covariance(result: xr.Dataset, kept: Sequence[str]) -> Array:
    """Return the stated covariance of a method, of the coefficients and the asymptotic frequency."""
    symbols = list(kept)
    count = len(kept)
    covariance = np.empty((count + 1, count + 1))
    covariance[:count, :count] = result.covariance.sel(force=symbols, other_force=symbols)
    covariance[count, :count] = covariance[:count, count] = result.frequency_covariance.sel(force=symbols)
    covariance[count, count] = result.asymptotic_frequency_standard_error.item() ** 2
    return covariance


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


def _of_each(result: xr.DataTree, change: Callable[[xr.Dataset], xr.Dataset]) -> xr.DataTree:
    """Return the tree with each of its identifications changed."""
    named = kinds.identifications_of(result)
    return result.assign({name: xr.DataTree(change(own)) for name, own in named.items()})


def with_contactless_frequency(result: Result, omega0: float, standard_error: float = 0.0) -> Result:
    """Add alpha = (w_inf/w0)^2 - 1 to an identification whose frequency was fitted.

    Parameters
    ----------
    result : Dataset or DataTree
        An identification, or a result that contains some.
    omega0 : float, rad/s
        Frequency of the oscillator without contact.
    standard_error : float, rad/s
        Standard error of `omega0`.

    Returns
    -------
    Dataset or DataTree
        The same with one additional force (the library's force of formula `x`), which refers to `omega0`; the
        others still refer to the fitted frequency. An identification that has this force is returned
        unchanged.

    Raises
    ------
    UsageError
        The library has no force of formula `x`.

    Notes
    -----
    Le Bot et al. 2019, Sec. 2.3; the errors of both frequencies are propagated to first order.
    """
    if isinstance(result, xr.DataTree):
        return _of_each(result, lambda own: with_contactless_frequency(own, omega0, standard_error))
    library = models.library_of(result, whole=True)
    force = library.role("x")
    if force is None:
        raise UsageError(
            f"Library '{library.title}' has no force of formula x, so that omega0 cannot be used."
        )
    if force.symbol in result.force:
        return result
    symbols: list[str] = result.force.values.tolist()
    limit = result.asymptotic_frequency.item()
    slope = 2.0 * limit / omega0**2
    jacobian = np.diag([*np.ones(len(symbols)), slope])
    covariance = jacobian @ stated_covariance(result, symbols) @ jacobian
    covariance[-1, -1] += (slope * limit / omega0 * standard_error) ** 2
    missing = {
        "coefficient": (limit / omega0) ** 2 - 1.0,
        "standard_error": np.sqrt(covariance[-1, -1]),
        "frequency_covariance": slope * result.asymptotic_frequency_standard_error.item() ** 2,
        "active": True,
        "refers_to": omega0,
        "constraint": "",
    }
    missing |= {name: values[0] for name, (_, values, _) in schema.force_labels([force]).items()}
    order = [s for s in library.symbols if s == force.symbol or s in symbols]
    whole = result.reindex(force=order, other_force=order, fill_value=missing)
    at = [[*symbols, force.symbol].index(s) for s in order]
    whole["covariance"] = whole.covariance.copy(data=covariance[np.ix_(at, at)])
    return whole.assign(variables.described("identification", {"omega0": (omega0, standard_error)}))


def with_scale_error(result: Result, relative_error: float) -> Result:
    """Include the error of the signal's calibration in the errors of an identification.

    Parameters
    ----------
    result : Dataset or DataTree
        An identification, or a result that contains some.
    relative_error : float
        Standard error of the factor by which the signal was calibrated, over the factor: 0.003.

    Returns
    -------
    Dataset or DataTree
        The same with this error in `covariance` and `standard_error`, and with `error_of_calibration(force)`.
        Known coefficients, and forces without a degree in the signal such as `sin(x) - x`, have no such
        error.

    Raises
    ------
    UsageError
        The error is not between 0 and 1.

    Notes
    -----
    With s x in place of x, the coefficient of a force of degree p in x is s^(1-p) c: its relative error is |1
    - p| times that of s, and the errors of two forces are fully correlated.
    """
    if not 0.0 <= relative_error < 1.0:
        raise UsageError(f"The relative error of a scale is a number from 0 to 1, not {relative_error}.")
    if isinstance(result, xr.DataTree):
        return _of_each(result, lambda own: with_scale_error(own, relative_error))
    degrees = [signal_powers(force) for force in models.library_of(result)]
    powers = np.array([0.0 if degree is None else degree[""] for degree in degrees])
    known = result.standard_error.values > 0.0
    by_scale = np.where(known, powers * result.coefficient.values, 0.0) * relative_error
    covariance = result.covariance + np.outer(by_scale, by_scale)
    error = variables.described("identification", {"error_of_calibration": np.abs(by_scale)})
    whole = {"covariance": covariance, "standard_error": np.hypot(result.standard_error, by_scale)}
    return result.assign(whole | error)
