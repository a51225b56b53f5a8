"""Whether coefficients found in several windows of a decay are the same."""

import numpy as np
import xarray as xr
from scipy.stats import chi2, norm

from sysid_trib.physics.quantities import Array, Variables


def windows_apart(starts: Array, length: float) -> Array:
    """The windows, from the first on, that share no sample."""
    chosen = np.zeros(starts.size, dtype=bool)
    free = -np.inf
    for i, start in enumerate(starts):
        if start >= free - 1e-6 * length:
            chosen[i], free = True, start + length
    return chosen


def constancy(table: xr.Dataset) -> Variables:
    """Chi-square of a constant and slope in time of each coefficient, over the windows that stand apart."""
    usable = table.apart.values & (table.reason.values == "")
    c, error = table.coefficient.values[usable], table.standard_error.values[usable]
    count, t = int(usable.sum()), table.window_time.values[usable]
    with np.errstate(all="ignore"):
        weight = 1.0 / error**2
        mean = (weight * c).sum(axis=0) / weight.sum(axis=0)
        square = (weight * (c - mean) ** 2).sum(axis=0)
        away = t[:, None] - (weight * t[:, None]).sum(axis=0) / weight.sum(axis=0)
        size = (weight * away**2).sum(axis=0)
        trend, spread = (weight * away * c).sum(axis=0) / size, 1.0 / np.sqrt(size)
    enough = count > 1
    p_value = chi2.sf(square, count - 1) if enough else np.full(square.shape, np.nan)
    trend_p = 2.0 * norm.sf(np.abs(trend / spread)) if enough else np.full(square.shape, np.nan)
    told = {
        "mean_coefficient": (mean, "see the coordinate unit", "weighted mean of the coefficient"),
        "chi_square": (square, "1", "chi-square of a constant coefficient"),
        "p_value": (p_value, "1", "probability of so large a chi-square by chance"),
        "trend": (trend, "per s", "slope of the coefficient in time"),
        "trend_standard_error": (spread, "per s", "standard error of the slope"),
        "trend_p_value": (trend_p, "1", "probability of so large a slope by chance"),
    }
    found: Variables = {k: (("force",), v, {"units": u, "long_name": n}) for k, (v, u, n) in told.items()}
    freedom = {"units": "1", "long_name": "degrees of freedom of each chi-square"}
    return found | {"degrees_of_freedom": ((), max(count - 1, 0), freedom)}
