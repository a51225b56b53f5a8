"""A record followed by the motion of a model that is given: innovations, and the random force over time.

Only the start of the motion and the sensor's zero adapt to the record.
"""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index, root_mean_square
from sysid_trib.errors import DecayError
from sysid_trib.likelihood import sensor_noise
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.linearised import linearised_about, spline_path
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results import schema, signal_scale
from sysid_trib.results.random_force import RandomForce, random_force_of
from sysid_trib.results.variables import described
from sysid_trib.simulation.model import Model

# Number of taps for 1/f noise: each is a state, and further ones change little at the frequency of a swing.
MOST_TAPS = 49


@dataclass(frozen=True)
class TrackedRecord:
    """A record, linear about the smoothed motion of a model.

    Attributes
    ----------
    model : Model
        The identified model.
    time, angle : (sample,) array of float, s and rad
        The record.
    linear : LinearModel
        About the smoothed motion, with columns for angle and rate at the start and for the sensor's zero.
    deviation : (3,) array of float
        Deviations of these three from the reference; nearly zero.
    zero : float, rad
        Zero of the sensor.
    noise : float, rad
        Standard deviation of the sensor's noise, of its innovations where it is coloured.
    per_tau : float, rad^2
        Growth of the variance of v in a unit of tau, by the random force.
    """

    model: Model
    time: Array
    angle: Array
    linear: LinearModel
    deviation: Array
    zero: float
    noise: float
    per_tau: float

    @property
    def ratio(self) -> float:
        """The random force's `per_tau` over the variance of the sensor's noise."""
        return self.per_tau / self.noise**2

    def innovations(self) -> tuple[Array, Array]:
        """Return the errors of one-step predictions and their standard deviations, (sample,) each, rad."""
        _, innovations, variance = self.linear.innovations(self.ratio, self.deviation)
        return innovations[:, 0], self.noise * np.sqrt(variance)

    def linear_about(self, path: Array, zero: float, by: tuple[str, ...] = ()) -> LinearModel:
        """Return the record linear about a path, with a zero of the sensor, and columns for parameters."""
        per_run = np.array([path[0, 0], self.model.reference_frequency * path[0, 1], zero])
        linear = linearised_about(self.model, (self.time, self.angle), path, per_run, by)
        return replace(linear, sensor_filter=self.linear.sensor_filter)

    def with_density(self, density: float) -> "TrackedRecord":
        """Return the record with another random force ((rad/s^2)^2/Hz), refitted from the present path.

        Raises
        ------
        DecayError
            The motion does not settle on the record.
        SimulationError
            The motion between two samples cannot be computed.
        """
        per_tau = RandomForce(density).per_tau(self.model.reference_frequency)
        return self if per_tau == self.per_tau else _settled(replace(self, per_tau=per_tau))


def track(decay: xr.Dataset, result: xr.Dataset, run: int = 0, every: int = 1) -> TrackedRecord:
    """Follow a record by an identified model with its random force.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        Any identification; one that says nothing of a random force has none.
    run : int
        Which of its runs the decay is, for noise and random force.
    every : int
        Decimation: one of so many samples is taken.

    Raises
    ------
    DecayError
        The motion does not settle on the record.
    SimulationError
        The motion between two samples cannot be computed.

    Notes
    -----
    The iterated extended Kalman smoother (Bell 1994): linear about a path, the next path is the smoothed
    motion. Without a random force that is least squares on the start, by multiple shooting.
    """
    model = replace(schema.model_of(result, run), inputs=inputs_of(decay))
    decay = decay.isel(time=slice(None, None, every))
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    frequency = model.reference_frequency
    per_tau = random_force_of(result, run).per_tau(frequency)
    # A record without noise is still one of finite digits.
    sensor = sensor_noise.sensor_noise_of(result, run).of_every(every, len(time))
    noise = max(sensor.innovation, 1e-12 * float(np.max(np.abs(angle))))
    path = spline_path(model, time, angle)
    linear = linearised_about(model, (time, angle), path, np.array([path[0, 0], frequency * path[0, 1], 0.0]))
    colour = sensor.filter_
    if len(colour) > MOST_TAPS:
        colour = sensor_noise.of_order(colour, MOST_TAPS - 1)
    linear = replace(linear, sensor_filter=colour)
    return _settled(TrackedRecord(model, time, angle, linear, np.zeros(3), 0.0, noise, per_tau))


