"""Coloured noise as an autoregression, its order by the Bayesian information criterion."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter, oaconvolve

Array = NDArray[np.float64]

MAX_ORDER = 20


def autoregression(residual: Array) -> Array:
    """Coefficients (order + 1,) of the filter that whitens a residual, the first is 1."""
    n = len(residual)
    centred = residual - residual.mean()
    covariance = np.array([centred[k:] @ centred[: n - k] for k in range(_most(n) + 1)]) / n
    return autoregression_of(covariance, n)[0]


def autoregression_of(covariance: Array, samples: int) -> tuple[Array, float]:
    """Whitening filter (order + 1,) of noise with an autocovariance (lag,), variance of its innovations.

    Yule and Walker's equations; the order minimises n log(variance) + order log(n).
    """
    best, found, left = np.inf, np.ones(1), float(covariance[0])
    for order in range(min(_most(samples) + 1, len(covariance))):
        weights = solve_toeplitz(covariance[:order], covariance[1 : order + 1]) if order else np.zeros(0)
        variance = float(covariance[0] - weights @ covariance[1 : order + 1])
        score = samples * np.log(max(variance, 1e-300)) + order * np.log(samples)
        if score < best:
            best, found, left = score, np.concatenate([[1.0], -weights]), variance
    return found, left


def fractional_difference(d: float, taps: int) -> Array:
    """Filter (tap,) that whitens noise with a spectrum of 1/f^(2 d): (1 - B)^d (Hosking 1981)."""
    k = np.arange(1, taps)
    return np.concatenate([[1.0], np.cumprod((k - 1.0 - d) / k)])


def warm_up_samples(filter_: Array) -> int:
    """First samples that a filter has no past for; of a long one, those that would need most of it."""
    return min(len(filter_) - 1, MAX_ORDER)


def whitened(values: Array, filter_: Array) -> Array:
    """Values along the first axis after the whitening filter, without the first that have no past."""
    if len(filter_) - 1 > MAX_ORDER:
        taps = filter_.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(oaconvolve(values, taps, axes=0))[warm_up_samples(filter_) : len(values)]
    return np.asarray(lfilter(filter_, [1.0], values, axis=0))[warm_up_samples(filter_) :]


def _most(samples: int) -> int:
    return min(MAX_ORDER, samples // 20)
