"""Coloured noise as an autoregression, its order by the Bayesian information criterion."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

Array = NDArray[np.float64]

MAX_ORDER = 20


def autoregression(residual: Array) -> Array:
    """Coefficients (order + 1,) of the filter that whitens a residual, the first is 1.

    Yule and Walker's equations; the order minimises n log(variance) + order log(n).
    """
    n = len(residual)
    most = min(MAX_ORDER, n // 20)
    centred = residual - residual.mean()
    covariance = np.array([centred[k:] @ centred[: n - k] for k in range(most + 1)]) / n
    best, found = np.inf, np.ones(1)
    for order in range(most + 1):
        weights = solve_toeplitz(covariance[:order], covariance[1 : order + 1]) if order else np.zeros(0)
        variance = covariance[0] - weights @ covariance[1 : order + 1]
        score = n * np.log(max(variance, 1e-300)) + order * np.log(n)
        if score < best:
            best, found = score, np.concatenate([[1.0], -weights])
    return found


def whitened(values: Array, filter_: Array) -> Array:
    """Values along the first axis after the whitening filter, without the first that have no past."""
    return np.asarray(lfilter(filter_, [1.0], values, axis=0))[len(filter_) - 1 :]
