"""Driven records: identified by the direct method and the trajectory, and predicted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SimulationError, Tell, UsageError, silent
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, white_p_value
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.trajectory import Trajectory
from sysid_trib.records.decay import Decays, as_runs, one_or_all, root_mean_square
from sysid_trib.records.inputs import inputs_for, inputs_of
from sysid_trib.records.signal import unit_of_signal
from sysid_trib.records.smoothing import nominal_frequency
from sysid_trib.results.references import comparison_values, stated_covariance
from sysid_trib.results.schema import library_of, model_of, shape_values_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import group_names, noise_of_run, variable
from sysid_trib.simulation.initial_conditions import first_guess, first_zero, fit_start
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.validation.residuals import fitted_motion
from sysid_trib.validation.verdict import APPROXIMATE_PART

# A model that leaves more of the record than this has not followed it.
SLIPPED_PART = 0.3


def is_driven(runs: Sequence[xr.Dataset]) -> bool:
    """True if a record has an input."""
    return any(inputs_of(run) for run in runs)


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
    fits = [_residuals(runs, replace(direct, random_force=_first(direct)).identify(decay, library))]
    # A residual of so many times the noise is more than noise.
    if direct.random_force == "auto" and _over_noise(fits[0]) > 1.5:
        fits.append(_residuals(runs, replace(direct, random_force="estimated").identify(decay, library)))
    best = min(fits, key=_size)
    pairs = {"direct": best}
    tell("trajectory")
    begun = replace(trajectory, random_force=_first(trajectory))
    if _over_motion(runs, best) < SLIPPED_PART and not trajectory.start:
        begun = replace(begun, start=_whole_model(best[0]))
    try:
        pairs["trajectory"] = _residuals(runs, begun.identify(one_or_all(runs), library))
    except DecayError:
        if _over_motion(runs, best) >= SLIPPED_PART:
            raise
    kept = {name: pair for name, pair in pairs.items() if _over_motion(runs, pair) < SLIPPED_PART}
    if not kept:
        raise DecayError(
            "No motion of these forces follows the record; offer other forces (--forces), or a shorter part "
            "of it (--window)."
        )
    return _tree(runs, kept)


def clock_of(record: xr.Dataset) -> float:
    """A frequency (rad/s) below which the rate of a motion has nearly all of its power, to two digits."""
    time = record.time.values.astype(float)
    step = float(np.median(np.diff(time)))
    rate = np.diff(np.interp(np.arange(time[0], time[-1], step), time, record.angle.values))
    power = np.cumsum(np.abs(np.fft.rfft(rate)) ** 2)
    # Part of the power of the rate.
    at = np.searchsorted(power, 0.95 * power[-1])
    return nominal_frequency(2.0 * np.pi * float(np.fft.rfftfreq(len(rate), step)[max(1, at)]))


def _whole_model(result: xr.Dataset) -> Model:
    """The model of a result with the coefficients of all runs, from which a fit can start."""
    coefficients = dict(zip(result.force.values.tolist(), result.coefficient.values.tolist(), strict=True))
    return Model(library_of(result), coefficients, result.reference_frequency.item(), shape_values_of(result))


def _first(method: Direct | Trajectory) -> RandomForceOption:
    return "off" if method.random_force == "auto" else method.random_force


Followed = tuple[xr.Dataset, list[Array]]


def _residuals(runs: Sequence[xr.Dataset], result: xr.Dataset) -> Followed:
    """A result, and what its free motion leaves of each run, (sample,); nan without a motion."""
    residuals = []
    for at, run in enumerate(runs):
        motion = fitted_motion(run, result, at)
        nothing = np.full(run.sizes["time"], np.nan)
        residuals.append(nothing if motion is None else run.angle.values - motion.x - motion.offset)
    return result, residuals


def _size(pair: Followed) -> float:
    size = root_mean_square([root_mean_square(residual) for residual in pair[1]])
    return size if np.isfinite(size) else np.inf


def _over_noise(pair: Followed) -> float:
    ratios = [root_mean_square(residual) / noise_of_run(pair[0], at) for at, residual in enumerate(pair[1])]
    return root_mean_square(ratios) if np.all(np.isfinite(ratios)) else np.inf


def _over_motion(runs: Sequence[xr.Dataset], pair: Followed) -> float:
    return _size(pair) / root_mean_square([float(run.angle.std()) for run in runs])


def _tree(runs: Sequence[xr.Dataset], kept: dict[str, Followed]) -> xr.DataTree:
    names = list(kept)
    answer = min(names, key=lambda name: _size(kept[name]))
    white = {name: min(1.0, len(runs) * min(map(white_p_value, kept[name][1]))) for name in names}
    unexplained = _over_motion(runs, kept[answer])
    verdict = "approximate" if unexplained <= APPROXIMATE_PART else "not explained"
    compared = xr.Dataset(
        {
            "residual_rms": variable("model", [_size(kept[n]) for n in names], "RMS residual", "rad"),
            "residual_over_noise": variable(
                "model", [_over_noise(kept[n]) for n in names], "over the noise", "1"
            ),
            "residual_over_motion": variable(
                "model", [_over_motion(runs, kept[n]) for n in names], "over the RMS of the record", "1"
            ),
            "residual_p_value": variable("model", [white[n] for n in names], "p-value of white noise", "1"),
        },
        {"model": names},
    )
    if len(names) == 2:
        compared = compared.merge(_difference(*(kept[name][0] for name in names)))
    compared.attrs = {
        "first": names[0],
        "second": names[-1],
        "answer": answer,
        "driven": "yes",
        "verdict_on_record": "explained" if white[answer] >= WHITE_LEVEL else verdict,
    }
    groups = {name: kept[name][0] for name in names} | {"comparison": compared}
    for at, group in enumerate(group_names("record", len(runs))):
        simulated = np.stack([runs[at].angle.values - kept[name][1][at] for name in names])
        angle = variable(("model", "time"), simulated, "angle of the model", "rad")
        groups[group] = runs[at].assign_coords(model=names).assign(simulated_angle=angle)
    return xr.DataTree.from_dict(groups)


def _difference(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Differences of coefficients and the asymptotic frequency, at the second's reference frequency."""
    symbols = [s for s in first.force.values.tolist() if s in second.force.values]
    frequency = second.reference_frequency.item()
    difference = np.subtract(*(comparison_values(result, symbols, frequency) for result in (first, second)))
    # The same record: the larger error of both, which their difference has at most where neither is wrong.
    errors = np.maximum(*(np.sqrt(np.diag(stated_covariance(result, symbols))) for result in (first, second)))
    z = np.divide(difference, errors, out=np.zeros_like(difference), where=errors > 0.0)
    return xr.Dataset(
        {
            "difference": variable("quantity", difference, "first minus second"),
            "standard_error": variable("quantity", errors, "the larger error of both"),
            "z": variable("quantity", z, "difference over error", "1"),
        },
        {"quantity": [*symbols, "asymptotic_frequency"]},
    )


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
        `residual_rms`, `residual_over_motion` (1, of the RMS about the mean); attrs `warm_up` (s).

    Raises
    ------
    DecayError
        The motion of the model cannot be computed here, or the warm-up leaves nothing.
    UsageError
        The record lacks an input of the model.
    """
    (record,) = as_runs(record, driven=True)
    library = library_of(result).in_run(run + 1)
    model = replace(model_of(result, run), inputs=inputs_for(record, library))
    time = record.time.values.astype(float)
    counted = time >= time[0] + (warm_up or 0.0)
    if warm_up is not None and not FEWEST_FITTED <= np.count_nonzero(~counted) < len(time):
        raise UsageError(
            f"A warm-up of {warm_up:g} s holds {np.count_nonzero(~counted)} of {len(time)} samples; it takes "
            f"{FEWEST_FITTED} or more, and not all."
        )
    angle = record.angle.values.astype(float)
    try:
        shown = _shown(model, time, angle, ~counted if warm_up is not None else counted)
    except SimulationError as error:
        raise DecayError(f"The model has no motion on this record: {error}") from None
    residual, unit = angle - shown, unit_of_signal(record)
    rms = float(np.sqrt(np.mean(residual[counted] ** 2)))
    data = {
        "predicted_angle": variable("time", shown, "prediction", unit),
        "residual": variable("time", residual, "record minus prediction", unit),
        "residual_rms": variable((), rms, "RMS of record minus prediction", unit),
        "residual_over_motion": variable(
            (), rms / float(np.std(angle[counted])), "RMS of the residual over that of the record", "1"
        ),
    }
    return record.assign(data).assign_attrs(warm_up=warm_up or 0.0)


def _shown(model: Model, time: np.ndarray, angle: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """What the sensor shows of the motion whose start fits these samples best, (sample,)."""
    start = first_guess(time, angle, model.reference_frequency)
    motion = fit_start(model, time[fitted], angle[fitted], start, offset=first_zero(model))
    if fitted.all():
        return np.asarray(motion.x + motion.offset)
    return np.asarray(trajectory(model, time, motion.angle, motion.rate).angle + motion.offset)
