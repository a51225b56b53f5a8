"""The error of the signal's calibration in the laws of an identification."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.results import references
from sysid_trib.results.law_curves import VARIABLE_OF_LAW
from sysid_trib.results.variables import described
from sysid_trib.smooth_laws.bands import band


def with_scale_error(result: references.Result, relative_error: float) -> references.Result:
    """Return an identification whose errors, also those of its laws, hold that of the signal's calibration.

    Parameters
    ----------
    result : Dataset or DataTree
        An identification, or a result that holds some.
    relative_error : float
        Standard error of the factor by which the signal was calibrated, over the factor: 0.003.

    Returns
    -------
    Dataset or DataTree
        As `results.references.with_scale_error`; `friction(speed)` and `restoring(displacement)` have their
        errors and bands with that of the calibration in them, and `friction_error_of_calibration`, ..., its
        part.

    Raises
    ------
    UsageError
        No error from 0 to 1.

    Notes
    -----
    With s x in the place of x a law F(v) is s F(v/s): its error is that of s times F - v F', wholly
    correlated over all speeds. A law that is proportional to v has none.
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
    """Return the derivative of a law at its places; that of each sign is taken by itself.

    Parameters
    ----------
    places, values : (place,) array of float
        Friction may jump between negative and positive speeds.
    """
    derivative = np.zeros_like(values)
    for side in (places < 0.0, places > 0.0):
        if np.count_nonzero(side) > 1:
            derivative[side] = np.gradient(values[side], places[side], edge_order=1)
    return derivative
