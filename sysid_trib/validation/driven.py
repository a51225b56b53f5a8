"""Driven records: identification by the direct method and the trajectory, and prediction."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib import records
from sysid_trib.arrays import Array, Mask, root_mean_square
from sysid_trib.errors import DecayError, SimulationError, SysidTribError, Tell, UsageError, silent
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, white_p_value
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.trajectory import StartsOption, Trajectory, measured_starts
from sysid_trib.records import inputs
from sysid_trib.records.conversion import factor_between
from sysid_trib.records.driven_parts import driven_parts
from sysid_trib.records.roles import input_label
from sysid_trib.records.runs import Decays, RecordLike, as_runs, one_or_all
from sysid_trib.records.signal import (
    LONGEST_FILLED,
    PARTED_STEP,
    checked_signal,
    unit_of_signal,
    usual_step,
)
from sysid_trib.records.smoothing import clock_of
from sysid_trib.results.judged import best
from sysid_trib.results.models import INPUT_UNITS, library_of, shape_values_of
from sysid_trib.results.references import stated_covariance
from sysid_trib.results.schema import model_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import described, group_names, noise_of_run, signal_units
from sysid_trib.simulation.initial_conditions import first_guess, first_zero, true_start
from sysid_trib.simulation.measured_motion import MEASURED, MEASURED_TIME, measured_motion
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation import judge, verdict
from sysid_trib.validation.collinearity import identifiability
from sysid_trib.validation.common_reference import comparison_values
from sysid_trib.validation.model_error import with_error_by_another_fit
from sysid_trib.validation.residuals import FollowedRuns, with_motions
from sysid_trib.validation.sensor_refit import with_own_sensor
from sysid_trib.validation.start_search import fit_start_of_several

# If the residual of a model exceeds this fraction of the record, it does not follow the record.
SLIPPED_PART = 0.3


def is_driven(runs: Sequence[xr.Dataset]) -> bool:
    """Return true if a record has an input."""
    return any(inputs.inputs_of(run) for run in runs)


@in_units_of_the_motion
def identified_driven(
    decay: Decays, library: ForceLibrary, direct: Direct, trajectory: Trajectory, *, tell: Tell = silent
) -> xr.DataTree:
    """Identify the forces of driven records by Direct and, starting from its result, by Trajectory.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        One run or several with `angle(time)` and inputs.
    library : ForceLibrary
        The offered forces.
    direct, trajectory : Direct and Trajectory
        With `random_force="auto"` Direct is fitted without a random force and, if the residual of its motion
        is more than noise, with one. If the random force explains the record (its innovations are white and
        independent of the motion), both methods use it. Otherwise it only represents the missing forces, and
        Direct is the fit whose motion follows the record better.
    tell : Tell

    Returns
    -------
    DataTree
        Groups: `record` (`record_1`, ... for several) with `simulated_angle(model, time)`; `direct` and
        `trajectory`; `judged`: over `model` the residual, the p-value that it is white, and the verdict, with
        the attributes `preferred` (the method with the smaller residual, or `direct` if a random force
        explains the record) and `verdict`; `agreement`: over `quantity` difference, standard error and z of
        both methods. A method whose motion does not follow the record is left out.

    Raises
    ------
    DecayError
        Neither method follows the record.
    """
    runs = as_runs(decay, driven=True)
    free = is_free_to_move(library, Constraints(direct.constraints).fixed)
    _refuse_constant_push(runs, library, free)
    if not free:
        runs = [_without_bias(run) for run in runs]
        decay = one_or_all(runs)
    if direct.reference_frequency is None and free:
        # Without an oscillation, the frequency is only a unit of time.
        clock = max(clock_of(run) for run in runs)
        direct = replace(direct, reference_frequency=clock)
        trajectory = replace(trajectory, reference_frequency=clock)
    tell("identifiability")
    separated = identifiability(runs, library, constraints=direct.constraints)
    tell("direct")
    together = dict(enumerate(runs))
    with _saying(separated):
        best = FollowedRuns(together, verdict.with_noise(direct, "off").identify(decay, library))
    random_explains, stochastic = False, None
    # In an integrated record a random force cannot be separated from noise.
    own_quantity = any(MEASURED in run for run in runs)
    if direct.random_force == "auto" and not own_quantity and _sizes(best)["p_value"] < WHITE_LEVEL:
        tell("random force")
        result = replace(direct, random_force="estimated").identify(decay, library)
        stochastic = FollowedRuns(together, result)
        random_explains = _random_force_explains(stochastic)
        pair = [stochastic] if random_explains else [best, stochastic]
        best = min(pair, key=lambda of: _sizes(of)["tested_rms"])
    slipped, models = not _follows(best), {"direct": best}
    tell("trajectory")
    # The errors of a fit of the free motion do not include a random force, whose effect lasts long.
    noise: RandomForceOption = "estimated" if random_explains else "off"
    begun = trajectory if trajectory.random_force != "auto" else replace(trajectory, random_force=noise)
    if not slipped and not trajectory.start:
        # Use the result with the coefficients of all runs.
        result = best.result
        of_all = dict(zip(result.force.values.tolist(), result.coefficient.values.tolist(), strict=True))
        frequency = result.reference_frequency.item()
        begun = replace(begun, start=Model(library_of(result), of_all, frequency, shape_values_of(result)))
    try:
        models["trajectory"] = FollowedRuns(together, begun.identify(one_or_all(runs), library))
    except DecayError:
        if slipped:
            raise
    kept = {name: of for name, of in models.items() if _follows(of)}
    if own_quantity and "trajectory" in kept:
        # Direct uses the integral, whose noise is not white.
        kept = {"trajectory": kept["trajectory"]}
    if stochastic is not None and not random_explains and _follows(stochastic):
        for name, of in kept.items():
            if of is not stochastic:
                wider = with_error_by_another_fit(of.result, stochastic.result)
                kept[name] = of.with_result(wider)
    if not kept:
        raise DecayError(
            "No motion with these forces follows the record; offer other forces "
            "(--forces), or a shorter part "
            "of it (--window)."
        )
    return _tree(kept, "direct" in kept and random_explains, separated)


@contextmanager
def _saying(separated: xr.Dataset) -> Iterator[None]:
    """Add to an error about identical forces the motion that separates them."""
    try:
        yield
    except DecayError as error:
        if "are the same force" not in str(error) or not separated.attrs["sentences"]:
            raise
        raise DecayError(f"{error} {' '.join(separated.attrs['sentences'].splitlines())}") from None


def _without_bias(run: xr.Dataset) -> xr.Dataset:
    """Return a run without the linear trend that a bias of the rate causes in its integral."""
    if MEASURED not in run or run.attrs["measured"] != "rate":
        return run
    time = run.time.values.astype(float)
    line = np.polynomial.Polynomial.fit(time, run.angle.values, 1)(time)
    return run.assign(angle=run.angle.copy(data=run.angle.values - line))


def _refuse_constant_push(runs: Sequence[xr.Dataset], library: ForceLibrary, free: bool) -> None:
    """Raise an error for a force of an input alone that is constant in each run, like the sensor's zero.

    Raises
    ------
    DecayError
        There is such a force. It is allowed for a body without a restoring force, which it accelerates.
    """
    known = [inputs.inputs_of(run) for run in runs]
    for force in library if not free else ():
        input_only = force.inputs and not {"x", "v", "t"} & force.formula.names
        values = [of_run[name].values for of_run in known for name in force.inputs if name in of_run]
        if input_only and values and all(inputs.is_constant(of) for of in values):
            name, size = input_label(runs[0], force.inputs[0]), values[0][0]
            raise DecayError(
                f"The input {name} is {size:g} throughout and drives nothing: force '{force.symbol}' cannot "
                "be separated from the sensor's zero. Name another column, or give forces that combine the "
                "input with the motion, such as u*x."
            )


def _follows(followed: FollowedRuns) -> bool:
    """Return true if the motion of a model stays in phase with the records."""
    return _sizes(followed)["residual_over_motion"] < SLIPPED_PART


def _random_force_explains(stochastic: FollowedRuns) -> bool:
    """Return true if a random force that is independent of the motion explains the record."""
    try:
        return verdict.has_white_residual(stochastic) and verdict.is_random(stochastic)
    except (SysidTribError, np.linalg.LinAlgError):
        return False


def residual_over_motion(runs: Sequence[xr.Dataset], result: xr.Dataset) -> float:
    """Return the RMS residual of a model over the RMS of the runs; infinite without a motion."""
    return _sizes(FollowedRuns(dict(enumerate(runs)), result))["residual_over_motion"]


SIZES = ("tested_rms", "tested_over_noise", "residual_over_motion", "p_value")


def _sizes(followed: FollowedRuns) -> dict[str, float]:
    """Return `SIZES` of the residuals of all runs, infinite if a run has no motion."""
    return followed.once("sizes", lambda: dict(zip(SIZES, _sizes_of(followed), strict=True)))


def _sizes_of(followed: FollowedRuns) -> list[float]:
    runs, result = [*followed.runs.values()], followed.result
    of_runs = [_residual(followed, at) for at in followed.runs]
    residuals = [residual for residual in of_runs if residual is not None]
    if len(residuals) < len(runs):
        return [np.inf] * len(SIZES)
    sizes = [root_mean_square(residual) for residual in residuals]
    rms = root_mean_square(sizes)
    over_noise = root_mean_square([size / noise_of_run(result, at) for at, size in enumerate(sizes)])
    record = root_mean_square([_size_of(run, result) for run in runs])
    return [rms, over_noise, rms / record, min(1.0, len(runs) * min(map(white_p_value, residuals)))]


def _residual(followed: FollowedRuns, at: int) -> Array | None:
    """Return the residual of a run, over w for each integration; None if it has no motion."""
    run, result = followed.runs[at], followed.result
    if MEASURED not in run:
        motion = followed.motions[at]
        return None if motion is None else run.angle.values - motion.x - motion.offset
    model = replace(model_of(result, at), inputs=inputs.inputs_of(run))
    start = float(np.ravel(result.start_angle)[at]), float(np.ravel(result.start_rate)[at])
    try:
        _, residual = measured_motion(model, run, start)
    except SimulationError:
        return None
    return np.asarray(residual / _per_integration(run, result))


def _per_integration(run: xr.Dataset, result: xr.Dataset) -> float:
    """Return the reference frequency to the power of the integrations of the measured quantity."""
    return float(result.reference_frequency.item() ** int(run.attrs.get("integrations", 0)))


def _size_of(run: xr.Dataset, result: xr.Dataset) -> float:
    """Return the standard deviation of the measured quantity, over w for each integration."""
    own = MEASURED in run
    return float(run[MEASURED if own else "angle"].std()) / (_per_integration(run, result) if own else 1.0)


def _tree(models: Mapping[str, FollowedRuns], random_explains: bool, separated: xr.Dataset) -> xr.DataTree:
    names, results = list(models), [followed.result for followed in models.values()]
    records = with_motions(models)
    of_names = dict(zip(names, results, strict=True))
    p_value = float("nan")
    if random_explains:
        p_value = verdict.p_value_of_dependence(verdict.tested_runs(models["direct"]))
    table = judge.judged(records, of_names, tested_driven(models), random_force_p=p_value)
    # With a random force, the free motion is not the nearest one, but the coefficients are right.
    least = names[int(np.argmin(table.tested_rms.values))]
    preferred = "direct" if random_explains else least
    evidence = verdict.evidence_of_models(table, models)
    for name in names if random_explains else ():
        # Coloured sensor noise has no such test here; `_random_force_explains` has tested it.
        p_value = 1.0 if np.isnan(p_value) else p_value
        evidence[name] = replace(
            evidence[name], residual_is_noise=True, has_random_force=True, random_force_p=p_value
        )
    table = judge.with_verdicts(table, evidence, preferred, "driven")
    groups = dict(zip(group_names("record", len(records)), records, strict=True))
    groups |= of_names | {"judged": table, "identifiability": separated}
    if len(names) == 2:
        groups["agreement"] = _difference(*results)
    return xr.DataTree.from_dict(groups)


def tested_driven(models: Mapping[str, FollowedRuns]) -> xr.Dataset:
    """Return over `model` the tests of residuals of driven records, which have no part at rest."""
    sizes: dict[str, Any] = {name: [_sizes(followed)[name] for followed in models.values()] for name in SIZES}
    nothing = np.full(len(models), np.nan)
    sizes |= dict.fromkeys(("departure_time", "spectral_line", "spectral_line_amplitude"), nothing)
    return xr.Dataset(described("judged", sizes), {"model": list(models)})


def _difference(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Return differences of coefficients and asymptotic frequency, at the second's reference frequency."""
    symbols = [s for s in first.force.values.tolist() if s in second.force.values]
    frequency = second.reference_frequency.item()
    difference = np.subtract(*(comparison_values(result, symbols, frequency) for result in (first, second)))
    # `cross_check.comparison` uses the influence of each sample on both, which is known for free decays only.
    # Both methods use the same record: if both are right, their difference is at most the larger of the two
    # errors.
    errors = np.maximum(*(np.sqrt(np.diag(stated_covariance(result, symbols))) for result in (first, second)))
    z = np.divide(difference, errors, out=np.zeros_like(difference), where=errors > 0.0)
    data = described("agreement", {"difference": difference, "standard_error": errors, "z": z})
    return xr.Dataset(data, {"quantity": [*symbols, "asymptotic_frequency"]})


