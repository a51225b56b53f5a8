"""Driven records: identified by the direct method and the trajectory, and predicted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.errors import DecayError, SimulationError, Tell, UsageError, silent
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, white_p_value
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.trajectory import Trajectory
from sysid_trib.records import inputs, smoothing
from sysid_trib.records.decay import Decays, as_runs, one_or_all, root_mean_square
from sysid_trib.results.references import comparison_values, stated_covariance
from sysid_trib.results.schema import library_of, model_of, shape_values_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import described, group_names, noise_of_run
from sysid_trib.simulation.initial_conditions import first_guess, first_zero, fit_start
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.validation import findings, verdict
from sysid_trib.validation.residuals import FollowedRuns, with_motions
from sysid_trib.validation.sensor_refit import with_own_sensor
from sysid_trib.validation.verdict import APPROXIMATE_PART

# A model that leaves more of the record than this has not followed it.
SLIPPED_PART = 0.3


def is_driven(runs: Sequence[xr.Dataset]) -> bool:
    """True if a record has an input."""
    return any(inputs.inputs_of(run) for run in runs)


@in_units_of_the_motion
def identified_driven(
    decay: Decays, library: ForceLibrary, direct: Direct, trajectory: Trajectory, *, tell: Tell = silent
) -> xr.DataTree:
    """Identify the forces of driven records by Direct and, from there, by Trajectory.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        `angle(time)` with inputs; of one or several runs.
    library : ForceLibrary
        The forces offered.
    direct, trajectory : Direct and Trajectory
        With `random_force="auto"` Direct is fitted without a random force and, where its motion leaves more
        than noise, with one, which stands for what the model lacks; the one whose motion follows the record
        better is taken.
    tell : Tell

    Returns
    -------
    DataTree
        Groups `record` (`record_1`, ... of several) with `simulated_angle(model, time)`; `direct` and
        `trajectory`; `comparison`: over `quantity` difference, standard error and z of both, over `model`
        `residual_rms`, `residual_over_noise`, `residual_over_motion`, `residual_p_value` that the residual
        is white; attrs `answer`, the method that leaves less, and `verdict_on_record`. A method whose motion
        does not follow the record is left out.

    Raises
    ------
    DecayError
        Neither follows the record.
    """
    runs = as_runs(decay, driven=True)
    if direct.reference_frequency is None and is_free_to_move(library, Constraints(direct.constraints).fixed):
        # Nothing swings: the frequency is but a clock.
        clock = max(clock_of(run) for run in runs)
        direct = replace(direct, reference_frequency=clock)
        trajectory = replace(trajectory, reference_frequency=clock)
    tell("direct")
    together = dict(enumerate(runs))
    best = FollowedRuns(together, verdict.with_noise(direct, "off").identify(decay, library))
    # A residual of so many times the noise is more than noise.
    if direct.random_force == "auto" and _sizes(best)["residual_over_noise"] > 1.5:
        stochastic = replace(direct, random_force="estimated").identify(decay, library)
        best = min(best, FollowedRuns(together, stochastic), key=lambda of: _sizes(of)["residual_rms"])
    slipped, models = _sizes(best)["residual_over_motion"] >= SLIPPED_PART, {"direct": best}
    tell("trajectory")
    begun = trajectory if trajectory.random_force != "auto" else replace(trajectory, random_force="off")
    if not slipped and not trajectory.start:
        # With the coefficients of all runs.
        result = best.result
        of_all = dict(zip(result.force.values.tolist(), result.coefficient.values.tolist(), strict=True))
        frequency = result.reference_frequency.item()
        begun = replace(begun, start=Model(library_of(result), of_all, frequency, shape_values_of(result)))
    try:
        models["trajectory"] = FollowedRuns(together, begun.identify(one_or_all(runs), library))
    except DecayError:
        if slipped:
            raise
    kept = {name: of for name, of in models.items() if _sizes(of)["residual_over_motion"] < SLIPPED_PART}
    if not kept:
        raise DecayError(
            "No motion of these forces follows the record; offer other forces (--forces), or a shorter part "
            "of it (--window)."
        )
    return _tree(kept)


def clock_of(record: xr.Dataset) -> float:
    """A frequency (rad/s) below which the rate of a motion has nearly all of its power, to two digits."""
    time = record.time.values.astype(float)
    step = float(np.median(np.diff(time)))
    rate = np.diff(np.interp(np.arange(time[0], time[-1], step), time, record.angle.values))
    power = np.cumsum(np.abs(np.fft.rfft(rate)) ** 2)
    # Part of the power of the rate.
    at = np.searchsorted(power, 0.95 * power[-1])
    return smoothing.nominal_frequency(2.0 * np.pi * float(np.fft.rfftfreq(len(rate), step)[max(1, at)]))


SIZES = ("residual_rms", "residual_over_noise", "residual_over_motion", "residual_p_value")


def _sizes(followed: FollowedRuns) -> dict[str, float]:
    """`SIZES` of what the motions leave of all runs, infinite where one has none."""
    return followed.once("sizes", lambda: dict(zip(SIZES, _sizes_of(followed), strict=True)))


def _sizes_of(followed: FollowedRuns) -> list[float]:
    runs, result = [*followed.runs.values()], followed.result
    pairs = zip(runs, followed.motions, strict=True)
    residuals = [run.angle.values - motion.x - motion.offset for run, motion in pairs if motion is not None]
    if len(residuals) < len(runs):
        return [np.inf] * len(SIZES)
    of_runs = [root_mean_square(residual) for residual in residuals]
    rms = root_mean_square(of_runs)
    over_noise = root_mean_square([size / noise_of_run(result, at) for at, size in enumerate(of_runs)])
    record = root_mean_square([float(run.angle.std()) for run in runs])
    return [rms, over_noise, rms / record, min(1.0, len(runs) * min(map(white_p_value, residuals)))]


def _tree(models: dict[str, FollowedRuns]) -> xr.DataTree:
    names, results = list(models), [followed.result for followed in models.values()]
    sizes = {name: [_sizes(followed)[name] for followed in models.values()] for name in SIZES}
    compared = xr.Dataset(described("driven", sizes), {"model": names})
    if len(names) == 2:
        compared = compared.merge(_difference(*results))
    best = compared.isel(model=int(np.argmin(compared.residual_rms.values)))
    verdict = "approximate" if best.residual_over_motion <= APPROXIMATE_PART else "not explained"
    compared.attrs = {
        "first": names[0],
        "second": names[-1],
        "answer": best.model.item(),
        "driven": "yes",
        "verdict_on_record": "explained" if best.residual_p_value >= WHITE_LEVEL else verdict,
    }
    records = with_motions(models)
    compared = compared.assign(findings.failure_of_models(records))
    groups = dict(zip(group_names("record", len(records)), records, strict=True))
    return xr.DataTree.from_dict(dict(zip(names, results, strict=True)) | {"comparison": compared} | groups)


def _difference(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Differences of coefficients and the asymptotic frequency, at the second's reference frequency."""
    symbols = [s for s in first.force.values.tolist() if s in second.force.values]
    frequency = second.reference_frequency.item()
    difference = np.subtract(*(comparison_values(result, symbols, frequency) for result in (first, second)))
    # The same record: the larger error of both, which their difference has at most where neither is wrong.
    errors = np.maximum(*(np.sqrt(np.diag(stated_covariance(result, symbols))) for result in (first, second)))
    z = np.divide(difference, errors, out=np.zeros_like(difference), where=errors > 0.0)
    data = described("driven", {"difference": difference, "standard_error": errors, "z": z})
    return xr.Dataset(data, {"quantity": [*symbols, "asymptotic_frequency"]})


