"""Residuals of the simulated motions of identified models: size, phase, departure and whiteness."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import SimulationError, SysidTribError
from sysid_trib.likelihood.sensor_noise import sensor_noise_of
from sysid_trib.motion_fit.innovations import TrackedRecord, track
from sysid_trib.records import inputs, sensor, smoothing
from sysid_trib.results.random_force import random_force_of
from sysid_trib.results.schema import model_of
from sysid_trib.results.variables import described, noise_of_run
from sysid_trib.simulation import initial_conditions
from sysid_trib.simulation.initial_conditions import FittedMotion
from sysid_trib.simulation.measured_motion import MEASURED, MEASURED_TIME, measured_part
from sysid_trib.simulation.motions import STEPS_A_PERIOD
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation import lack_of_fit

# A model departs from the record where the RMS over half a period exceeds this multiple of the noise.
DEPARTED = 2.0
# Variables of each model.
RESIDUALS = (
    *("tested_rms", "tested_over_noise", "departure_time", "p_value"),
    *("spectral_line", "spectral_line_amplitude"),
)


@dataclass(frozen=True)
class FollowedRuns:
    """Runs and a result; the result's model is simulated in each run once, when it is first needed.

    Attributes
    ----------
    runs : mapping of int to Dataset
        `angle(time)`, by their index among the result's runs.
    result : Dataset
        An identification.
    """

    runs: Mapping[int, xr.Dataset]
    result: xr.Dataset
    _made: dict[str, Any] = field(default_factory=dict)

    def with_result(self, result: xr.Dataset) -> "FollowedRuns":
        """Return the runs with a result of the same model with other errors."""
        return replace(self, result=result)

    def once(self, name: str, make: Callable[[], Any]) -> Any:
        """Return a quantity that is computed once; its error is cached too."""
        if name not in self._made:
            try:
                self._made[name] = make()
            except SysidTribError as error:
                self._made[name] = error
        if isinstance(self._made[name], SysidTribError):
            raise self._made[name]
        return self._made[name]

    @property
    def motions(self) -> list[FittedMotion | None]:
        """The free motion in each run, see `fitted_motion`."""
        return [self.motion(run) for run in self.runs]

    def motion(self, run: int) -> FittedMotion | None:
        """Return the free motion in a run, see `fitted_motion`."""
        return self.once(f"motion {run}", lambda: fitted_motion(self.runs[run], self.result, run))

    def tracked(self, run: int) -> TrackedRecord:
        """Return a run as a result of `track`.

        Raises
        ------
        DecayError
            The motion does not converge to the record.
        SimulationError
            The motion between two samples cannot be computed.
        """
        return self.once(f"tracked {run}", lambda: track(self.runs[run], self.result, run))


def fitted_motion(
    decay: xr.Dataset, result: xr.Dataset, run: int = 0, *, most_steps: int = STEPS_A_PERIOD
) -> FittedMotion | None:
    """Return the motion of an identified model in a run, with fitted start and zero; None if it diverges.

    `most_steps` : as in `trajectory`.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    model = replace(model_of(result, run), inputs=inputs.inputs_of(decay))
    zero = initial_conditions.first_zero(model)
    if "start_angle" in result and zero is not None:
        start = (float(np.ravel(result.start_angle)[run]), float(np.ravel(result.start_rate)[run]))
    else:
        start = initial_conditions.first_guess(time, angle, model.reference_frequency)
    # `discovery.free_motion` fits the start too, but from a path of the search and with its step limits: a
    # candidate may be too stiff, and still needs a motion.
    try:
        return initial_conditions.fit_start(model, time, angle, start, offset=zero, most_steps=most_steps)
    except SimulationError:
        return None


def with_motions(models: Mapping[str, FollowedRuns]) -> list[xr.Dataset]:
    """Return each run with the angle of every model, nan if it diverges, and its noise."""
    runs, records = next(iter(models.values())).runs.values(), []
    for run, *motions in zip(runs, *(followed.motions for followed in models.values()), strict=True):
        none = np.full(run.sizes["time"], np.nan)
        simulated = np.stack([none if motion is None else motion.x + motion.offset for motion in motions])
        records.append(with_noise_and_models(run, list(models), simulated))
    return records


def with_noise_and_models(decay: xr.Dataset, names: Sequence[str], simulated: Array) -> xr.Dataset:
    """Return a record with `simulated_angle(model, time)`, `residual(model, time)` and its `noise`, rad.

    Tables, sentences and figures show residuals over this noise for every model. For a driven record, whose
    motion no spline follows, it is at most the residual of a model.
    """
    # Replace the models of a record from another result.
    decay = decay.drop_dims("model", errors="ignore")
    noise = smoothing.sensor_noise(decay)
    if inputs.inputs_of(decay):
        remains = np.std(decay.angle.values - simulated, axis=1)
        noise = float(np.nanmin(remains, initial=noise))
    values = {"simulated_angle": simulated, "residual": decay.angle.values - simulated, "noise": noise}
    return decay.assign_coords(model=list(names)).assign(described("record", values))