WORSE_THAN_REST = (
    "This prediction is worse than no motion: the model has another frequency or damping on this record"
)
RECORD_AT_REST = (
    "The record does not move where it is predicted: only the RMS of the residual says how good this is"
)
# Least number of samples for fitting a start.
FEWEST_FITTED = 20


def predict(
    result: xr.Dataset | xr.DataTree,
    record: RecordLike,
    *,
    warm_up: float | None = None,
    run: int = 0,
    starts: StartsOption = "fitted",
) -> xr.Dataset:
    """Predict a record with an identified model: its simulated motion under the record's inputs.

    Parameters
    ----------
    result : Dataset or DataTree
        An identification of this record or another one; for a whole result, its preferred one.
    record : record
        `angle(time)`, or `(t, angle)`; with the inputs in the model's forces.
    warm_up : float, s, optional
        Duration of the beginning to which the start is fitted, and which is left out of the residual. By
        default the start is fitted to the whole record, and the whole record counts.
    run : int
        Index of the run of the result, from 0, whose coefficients are used.
    starts : {"fitted", "measured"}
        `measured` uses angle and rate of the smoothed record at its first sample, and no zero of the sensor:
        nothing is fitted to the record.

    Returns
    -------
    Dataset
        `angle(time)`, `predicted_angle(time)` as the sensor's reading, `residual(time)`; scalars
        `residual_rms`, `residual_over_motion` (relative to the RMS about the mean; infinite for a record at
        rest), and, if the start is fitted to an angle or a displacement, `offset`, the zero of the sensor
        that is fitted with it. Attributes: `warm_up` (s); `note`, a sentence if the prediction is worse than
        no motion; `refitted_sensors`, the sensor terms that were fitted to the record like its start and
        zero, because they belong to the run.

    Raises
    ------
    DecayError
        The motion of the model cannot be computed here, or no samples remain after the warm-up.
    UsageError
        The record lacks an input of the model, or its unit is of another kind than that of the model.

    Notes
    -----
    Signal and inputs are converted to the units in which the model was identified; the prediction has these
    units.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(seed=1), method="direct")
    >>> other = st.predict(result, st.records.paper_twin(seed=2))
    >>> print(f"{other.residual_rms.item():.1e} rad, {other.residual_over_motion.item():.1%} of the motion")
    5.7e-04 rad, 0.7% of the motion
    """
    given, identified = records.one_record(record, "predict"), best(result)
    checked_signal(given)
    if starts == "measured" and warm_up is not None:
        raise UsageError("A measured start needs no warm-up; leave one of both out.")
    begin = _Begin(
        warm_up=warm_up,
        end=np.inf if warm_up is None else float(given.time[0]) + warm_up,
        measured_times=given[MEASURED_TIME if MEASURED in given else "time"].values.astype(float),
    )
    (whole,) = driven_parts(given, across_gaps=True, known_until=begin.end)
    return _predict(identified, _in_units_of(identified, whole), begin=begin, run=run, starts=starts)


