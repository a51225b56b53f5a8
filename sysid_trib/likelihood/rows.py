"""The regression of Eq. 1 on its force columns: its rows, in weak and in strong form, and their solution."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.optimize import lsq_linear

from sysid_trib.arrays import Array, Mask
from sysid_trib.likelihood.linearisation import DeviationOperator
from sysid_trib.likelihood.optimizers import ConstraintMap
from sysid_trib.likelihood.problem import RunRegression, Runs, update
from sysid_trib.likelihood.weak_form import whiten
from sysid_trib.records.smoothing import KNOTS_PER_PERIOD, smooth


@dataclass(frozen=True)
class Rows:
    """Rows ``target = columns @ scaled coefficients + nuisances @ steps + noise``.

    Attributes
    ----------
    target : (row,) array of float
    columns : (row, force) array of float
        Each divided by its `scale`.
    nuisances : (row, run) or (row, run + 1) array of float
        The sensor's zero in each run and, where the frequency is fitted, the stiffness.
    scale : (force,) array of float, rad
        RMS of each force.
    factor : (band, row) array of float or None
        Cholesky factor of the covariance of the rows in unit noise of the samples; None if they are white.
    lags : int
        Rows of two periods, over which residuals may be correlated.
    """

    target: Array
    columns: Array
    nuisances: Array
    scale: Array
    factor: Array | None = None
    lags: int = 2 * KNOTS_PER_PERIOD


def rows_about(run: RunRegression, matrix: sp.csr_matrix) -> Rows:
    """Weak rows of the regression about a run's reference trajectory, without a factor.

    Parameters
    ----------
    run : RunRegression
    matrix : (row, sample) sparse array of float
        Operator of small deviations about a motion nearby.

    Notes
    -----
    With L the operator of small deviations and S the terms h of the sensor,
    ``A x + k value (H c) + L (angle - offset - S s - x) = L noise``, k = (frequency/nominal)^2. Along an
    exact solution the first part vanishes, so that errors of quadrature cannot bias the result; of a path
    nearby, what its first part differs is left. A known input is integrated where neither is there.
    """
    problem, path, form = run.problem, run.reference, run.problem.form
    k = (run.frequency / problem.nominal_frequency) ** 2
    target = -(matrix @ (problem.angle - run.offset - path.x))
    columns, stiffness = k * (form.value @ path.columns), k * (form.value @ path.x)
    if problem.of_sensor.any():
        columns[:, problem.of_sensor] = -(matrix @ path.columns[:, problem.of_sensor])
    if path.exact:
        target = target + columns @ run.acting
    elif path.near is not None:
        target = (
            target - form.curvature @ (path.x - path.near.x) - form.value @ (k * path.x - path.near.force)
        )
    else:
        target = target - form.curvature @ path.x - form.value @ (k * path.x - problem.forcing)
    nuisances = [-(matrix @ np.ones_like(path.x))] + [stiffness] * problem.frequency_free
    scale = path.rms_forces
    return Rows(target, columns / scale, np.column_stack(nuisances), scale)


def strong_rows(run: RunRegression) -> Rows:
    """Rows theta'' + theta of the smoothed record, one a sample.

    For comparison: the noise of second derivatives makes them far less precise than the weak form, and
    smoothing biases them.
    """
    problem, path = run.problem, run.reference
    x, _, acceleration, _ = smooth(problem.form.tau, problem.angle)
    k = (run.frequency / problem.nominal_frequency) ** 2
    scale = path.rms_forces
    nuisances = [-np.ones_like(x)] + [x] * problem.frequency_free
    lags = 2 * round(2.0 * np.pi / float(np.median(np.diff(problem.form.tau))))
    return Rows(-(acceleration / k + x), path.columns / scale, np.column_stack(nuisances), scale, lags=lags)


def weak_regression(runs: Sequence[RunRegression], operators: Sequence[DeviationOperator]) -> Rows:
    """The weak rows of all runs about their reference trajectories, with what whitens them."""
    pairs = zip(runs, operators, strict=True)
    rows = [replace(rows_about(run, near.matrix), factor=near.factor) for run, near in pairs]
    return stack_rows(runs, rows)


def stack_rows(runs: Sequence[RunRegression], rows: Sequence[Rows]) -> Rows:
    """Rows of several runs, each weighted by its noise, as one regression.

    It has common coefficients and a common stiffness, and a zero of the sensor for each run.
    """
    if len(rows) == 1:
        return rows[0]
    weights = run_weights(runs)
    samples = np.array([len(run.target) for run in rows])
    scale = np.sqrt(samples @ np.stack([run.scale**2 for run in rows]) / samples.sum())
    pairs = list(zip(rows, weights, strict=True))
    zeros = scipy.linalg.block_diag(*(w * run.nuisances[:, :1] for run, w in pairs))
    stiffness = np.concatenate([w * run.nuisances[:, 1:] for run, w in pairs])
    return Rows(
        np.concatenate([w * run.target for run, w in pairs]),
        np.concatenate([w * run.columns * (run.scale / scale) for run, w in pairs]),
        np.column_stack([zeros, stiffness]),
        scale,
        _stacked_factors([run.factor for run in rows if run.factor is not None]),
        rows[0].lags,
    )


def run_weights(runs: Sequence[RunRegression]) -> Array:
    """Weight of the rows of each run, (run,): its noise, relative to their RMS."""
    noise = np.array([run.noise for run in runs])
    return np.asarray(np.sqrt(np.mean(np.square(noise))) / noise)


def _stacked_factors(factors: Sequence[Array]) -> Array | None:
    """Factor of the covariance of all rows, banded as well: rows of different runs are independent."""
    if not factors:
        return None
    bands = max(len(factor) for factor in factors)
    return np.concatenate([np.pad(f, ((0, bands - len(f)), (0, 0))) for f in factors], axis=1)


def _white_without_nuisances(rows: Rows, columns: Array) -> tuple[Array, Array]:
    """White columns, in place of the rows' own, and target, the nuisances projected out of both."""
    table = np.column_stack([rows.nuisances, columns, rows.target])
    white = table if rows.factor is None else whiten(rows.factor, table)
    count = rows.nuisances.shape[1]
    basis, _ = np.linalg.qr(white[:, :count])
    outside = white[:, count:] - basis @ (basis.T @ white[:, count:])
    return outside[:, :-1], outside[:, -1]


