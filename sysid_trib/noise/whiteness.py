"""Whether a residual is white, whatever its size."""

import numpy as np
from scipy.stats import chi2

from sysid_trib.arrays import Array

# Autocorrelations that are looked at.
MOST_LAGS = 20
# Level at which a residual is not white.
WHITE_LEVEL = 1e-3


def white_p_value(residual: Array) -> float:
    """P-value that numbers, (sample,), are white: their first autocorrelations (Ljung and Box 1978)."""
    count = len(residual)
    lags = np.arange(1, min(MOST_LAGS, count // 4) + 1)
    size = float(residual @ residual)
    if not len(lags) or size == 0.0:
        return 1.0
    r = np.array([residual[:-lag] @ residual[lag:] for lag in lags]) / size
    return float(chi2.sf(count * (count + 2.0) * np.sum(r**2 / (count - lags)), len(lags)))