@dataclass(frozen=True, eq=False)
class _Begin:
    """Beginning of a record to which the start of its prediction is fitted.

    Attributes
    ----------
    warm_up : float or None, s
        Its duration; None for the whole record, which then counts too.
    end : float, s
        Time of its end; infinite for the whole record.
    measured_times : (sample,) array of float, s
        Times of the measured samples; samples at other times were filled.
    """

    warm_up: float | None
    end: float
    measured_times: Array

    def counted(self, time: Array) -> Mask:
        """Return the samples whose residual counts."""
        return np.asarray(time >= self.end) if self.warm_up is not None else np.ones(len(time), dtype=bool)

    def fitted(self, time: Array) -> Mask:
        """Return the samples to which the start is fitted.

        Raises
        ------
        UsageError
            There are too few, or no samples remain.
        """
        if self.warm_up is None:
            return np.ones(len(time), dtype=bool)
        # A filled sample depends on its neighbours, and these may be later than the warm-up.
        fitted = (time < self.end) & np.isin(time, self.measured_times)
        count = np.count_nonzero(fitted)
        if count < FEWEST_FITTED or not np.any(time >= self.end):
            raise UsageError(
                f"A warm-up of {self.warm_up:g} s contains {count} of {len(time)} samples; it must contain "
                f"{FEWEST_FITTED} or more, but not all."
            )
        return fitted


