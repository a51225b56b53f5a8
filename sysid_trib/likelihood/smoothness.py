"""Curves as random effects: penalised least squares with a smoothness estimated from the rows.

The coefficients of a curve are independent normal variables with a common variance (Ruppert, Wand & Carroll,
Semiparametric Regression, 2003, Ch. 4). Restricted likelihood estimates this variance; its uncertainty is
part of the covariance of the estimate.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from sysid_trib.arrays import Array, Index

# First grid of log variance ratios: from no curve at all to a curve without penalty.
COARSE = np.arange(-15.0, 31.0, 3.0)
# Ratios are neglected if their deviance exceeds the best one by this.
NEGLIGIBLE = 14.0
# Points of the grid along each ratio, for one or two curves and for more.
FINE_POINTS, FEW_POINTS = 9, 4


@dataclass(frozen=True)
class SmoothFit:
    """Penalised least squares of white rows.

    Attributes
    ----------
    coefficients : (column,) array of float
        Mean over the smoothness that the rows allow.
    covariance : (column, column) array of float
        Covariance due to the noise, the penalty and the smoothness.
    noise : float
        RMS residual of the white rows.
    penalty : (column,) array of float
        Inverse prior variance of each coefficient over the variance of the noise; zero without a penalty.
    """

    coefficients: Array
    covariance: Array
    noise: float
    penalty: Array


def smooth_least_squares(columns: Array, target: Array, curves: Sequence[Index]) -> SmoothFit:
    """Solve white rows, with the coefficients of each curve as random effects of a common variance.

    Parameters
    ----------
    columns : (row, column) array of float
    target : (row,) array of float
    curves : sequence of arrays of int
        Columns of each curve.

    Returns
    -------
    SmoothFit

    Notes
    -----
    Columns are scaled to unit norm, so that all coefficients of a curve contribute equally to the record. The
    standard deviation of a curve's coefficients has a uniform prior (Gelman, Bayesian Analysis 1, 2006, 515).
    Estimates are averaged over a grid of variances by their restricted likelihood. The covariance therefore
    includes the uncertainty of the smoothness and, by its Bayesian interpretation, the bias of smoothing
    (Nychka, Journal of the American Statistical Association 83, 1988, 1134).
    """
    unit = np.linalg.norm(columns, axis=0)
    unit[unit == 0.0] = 1.0
    equations = _NormalEquations.of(columns / unit, target, curves)
    points = [equations.fit(ratios) for ratios in equations.likely_ratios()]
    deviance = np.array([point.deviance for point in points])
    weights = np.exp(-0.5 * (deviance - deviance.min()))
    weights /= weights.sum()
    coefficients = np.sum([w * point.coefficients for w, point in zip(weights, points, strict=True)], axis=0)
    covariance = np.zeros((len(unit), len(unit)))
    variance, precision = 0.0, np.zeros(len(unit))
    for weight, point in zip(weights, points, strict=True):
        if weight < 1e-6 * weights.max():
            continue
        off = point.coefficients - coefficients
        inverse = scipy.linalg.cho_solve((point.factor, True), np.eye(len(unit)))
        covariance += weight * (point.variance * inverse + np.outer(off, off))
        variance += weight * point.variance
        precision += weight * point.penalty
    scale = 1.0 / unit
    return SmoothFit(
        coefficients * scale,
        covariance * np.outer(scale, scale),
        float(np.sqrt(variance)),
        precision * unit**2,
    )


@dataclass(frozen=True)
class _Point:
    """The estimate at given variance ratios, and its deviance."""

    deviance: float
    coefficients: Array
    variance: float
    penalty: Array
    factor: Array


@dataclass(frozen=True)
class _NormalEquations:
    """Normal equations of white rows, and the indices of the coefficients of curves."""

    gram: Array
    projected: Array
    square: float
    rows: int
    curves: Sequence[Index]

    @classmethod
    def of(cls, columns: Array, target: Array, curves: Sequence[Index]) -> "_NormalEquations":
        return cls(columns.T @ columns, columns.T @ target, float(target @ target), len(target), curves)

    def fit(self, ratios: Array) -> _Point:
        """Fit with given logarithms of the variance ratio of each curve's coefficients to the noise."""
        penalty = np.zeros(len(self.gram))
        for curve, ratio in zip(self.curves, ratios, strict=True):
            penalty[curve] = np.exp(-ratio)
        # The columns have unit norm: a ridge of the size of rounding separates identical columns.
        normal = self.gram + np.diag(penalty + len(self.gram) * np.finfo(float).eps)
        factor: Array = np.asarray(np.linalg.cholesky(normal), dtype=float)
        coefficients = scipy.linalg.cho_solve((factor, True), self.projected)
        count = sum(len(curve) for curve in self.curves)
        freedoms = max(1, self.rows - (len(penalty) - count))
        variance = max((self.square - coefficients @ self.projected) / freedoms, 1e-300)
        restricted = freedoms * np.log(variance) + 2.0 * np.sum(np.log(np.diag(factor)))
        restricted += sum(len(curve) * ratio for curve, ratio in zip(self.curves, ratios, strict=True))
        # Prior that is uniform in the standard deviation, as a density of the log variance.
        return _Point(float(restricted - np.sum(ratios)), coefficients, float(variance), penalty, factor)

    def likely_ratios(self) -> Iterator[Array]:
        """Yield a grid of variance ratios over the region that the rows allow."""
        centre = np.full(len(self.curves), COARSE[len(COARSE) // 2])
        # Optimise one curve after another, because their variances hardly depend on each other.
        for _ in range(2):
            for at in range(len(centre)):
                centre[at] = min(COARSE, key=lambda value: self.fit(_with(centre, at, value)).deviance)
        least = self.fit(centre).deviance
        axes = []
        for at in range(len(centre)):
            deviances = np.array([self.fit(_with(centre, at, value)).deviance for value in COARSE])
            likely = COARSE[deviances < least + NEGLIGIBLE]
            points = FINE_POINTS if len(centre) <= 2 else FEW_POINTS
            axes.append(np.linspace(likely.min() - 1.0, likely.max() + 1.0, points))
        yield from np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(centre))


def _with(values: Array, at: int, value: float) -> Array:
    """Return the values with one of them replaced."""
    changed = values.copy()
    changed[at] = value
    return changed