@dataclass(frozen=True)
class Solution:
    """Least squares of the rows.

    Attributes
    ----------
    coefficients : (force,) array of float
        Zero where a force is not in the model.
    steps : (run,) or (run + 1,) array of float
        Of the nuisances: the sensor's zero in each run (rad), the stiffness.
    covariance : (force + 1, force + 1) array of float
        Of the coefficients and the reference frequency (rad/s).
    noise : float, rad
        RMS residual of the white rows.
    lags : int
        Lags over which the covariance allows for correlated residuals.
    constraints : ConstraintMap
        With the coefficients that are held at a bound.
    residual : (row,) array of float
        Of the rows as they are, not white.
    """

    coefficients: Array
    steps: Array
    covariance: Array
    noise: float
    lags: int
    constraints: ConstraintMap
    residual: Array

    def applied_to(self, runs: Runs) -> Runs:
        """The runs with this solution as their estimate."""
        return update(runs, self.coefficients, self.steps, self.constraints)


def solve(rows: Rows, run: RunRegression, active: Mask, constraints: ConstraintMap) -> Solution:
    """Solve the rows for the active coefficients, (force,); `run` is any of those in the rows.

    Notes
    -----
    Of white rows the covariance is sigma^2 (X' X)^-1. Where the model leaves something in the residual, its
    rows are correlated: then it is the sandwich of Newey and West (1987) over two periods. Coefficients that
    would pass a bound are found by an active set and held there.
    """
    # Here, since importing pysindy takes as long as twenty identifications.
    from sysid_trib.likelihood.optimizers import WhitenedLeastSquares

    kept = constraints.keep(active)
    design, target, shift = _free_rows(rows, run, kept)
    fit = WhitenedLeastSquares(rows.factor, rows.lags).fit(design, target)
    count, scale = len(kept.free), rows.scale[kept.free]
    solved: Array = np.asarray(fit.coef_[0], dtype=float)
    free, steps = solved[:count] / scale, solved[count:]
    if np.any((free < kept.low) | (free > kept.high)):
        side = _bounds_reached(rows, design, target, kept)
        limits = np.where(side < 0, kept.low, kept.high)[side != 0]
        return solve(rows, run, active, kept.hold(side != 0, limits))
    coefficients = kept.matrix @ free + kept.constant
    jacobian = np.zeros((len(coefficients) + 1, len(solved)))
    jacobian[:-1, :count] = kept.matrix / scale
    if run.problem.frequency_free:
        coefficients = coefficients + shift * steps[-1]
        # From the stiffness to the frequency, w sqrt(1 + stiffness), and to coefficients that refer to it.
        jacobian[:-1, -1] = -kept.matrix @ _rescaling(run, coefficients)[kept.free]
        jacobian[-1, -1] = 0.5 * run.frequency * np.sqrt(max(0.25, 1.0 + steps[-1]))
    covariance = jacobian @ fit.covariance_[0] @ jacobian.T
    noise, lags = float(fit.noise_[0]), int(fit.lags_[0])
    return Solution(coefficients, steps, covariance, noise, lags, kept, target - design @ solved)


