"""The contact's linear stiffness from the frequency without contact."""

import numpy as np
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.results.schema import force_labels, library_of
from sysid_trib.results.variables import with_error


def with_contactless_frequency(result: xr.Dataset, omega0: float, standard_error: float = 0.0) -> xr.Dataset:
    """Add alpha = (w_inf/w0)^2 - 1 to an identification whose frequency was fitted.

    Parameters
    ----------
    result : Dataset
        An identification.
    omega0 : float, rad/s
        Frequency of the oscillator without contact.
    standard_error : float, rad/s
        Its standard error.

    Returns
    -------
    Dataset
        The identification with one force more (the library's force of formula `x`), which refers to
        `omega0`; the others stay referred to the fitted frequency. One that has it already is returned as it
        is.

    Raises
    ------
    UsageError
        The library has no force of formula `x`.

    Notes
    -----
    Le Bot et al. 2019, Sec. 2.3; errors of both frequencies propagated to first order.
    """
    library = library_of(result, whole=True)
    force = library.role("x")
    if force is None:
        raise UsageError(
            f"Library '{library.title}' has no force of formula x, so omega0 has nothing to give."
        )
    if force.symbol in result.force:
        return result
    limit = result.asymptotic_frequency.item()
    slope = 2.0 * limit / omega0**2
    variance = (slope * result.asymptotic_frequency_standard_error.item()) ** 2
    variance += (slope * limit / omega0 * standard_error) ** 2
    with_limit = slope * result.asymptotic_frequency_standard_error.item() ** 2
    numbers = {
        "coefficient": (limit / omega0) ** 2 - 1.0,
        "standard_error": np.sqrt(variance),
        "frequency_covariance": with_limit,
        "active": True,
        "refers_to": omega0,
    }
    added = xr.Dataset(
        {name: ("force", [value]) for name, value in numbers.items()},
        {"force": [force.symbol]} | force_labels([force]),
    )
    count = result.sizes["force"]
    covariance = np.zeros((count + 1, count + 1))
    covariance[:count, :count] = result.covariance
    covariance[count, :count] = covariance[:count, count] = slope * result.frequency_covariance
    covariance[count, count] = variance
    per_force = [name for name in result.variables if result[name].dims == ("force",) and name != "force"]
    longer = xr.concat(
        [result[per_force], added], "force", combine_attrs="override", data_vars="all", coords="all"
    )
    order = [s for s in library.symbols if s in longer.force]
    rest = result.drop_vars([*per_force, "force", "other_force", "covariance"])
    whole = rest.assign(longer.data_vars).assign_coords(other_force=longer.force.values)
    whole["covariance"] = (("force", "other_force"), covariance, result.covariance.attrs)
    whole = whole.assign(
        with_error("omega0", (), (omega0, standard_error), "frequency without contact", "rad/s")
    )
    return whole.sel(force=order, other_force=order)
