"""Least squares of rows with correlated noise, their errors, and constraints as a linear map."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy
from numpy.typing import NDArray

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.sensor_noise import autocorrelation, ljung_box_p_value
from sysid_trib.likelihood.smoothness import smooth_least_squares
from sysid_trib.likelihood.weak_form import whiten

# Significance level and lags of Ljung and Box's test (1978) of rows that should be white.
CORRELATION_LEVEL = 1e-4
CORRELATION_TEST_LAGS = 12


@dataclass(frozen=True)
class ConstraintMap:
    """Coefficients as ``matrix @ free coefficients + constant``.

    Attributes
    ----------
    free : (free,) array of int
        Indices of the free coefficients among all.
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

    @property
    def in_model(self) -> Mask:
        """Coefficients (force,) that may differ from zero."""
        return self.matrix.any(axis=1) | (self.constant != 0.0)

    def impose(self, coefficients: Array) -> Array:
        """Clip the free coefficients to their bounds, and compute the others from them, (force,)."""
        return self.matrix @ np.clip(coefficients[self.free], self.low, self.high) + self.constant

    def hold(self, held: Mask, values: Array) -> "ConstraintMap":
        """Return the map with some free coefficients (mask over `free`) held at values, (held,)."""
        kept, constant = ~held, self.constant + self.matrix[:, held] @ values
        return ConstraintMap(self.free[kept], self.matrix[:, kept], constant, self.low[kept], self.high[kept])

    def keep(self, active: Mask) -> "ConstraintMap":
        """Return the map in which free coefficients that are not active (force,) are zero."""
        dropped = ~active[self.free]
        return self.hold(dropped, np.zeros(int(np.sum(dropped))))

    def active(self, kept: Mask) -> Mask:
        """Return the coefficients (force,) in the model if some free ones (mask over `free`) are kept."""
        constrained = np.ones(len(self.constant), bool)
        constrained[self.free] = False
        fixed = constrained & ~self.matrix.any(axis=1)
        return fixed | (self.constant != 0.0) | self.matrix[:, kept].any(axis=1)


def constraint_map(
    constraints: Constraints, library: ForceLibrary, shapes: Mapping[str, float]
) -> ConstraintMap:
    """Return the map of a regression, which holds all shape parameters.

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
        A name is not a parameter, a tie is not linear in the coefficients, a bound is on a shape parameter,
        or no coefficient is free.
    """
    constraints.check(library)
    for name in constraints.bounds:
        if name not in library.symbols:
            raise UsageError(f"Shape parameter {name} is bounded; only a trajectory fit supports this.")
    names, matrix, constant = constraints.linear_map(library, shapes)
    if not names:
        raise UsageError("Every coefficient is fixed or tied; leave at least one free.")
    free = np.array([library.symbols.index(name) for name in names], dtype=np.intp)
    limits = np.array([constraints.bounds.get(name, (-np.inf, np.inf)) for name in names])
    return ConstraintMap(free, matrix, constant, limits[:, 0], limits[:, 1])


