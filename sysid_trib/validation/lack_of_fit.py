"""Lack of fit of models: in damping or frequency, by a force over angle and rate, and by a spectral line."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.cycles import backbone as bands, smooth_curve
from sysid_trib.errors import SysidTribError
from sysid_trib.records import half_sines
from sysid_trib.results import schema, signal_scale
from sysid_trib.results.variables import described
from sysid_trib.simulation.motions import FEW_STEPS_A_PERIOD
from sysid_trib.simulation.trajectory import trajectory


def lack_of_fit(
    decay: xr.Dataset, results: Mapping[str, xr.Dataset], curves: bands.Smoothed | None = None
) -> xr.Dataset:
    """Return the models' frequency and damping ratio against the backbone of a record.

    Parameters
    ----------
    decay : Dataset
        ``angle(time)`` of one run, `curves` its `smoothed_backbone`, if there is one.
    results : mapping of str to Dataset
        Identifications by name.

    Returns
    -------
    Dataset
        Over ``model`` and ``amplitude`` (of `backbone`): ``frequency`` (rad/s) and ``damping_ratio`` of the
        models, and ``frequency_deviation``, ``damping_ratio_deviation``: model minus record in half widths of
        the simultaneous 95 % band, so that a model is outside beyond 1; nan at amplitudes that the model does
        not reach. Over ``model`` and ``curve``: the largest ``departure`` outside of the band, and its range
        of amplitudes.

    Raises
    ------
    DecayError
        The record has no backbone.

    Notes
    -----
    The models' motions from a release are evaluated with the same half-sines and the same smoothing at the
    record's amplitudes, so that both have the same errors of averaging.
    """
    backbone, weights = curves or bands.smoothed_backbone(decay)
    rows = [_model_rows(decay, result, backbone) for result in results.values()]
    both, values = [_against(backbone, weights, of_model) for of_model in rows], dict[str, Array]()
    for name in bands.CURVES:
        of_models = np.array([pair[name] for pair in both]).reshape(len(both), 2, -1)
        values |= {name: of_models[:, 0], f"{name}_deviation": of_models[:, 1]}
    coords = {"model": list(results), **described("lack_of_fit", {"amplitude": backbone.amplitude.values})}
    return _with_departures(xr.Dataset(described("lack_of_fit", values), coords))


class Departure(NamedTuple):
    """Range of amplitudes in which a model leaves the band of a curve.

    Attributes
    ----------
    curve : str
        `frequency` or `damping_ratio`.
    deviation : float
        Largest deviation in half widths of the band, positive if the model is above the record.
    low, high : float
        Ends of the range of amplitudes; 0 and infinite beyond the ends of the record's range.
    """

    curve: str
    deviation: float
    low: float
    high: float


def departures(lack: xr.Dataset, model: str) -> list[Departure]:
    """Return the ranges of amplitude in which a model of `lack_of_fit` is outside of the bands."""
    amplitude, those = lack.amplitude.values, []
    for name in bands.CURVES:
        deviation = lack[f"{name}_deviation"].sel(model=model).values
        # A model that has stopped is outside of the band.
        outside = ~(np.abs(deviation) <= 1.0)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], outside, [False]]).astype(int)))
        for first, end in edges.reshape(-1, 2):
            part = deviation[first:end][np.isfinite(deviation[first:end])]
            farthest = float(part[np.argmax(np.abs(part))]) if len(part) else np.inf
            low = float(amplitude[first]) if first else 0.0
            high = float(amplitude[end - 1]) if end < len(amplitude) else np.inf
            those.append(Departure(name, farthest, low, high))
    return sorted(those, key=lambda departure: -abs(departure.deviation))


def _with_departures(lack: xr.Dataset) -> xr.Dataset:
    """Add the largest departure of each model from each curve; 0 for a model within the band."""
    nothing = {name: Departure(name, 0.0, np.nan, np.nan) for name in bands.CURVES}
    rows = []
    for model in lack.model.values.tolist():
        farthest = nothing | {of.curve: of for of in reversed(departures(lack, model))}
        rows.append([farthest[name][1:] for name in bands.CURVES])
    columns = np.moveaxis(np.array(rows, dtype=float), -1, 0)
    values = dict(zip(("departure", "departure_low", "departure_high"), columns, strict=True))
    return lack.assign_coords(curve=list(bands.CURVES)).assign(described("lack_of_fit", values))


def _against(
    backbone: xr.Dataset, weights: Mapping[str, Array], model: tuple[Array, Array, Array] | None
) -> dict[str, tuple[Array, Array]]:
    """Return a model's curves, smoothed like the record's, and deviations in half widths of the band."""
    log_amplitude = np.log(backbone.amplitude.values)
    nothing = np.full(len(log_amplitude), np.nan)
    if model is None:
        return dict.fromkeys(bands.CURVES, (nothing, nothing))
    against = {}
    for name, of_model in zip(bands.CURVES, model[1:], strict=True):
        curve, u = backbone[name].values, np.log(backbone.period_amplitude.values)
        there = scipy.interpolate.PchipInterpolator(model[0], of_model, extrapolate=False)(u)
        difference = there - backbone[f"period_{name}"].values
        smoothed = weights[name] @ np.where(np.isfinite(difference), difference, 0.0)
        reached = (log_amplitude >= model[0][0]) & (log_amplitude <= model[0][-1])
        # Model and record have the same averages, whose second-order error is the same for both.
        half = bands.half_width(backbone, name) - bands.left_open(name, curve, backbone.damping_ratio.values)
        smoothed = np.where(reached, smoothed, np.nan)
        against[name] = curve + smoothed, smoothed / half
    return against


def _model_rows(
    decay: xr.Dataset, result: xr.Dataset, backbone: xr.Dataset
) -> tuple[Array, Array, Array] | None:
    """Return increasing log amplitudes of a model's motion, frequency and damping ratio; None without one."""
    amplitude = backbone.period_amplitude
    top, low = float(np.log(amplitude.max())), float(np.log(amplitude.min()))
    # Release the model this number of half periods above the record; its first half periods are left out.
    above = 4.0 * np.pi * max(0.0, float(backbone.damping_ratio[-1]))
    largest = float(np.abs(decay.angle.values).max())
    # A model with less damping takes longer to the record's last amplitude: at most this multiple of its
    # length.
    for times in (1.0, 3.0):
        try:
            u, rows = _motion_rows(decay, result, float(np.exp(top + above) / largest), times)
        except SysidTribError:
            return None
        u, first = np.unique(u + np.log(largest), return_index=True)
        if u[0] <= low:
            break
    return u, rows["frequency"].target[first], rows["damping_ratio"].target[first]


