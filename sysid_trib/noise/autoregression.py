"""Coloured noise as an autoregression, its order by the Bayesian information criterion."""

import numpy as np
from scipy.signal import lfilter, oaconvolve

from sysid_trib.arrays import Array

MAX_ORDER = 20
# Part of itself that is left of what coloured noise has forgotten.
FORGOTTEN = 1e-3


def autoregression(residual: Array) -> Array:
    """Filter that whitens a residual.

    Parameters
    ----------
    residual : (sample,) array of float

    Returns
    -------
    (order + 1,) array of float
        Its coefficients, the first is 1.
    """
    n = len(residual)
    centred = residual - residual.mean()
    covariance = np.array([centred[k:] @ centred[: n - k] for k in range(_highest_order(n) + 1)]) / n
    return autoregression_of(covariance, n)[0]


def autoregression_of(covariance: Array, samples: int) -> tuple[Array, float]:
    """Autoregression of noise with a given autocovariance.

    Parameters
    ----------
    covariance : (lag,) array of float
    samples : int
        Number of samples that the autocovariance is from.

    Returns
    -------
    whitening_filter : (order + 1,) array of float
    variance : float
        Of the innovations.

    Notes
    -----
    Yule and Walker's equations; the order minimises n log(variance) + order log(n).
    """
    # Here, since a program that needs no autoregression starts faster without.
    from statsmodels.tsa.stattools import levinson_durbin

    highest = min(_highest_order(samples), len(covariance) - 1)
    if highest < 1 or covariance[0] <= 0.0:
        return np.ones(1), float(covariance[0])
    # Noise that its past determines has no variance left at some order, and no higher order is defined.
    with np.errstate(divide="ignore", invalid="ignore"):
        *_, variances, weights = levinson_durbin(covariance, nlags=highest, isacov=True)
    variances[0] = covariance[0]
    scores = samples * np.log(np.maximum(variances, 1e-300)) + np.arange(highest + 1) * np.log(samples)
    order = int(np.nanargmin(scores))
    return np.concatenate([[1.0], -weights[1 : order + 1, order]]), float(variances[order])


def fractional_difference(order: float, taps: int) -> Array:
    """Filter that whitens noise with a spectrum of 1/f^(2 d).

    Parameters
    ----------
    order : float
        The d of fractional differencing.
    taps : int

    Returns
    -------
    (tap,) array of float
        The coefficients of (1 - B)^d (Hosking 1981).
    """
    k = np.arange(1, taps)
    return np.concatenate([[1.0], np.cumprod((k - 1.0 - order) / k)])


def warm_up_samples(whitening_filter: Array) -> int:
    """First samples that a filter has no past for; of a long one, those that would need most of it."""
    return min(len(whitening_filter) - 1, MAX_ORDER)


def memory_samples(whitening_filter: Array) -> int:
    """Samples after which the inverse of a whitening filter is below a part `FORGOTTEN`.

    Of a long one twice its length: what noise of long memory does after so long, it leaves out itself.
    """
    if len(whitening_filter) == 1:
        return 0
    if len(whitening_filter) - 1 > MAX_ORDER:
        return 2 * len(whitening_filter)
    slowest = min(max(float(np.max(np.abs(np.roots(whitening_filter)))), 1e-3), 1.0 - 1e-4)
    return int(np.ceil(np.log(FORGOTTEN) / np.log(slowest))) + len(whitening_filter)


def whitened(values: Array, whitening_filter: Array) -> Array:
    """Values along the first axis after the whitening filter, without the first that have no past."""
    start = warm_up_samples(whitening_filter)
    if len(whitening_filter) - 1 > MAX_ORDER:
        taps = whitening_filter.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray(oaconvolve(values, taps, axes=0))[start : len(values)]
    return np.asarray(lfilter(whitening_filter, [1.0], values, axis=0))[start:]


def _highest_order(samples: int) -> int:
    return min(MAX_ORDER, samples // 20)
