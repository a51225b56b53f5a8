"""A record tracked with a given model: innovations, and the random force over time.

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

# Number of taps for 1/f noise: each is a state; more taps change little at the frequency of a swing.
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
        Linear model about the smoothed motion, with columns for start angle, start rate and the sensor's
        zero.
    deviation : (3,) array of float
        Deviations of start angle, start rate and zero from the reference; nearly zero.
    zero : float, rad
        Zero of the sensor.
    noise : float, rad
        Standard deviation of the sensor's noise, or of its innovations if it is coloured.
    per_tau : float, rad^2
        Growth of the variance of v per unit of tau, due to the random force.
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
        """Return the record, linear about a path, with a zero of the sensor and columns for parameters."""
        per_run = np.array([path[0, 0], self.model.reference_frequency * path[0, 1], zero])
        linear = linearised_about(self.model, (self.time, self.angle), path, per_run, by)
        return replace(linear, sensor_filter=self.linear.sensor_filter)

    def with_density(self, density: float) -> "TrackedRecord":
        """Return the record with another random force ((rad/s^2)^2/Hz), refitted from the present path.

        Raises
        ------
        DecayError
            The motion does not converge to the record.
        SimulationError
            The motion between two samples cannot be computed.
        """
        per_tau = RandomForce(density).per_tau(self.model.reference_frequency)
        return self if per_tau == self.per_tau else _settled(replace(self, per_tau=per_tau))


def track(decay: xr.Dataset, result: xr.Dataset, run: int = 0, every: int = 1) -> TrackedRecord:
    """Track a record with an identified model and its random force.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        Any identification; without information on a random force it has none.
    run : int
        Index of the run of the result whose noise and random force apply to the decay.
    every : int
        Decimation: one of `every` samples is used.

    Raises
    ------
    DecayError
        The motion does not converge to the record.
    SimulationError
        The motion between two samples cannot be computed.

    Notes
    -----
    This is the iterated extended Kalman smoother (Bell 1994): the model is linear about a path, and the next
    path is the smoothed motion. Without a random force, it is least squares for the start, by multiple
    shooting.
    """
    model = replace(schema.model_of(result, run), inputs=inputs_of(decay))
    decay = decay.isel(time=slice(None, None, every))
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    frequency = model.reference_frequency
    per_tau = random_force_of(result, run).per_tau(frequency)
    # Even a record without noise has a finite number of digits.
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
    """Return the record about the motion to which repeated smoothing converges."""
    # The path has converged if it moves by less than this fraction of the sensor's noise.
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
        # If friction alternately holds and releases the body, the changes are periodic: stop after three
        # steps without a smaller change.
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
        Any identification of the decay. Coefficients, noise and random force are those of the identification;
        the start of the motion and the sensor's zero adapt to the record.
    run : int
        Index of the run of the result that the decay is.

    Returns
    -------
    Dataset
        Over `time`: `innovation` and its standard deviation by the model, `innovation_standard_deviation`
        (rad); `smoothed_angle` (rad) and `smoothed_rate` (rad/s) of the motion; `random_force`, mean
        acceleration in spans of the `averaging_time` (s), with `random_force_standard_error` (rad/s^2).
        Over `lag`: `autocorrelation` of the innovations in units of their standard deviation. Scalars:
        `innovation_rms` (rad) and `ljung_box_p_value`.

    Raises
    ------
    DecayError
        The motion does not converge to the record.
    SimulationError
        The motion between two samples cannot be computed.

    Notes
    -----
    Innovations of a correct model are white (Ljung 1999); the test is that of Ljung and Box (1978). Without a
    random force the innovations are the record minus a free motion. The averaging time is twice the time in
    which the random force moves the motion as far as the sensor's noise can show, (r^2 dt / per_tau) to the
    power 1/4 in units of tau: within shorter spans little is known of the force.

    Examples
    --------
    The model lacks no force: its errors of prediction are white.

    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> errors = st.validation.innovations(decay, st.identify(decay, method="direct"))
    >>> errors.innovation_rms.round(5).item(), bool(errors.ljung_box_p_value > 0.01)
    (0.00058, True)
    """
    return innovations_of(decay, track(decay, result, run))


def innovations_of(decay: xr.Dataset, tracked: TrackedRecord) -> xr.Dataset:
    """Return `innovations` of a record that was already tracked."""
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
        # There is no force to resolve: it is zero.
        return np.arange(len(time))
    step = float(np.median(np.diff(time)))
    resolved = 2.0 * (frequency * step / tracked.ratio) ** 0.25 / frequency
    width = max(1.0, np.round(resolved / step)) * step
    return np.floor((time - time[0]) / width + 1e-9).astype(int)


def _random_force(tracked: TrackedRecord, spans: Index) -> tuple[Array, Array, Array]:
    """Return smoothed states (state, sample), and each span's mean random force and error, (sample,) each.

    The state has one more entry, the impulse int xi dtau since the span began. Part of the impulse follows
    from the random part of each step in x and v by regression; the rest is independent noise.
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
    # The impulse of a span is its value at the first sample of the next span, before it restarts from zero.
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

    They follow from the covariances of the free oscillator, for steps `length` of tau: (step, 2), (step,).
    """
    cross = np.stack([1.0 - np.cos(length), np.sin(length)], axis=1)
    # A body that friction holds for the whole step contains no information on the force.
    free = np.linalg.det(diffusion) > 1e-9 * length**4
    weights = np.zeros_like(cross)
    weights[free] = np.linalg.solve(diffusion[free], cross[free, :, None])[..., 0]
    return weights, np.maximum(length - np.sum(weights * cross, axis=1), 0.0)