@signal_scale.in_units_of_the_motion
def _motion_rows(
    decay: xr.Dataset, result: xr.Dataset, release: float, times: float
) -> tuple[Array, dict[str, smooth_curve.CurveRows]]:
    """Return the periods of the motion from a release; amplitudes relative to the record's largest signal."""
    time, largest = decay.time.values.astype(float), float(np.abs(decay.angle.values).max())
    step = (time[-1] - time[0]) / (len(time) - 1)
    grid = np.arange(round(times * len(time))) * step
    motion = trajectory(schema.model_of(result), grid, release * largest, 0.0, most_steps=FEW_STEPS_A_PERIOD)
    stop = grid <= motion.stop_time if np.isfinite(motion.stop_time) else np.full(len(grid), True)
    simulated = xr.Dataset({"angle": ("time", motion.angle[stop] / largest)}, {"time": grid[stop]})
    return bands.period_rows(half_sines.envelope(simulated))


# The level about a line is that of this number of neighbours on either side, beyond those into which it
# leaks.
LEVEL_LINES, LEAK = 48, 4
# Highest harmonic of the motion that is attributed to the motion in the residual.
MOTION_HARMONICS = 7
SLOWEST = 4.0
NO_LINE = (float("nan"), float("nan"))
# Significance level of a line.
LINE_LEVEL = 1e-6
# Largest fraction of the sum of squares that remains after a line is removed from the residual without
# harmonics; largest number of samples for this search, and least degrees of freedom.
LEFT_BY_A_LINE, MOST_ALONE, FEWEST_DEGREES = 0.25, 5000, 20


def spectral_line(time: Array, residual: Array, motion: tuple[Array, Array]) -> tuple[float, float]:
    """Return the angular frequency (rad/s) and amplitude of a line in a residual; nan if there is none.

    Time is in s, the residual in any unit, (sample,); harmonics of the motion (x, v) are excluded.

    The power of a line over the mean of 2 m neighbours is F distributed with 2 and 4 m degrees of freedom if
    the spectrum is flat around it: P(> r) = (1 + r/(2 m))^(-2 m); times the number of lines (Bonferroni).
    """
    samples = len(residual)
    # The residual of a motion contains the motion's harmonics. `omnibus_test._strongest_line` tests white
    # rows, which contain none; `screen._lines` proposes frequencies without a test.
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2
    resolution = 2.0 * np.pi * (samples - 1) / (samples * (time[-1] - time[0]))
    excluded = _harmonics(time, motion, resolution, len(power))
    excluded[[0, -1]] = True
    if len(power) <= 2 * LEVEL_LINES or excluded.all():
        return _line_alone(time, residual, motion)
    window = np.ones(2 * LEVEL_LINES + 1)
    window[LEVEL_LINES - LEAK : LEVEL_LINES + LEAK + 1] = 0.0
    counted = np.where(excluded, 0.0, 1.0)
    total, count = (np.convolve(values, window, "same") for values in (power * counted, counted))
    count = np.maximum(count, 1.0)
    log_p = -count * np.log1p(power / np.maximum(total, 1e-300))
    at = int(np.argmin(np.where(excluded, 0.0, log_p)))
    # Significance level of the highest line among all.
    if log_p[at] + np.log(counted.sum()) > np.log(LINE_LEVEL):
        return _line_alone(time, residual, motion)
    # Frequency of the peak between the lines of the spectrum, from the ratio of the two highest amplitudes.
    left, peak, right = np.sqrt(power[at - 1 : at + 2])
    frequency = resolution * (at + (right / (peak + right) if right > left else -left / (peak + left)))
    waves = np.column_stack([wave(frequency * (time - time[0])) for wave in (np.cos, np.sin, np.ones_like)])
    line = waves @ np.linalg.lstsq(waves, residual, rcond=None)[0]
    # A line counts if its RMS exceeds this fraction of that of the rest; a weaker one has no effect.
    marked = np.std(line) > 0.5 * np.std(residual - line)
    return (frequency, float(np.sqrt(2.0) * np.std(line))) if marked else NO_LINE


