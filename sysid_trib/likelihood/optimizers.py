"""Optimisers of pysindy: least squares of rows of correlated noise, and a choice by significance."""

from typing import Any

import numpy as np
from pysindy.optimizers import BaseOptimizer

from sysid_trib.arrays import Array
from sysid_trib.likelihood.least_squares import significant, white_least_squares, whitened


class WhitenedLeastSquares(BaseOptimizer):
    """Least squares of rows whose noise has a known covariance up to a factor, with standard errors.

    The optimiser is for `pysindy.SINDy(optimizer=...)`; `Direct` solves its rows by the same least squares.

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
        """Whiten the rows and solve them, once; see `pysindy.optimizers.BaseOptimizer.fit`."""
        # The checks and the first guess of BaseOptimizer.fit would take ten times as long as the solution.
        x, y = (np.asarray(part, dtype=float).reshape(len(part), -1) for part in (x_, y))
        if self.covariance_factor is None:
            weights = np.sqrt(np.broadcast_to(1.0 if sample_weight is None else sample_weight, len(x)))
            finite = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
            x, y = ((weights[:, None] * part)[finite] for part in (x, y))
        self._reduce(x, y)
        self.Theta_, self.ind_, self.history_, self.intercept_ = x, self.coef_ != 0.0, [self.coef_], 0.0
        return self

    def _reduce(self, x: Array, y: Array) -> None:
        columns, targets = (whitened(self.covariance_factor, part) for part in (x, y))
        solutions = [white_least_squares(columns, target, self.correlation_lags) for target in targets.T]
        coefficients, covariances, noises, lags = zip(*solutions, strict=True)
        self.coef_, self.covariance_ = np.stack(coefficients), np.stack(covariances)
        self.noise_, self.lags_ = np.array(noises), np.array(lags)


class SignificanceSelection(BaseOptimizer):
    """The features that the rows demand, by a family-wise level of significance; the others are zero.

    Parameters
    ----------
    level : float, default 0.01
        Probability of keeping any feature that is not there (see `significant`).
    removed_columns : int, default 0
        Columns that have been projected out of the rows before.

    Attributes
    ----------
    coef_ : (target, feature) array of float
        Least squares on the kept features.
    """

    def __init__(self, level: float = 0.01, removed_columns: int = 0) -> None:
        super().__init__(unbias=False)
        self.level = level
        self.removed_columns = removed_columns

    def _reduce(self, x: Any, y: Any) -> None:
        self.coef_ = np.zeros((y.shape[1], x.shape[1]))
        for i, target in enumerate(np.asarray(y).T):
            kept = significant(np.asarray(x), target, self.level, self.removed_columns)
            self.coef_[i, kept] = np.linalg.lstsq(x[:, kept], target, rcond=None)[0]
