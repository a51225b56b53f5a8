"""Fraction of random force in the noise: restricted likelihood in the ratio of two variances.

The noise of the rows has the covariance variance * (A + ratio * B), with A of the sensor's noise and B of a
random force of unit size. Restricted likelihood (Patterson and Thompson 1971) allows for the estimated
coefficients.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.weak_form import cholesky_factor, log_determinant, whiten

# Range of ratios: from a random walk far below the noise level at the end to impulses far above it in each
# sample.
SMALLEST_WALK = 0.03
LARGEST_IMPULSE = 10.0
# Most iterations of the sensor's variance if the random force is given.
VARIANCE_ROUNDS = 6
# Relative change of this variance at which it has converged.
SETTLED_VARIANCE = 1e-4
# Step of the first grid, in the logarithm of the ratio; a maximum of the likelihood is wider.
FIRST_GRID = 2.0
LOG_TOLERANCE = 0.02
# Increase of the deviance over that without a random force at which a ratio is one standard error too large.
RISEN = 1.0
# Step of the difference quotient for the curvature, in the logarithm.
CURVATURE_STEP = 0.3


@dataclass(frozen=True)
class WhiteRows:
    """Rows whose noise is white at the given ratio.

    Attributes
    ----------
    target : (row,) array of float
    design : (row, column) array of float
    log_determinant : float
        Log determinant of the covariance in units of the variance.
    further : float
        Number of additional samples that one row represents: a row of noise alone may contain the squares of
        many samples.
    least_variance : float
        Lower limit of the variance.
    """

    target: Array
    design: Array
    log_determinant: float
    further: float = field(default=0.0, kw_only=True)
    least_variance: float = field(default=0.0, kw_only=True)

    @cached_property
    def _size(self) -> Array:
        """Length of each column."""
        return np.asarray(np.linalg.norm(self.design, axis=0))

    @property
    def degrees_of_freedom(self) -> float:
        """Number of samples minus the number of columns that have an effect."""
        return max(1.0, len(self.target) + self.further - float(np.sum(self._size > 0.0)))

    def restricted_deviance(self) -> tuple[float, float]:
        """Return minus twice the log restricted likelihood with its variance profiled, and the variance."""
        # The triangular factor of design and target is sufficient.
        acting = self._size > 0.0
        size = self._size[acting]
        # Contiguous columns, as LAPACK needs them, take a third of the time.
        columns = np.concatenate([self.design.T[acting] / size[:, None], self.target[None]])
        factor: Array = np.asarray(np.linalg.qr(columns.T, mode="r"), dtype=float)
        count = len(size)
        if len(factor) <= count:
            raise DecayError(
                f"{len(self.target)} equations cannot determine a random force in "
                f"addition to {count} parameters; "
                "leave it out (--random-force off), or give a longer record."
            )
        degrees_of_freedom = self.degrees_of_freedom
        variance = max(float(factor[count, count] ** 2) / degrees_of_freedom, 1e-300)
        information = 2.0 * float(np.sum(np.log(np.abs(np.diag(factor)[:count]) * size + 1e-300)))
        deviance = degrees_of_freedom * np.log(variance) + self.log_determinant + information
        if variance >= self.least_variance:
            return deviance, variance
        part = variance / self.least_variance
        return deviance + degrees_of_freedom * float(part - 1.0 - np.log(part)), self.least_variance

    def solution(self) -> tuple[Array, Array]:
        """Return least squares of the rows: coefficients, and their covariance in units of the variance."""
        size = np.where(self._size > 0.0, self._size, 1.0)
        q, r = np.linalg.qr(self.design / size)
        # For collinear columns, take the solution of least norm.
        inverse = np.linalg.pinv(r) if np.linalg.cond(r) > 1e13 else solve_triangular(r, np.eye(len(r)))
        scaled = inverse / size[:, None]
        return np.asarray(scaled @ (q.T @ self.target)), np.asarray(scaled @ scaled.T)


@dataclass(frozen=True)
class VarianceRatio:
    """The ratio of two variances with the largest restricted likelihood.

    Attributes
    ----------
    ratio : float
        Ratio; 0 if the likelihood is largest there.
    variance : float
        Variance of the sensor's noise.
    relative_error : float
        Relative standard error of ratio * variance; nan if the ratio is 0.
    upper : float
        For a ratio of 0: the ratio at which the deviance is larger by one, which corresponds to one standard
        error.
    gain : float
        Decrease of the deviance due to the random force.
    deviance : float
        Minus twice the logarithm of the restricted likelihood.
    """

    ratio: float
    variance: float
    relative_error: float
    upper: float
    gain: float
    deviance: float = float("nan")

    @property
    def p_value(self) -> float:
        """p-value of a ratio of zero."""
        return p_value_of_gain(self.gain)


def p_value_of_gain(gain: float) -> float:
    """Return the p-value of a zero ratio, from the decrease of the deviance at another (Chernoff 1954)."""
    return 0.5 * float(scipy.stats.chi2.sf(gain, 1)) if gain > 0.0 else 1.0


def rows_by_ratio(
    band: Array,
    gram: Array,
    table: Array,
    further: tuple[float, float, float] | None = None,
    least_variance: float = 0.0,
) -> Callable[[float], WhiteRows]:
    """Return the function that gives the white rows for a ratio of the two variances.

    Parameters
    ----------
    band, gram : (band, row) array of float
        Covariance of the rows due to the sensor's noise and due to the random force, of unit variance.
    table : (row, column) array of float
        Columns, then the target.
    further : (float, float, float)
        Further samples of the sensor's noise: their number, the sum of the squares of their innovations
        (rad^2), and the logarithm of the determinant of their covariance.
    least_variance : float
        See `WhiteRows`.
    """

    def rows(ratio: float) -> WhiteRows:
        factor = cholesky_factor(band, gram, ratio)
        white, determinant = whiten(factor, table), log_determinant(factor)
        if further is None:
            return WhiteRows(white[:, -1], white[:, :-1], determinant, least_variance=least_variance)
        samples, squares, of_further = further
        # One row contains the squares of all further samples.
        white = np.pad(white, ((0, 1), (0, 0)))
        white[-1, -1] = np.sqrt(squares)
        return WhiteRows(white[:, -1], white[:, :-1], determinant + of_further, further=samples - 1.0)

    return rows


def variance_ratio(
    rows: Callable[[float], WhiteRows], duration: float, step: float, start: float | None = None
) -> VarianceRatio:
    """Find the ratio of largest restricted likelihood.

    Parameters
    ----------
    rows : callable
        Function that returns the white rows for a ratio.
    duration, step : float
        See `ratio_span`, which gives the range of the search; zero is tried as well.
    start : float, optional
        Last estimate; only ratios near it are tried.

    Returns
    -------
    VarianceRatio
    """
    known: dict[float, tuple[float, float]] = {}

    def deviance(log_ratio: float) -> float:
        if log_ratio not in known:
            known[log_ratio] = rows(float(np.exp(log_ratio))).restricted_deviance()
        return known[log_ratio][0]

    sensor_alone = rows(0.0)
    none = sensor_alone.restricted_deviance()
    first, last = np.log(ratio_span(duration, step))
    grid = np.linspace(first, last, max(3, round((last - first) / FIRST_GRID)))
    if start == 0.0:
        risen = (number for number, at in enumerate(grid) if deviance(at) > none[0] + RISEN)
        grid = grid[: next(risen, len(grid)) + 1]
    elif start is not None:
        grid = np.clip(np.log(start) + np.array([-1.0, 0.0, 1.0]), first, last)
    best = float(min(grid, key=deviance))
    # A maximum is wider than the grid: if even the smallest ratio is too large, there is no maximum below it.
    if best > first or deviance(best) <= none[0] + RISEN:
        best = _refined(deviance, grid, best, (first, last))
    gain = none[0] - deviance(best)
    if gain <= 0.0:
        too_large = [at for at in sorted(known) if known[at][0] > none[0] + RISEN]
        upper = float(np.exp(too_large[0])) if too_large else float("nan")
        return VarianceRatio(0.0, none[1], float("nan"), upper, 0.0, none[0])
    error = _relative_error(deviance, known, best, sensor_alone.degrees_of_freedom)
    return VarianceRatio(float(np.exp(best)), known[best][1], error, float("nan"), gain, deviance(best))


def _refined(
    deviance: Callable[[float], float], grid: Array, best: float, span: tuple[float, float]
) -> float:
    """Return the minimum of the deviance about the best logarithm of a grid."""
    reach = float(np.max(np.diff(grid))) if len(grid) > 1 else FIRST_GRID
    minimum = minimize_scalar(
        deviance,
        bounds=(max(span[0], best - reach), min(span[1], best + reach)),
        method="bounded",
        options={"xatol": LOG_TOLERANCE},
    )
    return min((float(minimum.x), best), key=deviance)


def ratio_span(duration: float, step: float) -> tuple[float, float]:
    """Return the smallest and largest ratio for which a random force is visible but not dominant in a sample.

    Parameters
    ----------
    duration : float
        Duration of the record in tau.
    step : float
        Time between two samples, in tau.
    """
    return SMALLEST_WALK**2 / (0.5 * duration), 3.0 * LARGEST_IMPULSE**2 / step**3


def held_ratio(rows: Callable[[float], WhiteRows], per_tau: float, variance: float | None) -> VarianceRatio:
    """Return the ratio for a given size of the random force, `per_tau` in the unit of the variance.

    `variance` : last variance of the sensor's noise; None if unknown.
    """
    if variance is None:
        variance = rows(0.0).restricted_deviance()[1]
    deviance = float("nan")
    for _ in range(VARIANCE_ROUNDS if per_tau else 1):
        before = variance
        deviance, variance = rows(per_tau / variance).restricted_deviance()
        if abs(variance - before) < SETTLED_VARIANCE * variance:
            break
    return VarianceRatio(per_tau / variance, variance, float("nan"), float("nan"), 0.0, deviance)


def _relative_error(
    deviance: Callable[[float], float],
    known: dict[float, tuple[float, float]],
    best: float,
    degrees_of_freedom: float,
) -> float:
    """Return the standard error of log(ratio * variance), from the curvature in both logarithms."""
    step = CURVATURE_STEP
    low, here, high = (deviance(best + side * step) for side in (-1.0, 0.0, 1.0))
    profile = max((low + high - 2.0 * here) / step**2, 1e-12)
    slope = (np.log(known[best + step][1]) - np.log(known[best - step][1])) / (2.0 * step)
    # With the variance profiled, log(variance) changes by `slope` per unit of log(ratio); the curvature in
    # log(variance) is `degrees_of_freedom`.
    variance_of_log_ratio = 2.0 / profile
    return float(np.sqrt((1.0 + slope) ** 2 * variance_of_log_ratio + 2.0 / max(1, degrees_of_freedom)))