def without_line(time: Array, residual: Array, frequency: float) -> Array:
    """Return a residual without the line of this angular frequency (rad/s) and its mean."""
    waves = np.column_stack([wave(frequency * (time - time[0])) for wave in (np.cos, np.sin, np.ones_like)])
    return np.asarray(residual - waves @ np.linalg.lstsq(waves, residual, rcond=None)[0])


def _line_alone(time: Array, residual: Array, motion: tuple[Array, Array]) -> tuple[float, float]:
    """Return the `spectral_line` of the residual without harmonics, if the residual is mostly this line.

    In a short record the harmonics leak into the whole spectrum. Here they are columns with an amplitude that
    is proportional to the motion's and varies slowly. A line counts if it explains most of the rest (F test).
    """
    samples = len(residual)
    if samples > MOST_ALONE:
        return NO_LINE
    columns = _harmonic_columns(time, motion)
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, sizes > 1e-6 * sizes[0]]
    degrees = samples - basis.shape[1] - 3
    rest = residual - basis @ (basis.T @ residual)
    if degrees < FEWEST_DEGREES or not np.any(rest):
        return NO_LINE
    resolution = 2.0 * np.pi * (samples - 1) / (samples * (time[-1] - time[0]))
    power = np.abs(np.fft.rfft(rest, 4 * samples)) ** 2
    frequencies = 0.25 * resolution * np.arange(len(power))
    own = _harmonics(
        time, motion, 0.25 * resolution, len(power), most=1, leak=4 * LEAK, slowest=4.0 * SLOWEST
    )
    peak = frequencies[int(np.argmax(np.where(own, 0.0, power)))]
    best = (np.inf, 0.0, 0.0)
    for frequency in peak + 0.25 * resolution * np.linspace(-1.0, 1.0, 21):
        waves = np.column_stack([wave(frequency * (time - time[0])) for wave in (np.cos, np.sin)])
        waves = waves - basis @ (basis.T @ waves)
        parts = np.linalg.lstsq(waves, rest, rcond=None)[0]
        left = float(np.sum((rest - waves @ parts) ** 2) / np.sum(rest**2))
        best = min(best, (left, float(frequency), float(np.hypot(*parts))))
    left, frequency, amplitude = best
    log_p = 0.5 * degrees * np.log(max(left, 1e-300)) + np.log(samples)
    return (frequency, amplitude) if left < LEFT_BY_A_LINE and log_p < np.log(LINE_LEVEL) else NO_LINE


def _harmonic_columns(time: Array, motion: tuple[Array, Array]) -> Array:
    """Return columns for drifts and for harmonics of a motion with slowly changing amplitudes."""
    x, v = motion
    phase, size = np.unwrap(np.arctan2(-v, x)), np.hypot(x, v)
    s = 2.0 * (time - time[0]) / (time[-1] - time[0]) - 1.0
    columns = [s**power for power in range(4)]
    for harmonic in range(1, MOTION_HARMONICS + 1):
        for power in range(4 if harmonic == 1 else 2):
            amplitude = size / size.max() * s**power
            columns += [amplitude * np.cos(harmonic * phase), amplitude * np.sin(harmonic * phase)]
    return np.column_stack(columns)


def _harmonics(
    time: Array,
    motion: tuple[Array, Array],
    resolution: float,
    count: int,
    *,
    most: int = MOTION_HARMONICS,
    leak: float = LEAK,
    slowest: float = SLOWEST,
) -> Mask:
    """Return the mask of lines into which a harmonic of the motion leaks: at its start, end, or between."""
    phase = np.unwrap(np.arctan2(-motion[1], motion[0]))
    quarter = max(2, len(time) // 4)
    rates = [(phase[b] - phase[a]) / (time[b] - time[a]) for a, b in ((0, quarter), (-quarter - 1, -1))]
    at = resolution * np.arange(count)
    low, high = min(np.abs(rates)), max(np.abs(rates))
    # Extrapolate the means of quarters to either end, for a frequency that changes uniformly.
    low, high = low - (high - low) / 6.0, high + (high - low) / 6.0
    # A slow drift is not a line.
    excluded = at <= slowest * resolution
    for harmonic in range(1, most + 1):
        middle, half = 0.5 * harmonic * (low + high), 0.5 * harmonic * (high - low)
        excluded |= np.abs(at - middle) <= half + leak * resolution
    return np.asarray(excluded)
