"""Fitted and held-out parts of records, their prediction, and the test whether the residual is noise."""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.paths import RecordPath
from sysid_trib.discovery.engine.run_rows import decimated, run_rows
from sysid_trib.discovery.engine.start_model import default_shapes, path_like
from sysid_trib.discovery.engine.trials import TrialEffect
from sysid_trib.discovery.free_motion import free_motion, free_motions, model_identification, model_of_fit
from sysid_trib.discovery.omnibus_test import FAMILIES
from sysid_trib.errors import DecayError, SysidTribError, UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.selection import forces_to_identify
from sysid_trib.likelihood.sensor_noise import white_p_value
from sysid_trib.likelihood.weak_form import whiten
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.smoothing import KNOTS_PER_PERIOD, sensor_noise, swing_frequency
from sysid_trib.validation.holdout import first_held_out, mean_over_error, up_to_held_out
from sysid_trib.validation.random_force_test import dependence_on_motion
from sysid_trib.validation.residuals import FollowedRuns


class Prediction(NamedTuple):
    """Prediction of parts of records to which a model was not fitted.

    Attributes
    ----------
    log_densities : (period,) array of float
        Mean logarithm of the predictive density of the rows in each period of all parts, given the rows
        before.
    residuals : tuple of (sample,) array of float, rad
        Residual of the free motion in each part, with fitted start and sensor's zero; empty if the model has
        no motion.
    """

    log_densities: Array
    residuals: tuple[Array, ...]

    @property
    def rms(self) -> float:
        """RMS residual of all parts, rad; nan if the model has no motion."""
        if not all(map(len, self.residuals)):
            return float("nan")
        return root_mean_square([root_mean_square(residual) for residual in self.residuals])


def start_forces(
    asked: ForceLibrary, reference_frequency: float | None, constraints: Constraints
) -> tuple[ForceLibrary, list[Force], list[tuple[TrialEffect, float]]]:
    """Return the forces of the start model: all, the fitted ones, and held ones with coefficients."""
    if not len(asked):
        raise UsageError("The start model has no force; give at least one, such as a viscous one.")
    model = forces_to_identify(asked, reference_frequency)
    fix = constraints.fixed
    if other := [name for name in constraints.names if name not in fix]:
        raise UsageError(
            f"discover supports fixed coefficients only; leave out the bound or tie of {other[0]}."
        )
    able = [force.symbol for force in model if force.kind == "force"]
    for symbol in fix:
        if symbol not in able:
            raise UsageError(f"No force '{symbol}' of the model can be held; there are {', '.join(able)}.")
    free = [force for force in model if force.symbol not in fix]
    if not free:
        raise UsageError("Every force of the start model is fixed; add one that is fitted, such as zeta.")
    held = [(TrialEffect(f, default_shapes(f)), float(fix[f.symbol])) for f in model if f.symbol in fix]
    return model, free, held


class RecordPart(NamedTuple):
    """A part of a run.

    `record` : samples of the part. `run` : index of its run, from 0. `origin` : time (s) from which the `t`
    of formulas counts. `before` : the samples before the part and its first sample, for history-dependent
    forces; None at the beginning of a record.
    """

    record: xr.Dataset
    run: int
    origin: float
    before: xr.Dataset | None = None


def search_parts(
    runs: Sequence[xr.Dataset], unseen: Sequence[xr.Dataset], per_period: int
) -> tuple[list[xr.Dataset], list[RecordPart], list[RecordPart]]:
    """Return the decimated runs, the parts to which models are fitted, and the parts that they predict.

    Driven records are decimated only as far as their inputs allow.

    Models are fitted to whole runs and predict the held-out records. Without held-out records, they are
    fitted to the first two thirds of each run and predict the last third.
    """
    kept, records = (
        [run if inputs_of(run) else decimated(run, per_period) for run in those] for those in (runs, unseen)
    )
    learnt, later = list[RecordPart](), list[RecordPart]()
    for at, run in enumerate(kept):
        time = run.time.values.astype(float)
        end = len(time) if records else first_held_out(time)
        for part in _stretches(run, slice(0, end)):
            learnt.append(RecordPart(part, at, float(time[0]), _before(run, part)))
        for part in [] if records else _stretches(run, slice(end, None)):
            is_whole = part.sizes["time"] == len(time) - end
            before = up_to_held_out(run) if is_whole else _before(run, part)
            later.append(RecordPart(part, at, float(time[0]), before))
    for at, record in enumerate(records):
        # Each part has the noise of its run; `t` counts from the first sample of the record that contains it.
        name = record.attrs.get("record_checksum")
        same = [run for run in kept if name and run.attrs.get("record_checksum") == name]
        origin = float((same or [record])[0].time.values[0])
        run_of_noise = min(at, len(kept) - 1)
        later.extend(RecordPart(part, run_of_noise, origin) for part in _stretches(record, slice(None)))
    return kept, learnt, later