def _in_units_of(result: xr.Dataset, record: xr.Dataset) -> xr.Dataset:
    """Convert a record to the units of a result.

    Raises
    ------
    UsageError
        A unit is of another kind.
    """
    unit, wanted = unit_of_signal(record), signal_units(result)
    factor = _factor("The signal of the record", unit, wanted)
    kinds = {channel.input: channel.kind for channel in library_of(result).channels}
    known = json.loads(str(result.attrs.get(INPUT_UNITS, "{}")))
    changed = record.copy()
    for key, values in record.variables.items():
        name, attrs = str(key), dict(values.attrs)
        own, by, new = str(attrs.get("units", "")), 1.0, ""
        if name in kinds:
            target = wanted + inputs.PER_KIND[kinds[name]] if kinds[name] else known.get(name)
            if own and target:
                by, new = _factor(f"The input {input_label(record, name)}", own, target), target
        elif own.startswith(unit) and own.removeprefix(unit) in inputs.PER_KIND.values():
            by, new = factor, wanted + own.removeprefix(unit)
        if new and by != 1.0:
            changed[name] = (values.dims, by * values.values, attrs | {"units": new})
    return changed


def _factor(what: str, unit: str, wanted: str) -> float:
    """Return the factor between two units; raise an error that names them if there is none."""
    factor = factor_between(unit, wanted)
    if factor is None:
        raise UsageError(
            f"{what} is in the unit {unit}, and the model was identified in {wanted}, which is of another "
            "kind; convert the record, or correct its unit."
        )
    return factor


