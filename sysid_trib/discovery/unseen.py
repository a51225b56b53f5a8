"""What has not been seen, predicted: by the likelihood of its rows, and by a free run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.discovery.free_motion import free_motion, model_of_fit
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.paths import RecordPath
from sysid_trib.likelihood.run_rows import run_rows
from sysid_trib.likelihood.weak_form import cholesky_factor, whiten
from sysid_trib.records.decay import root_mean_square
from sysid_trib.records.smoothing import KNOTS_PER_PERIOD


@dataclass(frozen=True)
class Prediction:
    """How a model predicts what it has not seen.

    Attributes
    ----------
    scores : tuple of (period,) array of float
        Of each part: mean logarithm of the predictive density of the rows of each period, given those before.
    rms : float, rad
        Residual of the free motion, its start and the sensor's zero fitted.
    """

    scores: tuple[Array, ...]
    rms: float


def predicted(
    model: FittedModel,
    parts: Sequence[xr.Dataset],
    befores: Sequence[xr.Dataset | None],
    origins: Sequence[float],
    runs: Sequence[int],
    frequency: float,
) -> Prediction:
    """Predict parts of records by a model that has not seen them.

    Parameters
    ----------
    model : FittedModel
    parts : sequence of Dataset
        With `angle(time)`.
    befores : sequence of Dataset or None
        The record of each up to the part's first sample, and with it; None of a record of its own.
    origins : sequence of float, s
        From which the `t` of formulas counts in each.
    runs : sequence of int
        Whose noises are those of each.
    frequency : float, rad/s
        Of the test functions, the same for models that are compared.

    Notes
    -----
    Variances are the model's, and so are coefficients and shapes, with their errors: a model is not blamed
    for what it does not know. Of the part itself come its start, which the rows need not know, and the
    sensor's zero; of what came before what forces remember, as a resonator that rings on. The rows follow
    each other in time, and the factor of their covariance is triangular: each is predicted by those before
    it, a few samples ahead.
    """
    scores, residuals = [], []
    for part, before, origin, run in zip(parts, befores, origins, runs, strict=True):
        near = model.rows[run].path
        past = None if all(trial.force.memoryless for trial in model.trials) else before
        path = near.of_run(part, frequency, origin, past).rescaled(near.frequency)
        scored, path = _scored(model, path, run)
        scores.append(scored)
        try:
            motion = free_motion(model_of_fit(model), path, model.sensor(run))
            residuals.append(root_mean_square(motion.residual))
        except SysidTribError:
            residuals.append(float("nan"))
    return Prediction(tuple(scores), root_mean_square(residuals))


def _scored(model: FittedModel, path: RecordPath, run: int) -> tuple[Array, RecordPath]:
    """Mean logarithm of the predictive density of the rows of each period, and the smoothed path."""
    ratio, deviation = float(model.likelihood.ratios[run]), float(np.sqrt(model.likelihood.variances[run]))
    guess = np.append(model.coefficients, model.stiffness)
    sensors = [at for at, trial in enumerate(model.trials) if trial.force.kind == "sensor"]
    # Rounds of the path of a part that is predicted.
    for _ in range(3):
        rows = run_rows(path, model.trials, guess)
        unexplained = rows.target - rows.columns(model.trials) @ model.coefficients
        unexplained = unexplained - model.stiffness * path.stiffness_column
        zero = -(rows.operator @ np.ones(len(path.time)))
        factor = cholesky_factor(rows.band, path.form.gram, ratio)
        white = whiten(factor, np.column_stack([unexplained, zero]))
        offset = float(white[:, 1] @ white[:, 0] / (white[:, 1] @ white[:, 1]))
        error = path.sensor_values([model.trials[at] for at in sensors]) @ model.coefficients[sensors]
        slopes = path.sensor_slopes(model.trials, model.coefficients)
        motion = rows.smoothed_motion(unexplained - offset * zero, offset + error, slopes, ratio)
        followed = path.follow(motion, model.trials, model.coefficients)
        if not np.all(np.isfinite(followed.points.x)):
            # A model that runs away is judged with the last motion it follows.
            break
        path = followed
    parameters, covariance = model.without_zeros(rows)
    columns, of_zero = whiten(factor, parameters) / deviation, white[:, 1]
    columns = columns - np.outer(of_zero, of_zero @ columns) / (of_zero @ of_zero)
    innovation = (white[:, 0] - offset * of_zero) / deviation
    scores = _scores_of_periods(innovation, columns, covariance)
    return scores - _means_of_periods(np.log(factor[0])) - np.log(deviation), path


def _scores_of_periods(innovation: Array, columns: Array, covariance: Array) -> Array:
    """Mean logarithm of the density of white rows in each period, with parameters that are not quite known.

    Parameters
    ----------
    innovation : (row,) array of float
        With the parameters as they are thought to be.
    columns : (row, parameter) array of float
    covariance : (parameter, parameter) array of float
        What is not known of them before the first row; each period makes them better known (recursive least
        squares).
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    columns, covariance = columns * size, covariance / np.outer(size, size)
    change, scores = np.zeros(len(size)), []
    for begin in range(0, len(innovation) - KNOTS_PER_PERIOD + 1, KNOTS_PER_PERIOD):
        part = columns[begin : begin + KNOTS_PER_PERIOD]
        surprise = innovation[begin : begin + KNOTS_PER_PERIOD] - part @ change
        along = part @ covariance
        of_parameters = along @ part.T
        if not np.all(np.isfinite(of_parameters)):
            scores.append(-np.inf)
            continue
        # The unit matrix and what parameters add: no variance is below one, but for rounding.
        variances, turned = np.linalg.eigh(np.eye(KNOTS_PER_PERIOD) + of_parameters)
        variances = np.maximum(variances, 1.0)
        solved = turned @ (turned.T @ np.column_stack([surprise, along]) / variances[:, None])
        squares = surprise @ solved[:, 0]
        scores.append(-0.5 * (squares + np.sum(np.log(variances))) / KNOTS_PER_PERIOD)
        change = change + along.T @ solved[:, 0]
        covariance = covariance - along.T @ solved[:, 1:]
    return np.array(scores)


def _means_of_periods(values: Array) -> Array:
    """Means of values (row,) over whole periods, (period,)."""
    periods = len(values) // KNOTS_PER_PERIOD
    return np.asarray(values[: periods * KNOTS_PER_PERIOD].reshape(periods, KNOTS_PER_PERIOD).mean(axis=1))


def improvements(predictions: Sequence[Prediction]) -> Array:
    """By how many of its errors the last prediction is better than each before it, (prediction - 1,).

    Not each than the one before: while other forces are missing, a right name may predict worse.
    """
    return np.array([better_by(predictions[-1], before) for before in predictions[:-1]])


def better_by(after: Prediction, before: Prediction) -> float:
    """By how many of its errors the mean score of one model is better than that of another.

    Notes
    -----
    Diebold and Mariano's test of means over periods, between which scores are taken as independent; nan of
    fewer than three.
    """
    pairs = zip(after.scores, before.scores, strict=True)
    with np.errstate(invalid="ignore"):
        difference = np.concatenate([later - other for later, other in pairs])
    # Without periods in which a model's errors are not finite.
    difference = difference[np.isfinite(difference)]
    if len(difference) < 3 or not np.ptp(difference):
        return float("nan")
    return float(difference.mean() / difference.std(ddof=1) * np.sqrt(len(difference)))
