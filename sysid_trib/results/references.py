"""Changes of an identification: the frequency without contact as its reference, errors of a calibration."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.forces.notation import signal_powers
from sysid_trib.results import kinds, models, schema, variables

Result = TypeVar("Result", xr.Dataset, xr.DataTree)


def stated_covariance(result: xr.Dataset, kept: Sequence[str]) -> Array:
    """Return the stated covariance of a method, of the coefficients and the asymptotic frequency."""
    symbols = list(kept)
    count = len(kept)
    covariance = np.empty((count + 1, count + 1))
    covariance[:count, :count] = result.covariance.sel(force=symbols, other_force=symbols)
    covariance[count, :count] = covariance[:count, count] = result.frequency_covariance.sel(force=symbols)
    covariance[count, count] = result.asymptotic_frequency_standard_error.item() ** 2
    return covariance


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

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> with_alpha = st.physics.with_contactless_frequency(result, omega0=8.87, standard_error=0.01)
    >>> with_alpha.coefficient.sel(force="alpha").round(3).item(), round((9.90945 / 8.87) ** 2 - 1.0, 3)
    (0.248, 0.248)
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
    With s x in place of x, the coefficient of a force of degree p in x is s^(1-p) c: its relative error is
    |1 - p| times that of s, and the errors of two forces are fully correlated.
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