@in_units_of_the_motion
def _predict(
    result: xr.Dataset,
    record: xr.Dataset,
    *,
    begin: _Begin,
    run: int,
    starts: StartsOption,
) -> xr.Dataset:
    """Predict a record in the units of the result (see `predict`)."""
    library = library_of(result).in_run(run + 1)
    model = replace(model_of(result, run), inputs=inputs.inputs_for(record, library))
    if first_zero(model) is not None:
        record = _without_bias(record)
    if starts == "measured":
        return _from_measured_start(record, model)
    if MEASURED in record:
        return _predicted_measured(result, record, model, begin)
    time, angle = record.time.values.astype(float), record.angle.values.astype(float)
    counted, fitted = begin.counted(time), begin.fitted(time)
    model, record = with_own_sensor(result, model, record, fitted)
    try:
        motion = fit_start_of_several(
            model,
            time[fitted],
            angle[fitted],
            _guess(time[fitted], angle[fitted], model),
            offset=first_zero(model),
        )
        x = motion.x if fitted.all() else trajectory(model, time, motion.angle, motion.rate).angle
    except SimulationError as error:
        raise DecayError(f"The model has no motion on this record: {error}") from None
    shown = x + motion.offset
    residual = angle - shown
    values = {"predicted_angle": shown, "residual": residual, "offset": motion.offset}
    scalars = _size_of_residual(residual[counted], angle[counted])
    return _with_prediction(record, values | scalars, begin.warm_up)


