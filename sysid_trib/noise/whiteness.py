"""Whether numbers are white, whatever their size: their autocorrelations (Ljung and Box 1978)."""

import numpy as np
from scipy.stats import chi2

from sysid_trib.arrays import Array, Index

# Autocorrelations that are looked at.
MOST_LAGS = 20
# Level at which a residual is not white.
WHITE_LEVEL = 1e-3


def autocorrelation(values: Array, lags: Index) -> Array:
    """Autocorrelation at some lags, (lag,), of values whose mean is left in: residuals should have none."""
    whole = float(values @ values)
    return np.array([values[lag:] @ values[:-lag] for lag in lags]) / (whole if whole > 0.0 else 1.0)


def ljung_box_p_value(correlation: Array, lags: Index, count: int) -> float:
    """P-value that so many values are white, by their autocorrelations at some lags, (lag,)."""
    statistic = count * (count + 2) * float(np.sum(correlation**2 / (count - lags)))
    return float(chi2.sf(statistic, len(lags)))


def white_p_value(residual: Array) -> float:
    """P-value that a residual, (sample,), is white; 1 of one too short to tell."""
    lags = np.arange(1, min(MOST_LAGS, len(residual) // 4) + 1)
    return ljung_box_p_value(autocorrelation(residual, lags), lags, len(residual)) if len(lags) else 1.0