# Samples by which a start can be fitted.
FEWEST_FITTED = 20


@in_units_of_the_motion
def predict(
    result: xr.Dataset, record: xr.Dataset, *, warm_up: float | None = None, run: int = 0
) -> xr.Dataset:
    """Predict a record by an identified model: its free run under the record's inputs.

    Parameters
    ----------
    result : Dataset
        An identification, of this record or of another one.
    record : Dataset
        `angle(time)`, and the inputs that the model's forces hold.
    warm_up : float, s, optional
        The start is fitted to so much of the beginning, which does not count for the residual; to all of the
        record where left out, and all of it counts.
    run : int
        Of the result's runs, from 0, the one whose own coefficients are taken.

    Returns
    -------
    Dataset
        `angle(time)`, `predicted_angle(time)` as the sensor shows it, `residual(time)`; scalars
        `residual_rms`, `residual_over_motion` (1, of the RMS about the mean); attrs `warm_up` (s), and
        `refitted_sensors`, the sensor terms that were fitted to the record, as its start and zero are:
        they belong to the run.

    Raises
    ------
    DecayError
        The motion of the model cannot be computed here, or the warm-up leaves nothing.
    UsageError
        The record lacks an input of the model.
    """
    (record,) = as_runs(record, driven=True)
    library = library_of(result).in_run(run + 1)
    model = replace(model_of(result, run), inputs=inputs.inputs_for(record, library))
    time = record.time.values.astype(float)
    counted = time >= time[0] + (warm_up or 0.0)
    if warm_up is not None and not FEWEST_FITTED <= np.count_nonzero(~counted) < len(time):
        raise UsageError(
            f"A warm-up of {warm_up:g} s holds {np.count_nonzero(~counted)} of {len(time)} samples; it takes "
            f"{FEWEST_FITTED} or more, and not all."
        )
    angle = record.angle.values.astype(float)
    fitted = counted if warm_up is None else ~counted
    model, record = with_own_sensor(result, model, record, fitted)
    start = first_guess(time, angle, model.reference_frequency)
    try:
        motion = fit_start(model, time[fitted], angle[fitted], start, offset=first_zero(model))
        x = motion.x if fitted.all() else trajectory(model, time, motion.angle, motion.rate).angle
    except SimulationError as error:
        raise DecayError(f"The model has no motion on this record: {error}") from None
    shown = x + motion.offset
    residual = angle - shown
    rms = float(np.sqrt(np.mean(residual[counted] ** 2)))
    values = {"predicted_angle": shown, "residual": residual, "residual_rms": rms}
    values |= {"residual_over_motion": rms / float(np.std(angle[counted]))}
    return record.assign(described("predicted", values)).assign_attrs(warm_up=warm_up or 0.0)