def _before(run: xr.Dataset, part: xr.Dataset) -> xr.Dataset | None:
    """Return the run before a part, at most as long, with the first sample of the part; None at the start."""
    begin, count = int(np.searchsorted(run.time.values, part.time.values[0])), part.sizes["time"]
    return run.isel(time=slice(max(0, begin - count), begin + 1)) if begin else None


def _stretches(run: xr.Dataset, within: slice) -> Iterator[xr.Dataset]:
    """Yield the part of a run, or three stretches of it if the run is driven and long."""
    part = run.isel(time=within)
    if not inputs_of(run):
        yield part
        return
    try:
        # A decay shows every amplitude once, a driven record shows the same amplitudes again and again. The
        # computing time of a candidate grows with the number of periods. Beyond this number in each of three
        # stretches, the named effects do not change.
        duration = 2.0 * np.pi / swing_frequency(run) * 60
    except DecayError:
        # Without an oscillation there are no periods to count.
        yield part
        return
    time = part.time.values
    if time[-1] - time[0] > 4.0 * duration:
        # At the beginning of a record the states of history-dependent forces are unknown; a few periods
        # determine them.
        part = part.sel(time=slice(time[0] + 0.1 * duration, None))
    time = part.time.values
    whole = time[-1] - time[0]
    if whole <= 3.0 * duration:
        yield part
        return
    starts = time[0] + np.linspace(0.0, 1.0, 3) * (whole - duration)
    ends = starts + duration
    bounds = zip(np.searchsorted(time, starts), np.searchsorted(time, ends, side="right"), strict=True)
    yield from (part.isel(time=slice(int(first), int(last))) for first, last in bounds)


def predicted(
    model: FittedModel, parts: Sequence[RecordPart], runs: Sequence[int], frequency: float
) -> Prediction:
    """Predict parts of records to which the model was not fitted.

    Parameters
    ----------
    model : FittedModel
    parts : sequence of RecordPart
    runs : sequence of int
        Index of the run whose noises each part has.
    frequency : float, rad/s
        Frequency of the test functions, which is the same for all compared models.

    Notes
    -----
    Variances, coefficients and shapes are the model's. Errors of the coefficients and shapes widen the
    predictive density, so uncertain parameters are not penalised. The start and the sensor's zero are fitted
    to the part itself, because the rows do not contain the start. Internal states, such as those of a
    resonator, continue from the record before. The rows are ordered in time, and the factor of their
    covariance is triangular: each row is predicted from those before it, a few samples ahead.
    """
    scores, residuals = [], []
    for part, run in zip(parts, runs, strict=True):
        near = model.rows[run].path
        past = None if all(trial.force.memoryless for trial in model.trials) else part.before
        path = path_like(near, part.record, frequency, part.origin, past).rescaled(near.frequency)
        scored, path = _scored(model, path, run)
        scores.append(scored)
        try:
            motion = free_motion(model_of_fit(model), path, model.sensor(run))
            residuals.append(motion.residual)
        except SysidTribError:
            residuals.append(np.array([]))
    return Prediction(np.concatenate(scores), tuple(residuals))


def _scored(model: FittedModel, path: RecordPath, run: int) -> tuple[Array, RecordPath]:
    """Return mean log predictive density of the rows of each period, and the smoothed path."""
    ratio, deviation = float(model.likelihood.ratios[run]), float(np.sqrt(model.likelihood.variances[run]))
    # Three iterations of the path of the predicted part.
    for _ in range(3):
        rows = run_rows(path, model.trials, model.estimate)
        unexplained = rows.target - rows.columns(model.trials) @ model.coefficients
        unexplained = unexplained - model.stiffness * path.stiffness_column
        zero = -(rows.operator @ np.ones(len(path.time)))
        factor = rows.factor(ratio)
        white = whiten(factor, np.column_stack([unexplained, zero]))
        offset = float(white[:, 1] @ white[:, 0] / (white[:, 1] @ white[:, 1]))
        errors = offset + path.sensor_errors(model.terms), path.sensor_slopes(model.terms)
        followed = path.follow(rows.smoothed_motion(unexplained - offset * zero, *errors, ratio), model.terms)
        if not np.all(np.isfinite(followed.points[1])):
            # If the model diverges, judge it with the last motion that follows the part.
            break
        path = followed
    parameters, covariance = model.without_zeros(rows)
    columns, of_zero = whiten(factor, parameters) / deviation, white[:, 1]
    columns = columns - np.outer(of_zero, of_zero @ columns) / (of_zero @ of_zero)
    innovation = (white[:, 0] - offset * of_zero) / deviation
    scores = _scores_of_periods(innovation, columns, covariance)
    determinants = np.log(factor[0][: len(scores) * KNOTS_PER_PERIOD]).reshape(-1, KNOTS_PER_PERIOD)
    return scores - determinants.mean(axis=1) - np.log(deviation), path


