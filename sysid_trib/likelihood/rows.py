"""The regression of Eq. 1 on its force columns: rows in weak and strong form, and their solution."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.optimize import lsq_linear

from sysid_trib.arrays import Array, Mask
from sysid_trib.likelihood.least_squares import ConstraintMap, significant, white_least_squares, whitened
from sysid_trib.likelihood.regression import RunRegression, Runs, with_common_values
from sysid_trib.records.smoothing import KNOTS_PER_PERIOD, smooth
from sysid_trib.simulation.model import rescaling_factors


@dataclass(frozen=True)
class Rows:
    """Rows ``target = columns @ coefficients + nuisances @ steps + noise`` of runs about their paths.

    Attributes
    ----------
    runs : tuple of RunRegression
    target : (row,) array of float
    columns : (row, force) array of float
    nuisances : (row, run) or (row, run + 1) array of float
        The sensor's zero in each run and, if the frequency is fitted, the stiffness.
    factor : (band, row) array of float or None
        Cholesky factor of the rows' covariance for unit noise of the samples; None if the rows are white.
    lags : int
        Number of rows in two periods, over which residuals may be correlated.
    """

    runs: Runs
    target: Array
    columns: Array
    nuisances: Array
    factor: Array | None = None
    lags: int = 2 * KNOTS_PER_PERIOD

    @property
    def rms_forces(self) -> Array:
        """RMS of each force along the motions (force,), rad, for coefficient 1."""
        of_runs = [np.mean(run.columns**2, axis=0) for run in self.runs]
        rms = np.sqrt(np.average(of_runs, axis=0, weights=[run.form.rows for run in self.runs]))
        return np.where(rms > 0, rms, 1.0)


def rows_about(run: RunRegression, matrix: sp.csr_matrix, factor: Array | None = None) -> Rows:
    """Return the weak rows of the regression about a run's path.

    Parameters
    ----------
    run : RunRegression
    matrix : (row, sample) sparse array of float
        Operator of small deviations about a nearby motion.
    factor : (band, row) array of float, optional
        See `Rows`.

    Notes
    -----
    With L the operator of small deviations, S the terms h of the sensor and k = (frequency/nominal)^2, the
    rows are ``A x + k value (H c) + L (angle - offset - S s - x) = L noise``. Along an exact solution the
    first two terms cancel, so that quadrature errors cannot bias the result. Along a nearby path, only its
    difference from the exact solution remains. A known input is integrated if neither is available.
    """
    form, k = run.form, run.stiffness_scale
    target = -(matrix @ (run.angle - run.offset - run.x))
    columns, stiffness = k * (form.value @ run.columns), k * (form.value @ run.x)
    if run.of_sensor.any():
        columns[:, run.of_sensor] = -(matrix @ run.columns[:, run.of_sensor])
    if run.exact:
        target = target + columns @ run.acting
    else:
        near, force = (0.0, run.forcing) if run.near is None else run.near
        target = target - form.curvature @ (run.x - near) - form.value @ (k * run.x - force)
    # A common zero of all runs is a separate column.
    own_zero = np.full_like(run.x, not run.library.has_common_zero)
    nuisances = [-(matrix @ own_zero)] + [stiffness] * run.frequency_free
    return Rows((run,), target, columns, np.column_stack(nuisances), factor)


def strong_rows(runs: Runs) -> Rows:
    """Return rows theta'' + theta of the smoothed records, one a sample.

    They serve comparison: the noise of second derivatives makes them far less precise than the weak form, and
    smoothing biases them.
    """
    rows = []
    for run in runs:
        x, _, acceleration, _ = smooth(run.form.tau, run.angle)
        target = -(acceleration / run.stiffness_scale + x)
        nuisances = np.column_stack([-np.ones_like(x)] + [x] * run.frequency_free)
        lags = 2 * round(2.0 * np.pi / float(np.median(np.diff(run.form.tau))))
        rows.append(Rows((run,), target, run.columns, nuisances, lags=lags))
    return stacked(rows)


def weak_rows(runs: Runs, near: Runs | None = None) -> Rows:
    """Return weak rows of all runs about their paths, with their whitening for white noise of the samples.

    The rows are linear about these paths, or about the paths of the runs `near`.
    """
    pairs = zip(runs, near or runs, strict=True)
    return stacked([rows_about(run, at.operator, at.white_factor) for run, at in pairs])


def stacked(rows: Sequence[Rows]) -> Rows:
    """Return the rows of several runs, each weighted by its noise relative to their RMS, as one regression.

    The runs have common coefficients and a common stiffness; each has its own zero of the sensor.
    """
    if len(rows) == 1:
        return rows[0]
    runs = tuple(run for of_run in rows for run in of_run.runs)
    noise = np.array([run.noise for run in runs])
    pairs = list(zip(rows, np.sqrt(np.mean(np.square(noise))) / noise, strict=True))
    zeros = scipy.linalg.block_diag(*(w * run.nuisances[:, :1] for run, w in pairs))
    stiffness = np.concatenate([w * run.nuisances[:, 1:] for run, w in pairs])
    # Rows of different runs are independent, so their common factor is banded too.
    factors = [run.factor for run in rows if run.factor is not None]
    bands = max(map(len, factors), default=0)
    padded = [np.pad(factor, ((0, bands - len(factor)), (0, 0))) for factor in factors]
    return Rows(
        runs,
        np.concatenate([w * run.target for run, w in pairs]),
        np.concatenate([w * run.columns for run, w in pairs]),
        np.column_stack([zeros, stiffness]),
        np.concatenate(padded, axis=1) if padded else None,
        rows[0].lags,
    )


@dataclass(frozen=True)
class Solution:
    """Least squares of rows.

    Attributes
    ----------
    rows : Rows
    runs : tuple of RunRegression
        Runs with the new estimate, along the paths of the rows.
    coefficients : (force,) array of float
        Coefficients at the frequency of the rows; zero if a force is not in the model.
    steps : (run,) or (run + 1,) array of float
        Steps of the nuisances: the sensor's zero in each run (rad), the stiffness.
    covariance : (force + 1, force + 1) array of float
        Covariance of the coefficients and the reference frequency (rad/s).
    noise : float, rad
        RMS residual of the white rows.
    lags : int
        Number of lags over which the covariance allows for correlated residuals.
    constraints : ConstraintMap
        Constraints; coefficients at a bound are fixed there.
    """

    rows: Rows
    runs: Runs
    coefficients: Array
    steps: Array
    covariance: Array
    noise: float
    lags: int
    constraints: ConstraintMap


def solve(rows: Rows, constraints: ConstraintMap) -> Solution:
    """Solve the rows for the free coefficients.

    Notes
    -----
    If the residual is correlated, the covariance is the sandwich of `white_least_squares` over two periods.
    An active-set method finds coefficients that would pass a bound and holds them there.

    A constraint applies at the fitted reference frequency: a fitted stiffness changes the coefficients that
    satisfy it at the present frequency.
    """
    run = rows.runs[0]
    rescaling = _rescaling(run, run.coefficients * constraints.in_model)
    shift = rescaling - constraints.matrix @ rescaling[constraints.free]
    nuisances = rows.nuisances
    if run.frequency_free:
        nuisances = np.column_stack([nuisances[:, :-1], nuisances[:, -1] + rows.columns @ shift])
    design = np.column_stack([rows.columns @ constraints.matrix, nuisances])
    target = rows.target - rows.columns @ constraints.constant
    names = [run.library.symbols[i] for i in constraints.free]
    curves = list(run.library.curves_among(names).values())
    columns, white_target = whitened(rows.factor, design), whitened(rows.factor, target[:, None])[:, 0]
    solved, solved_covariance, noise, lags = white_least_squares(columns, white_target, rows.lags, curves)
    count = len(constraints.free)
    free, steps = solved[:count], solved[count:]
    if np.any((free < constraints.low) | (free > constraints.high)):
        # Nuisance parameters have no bounds.
        low, high = np.full((2, len(solved)), [[-np.inf], [np.inf]])
        low[:count], high[:count] = constraints.low, constraints.high
        side = lsq_linear(columns, white_target, (low, high), method="bvls").active_mask[:count]
        if not np.any(side):
            # If only the penalty of curves makes coefficients exceed bounds, hold those.
            side = np.sign(free - np.clip(free, constraints.low, constraints.high))
        limits = np.where(side < 0, constraints.low, constraints.high)[side != 0]
        return solve(rows, constraints.hold(side != 0, limits))
    coefficients = constraints.matrix @ free + constraints.constant
    jacobian = np.zeros((len(coefficients) + 1, len(solved)))
    jacobian[:-1, :count] = constraints.matrix
    if run.frequency_free:
        coefficients = coefficients + shift * steps[-1]
        # Jacobian from the stiffness to the frequency, w sqrt(1 + stiffness), and to coefficients that refer
        # to it.
        jacobian[:-1, -1] = -constraints.matrix @ _rescaling(run, coefficients)[constraints.free]
        jacobian[-1, -1] = 0.5 * run.frequency * np.sqrt(max(0.25, 1.0 + steps[-1]))
    covariance = jacobian @ solved_covariance @ jacobian.T
    runs = _updated(rows.runs, coefficients, steps, constraints)
    return Solution(rows, runs, coefficients, steps, covariance, noise, lags, constraints)


def _rescaling(run: RunRegression, coefficients: Array) -> Array:
    """Return the change of the coefficients (force,) per unit of stiffness for the same force."""
    degrees = np.array([2.0 if f.speed_degree is None else f.speed_degree for f in run.library])
    return np.where(run.of_sensor, 0.0, 0.5 * (2.0 - degrees) * coefficients)


def _updated(runs: Runs, coefficients: Array, steps: Array, constraints: ConstraintMap) -> Runs:
    """Return the runs with the next estimate and with the columns along the last motions.

    A fitted stiffness, the last of the steps, changes the reference frequency.
    """
    first, former = runs[0], runs[0].frequency
    frequency = former
    if first.frequency_free:
        frequency = float(former * np.sqrt(max(0.25, 1.0 + steps[-1])))
        factors = rescaling_factors(first.library.forces, former, frequency)
        # For a force without a degree in v, keep w^2 c and so its size at least. A sensor term has no w^2.
        factors = np.where(np.isnan(factors), (former / frequency) ** 2, factors)
        coefficients = coefficients * np.where(first.of_sensor, 1.0, factors)
    changed = [
        replace(run, offset=run.offset + float(step), v=run.v * (former / frequency))
        for run, step in zip(runs, steps, strict=False)
    ]
    return with_common_values(changed, constraints.impose(coefficients), frequency)


def with_errors_of_dropped(solution: Solution, active: Mask, constraints: ConstraintMap) -> Solution:
    """Return the solution with variances for inactive forces, as if each were added to the model."""
    covariance = solution.covariance.copy()
    for j in constraints.free[~active[constraints.free]]:
        added = active.copy()
        added[j] = True
        covariance[j, j] = solve(solution.rows, constraints.keep(added)).covariance[j, j]
    return replace(solution, covariance=covariance)


def with_errors_of_bounded(solution: Solution, constraints: ConstraintMap) -> Solution:
    """Return the solution with the covariance of the fit in which the coefficients at their bounds are free.

    A coefficient at its bound is uncertain: the errors of the others include this uncertainty.

    Parameters
    ----------
    solution : Solution
        Solution with some coefficients held at a bound.
    constraints : ConstraintMap
        The map in which these coefficients are still free.
    """
    if len(solution.constraints.free) == len(constraints.free):
        return solution
    unbounded = np.full(len(constraints.free), np.inf)
    free = solve(solution.rows, replace(constraints, low=-unbounded, high=unbounded))
    # The errors of the bounded fit include the residual due to the bounds.
    widening = max(1.0, solution.noise / free.noise) if free.noise > 0.0 else 1.0
    return replace(solution, covariance=widening**2 * free.covariance)


def select(
    rows: Rows, constraints: ConstraintMap, optimizer: Any = None, significance: float | None = None
) -> Mask:
    """Return the forces kept by an optimiser and at a significance level; all without either.

    Parameters
    ----------
    rows : Rows
    constraints : ConstraintMap
    optimizer : pysindy optimiser, optional
        It receives the whitened columns of the free coefficients, scaled to their RMS force (rad). Nuisances
        are projected out and never thresholded.
    significance : float, optional
        Significance level, see `significant`.

    Returns
    -------
    (force,) array of bool
        Fixed coefficients are always in the model; tied ones are in the model with the coefficients of their
        ties.
    """
    kept, count = np.ones(len(constraints.free), bool), rows.nuisances.shape[1]
    if optimizer is not None or significance is not None:
        columns = rows.columns @ constraints.matrix / rows.rms_forces[constraints.free]
        target = rows.target - rows.columns @ constraints.constant
        white = whitened(rows.factor, np.column_stack([rows.nuisances, columns, target]))
        basis, _ = np.linalg.qr(white[:, :count])
        outside = white[:, count:] - basis @ (basis.T @ white[:, count:])
    if optimizer is not None:
        # The optimiser may be the user's object: it must not be changed.
        kept &= deepcopy(optimizer).fit(outside[:, :-1], outside[:, -1:]).coef_[0] != 0.0
    if significance is not None:
        kept &= significant(outside[:, :-1], outside[:, -1], significance, removed_columns=count)
    return constraints.active(kept)