def white_least_squares(
    columns: Array, target: Array, lags: int = 0, curves: Sequence[Index] = ()
) -> tuple[Array, Array, float, int]:
    """Solve white rows.

    Parameters
    ----------
    columns : (row, column) array of float
    target : (row,) array of float
    lags : int
        Number of lags over which the covariance allows for correlation, if the residual is correlated; 0
        means white.
    curves : sequence of arrays of int
        Columns whose coefficients are random effects of one variance each (see `smooth_least_squares`).

    Returns
    -------
    coefficients : (column,) array of float
    covariance : (column, column) array of float
    noise : float
        RMS residual.
    lags : int
        Number of lags over which the covariance allows for correlation.

    Notes
    -----
    The covariance for white rows is sigma^2 (X' X)^-1. If the residual is correlated, because the model is
    incomplete, the estimator of Newey and West (1987) is used.
    """
    # Scale the columns by powers of two near their size, which causes no rounding. Otherwise the columns of a
    # start, in the record's unit, and those of forces may differ by orders of magnitude.
    unit = np.exp2(-np.frexp(np.linalg.norm(columns, axis=0))[1].astype(float))
    scaled = columns * unit
    gram = scaled.T @ scaled
    if curves:
        smooth = smooth_least_squares(scaled, target, curves)
        solved, covariance, noise = smooth.coefficients, smooth.covariance, smooth.noise
        inverse = np.linalg.inv(gram + np.diag(smooth.penalty))
    else:
        solved = np.linalg.lstsq(scaled, target, rcond=None)[0]
        squares = np.sum((target - scaled @ solved) ** 2)
        noise = float(np.sqrt(squares / max(1, len(scaled) - len(unit))))
        inverse = np.asarray(np.linalg.pinv(gram), dtype=float)
        covariance = noise**2 * inverse
    residual = target - scaled @ solved
    lags = lags if _correlated(residual) else 0
    if lags:
        # Import only here, because it takes 0.2 s.
        from statsmodels.stats.sandwich_covariance import S_hac_simple

        correlated = S_hac_simple(scaled * residual[:, None], nlags=lags) - noise**2 * gram
        covariance = covariance + inverse @ correlated @ inverse
    return solved * unit, covariance * np.outer(unit, unit), noise, lags


def _correlated(residual: Array) -> bool:
    """Return true if the residuals of neighbouring rows are correlated (Ljung and Box 1978)."""
    most = min(CORRELATION_TEST_LAGS, len(residual) // 2 - 1)
    if most < 1 or not residual.any():
        return False
    return ljung_box_p_value(autocorrelation(residual, most), len(residual)) < CORRELATION_LEVEL


def whitened(factor: Array | None, table: Array) -> Array:
    """Whiten rows by the Cholesky factor of their noise's covariance; return them unchanged if it is None."""
    return table if factor is None else whiten(factor, table)


def significant(columns: Array, target: Array, level: float, removed_columns: int) -> Mask:
    """Select the significant columns of white rows, (column,), at a family-wise significance level.

    Parameters
    ----------
    columns : (row, column) array of float
    target : (row,) array of float
    level : float
        Probability of keeping any column without effect (Bonferroni over the offered columns).
    removed_columns : int
        Number of columns projected out of the rows before; the residual has fewer degrees of freedom by this
        number.

    Notes
    -----
    The kept set minimises ``RSS/sigma^2 + t^2 * size``, with t^2 the chi-square of one column at the level:
    no drop, addition or exchange improves it. With correlated columns, one-way elimination drops true columns
    in favour of combinations of others. Exchanges, from the empty and from the full set, do not stop there
    (Miller, Subset Selection in Regression, 2002, Sec. 3.4).
    """
    count = columns.shape[1]
    triangle: Array = np.asarray(np.linalg.qr(np.column_stack([columns, target]), mode="r"))
    table, projected = triangle[:, :count], triangle[:, count]

    def residual_sum(kept: Mask) -> float:
        solution = np.linalg.lstsq(table[:, kept], projected, rcond=1e-12)[0] if kept.any() else np.zeros(0)
        return float(np.sum((projected - table[:, kept] @ solution) ** 2))

    # Columns may be dependent: the noise is the residual of all columns, with the rank as their number.
    degrees = max(1, len(target) - removed_columns - int(np.linalg.matrix_rank(table)))
    noise = max(residual_sum(np.ones(count, bool)) / degrees, 1e-300)
    penalty = noise * float(scipy.stats.chi2.isf(level / max(1, count), 1))

    def deviance(kept: Mask) -> float:
        return residual_sum(kept) / penalty + float(np.sum(kept))

    return min((_exchange(deviance, np.full(count, full)) for full in (False, True)), key=deviance)


def _exchange(deviance: Callable[[Mask], float], kept: Mask) -> Mask:
    """Apply the best drop, addition or exchange until none improves."""
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
