"""Whether the coefficients of several windows of a decay are the same."""

import numpy as np
import xarray as xr
from scipy.stats import chi2, norm

from sysid_trib.arrays import Array
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable, with_error


def separate_windows(starts: Array, length: float) -> Array:
    """The windows, from the first on, that share no sample, as true and false.

    Parameters
    ----------
    starts : (window,) array of float, s
        Their first times, rising.
    length : float, s
        Length of a window.
    """
    chosen = np.zeros(starts.size, dtype=bool)
    end = -np.inf
    for i, start in enumerate(starts):
        if start >= end - 1e-6 * length:
            chosen[i], end = True, start + length
    return chosen


def constancy(table: xr.Dataset) -> Variables:
    """Tests of a constant coefficient over the windows that share no sample: chi-square, slope in time.

    Parameters
    ----------
    table : Dataset
        See `sliding_coefficients`.
    """
    usable = table.apart.values & table.decided.values
    c, error = table.coefficient.values[usable], table.standard_error.values[usable]
    count, t = int(usable.sum()), table.window_time.values[usable]
    with np.errstate(all="ignore"):
        weight = 1.0 / error**2
        mean = (weight * c).sum(axis=0) / weight.sum(axis=0)
        square = (weight * (c - mean) ** 2).sum(axis=0)
        away = t[:, None] - (weight * t[:, None]).sum(axis=0) / weight.sum(axis=0)
        moment = (weight * away**2).sum(axis=0)
        trend, trend_error = (weight * away * c).sum(axis=0) / moment, 1.0 / np.sqrt(moment)
    enough = count > 1
    p_value = chi2.sf(square, count - 1) if enough else np.full(square.shape, np.nan)
    trend_p = 2.0 * norm.sf(np.abs(trend / trend_error)) if enough else np.full(square.shape, np.nan)
    return {
        "mean_coefficient": variable("force", mean, "weighted mean of the coefficient", PER_FORCE_UNIT),
        "chi_square": variable("force", square, "chi-square of a constant coefficient", "1"),
        "p_value": variable("force", p_value, "p-value of a constant coefficient", "1"),
        **with_error("trend", "force", (trend, trend_error), "slope of the coefficient in time", "per s"),
        "trend_p_value": variable("force", trend_p, "p-value of no slope", "1"),
        "degrees_of_freedom": variable((), max(count - 1, 0), "degrees of freedom of each chi-square", "1"),
    }
