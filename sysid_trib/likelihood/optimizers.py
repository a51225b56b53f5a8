"""Optimisers of pysindy for rows of correlated noise, and constraints as a linear map of free coefficients.

They serve in `pysindy.SINDy(optimizer=...)` as well as in `Direct`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pysindy.optimizers import BaseOptimizer
from scipy.stats import chi2

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.weak_form import whiten


@dataclass(frozen=True)
class ConstraintMap:
    """Coefficients as ``matrix @ free coefficients + constant``.

    Attributes
    ----------
    free : (free,) array of int
        Places of the free coefficients among all.
    matrix : (force, free) array of float
    constant : (force,) array of float
    low, high : (free,) array of float
        Bounds of the free coefficients.
    """

    free: NDArray[np.intp]
    matrix: Array
    constant: Array
    low: Array
    high: Array

    def impose(self, coefficients: Array) -> Array:
        """The coefficients (force,) with the free ones within their bounds and the others by them."""
        return self.matrix @ np.clip(coefficients[self.free], self.low, self.high) + self.constant

    def hold(self, held: Mask, values: Array) -> "ConstraintMap":
        """The map with some free coefficients (mask over `free`) held at values, (held,)."""
        kept, constant = ~held, self.constant + self.matrix[:, held] @ values
        return ConstraintMap(self.free[kept], self.matrix[:, kept], constant, self.low[kept], self.high[kept])

    def keep(self, active: Mask) -> "ConstraintMap":
        """The map in which the free coefficients that are not active (force,) are zero."""
        dropped = ~active[self.free]
        return self.hold(dropped, np.zeros(int(np.sum(dropped))))

    def active(self, kept: Mask) -> Mask:
        """Coefficients (force,) that are in the model if some free ones (mask over `free`) are kept."""
        constrained = np.ones(len(self.constant), bool)
        constrained[self.free] = False
        fixed = constrained & ~self.matrix.any(axis=1)
        return fixed | (self.constant != 0.0) | self.matrix[:, kept].any(axis=1)


def constraint_map(
    constraints: Constraints, library: ForceLibrary, shapes: Mapping[str, float]
) -> ConstraintMap:
    """The map of a regression, in which all shape parameters are held.

    Parameters
    ----------
    constraints : Constraints
    library : ForceLibrary
        The forces to identify.
    shapes : mapping of str to float
        Values of shape parameters.

    Returns
    -------
    ConstraintMap

    Raises
    ------
    UsageError
        A name is no parameter, a tie is not linear in the coefficients, a bound is on a shape parameter, or
        no coefficient is free.
    """
    constraints.check(library)
    for name in constraints.bounds:
        if name not in library.symbols:
            raise UsageError(f"Shape parameter {name} is bounded, which only a trajectory fit can do.")
    names, matrix, constant = constraints.linear_map(library, shapes)
    if not names:
        raise UsageError("Every coefficient is fixed or tied; leave at least one free.")
    free = np.array([library.symbols.index(name) for name in names], dtype=np.intp)
    limits = np.array([constraints.bounds.get(name, (-np.inf, np.inf)) for name in names])
    return ConstraintMap(free, matrix, constant, limits[:, 0], limits[:, 1])


# Level and lags of Ljung and Box's test (1978) of rows that should be white.
CORRELATION_LEVEL = 1e-4
CORRELATION_TEST_LAGS = 12


class WhitenedLeastSquares(BaseOptimizer):
    """Least squares of rows whose noise has a known covariance up to a factor, with standard errors.

    Parameters
    ----------
    covariance_factor : (band, row) array of float, optional
        Cholesky factor of the covariance of the rows' noise, lower banded as `scipy.linalg` stores it. The
        rows are taken for white where it is left out.
    correlation_lags : int, default 0
        Lags over which the errors allow for correlation where the residuals of the whitened rows have one
        (Newey and West 1987); 0 takes them for white.

    Attributes
    ----------
    coef_ : (target, feature) array of float
    covariance_ : (target, feature, feature) array of float
        Covariance of the coefficients.
    noise_ : (target,) array of float
        RMS residual of the whitened rows.
    lags_ : (target,) array of int
        Lags over which the errors allow for correlation.
    """

    def __init__(self, covariance_factor: Array | None = None, correlation_lags: int = 0) -> None:
        super().__init__(unbias=False)
        self.covariance_factor = covariance_factor
        self.correlation_lags = correlation_lags

    def fit(self, x_: Any, y: Any, sample_weight: Any = None, **reduce_kws: Any) -> "WhitenedLeastSquares":
        """Whiten the rows and solve them, once.

        Parameters
        ----------
        x_ : (row, feature) array of float
        y : (row,) or (row, target) array of float
        sample_weight : (row,) array of float, optional
            Of white rows.
        **reduce_kws
            Not used.

        Returns
        -------
        WhitenedLeastSquares
            Itself.
        """
        # The checks and the first guess of BaseOptimizer.fit would take ten times as long as the solution.
        x, y = (np.asarray(part, dtype=float).reshape(len(part), -1) for part in (x_, y))
        if self.covariance_factor is not None:
            x, y = (whiten(self.covariance_factor, part) for part in (x, y))
        else:
            weights = np.sqrt(np.broadcast_to(1.0 if sample_weight is None else sample_weight, len(x)))
            finite = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
            x, y = ((weights[:, None] * part)[finite] for part in (x, y))
        self._reduce(x, y)
        self.Theta_, self.ind_, self.history_, self.intercept_ = x, self.coef_ != 0.0, [self.coef_], 0.0
        return self

    def _reduce(self, x: Array, y: Array) -> None:
        # Columns in units of a power of two near their own size, which rounds nothing: those of a start in
        # the record's unit and those of forces would else be far apart.
        unit = np.exp2(-np.frexp(np.linalg.norm(x, axis=0))[1].astype(float))
        columns = x * unit
        solved = np.linalg.lstsq(columns, y, rcond=None)[0].T
        self.coef_ = solved * unit
        residuals = (y - columns @ solved.T).T
        self.noise_ = np.sqrt(np.sum(residuals**2, axis=1) / max(1, x.shape[0] - x.shape[1]))
        self.lags_ = np.array([self.correlation_lags if _correlated(r) else 0 for r in residuals])
        inverse: Array = np.asarray(np.linalg.pinv(columns.T @ columns), dtype=float)
        targets = zip(residuals, self.lags_.tolist(), self.noise_, strict=True)
        covariances = [
            _sandwich(columns, inverse, r, lags) if lags else s**2 * inverse for r, lags, s in targets
        ]
        self.covariance_ = np.stack(covariances) * np.outer(unit, unit)


class SignificanceSelection(BaseOptimizer):
    """The features that the rows demand, by a family-wise level of significance; the others are zero.

    Parameters
    ----------
    level : float, default 0.01
        Probability of keeping any feature that is not there (Bonferroni over the features offered).
    removed_columns : int, default 0
        Columns that have been projected out of the rows before: the residual has as many fewer degrees of
        freedom.

    Attributes
    ----------
    coef_ : (target, feature) array of float
        Least squares on the kept features.

    Notes
    -----
    The kept set minimises ``RSS/sigma^2 + t^2 * size``, t^2 the chi-square of one feature at the level: none
    can be dropped, added or exchanged. Correlated features make one-way elimination drop true ones for
    combinations of others; exchanges, from the empty and from the full set, do not stop there (Miller, Subset
    Selection in Regression, 2002, Sec. 3.4).
    """

    def __init__(self, level: float = 0.01, removed_columns: int = 0) -> None:
        super().__init__(unbias=False)
        self.level = level
        self.removed_columns = removed_columns

    def _reduce(self, x: Array, y: Array) -> None:
        coefficients = np.zeros((y.shape[1], x.shape[1]))
        for i, target in enumerate(np.asarray(y).T):
            kept = _significant(x, target, self.level, self.removed_columns)
            coefficients[i, kept] = np.linalg.lstsq(x[:, kept], target, rcond=None)[0]
        self.coef_ = coefficients


def _correlated(residual: Array) -> bool:
    """True if the residuals of neighbouring rows are correlated (Ljung and Box 1978)."""
    n, total = len(residual), float(residual @ residual)
    lags = np.arange(1, min(CORRELATION_TEST_LAGS, n // 2 - 1) + 1)
    if not lags.size or total == 0.0:
        return False
    # About zero, not about their mean: rows without noise have none.
    correlations = np.array([residual[lag:] @ residual[:-lag] / total for lag in lags])
    # statsmodels takes 0.2 s to import for this sum.
    statistic = n * (n + 2) * np.sum(correlations**2 / (n - lags))
    return bool(chi2.sf(statistic, len(lags)) < CORRELATION_LEVEL)


def _sandwich(x: Array, inverse: Array, residual: Array, lags: int) -> Array:
    """Covariance of least squares whose residuals are correlated over so many lags (Newey and West 1987)."""
    from statsmodels.stats.sandwich_covariance import S_hac_simple

    return np.asarray(inverse @ S_hac_simple(x * residual[:, None], nlags=lags) @ inverse)


def _significant(columns: Array, target: Array, level: float, removed_columns: int) -> Mask:
    """Columns of the set with the least penalised deviance."""
    count = columns.shape[1]
    triangle: Array = np.asarray(np.linalg.qr(np.column_stack([columns, target]), mode="r"))
    table, projected = triangle[:, :count], triangle[:, count]

    def residual_sum(kept: Mask) -> float:
        solution = np.linalg.lstsq(table[:, kept], projected, rcond=1e-12)[0] if kept.any() else np.zeros(0)
        return float(np.sum((projected - table[:, kept] @ solution) ** 2))

    # Columns may be dependent: the residual of all of them is the noise, by as many as are independent.
    degrees = max(1, len(target) - removed_columns - int(np.linalg.matrix_rank(table)))
    noise = max(residual_sum(np.ones(count, bool)) / degrees, 1e-300)
    penalty = noise * float(chi2.isf(level / max(1, count), 1))

    def deviance(kept: Mask) -> float:
        return residual_sum(kept) / penalty + float(np.sum(kept))

    return min((_exchange(deviance, np.full(count, full)) for full in (False, True)), key=deviance)


def _exchange(deviance: Callable[[Mask], float], kept: Mask) -> Mask:
    """Take the best of all drops, additions and exchanges until none helps."""
    flips = np.eye(len(kept), dtype=bool)
    pairs = [first | second for first, second in combinations(flips, 2)]
    lowest = deviance(kept)
    while True:
        trials = [kept ^ flip for flip in [*flips, *(pair for pair in pairs if np.sum(pair & kept) == 1)]]
        deviances = [deviance(trial) for trial in trials]
        best = int(np.argmin(deviances))
        if deviances[best] >= lowest - 1e-9:
            return kept
        kept, lowest = trials[best], deviances[best]