def with_errors_of_dropped(
    solution: Solution, rows: Rows, run: RunRegression, active: Mask, constraints: ConstraintMap
) -> Solution:
    """The solution with the variances that forces which are not active would have if they were added."""
    covariance = solution.covariance.copy()
    for j in constraints.free[~active[constraints.free]]:
        added = active.copy()
        added[j] = True
        covariance[j, j] = solve(rows, run, added, constraints).covariance[j, j]
    return replace(solution, covariance=covariance)


def select(rows: Rows, optimizers: Sequence[Any], constraints: ConstraintMap) -> Mask:
    """Forces to which all of the optimisers give a coefficient.

    Parameters
    ----------
    rows : Rows
    optimizers : sequence of pysindy optimisers
        They see the columns of the free coefficients, scaled to their RMS force (rad) and white; nuisances
        are projected out and never thresholded.
    constraints : ConstraintMap

    Returns
    -------
    (force,) array of bool
        Fixed coefficients are always in the model, tied ones with those that they are tied to.
    """
    kept = np.ones(len(constraints.free), bool)
    if not optimizers:
        return constraints.active(kept)
    target = replace(rows, target=rows.target - rows.columns @ (rows.scale * constraints.constant))
    columns, y = _white_without_nuisances(target, rows.columns @ _scaled(rows, constraints))
    for optimizer in optimizers:
        # The optimiser may be the user's: it must not come back changed.
        kept &= deepcopy(optimizer).fit(columns, y[:, None]).coef_[0] != 0.0
    return constraints.active(kept)


def _free_rows(rows: Rows, run: RunRegression, constraints: ConstraintMap) -> tuple[Array, Array, Array]:
    """Design by the free coefficients, scaled, and the nuisances; the target; what a stiffness shifts.

    A constraint holds at the reference frequency that is fitted with it: a stiffness changes the coefficients
    that hold it at the present frequency, (force,), by the last.
    """
    in_model = constraints.matrix.any(axis=1) | (constraints.constant != 0.0)
    rescaling = _rescaling(run, run.coefficients * in_model)
    shift = rescaling - constraints.matrix @ rescaling[constraints.free]
    target = rows.target - rows.columns @ (rows.scale * constraints.constant)
    nuisances = rows.nuisances
    if run.problem.frequency_free:
        moving = nuisances[:, -1] + rows.columns @ (rows.scale * shift)
        nuisances = np.column_stack([nuisances[:, :-1], moving])
    return np.column_stack([rows.columns @ _scaled(rows, constraints), nuisances]), target, shift


def _scaled(rows: Rows, constraints: ConstraintMap) -> Array:
    """The map of scaled free coefficients to scaled coefficients, (force, free)."""
    return rows.scale[:, None] * constraints.matrix / rows.scale[constraints.free]


def _rescaling(run: RunRegression, coefficients: Array) -> Array:
    """By how much a unit of stiffness changes the coefficients (force,) that give the same force."""
    degrees = np.array([2.0 if f.speed_degree is None else f.speed_degree for f in run.problem.library])
    return np.where(run.problem.of_sensor, 0.0, 0.5 * (2.0 - degrees) * coefficients)


def _bounds_reached(rows: Rows, design: Array, target: Array, constraints: ConstraintMap) -> Array:
    """Bound that each free coefficient has reached in bounded least squares: -1 the low, 1 the high, or 0."""
    table = np.column_stack([design, target])
    white = table if rows.factor is None else whiten(rows.factor, table)
    limits = np.full((2, design.shape[1]), [[-np.inf], [np.inf]])
    count, scale = len(constraints.free), rows.scale[constraints.free]
    limits[:, :count] = constraints.low * scale, constraints.high * scale
    bounded = lsq_linear(white[:, :-1], white[:, -1], limits, method="bvls")
    return np.asarray(bounded.active_mask[:count])