def residuals(followed: Mapping[str, FollowedRuns], noise_of: xr.Dataset) -> xr.Dataset:
    """Return the residual of each model: RMS, RMS over the noise, first departure, p-value of white noise.

    Parameters
    ----------
    followed : mapping of str to FollowedRuns
        The runs with each identification, by its name.
    noise_of : Dataset
        The identification whose noise of a sample is used.

    Returns
    -------
    Dataset
        For several runs: RMS over all, the earliest departure, the smallest p-value times the number of runs
        (Bonferroni), and the highest line; also those of each run, with the dimension `run`.

    Notes
    -----
    In a record with a random force, the residual of a free motion is a random walk and not a failure of the
    model. With a random force or coloured sensor noise, the innovations replace the residual, and their
    standard deviation replaces the noise. A separate spectral line (`spectral_line`), such as hum, is not
    noise: if it is within the band of the motion, the p-value is zero.
    """
    noises = [noise_of_run(noise_of, run) for run in range(len(next(iter(followed.values())).runs))]
    rows = [
        [_of_run_once(model, run, noise) for run, noise in enumerate(noises)] for model in followed.values()
    ]
    # Each of `RESIDUALS`, (run, model).
    columns = np.array(rows).transpose(2, 1, 0)
    rms, departure, p_value, line = columns[:2], columns[2], columns[3], columns[4:]
    count, highest = columns.shape[1], np.argmax(np.nan_to_num(columns[5]), axis=0)
    whole = [
        *(np.sqrt(np.mean(rms**2, axis=1)) if count > 1 else rms[:, 0]),
        np.fmin.reduce(departure),
        np.minimum(1.0, count * p_value.min(axis=0)),
        *np.take_along_axis(line, highest[None, None], axis=1)[:, 0],
    ]
    values = dict(zip(RESIDUALS, whole, strict=True))
    if count > 1:
        values |= {f"run_{name}": of for name, of in zip(RESIDUALS, columns, strict=True)}
    return xr.Dataset(described("judged", values), {"model": list(followed)})


def _of_run_once(followed: FollowedRuns, run: int, noise: float) -> tuple[float, ...]:
    """Return `_of_run`, computed once for each noise."""
    motion = followed.motions[run]
    values: tuple[float, ...] = followed.once(
        f"residual of run {run} over {noise!r}", lambda: _of_run(followed, motion, run, noise)
    )
    return values


def _of_run(followed: FollowedRuns, motion: FittedMotion | None, run: int, noise: float) -> tuple[float, ...]:
    """Return `RESIDUALS` of a run: of record minus motion, or of the innovations over their deviation."""
    decay, result = followed.runs[run], followed.result
    time, line, fitted, noises = decay.time.values, lack_of_fit.NO_LINE, 0, None
    stochastic = random_force_of(result, run) or sensor_noise_of(result, run).warm_up
    if motion is not None:
        residual, path = decay.angle.values - motion.offset - motion.x, (motion.x, motion.v)
        if not stochastic and int(decay.attrs.get("integrations", 0)) and MEASURED in decay:
            residual = _measured_residual(decay, result, motion)
        line = lack_of_fit.spectral_line(time, residual, path)
    try:
        tracked = followed.tracked(run) if stochastic else None
    except SysidTribError:
        motion = tracked = None
    if motion is None and tracked is None:
        return np.nan, np.nan, float(time[0]), 0.0, *line
    if tracked is not None:
        innovation, deviation = tracked.innovations()
        rms, residual, noise = root_mean_square(innovation), innovation / deviation, 1.0
        path = (tracked.linear.path[:, 0], tracked.linear.path[:, 1])
    else:
        rms, step = root_mean_square(residual), sensor.coarse_step(decay, noise)
        noises = sensor.rounded_noise(path[0], step, noise) if step else None
        # Coefficients and frequency, and the start of the motion.
        errors = [*result.standard_error.values, result.reference_frequency_standard_error.item()]
        fitted = int(np.count_nonzero(np.asarray(errors) > 0.0)) + 2
    width = half_period(path[1])
    departure = departure_time(time, residual, noise, width)
    p_value = _noise_p_value(residual, noise, width, path, fitted, noises)
    # The band of the sensor's noise starts at this multiple of the frequency of the swing; a line below is
    # not part of that noise.
    in_band = line[0] < 6.0 * result.asymptotic_frequency.item()
    if in_band and tracked is None and root_mean_square(residual) <= noise:
        # The noise of the record's own spline contains the line: test the rest of the residual.
        rest = lack_of_fit.without_line(time, residual, line[0])
        return (
            *(rms, root_mean_square(residual) / noise, departure),
            *(_noise_p_value(rest, root_mean_square(rest), width, path, fitted), *line),
        )
    return rms, root_mean_square(residual) / noise, departure, 0.0 if in_band else p_value, *line