def _settled(tracked: TrackedRecord) -> TrackedRecord:
    """Return the record about the motion at which its smoothing converges."""
    # The path is settled where it moves by less than this part of the sensor's noise.
    tolerance = 0.01 * tracked.noise
    changes: list[float] = []
    for _ in range(12):
        linear = tracked.linear
        deviation, _ = linear.rows(tracked.ratio).solution()
        change = linear.smoothed_motion(tracked.ratio, deviation) - linear.path
        if not np.all(np.isfinite(change)):
            break
        if np.max(np.abs(change[:, 0])) <= tolerance and abs(deviation[2]) <= tolerance:
            return replace(tracked, deviation=deviation)
        changes.append(float(np.max(np.abs(change))))
        # If friction alternately holds and frees the body, the changes are periodic: stop after so many steps
        # without a smaller change.
        if np.argmin(changes) < len(changes) - 3:
            break
        zero = float(tracked.zero + deviation[2])
        tracked = replace(tracked, linear=tracked.linear_about(linear.path + change, zero), zero=zero)
    raise DecayError(
        "The motion of this identification does not converge to the record; its forces do not describe it. "
        "Offer others, or a shorter window."
    )


@signal_scale.in_units_of_the_motion
def innovations(decay: xr.Dataset, result: xr.Dataset, run: int = 0) -> xr.Dataset:
    """Return the one-step prediction errors of an identification, and the random force over time.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        Any identification of it. Coefficients, noise and random force are its own; the start of the motion
        and the sensor's zero adapt to the record.
    run : int
        Which of the result's runs the decay is.

    Returns
    -------
    Dataset
        Over `time`: `innovation` and its standard deviation by the model, `innovation_standard_deviation`
        (rad); `smoothed_angle` (rad) and `smoothed_rate` (rad/s) of the motion; `random_force`, mean
        acceleration in spans of the `averaging_time` (s), with `random_force_standard_error` (rad/s^2).
        Over `lag`: `autocorrelation` of the innovations in units of their standard deviation. Besides
        `innovation_rms` (rad), `ljung_box_p_value`.

    Raises
    ------
    DecayError
        The motion does not settle on the record.
    SimulationError
        The motion between two samples cannot be computed.

    Notes
    -----
    Innovations of a right model are white (Ljung 1999); the test is that of Ljung and Box (1978). Without a
    random force they are what a free motion leaves of the record. The averaging time is twice the time in
    which the random force moves the motion as far as the sensor's noise lets it be seen, (r^2 dt / per_tau)
    to the power 1/4 in units of tau: within shorter spans little is known of the force.
    """
    return innovations_of(decay, track(decay, result, run))