def _scores_of_periods(innovation: Array, columns: Array, covariance: Array) -> Array:
    """Return the mean log density of white rows in each period, with uncertain parameters.

    Parameters
    ----------
    innovation : (row,) array of float
        Innovations of the rows with the estimated parameters.
    columns : (row, parameter) array of float
    covariance : (parameter, parameter) array of float
        Covariance of the parameters before the first row; each period reduces it (recursive least squares).
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
        # The unit matrix plus the covariance due to parameters: no variance is below one, except by rounding.
        variances, turned = np.linalg.eigh(np.eye(KNOTS_PER_PERIOD) + of_parameters)
        variances = np.maximum(variances, 1.0)
        solved = turned @ (turned.T @ np.column_stack([surprise, along]) / variances[:, None])
        squares = surprise @ solved[:, 0]
        scores.append(-0.5 * (squares + np.sum(np.log(variances))) / KNOTS_PER_PERIOD)
        change = change + along.T @ solved[:, 0]
        covariance = covariance - along.T @ solved[:, 1:]
    return np.array(scores)


def improvements(predictions: Sequence[Prediction]) -> Array:
    """Return the gain of the last prediction over each earlier one, in standard errors, (prediction - 1,).

    Do not require every step to improve the prediction: a correct force can predict worse while others are
    still missing.

    Notes
    -----
    This is Diebold and Mariano's test (see `mean_over_error`). The score is the predictive density of the
    rows, which includes the errors of the coefficients. `compare` uses residuals of motions instead, because
    some of its methods give no density (`validation.holdout.diebold_mariano`).
    """
    better = []
    for before in predictions[:-1]:
        with np.errstate(invalid="ignore"):
            difference = predictions[-1].log_densities - before.log_densities
        # Leave out periods in which a model's errors are not finite.
        better.append(mean_over_error(difference[np.isfinite(difference)]))
    return np.array(better)


def noise_p_value(model: FittedModel, runs: Sequence[xr.Dataset], unseen: Callable[[], float]) -> float:
    """Return the p-value that the residual of every run is sensor noise or a random force.

    The p-value is 1 if the free motion follows the records and predicts the held-out parts up to the noise
    (`unseen` : function that returns the RMS of the held-out residual). It is 0 if the motion does not follow
    a record and the model has no random force there. With a random force, the free motion departs from the
    record and predicts distant times well only by chance; and coloured noise may hide a force. Then the
    residual must not depend on angle, speed or time (`dependence_on_motion`; Bonferroni). A driven motion may
    contain components that no spline follows, so that its noise is not known without a model. Its residual is
    therefore tested for whiteness.
    """
    motions, most = free_motions(model), model.settings.free_residual
    if any(map(inputs_of, runs)):
        return min(1.0, len(motions) * min(white_p_value(motion.residual) for motion in motions))
    stochastic = model.likelihood.ratios > 0.0
    if any(not motion.over_noise < most and not stochastic[at] for at, motion in enumerate(motions)):
        return 0.0
    noises = [sensor_noise(run) for run in runs]
    sizes = zip([root_mean_square(motion.residual) for motion in motions], noises, strict=True)
    follows = all(size < most * noise for size, noise in sizes)
    if follows and unseen() < most * root_mean_square(noises):
        return 1.0
    followed = FollowedRuns(dict(enumerate(runs)), model_identification(model, motions, runs))
    try:
        least = min(dependence_on_motion(followed, at).p_value.item() for at in range(len(runs)))
    except SysidTribError:
        return 0.0
    return float(min(1.0, FAMILIES * len(runs) * least))