def _measured_residual(decay: xr.Dataset, result: xr.Dataset, motion: FittedMotion) -> Array:
    """Return measurement minus model, (sample,), rad: over the frequency for each integration.

    Integration makes white noise red, so the residual of the integral is never white.
    """
    time, model = decay.time.values.astype(float), model_of(result)
    simulated = trajectory(model, time, motion.angle, motion.rate)
    measured = decay[MEASURED].sel({MEASURED_TIME: time}).values
    residual = measured - simulated.shown(*measured_part(decay)[0])
    # Fit the bias and the start again: the start was fitted to the integral.
    start = motion.sensitivity if motion.sensitivity is not None else np.zeros((len(time), 0))
    free = np.column_stack([np.ones(len(time)), start])
    residual = residual - free @ np.linalg.lstsq(free, residual, rcond=None)[0]
    return np.asarray(residual / smoothing.swing_frequency(decay) ** int(decay.attrs["integrations"]))


def departure_time(time: Array, residual: Array, noise: float, width: int) -> float:
    """Return the first time at which the mean square over a width exceeds the noise's; nan if never."""
    total = np.concatenate([[0.0], np.cumsum(residual**2)])
    local = (total[width:] - total[:-width]) / width
    # Level that the mean over this number of noise samples exceeds once in a hundred records.
    level = max(DEPARTED**2, float(scipy.stats.chi2.isf(0.01 * width / len(residual), width)) / width)
    departed = np.flatnonzero(local > level * noise**2)
    return float(time[departed[0]]) if len(departed) else float("nan")


def _noise_p_value(
    residual: Array,
    noise: float,
    samples: int,
    motion: tuple[Array, Array],
    fitted: int,
    noises: Iterable[Array] | None = None,
) -> float:
    """Return the p-value that a residual is noise, white or like given draws, by two tests (Bonferroni).

    The residual of a missing force is slow. It is not visible in the RMS of all samples, but in their means
    over twelfths of a period. A residual that slowly changes the amplitude and phase of the motion (x, v) is
    not visible in these means either, but in the few polynomials in time that describe such changes.
    """
    width, (numbers, slow_square) = max(1, samples // 6), sensor.slow_part(*motion)

    def sizes(values: Array) -> Array:
        """Return the squares of both parts over those of one sample's noise, (2,)."""
        means = values[: len(values) // width * width].reshape(-1, width).mean(axis=1) / noise
        return np.array([width * np.sum(means**2), slow_square(values / noise)])

    # Least degrees of freedom of a slow residual, for any number of fitted parameters.
    scale, degrees = np.ones(2), np.array([len(residual) // width, max(4, numbers - fitted)])
    if noises is not None:
        # Chi-square with the same mean and variance.
        drawn = np.array([sizes(values) for values in noises])
        scale = drawn.var(axis=0) / (2.0 * drawn.mean(axis=0))
        degrees = drawn.mean(axis=0) / scale
    return float(min(1.0, 2.0 * np.min(scipy.stats.chi2.sf(sizes(residual) / scale, degrees))))


def half_period(v: Array) -> int:
    """Return the number of samples in half a period, from sign changes of angle or speed."""
    turns = np.flatnonzero(np.diff(np.sign(v)) != 0)
    return int(np.median(np.diff(turns))) if len(turns) > 2 else max(1, len(v) // 10)


def motion_residual(decay: xr.Dataset, motion: FittedMotion, envelope: xr.Dataset) -> xr.Dataset:
    """Return record minus motion of a model, with the record's envelope, whose extrema give its phase.

    Returns
    -------
    Dataset
        `residual(time)` (rad); the largest `phase_error` (rad; nan if the motion stops early) and `stop_time`
        (s; nan if it does not stop within the record).
    """
    time = decay.time.values.astype(float)
    residual = decay.angle.values.astype(float) - motion.offset - motion.x
    stop = motion.stop_time if motion.stop_time < time[-1] else float("nan")
    error = float("nan") if np.isfinite(stop) else _phase_error(time, motion, envelope)
    return xr.Dataset({"residual": ("time", residual), "phase_error": error, "stop_time": stop})


def _phase_error(time: Array, motion: FittedMotion, envelope: xr.Dataset) -> float:
    """Return the largest angle (rad) between the phases of motion and record, at the record's extrema."""
    inside = (envelope.extremum_time.values > time[0]) & (envelope.extremum_time.values < time[-1])
    turns, sign = envelope.extremum_time.values[inside], envelope.sign.values[inside]
    if not len(turns):
        return float("nan")
    # Phase about the record's equilibrium, which a one-sided force shifts.
    phase = np.interp(turns, time, np.unwrap(np.arctan2(-motion.v, motion.offset + motion.x)))
    lead = phase - np.pi * np.arange(len(turns)) - (0.0 if sign[0] > 0 else np.pi)
    # Count whole turns from the place where both are nearest, because those at the start are arbitrary.
    middle = 2.0 * np.pi * np.round(np.median(lead) / (2.0 * np.pi))
    return float(np.max(np.abs(lead - middle)))
