"""The sensor's noise: level, colour, tests for whiteness, and its covariance in banded rows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.results.variables import Variables, noise_of_run, variable

MAX_ORDER = 20
# Correlation below which samples of coloured noise count as independent.
FORGOTTEN = 1e-3
# Number of entries per row beyond which dense products of blocks of rows are faster than the sparse product.
LONG_ROWS = 400


def autoregression(residual: Array) -> Array:
    """Return the filter that whitens a residual.

    Parameters
    ----------
    residual : (sample,) array of float

    Returns
    -------
    (order + 1,) array of float
        Coefficients of the filter; the first is 1.
    """
    n = len(residual)
    centred = residual - residual.mean()
    covariance = np.array([centred[k:] @ centred[: n - k] for k in range(_highest_order(n) + 1)]) / n
    return _autoregression_of(covariance, n)[0]


def _autoregression_of(covariance: Array, samples: int) -> tuple[Array, float]:
    """Return whitening filter, (order + 1,), and innovation variance from the autocovariance of n samples.

    The filter solves Yule and Walker's equations; the order minimises n log(variance) + order log(n).
    """
    # Import only here: a program that needs no autoregression starts faster.
    from statsmodels.tsa.stattools import levinson_durbin

    highest = min(_highest_order(samples), len(covariance) - 1)
    if highest < 1 or covariance[0] <= 0.0:
        return np.ones(1), float(covariance[0])
    # If the past determines the noise, the variance vanishes at some order, and higher orders are undefined.
    with np.errstate(divide="ignore", invalid="ignore"):
        *_, variances, weights = levinson_durbin(covariance, nlags=highest, isacov=True)
    variances[0] = covariance[0]
    scores = samples * np.log(np.maximum(variances, 1e-300)) + np.arange(highest + 1) * np.log(samples)
    order = int(np.nanargmin(scores))
    return np.concatenate([[1.0], -weights[1 : order + 1, order]]), float(variances[order])


def autoregression_of_order(covariance: Array, order: int) -> tuple[Array, float]:
    """Return whitening filter, (order + 1,), and innovation variance, by an autocovariance that is known."""
    weights = scipy.linalg.solve_toeplitz(covariance[:order], covariance[1 : order + 1])
    return np.append(1.0, -weights), float(covariance[0] - weights @ covariance[1 : order + 1])


def filter_of(partial: Array) -> Array:
    """Return the whitening filter of partial autocorrelations (Levinson, Durbin): stable within (-1, 1)."""
    filter_ = np.ones(1)
    for value in partial:
        longer = np.append(filter_, 0.0)
        filter_ = longer - value * longer[::-1]
    return filter_


def partial_autocorrelations(filter_: Array) -> Array:
    """Return the partial autocorrelations of a whitening filter, (order,): the inverse of `filter_of`."""
    partial = []
    while len(filter_) > 1:
        last = filter_[-1]
        partial.append(-last)
        filter_ = ((filter_ - last * filter_[::-1]) / (1.0 - last**2))[:-1]
    return np.array(partial[::-1])


def of_order(filter_: Array, order: int) -> Array:
    """Return the nearest whitening filter of another order, (order + 1,).

    Truncate the partial autocorrelations: the leading taps of a longer filter need not be stable.
    """
    partial = np.zeros(order)
    known = partial_autocorrelations(filter_)[:order]
    partial[: len(known)] = known
    return filter_of(partial)


def filter_slopes(partial: Array) -> Array:
    """Return slopes of the filter by each partial autocorrelation, (tap, order); it is linear in each."""
    order = len(partial)
    slopes = np.empty((order + 1, order))
    for at in range(order):
        ends = [filter_of(np.where(np.arange(order) == at, value, partial)) for value in (0.0, 1.0)]
        slopes[:, at] = ends[1] - ends[0]
    return slopes


def memory_samples(whitening_filter: Array) -> int:
    """Return the number of samples after which the inverse of a whitening filter is negligible.

    For a long filter it is twice its length, because the filter itself neglects longer memory.
    """
    if len(whitening_filter) == 1:
        return 0
    if len(whitening_filter) - 1 > MAX_ORDER:
        return 2 * len(whitening_filter)
    slowest = min(max(float(np.max(np.abs(np.roots(whitening_filter)))), 1e-3), 1.0 - 1e-4)
    return int(np.ceil(np.log(FORGOTTEN) / np.log(slowest))) + len(whitening_filter)


def whitened(values: Array, whitening_filter: Array) -> Array:
    """Return values along the first axis after the whitening filter, without the first ones."""
    start = NoiseModel(1.0, whitening_filter).warm_up
    return np.asarray(scipy.signal.lfilter(whitening_filter, [1.0], values, axis=0))[start:]


def _highest_order(samples: int) -> int:
    return min(MAX_ORDER, samples // 20)


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one run.

    Attributes
    ----------
    innovation : float, rad
        Standard deviation of the innovations.
    filter_ : (tap,) array of float
        Whitening filter; [1] if the noise is white.
    """

    innovation: float
    filter_: Array

    @property
    def warm_up(self) -> int:
        """Number of first samples that cannot be whitened; for a long filter, those that need most of it."""
        return min(len(self.filter_) - 1, MAX_ORDER)

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of a sample, rad."""
        # Number of lines of a record; for a long filter of 1/f noise, the variance increases with the
        # duration.
        lines = len(self.filter_) if len(self.filter_) - 1 > MAX_ORDER else 4096
        power = np.abs(np.fft.rfft(self.filter_, lines)[1:]) ** 2
        return self.innovation * float(np.sqrt(np.mean(1.0 / power)))

    def of_every(self, step: int, samples: int) -> "NoiseModel":
        """Return the noise of every `step`-th sample, for a number of kept samples, as an autoregression."""
        if step == 1 or len(self.filter_) == 1:
            return self
        lags = step * MAX_ORDER + 1
        # Autocovariance from the impulse response, which is long enough to have decayed.
        response = scipy.signal.lfilter(
            [1.0], self.filter_, np.eye(1, lags + 2 * memory_samples(self.filter_))[0]
        )
        size = len(response)
        covariance = np.array([response[lag:] @ response[: size - lag] for lag in range(0, lags, step)])
        filter_, variance = _autoregression_of(covariance, samples)
        return NoiseModel(self.innovation * float(np.sqrt(variance)), filter_)

    def draws(self, samples: int, count: int) -> Array:
        """Return simulated noise, (count, samples), rad, with mean zero and a fixed seed."""
        lines = np.fft.rfft(np.random.default_rng(0).standard_normal((count, samples)))
        response = np.fft.rfft(self.filter_, samples)
        # A random walk has no mean to return to.
        lines[:, 0], response[0] = 0.0, 1.0
        return np.asarray(np.fft.irfft(self.innovation * lines / response, samples))


FILTER = "noise_filter"


def colour_variables(filters: Sequence[Array]) -> Variables:
    """Return the whitening filters of the sensor noise as variables of a result; empty if all are white.

    Parameters
    ----------
    filters : (run,) sequence of (tap,) arrays of float
        Autoregressions; the first coefficient of each is 1.
    """
    taps = max(len(filter_) for filter_ in filters)
    if taps == 1:
        return {}
    table = np.stack([np.pad(filter_, (0, taps - len(filter_))) for filter_ in filters])
    text = "autoregression that whitens the sensor's noise"
    several = len(filters) > 1
    return {FILTER: variable(("run", "tap") if several else "tap", table if several else table[0], text, "1")}


def sensor_noise_of(result: xr.Dataset, run: int = 0) -> NoiseModel:
    """Return the sensor's noise in one run of an identification; white if no colour is stored."""
    level = noise_of_run(result, run)
    if FILTER not in result:
        return NoiseModel(level, np.ones(1))
    table = result[FILTER]
    filter_ = np.trim_zeros(table.values[run] if "run" in table.dims else table.values, "b")
    return NoiseModel(level / NoiseModel(1.0, filter_).standard_deviation, filter_)


