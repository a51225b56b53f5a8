"""Rows of the regression of Eq. 1 on its force columns, in weak and in strong form."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sysid_trib.arrays import Array
from sysid_trib.likelihood.linearisation import DeviationOperator
from sysid_trib.likelihood.problem import RunRegression
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


def weak_rows(run: RunRegression, operator: DeviationOperator) -> Rows:
    """Weak rows about a run's reference trajectory (see `rows_about`), with what whitens them."""
    return replace(rows_about(run, operator.matrix), factor=operator.factor)


def rows_about(run: RunRegression, matrix: sp.csr_matrix) -> Rows:
    """Weak rows of the regression about a run's reference trajectory.

    Parameters
    ----------
    run : RunRegression
    matrix : (row, sample) sparse array of float
        Operator of small deviations about a motion nearby.

    Returns
    -------
    Rows
        Without a factor.

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
    """The weak rows of all runs about their reference trajectories."""
    return stack_rows(runs, [weak_rows(run, near) for run, near in zip(runs, operators, strict=True)])


def stack_rows(runs: Sequence[RunRegression], rows: Sequence[Rows]) -> Rows:
    """Rows of several runs as one regression.

    Parameters
    ----------
    runs : sequence of RunRegression
        Each counts by its noise, relative to their RMS.
    rows : sequence of Rows
        Of each run.

    Returns
    -------
    Rows
        With common coefficients and stiffness, and a zero of the sensor for each run.
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


def white_without_nuisances(rows: Rows, columns: Array) -> tuple[Array, Array]:
    """White columns and target, the nuisances projected out of them.

    Parameters
    ----------
    rows : Rows
    columns : (row, column) array of float
        The columns to take in place of the rows' own.

    Returns
    -------
    columns : (row, column) array of float
    target : (row,) array of float
    """
    table = np.column_stack([rows.nuisances, columns, rows.target])
    white = table if rows.factor is None else whiten(rows.factor, table)
    count = rows.nuisances.shape[1]
    basis, _ = np.linalg.qr(white[:, :count])
    outside = white[:, count:] - basis @ (basis.T @ white[:, count:])
    return outside[:, :-1], outside[:, -1]