def innovations_of(decay: xr.Dataset, tracked: TrackedRecord) -> xr.Dataset:
    """Return `innovations` of a record that was followed before."""
    innovation, deviation = tracked.innovations()
    most, spans = min(sensor_noise.MOST_LAGS, max(1, len(innovation) // 4)), _spans(tracked)
    correlation = sensor_noise.autocorrelation(innovation / deviation, most)
    white = sensor_noise.ljung_box_p_value(correlation, len(innovation))
    smoothed, force, force_error = _random_force(tracked, spans)
    frequency, rms = tracked.model.reference_frequency, root_mean_square(innovation)
    width = float(np.median(np.diff(tracked.time[np.flatnonzero(np.diff(spans, prepend=-1))])))
    values = {
        "innovation": innovation,
        "innovation_standard_deviation": deviation,
        "smoothed_angle": smoothed[0],
        "smoothed_rate": frequency * smoothed[1],
        "random_force": (force, force_error),
        "autocorrelation": correlation,
        "innovation_rms": rms,
        "ljung_box_p_value": white,
        "averaging_time": width,
    }
    return xr.Dataset(described("innovations", values), {"time": decay.time, "lag": np.arange(1, most + 1)})


def _spans(tracked: TrackedRecord) -> Index:
    """Return the number of the span in which each sample's next step lies, (sample,) array of int."""
    time, frequency = tracked.time, tracked.model.reference_frequency
    if tracked.ratio == 0.0:
        # There is no force to resolve; zero is shown.
        return np.arange(len(time))
    step = float(np.median(np.diff(time)))
    resolved = 2.0 * (frequency * step / tracked.ratio) ** 0.25 / frequency
    width = max(1.0, np.round(resolved / step)) * step
    return np.floor((time - time[0]) / width + 1e-9).astype(int)


def _random_force(tracked: TrackedRecord, spans: Index) -> tuple[Array, Array, Array]:
    """Return smoothed states (state, sample), and each span's mean random force and error, (sample,) each.

    The state has one entry more, the impulse int xi dtau since the span began. Its part that the step shows
    in x and v comes with them, by regression on their random part; the rest is noise of its own.
    """
    linear, frequency = tracked.linear, tracked.model.reference_frequency
    size = linear.path.shape[1]
    if tracked.ratio == 0.0:
        zero = np.zeros(len(tracked.time))
        return linear.smoothed_motion(0.0, tracked.deviation).T, zero, zero
    with_impulse = _with_impulse(tracked, spans)
    states = with_impulse.smoothed_motion(tracked.ratio, tracked.deviation)
    covariance = with_impulse.statsmodels(tracked.ratio, smoothed=True).smooth().smoothed_state_cov
    firsts = np.flatnonzero(np.diff(spans[:-1], prepend=-1))
    # The impulse of a span is that at the first sample of the next, before it starts anew.
    ends = np.append(firsts[1:], len(spans) - 1)
    # xi acts in v = theta'/w and in tau: the rate grows by w times the impulse.
    scale = frequency / (tracked.time[ends] - tracked.time[firsts])
    variance = np.maximum(covariance[size, size, ends], 0.0)
    at = np.searchsorted(firsts, np.arange(len(spans)), side="right") - 1
    force = scale * states[ends, size]
    return states[:, :size].T, force[at], (scale * tracked.noise * np.sqrt(variance))[at]


def _with_impulse(tracked: TrackedRecord, spans: Index) -> LinearModel:
    """Return the record's linear model with the impulse in each span as a state."""
    steps, size = tracked.linear.steps, tracked.linear.path.shape[1]
    length = tracked.model.reference_frequency * np.diff(tracked.time)
    weights, rest = _impulse_of_step(length, steps.diffusion[:, :2, :2])
    goes_on = np.append(0.0, spans[1:-1] == spans[:-2])
    selection = np.tile(np.eye(size + 1), (len(weights), 1, 1))
    selection[:, size, :2] = weights
    diffusion = np.pad(steps.diffusion, ((0, 0), (0, 1), (0, 1)))
    diffusion[:, size, size] = rest
    diffusion = selection @ diffusion @ selection.swapaxes(1, 2)
    return tracked.linear.with_further_state(goes_on, diffusion, 0.0)


def _impulse_of_step(length: Array, diffusion: Array) -> tuple[Array, Array]:
    """Return the regression of each step's impulse on its noise in x and v, and the residual variance.

    By the covariances of the free oscillator, over steps `length` of tau: (step, 2), (step,).
    """
    cross = np.stack([1.0 - np.cos(length), np.sin(length)], axis=1)
    # A body that friction holds for the whole step contains no information on the force.
    free = np.linalg.det(diffusion) > 1e-9 * length**4
    weights = np.zeros_like(cross)
    weights[free] = np.linalg.solve(diffusion[free], cross[free, :, None])[..., 0]
    return weights, np.maximum(length - np.sum(weights * cross, axis=1), 0.0)