# Number of autocorrelations in the test.
MOST_LAGS = 20
# Significance level of the test that a residual is white.
WHITE_LEVEL = 1e-3


def autocorrelation(values: Array, most: int) -> Array:
    """Return the autocorrelation at the lags from 1 to `most`, without subtraction of the mean."""
    whole = float(values @ values)
    products = [values[lag:] @ values[:-lag] for lag in range(1, most + 1)]
    return np.array(products) / (whole if whole > 0.0 else 1.0)


def ljung_box_p_value(correlation: Array, count: int) -> float:
    """Return the p-value that `count` values are white, from the autocorrelation at first lags, (lag,)."""
    lags = np.arange(1, len(correlation) + 1)
    statistic = count * (count + 2) * float(np.sum(correlation**2 / (count - lags)))
    return float(scipy.stats.chi2.sf(statistic, len(lags)))


def white_p_value(residual: Array) -> float:
    """Return the p-value that a residual, (sample,), is white; 1 if it is too short for the test."""
    most = min(MOST_LAGS, len(residual) // 4)
    return ljung_box_p_value(autocorrelation(residual, most), len(residual)) if most else 1.0


def covariance_band(operator: sp.csr_matrix, other: sp.csr_matrix | None = None) -> Array:
    """Return the diagonals of `operator @ operator.T`, (band, row), in the lower form of scipy.linalg.

    Parameters
    ----------
    operator : (row, sample) sparse array of float
        Each row acts on neighbouring samples, and later rows on later samples.
    other : (row, sample) sparse array of float, optional
        Second operator, if it differs from the first; the product must be symmetric.
    """
    if other is None and operator.nnz > LONG_ROWS * operator.shape[0]:
        return _band_by_blocks(operator.sorted_indices())
    entries = (operator @ (operator if other is None else other).T).tocoo()
    below = entries.row - entries.col
    band = np.zeros((int(below.max()) + 1, operator.shape[0]))
    lower = below >= 0
    band[below[lower], entries.col[lower]] = entries.data[lower]
    return band


def _band_by_blocks(operator: sp.csr_matrix) -> Array:
    """Return `covariance_band` for rows on many samples each, by dense products of overlapping rows."""
    first = np.minimum.accumulate(operator.indices[operator.indptr[:-1]][::-1])[::-1]
    end = np.maximum.accumulate(operator.indices[operator.indptr[1:] - 1] + 1)
    rows = len(first)
    # Number of rows from each row on that share a sample with it, including itself.
    bands = int(np.max(np.searchsorted(first, end) - np.arange(rows)))
    band = np.zeros((bands, rows))
    for begin in range(0, rows, bands):
        last = min(begin + 2 * bands - 1, rows)
        dense = operator[begin:last, first[begin] : end[last - 1]].toarray()
        products = dense @ dense[:bands].T
        for below in range(min(bands, last - begin)):
            diagonal = np.diagonal(products, -below)
            band[below, begin : begin + len(diagonal)] = diagonal
    return band
