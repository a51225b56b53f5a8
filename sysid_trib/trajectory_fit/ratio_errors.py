"""What it adds to the errors of a regression that the ratio of the two variances is not known exactly."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array, Mask
from sysid_trib.noise.ratio_posterior import ratio_posterior
from sysid_trib.noise.variance_ratio import WhiteRows
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


def covariance_by_ratios(
    weighed: Sequence[WeighedRun], solution: Solution, active: Mask, constraints: ConstraintMap
) -> Array:
    """What ratios that are not known exactly add to the covariance of a solution, each run's by itself.

    Parameters
    ----------
    weighed : sequence of WeighedRun
        All runs of the solution.
    solution : Solution
        At the most likely ratios.
    active : (force,) array of bool
    constraints : ConstraintMap

    Returns
    -------
    (force + 1, force + 1) array of float
        Mean square of the errors over the ratios that the run leaves open, beyond that at its most likely
        one: the solution moves with the ratio, and so does its covariance.
    """
    runs = tuple(each_run.run for each_run in weighed)
    added = np.zeros_like(solution.covariance)
    for at, (run, _, _, likelihood) in enumerate(weighed):
        assert run.noises is not None
        for ratio, variance, weight in ratio_posterior(likelihood.rows, run.noises.ratio):
            noises = replace(run.noises, ratio=replace(run.noises.ratio, ratio=ratio, variance=variance))
            others = (*runs[:at], replace(run, noises=noises), *runs[at + 1 :])
            of_runs = [each_run.rows for each_run in weighed]
            of_runs[at] = replace(of_runs[at], factor=likelihood.factor(ratio))
            other = solve(stack_rows(others, of_runs), runs[0], active, constraints)
            change = common_values(other.applied_to(runs)) - common_values(solution.applied_to(runs))
            added += weight * (other.covariance + np.outer(change, change) - solution.covariance)
    return added
