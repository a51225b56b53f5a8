"""A regression over the ratios of the two variances that a record leaves open: its mean and its errors."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array, Mask
from sysid_trib.noise.ratio_posterior import RatioAverage, average_over_ratios
from sysid_trib.noise.variance_ratio import VarianceRatio, WhiteRows
from sysid_trib.regression.constraint_map import ConstraintMap
from sysid_trib.regression.linearisation import DeviationOperator
from sysid_trib.regression.problem import RunRegression
from sysid_trib.regression.rows import Rows, stack_rows
from sysid_trib.regression.solution import Solution, solve
from sysid_trib.regression.weak_form import cholesky_factor, whitened_by_both
from sysid_trib.trajectory_fit.refined_columns import common_values


class Prior(NamedTuple):
    """As of further samples of the sensor's noise, beside the rows.

    Attributes
    ----------
    samples : float
        How many.
    squares : float, rad^2
        Sum of the squares of their innovations.
    log_determinant : float
        Of their covariance, in units of the variance of the innovations.
    """

    samples: float
    squares: float
    log_determinant: float = 0.0


class RatioLikelihood(NamedTuple):
    """Rows of one run by the ratio of its two variances.

    Attributes
    ----------
    band, gram : (band, row) array of float
        Covariance of the rows by the sensor's noise and by the random force, of unit variance.
    table : (row, column) array of float
        Free columns, nuisances, target.
    prior : Prior
        What is known besides of the sensor's noise.
    """

    band: Array
    gram: Array
    table: Array
    prior: Prior

    def rows(self, ratio: float) -> WhiteRows:
        """White with this ratio."""
        white, log_determinant = whitened_by_both(self.band, self.gram, ratio, self.table)
        samples, squares, of_prior = self.prior
        # One row has the squares of all further samples.
        design = np.concatenate([white[:, :-1], np.zeros((1, white.shape[1] - 1))])
        target = np.append(white[:, -1], np.sqrt(squares))
        return WhiteRows(target, design, log_determinant + of_prior, further=samples - 1.0)

    def factor(self, ratio: float) -> Array:
        """Cholesky factor of the covariance."""
        return cholesky_factor(self.band, self.gram, ratio)


class WeighedRun(NamedTuple):
    """A run with its `noises`, its rows, the operator that they are taken with, and its likelihood."""

    run: RunRegression
    rows: Rows
    operator: DeviationOperator
    likelihood: RatioLikelihood


def average_by_ratios(
    weighed: Sequence[WeighedRun], solution: Solution, active: Mask, constraints: ConstraintMap
) -> RatioAverage:
    """Coefficients and reference frequency over the ratios that the runs leave open, each run's by itself.

    Parameters
    ----------
    weighed : sequence of WeighedRun
        All runs of the solution.
    solution : Solution
        At the most likely ratios.
    active : (force,) array of bool
    constraints : ConstraintMap
    """
    zero = np.zeros_like(solution.covariance)
    shift, added = zero[0], zero
    for at, (run, _, _, likelihood) in enumerate(weighed):
        assert run.noises is not None
        solved = partial(_solved_with, weighed, at, active, constraints)
        average = average_over_ratios(likelihood.rows, run.noises.ratio, len(run.problem.time), solved)
        shift, added = shift + average.shift, added + average.covariance
    return RatioAverage(shift, added)


def _solved_with(
    weighed: Sequence[WeighedRun], at: int, active: Mask, constraints: ConstraintMap, ratio: VarianceRatio
) -> tuple[Array, Array]:
    """Coefficients and frequency, and their covariance, with another ratio of one run."""
    runs, rows = [each_run.run for each_run in weighed], [each_run.rows for each_run in weighed]
    noises = runs[at].noises
    assert noises is not None
    runs[at] = replace(runs[at], noises=replace(noises, ratio=ratio))
    rows[at] = replace(rows[at], factor=weighed[at].likelihood.factor(ratio.ratio))
    other = solve(stack_rows(tuple(runs), rows), runs[0], active, constraints)
    return common_values(other.applied_to(tuple(runs))), other.covariance