def _guess(time: Array, angle: Array, model: Model) -> tuple[float, float]:
    """Return the first estimate of the start from the given samples."""
    # In a gap, a spline contains no information.
    steps = np.diff(time)
    longest = LONGEST_FILLED * 2.0 * np.pi / model.reference_frequency
    # The reference frequency of a body without a spring may be far above that of the samples.
    gaps = np.flatnonzero(steps > max(longest, PARTED_STEP * usual_step(steps)))
    before = slice(gaps[0] + 1 if gaps.size else None)
    return first_guess(time[before], angle[before], model.reference_frequency)


def _size_of_residual(residual: Array, motion: Array) -> dict[str, float]:
    """Return the RMS of a residual, and its ratio to the motion: infinite for a record at rest."""
    rms = root_mean_square(residual)
    size = 0.0 if inputs.is_constant(motion) else float(np.std(motion))
    return {"residual_rms": rms, "residual_over_motion": rms / size if size else float("inf")}


def _from_measured_start(record: xr.Dataset, model: Model) -> xr.Dataset:
    """Predict a record from its measured start, without fitting anything to it."""
    shown_angle, rate, _ = measured_starts([record]).values()
    time, angle = record.time.values.astype(float), record.angle.values.astype(float)
    try:
        shown = trajectory(model, time, true_start(model, shown_angle, rate), rate).angle
    except SimulationError as error:
        raise DecayError(f"The model has no motion on this record: {error}") from None
    residual = angle - shown
    values = {"predicted_angle": shown, "residual": residual}
    predicted = _with_prediction(record, values | _size_of_residual(residual, angle), None)
    return predicted.assign_attrs(starts="measured")


def _with_prediction(
    record: xr.Dataset, values: Mapping[str, Array | float], warm_up: float | None
) -> xr.Dataset:
    """Return the record with its prediction, and a note if this is worse than no motion."""
    ratio = float(values["residual_over_motion"])
    note = ""
    if ratio == float("inf"):
        note = RECORD_AT_REST
    elif not ratio < 1.0:
        note = WORSE_THAN_REST
    return record.assign(described("predicted", values)).assign_attrs(warm_up=warm_up or 0.0, note=note)


def _predicted_measured(result: xr.Dataset, record: xr.Dataset, model: Model, begin: _Begin) -> xr.Dataset:
    """Predict a run of a measured rate or acceleration: residuals are in this quantity, over w."""
    time = record.measured_time.values.astype(float)
    counted, fitted = begin.counted(time), begin.fitted(time)
    try:
        motions = [
            measured_motion(model, record, start, fitted=fitted)
            for start in _guesses_of_measured(record, fitted, model)
        ]
    except SimulationError as error:
        raise DecayError(f"The model has no motion on this record: {error}") from None
    motion, residual = min(motions, key=lambda pair: root_mean_square(pair[1][fitted]))
    scale = _per_integration(record, result)
    residual = residual / scale
    values = {"predicted_angle": np.interp(record.time.values, time, motion.angle)}
    values |= {"residual": np.interp(record.time.values, time, residual)}
    scalars = _size_of_residual(residual[counted], record[MEASURED].values[counted] / scale)
    return _with_prediction(record, values | scalars, begin.warm_up)


def _guesses_of_measured(record: xr.Dataset, fitted: Mask, model: Model) -> list[tuple[float, float]]:
    """Return first estimates of the start from the fitted samples of a rate or an acceleration."""
    if fitted.all():
        return [_guess(record.time.values.astype(float), record.angle.values.astype(float), model)]
    time = record.measured_time.values.astype(float)[fitted]
    guesses = []
    # A sensor's zero grows by integration. Over several periods the mean is this zero, over a part of one it
    # belongs to the motion.
    for without_mean in (False, True):
        angle = record[MEASURED].values.astype(float)[fitted]
        for _ in range(int(record.attrs.get("integrations", 0))):
            angle = inputs.integral_of_rate(time, angle - without_mean * angle.mean())
        guesses.append(_guess(time, angle, model))
    return guesses
