"""Calibration error of the signal in the laws of an identification."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.results import references
from sysid_trib.results.law_curves import VARIABLE_OF_LAW
from sysid_trib.results.variables import described
from sysid_trib.smooth_laws.bands import band


def with_scale_error(result: references.Result, relative_error: float) -> references.Result:
    """Return an identification whose errors, also in its laws, include the signal's calibration error.

    Parameters
    ----------
    result : Dataset or DataTree
        An identification, or a result that contains some.
    relative_error : float
        Relative standard error of the signal's calibration factor, such as 0.003.

    Returns
    -------
    Dataset or DataTree
        As from `results.references.with_scale_error`; the errors and bands of `friction(speed)` and
        `restoring(displacement)` include the calibration error, and `friction_error_of_calibration`, ...,
        contains it alone.

    Raises
    ------
    UsageError
        The error is not between 0 and 1.

    Notes
    -----
    With s x in place of x, a law F(v) becomes s F(v/s): its error is the error of s times F - v F', fully
    correlated over all speeds. A law proportional to v has no such error.

    Examples
    --------
    A dimensionless coefficient such as zeta does not depend on the signal's scale, delta does.

    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> scaled = st.physics.with_scale_error(result, relative_error=0.05)
    >>> (scaled.standard_error / result.standard_error).sel(force=["zeta", "delta"]).round(1).values.tolist()
    [1.0, 4.4]
    """
    whole = references.with_scale_error(result, relative_error)
    if isinstance(whole, xr.DataTree):
        groups = {
            node.path: _with_laws(node.to_dataset(inherit=False), relative_error) for node in whole.subtree
        }
        return xr.DataTree.from_dict(groups)
    return _with_laws(whole, relative_error)


def _with_laws(result: xr.Dataset, relative_error: float) -> xr.Dataset:
    for law, variable in VARIABLE_OF_LAW.items():
        if f"{law}_covariance" not in result:
            continue
        places, values = result[variable].values, result[law].values
        by_scale = relative_error * (values - places * slope(places, values))
        covariance = result[f"{law}_covariance"].values + np.outer(by_scale, by_scale)
        changed = band(law, values, covariance, result[f"{variable}_visited"].values)
        changed |= {f"{law}_covariance": covariance, f"{law}_error_of_calibration": np.abs(by_scale)}
        described_here = described("laws", changed)
        for name in described_here:
            units = result[f"{law}_covariance" if name.endswith("covariance") else law].attrs["units"]
            described_here[name][2]["units"] = units
        result = result.assign(described_here)
    return result


def slope(places: Array, values: Array) -> Array:
    """Return the derivative of a law at its places, computed separately for each sign.

    Parameters
    ----------
    places, values : (place,) array of float
        Friction may be discontinuous between negative and positive speeds.
    """
    derivative = np.zeros_like(values)
    for side in (places < 0.0, places > 0.0):
        if np.count_nonzero(side) > 1:
            derivative[side] = np.gradient(values[side], places[side], edge_order=1)
    return derivative
