"""Innovations of any identification, and the random force over time: when the motion was pushed."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.likelihood.sensor_noise import autocorrelation, ljung_box_p_value
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.tracked import TrackedRecord, track
from sysid_trib.records.decay import root_mean_square
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import described

LAGS = 20


@in_units_of_the_motion
def innovations(decay: xr.Dataset, result: xr.Dataset, run: int = 0) -> xr.Dataset:
    """What an identification predicts wrongly one sample ahead, and the random force over time.

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
    """`innovations` of a record that was followed before."""
    innovation, deviation = tracked.innovations()
    lags, spans = np.arange(1, 1 + min(LAGS, max(1, len(innovation) // 4))), _spans(tracked)
    correlation = autocorrelation(innovation / deviation, lags)
    white = ljung_box_p_value(correlation, lags, len(innovation))
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
    return xr.Dataset(described("innovations", values), {"time": decay.time, "lag": lags})


def _spans(tracked: TrackedRecord) -> Index:
    """Number of the span in which each sample's next step lies, (sample,) array of int."""
    time, frequency = tracked.time, tracked.model.reference_frequency
    if tracked.ratio == 0.0:
        # There is no force to resolve; what is shown is zero.
        return np.arange(len(time))
    step = float(np.median(np.diff(time)))
    resolved = 2.0 * (frequency * step / tracked.ratio) ** 0.25 / frequency
    width = max(1.0, np.round(resolved / step)) * step
    return np.floor((time - time[0]) / width + 1e-9).astype(int)


def _random_force(tracked: TrackedRecord, spans: Index) -> tuple[Array, Array, Array]:
    """Smoothed states (state, sample), and mean random force in the spans with its error, (sample,) each.

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
    """The record's linear model with the impulse in each span as a state."""
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
    """Regression of the impulse of each step on the noise that it adds to x and v, and the variance left.

    By the covariances of the free oscillator, over steps `length` of tau: (step, 2), (step,).
    """
    cross = np.stack([1.0 - np.cos(length), np.sin(length)], axis=1)
    # A body that friction holds for the whole step shows nothing of the force.
    free = np.linalg.det(diffusion) > 1e-9 * length**4
    weights = np.zeros_like(cross)
    weights[free] = np.linalg.solve(diffusion[free], cross[free, :, None])[..., 0]
    return weights, np.maximum(length - np.sum(weights * cross, axis=1), 0.0)
