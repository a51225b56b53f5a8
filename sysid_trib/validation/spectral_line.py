"""A line in the spectrum of a residual, away from the harmonics of the motion: hum, or another mode."""

import numpy as np

from sysid_trib.arrays import Array, Mask

# Significance level of the highest line among all.
LINE_LEVEL = 1e-6
# A line counts whose RMS is beyond this part of that of the rest: a fainter one changes nothing.
LOUD_PART = 0.5
# The level about a line is that of so many neighbours on either side, beyond those into which it leaks.
LEVEL_LINES, LEAK = 48, 4
# Up to this harmonic what is left of a motion is the motion's.
MOTION_HARMONICS = 7
SLOWEST = 4.0
NO_LINE = (float("nan"), float("nan"))


def spectral_line(time: Array, residual: Array, motion: tuple[Array, Array]) -> tuple[float, float]:
    """Angular frequency (rad/s) and amplitude of a line in a residual; nan where there is none.

    Parameters
    ----------
    time, residual : (sample,) array of float
        In s, and in any unit.
    motion : two (sample,) arrays of float
        x and v of the model, whose harmonics are left out.

    Notes
    -----
    A line's power over the mean of 2 m neighbours' is F distributed with 2 and 4 m degrees of freedom where
    the spectrum is flat about it: P(> r) = (1 + r/(2 m))^(-2 m); times the number of lines (Bonferroni).
    """
    samples = len(residual)
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2
    resolution = 2.0 * np.pi * (samples - 1) / (samples * (time[-1] - time[0]))
    excluded = _harmonics(time, motion, resolution, len(power))
    excluded[[0, -1]] = True
    if len(power) < 2 * LEVEL_LINES or excluded.all():
        return NO_LINE
    window = np.ones(2 * LEVEL_LINES + 1)
    window[LEVEL_LINES - LEAK : LEVEL_LINES + LEAK + 1] = 0.0
    counted = np.where(excluded, 0.0, 1.0)
    total, count = (np.convolve(values, window, "same") for values in (power * counted, counted))
    count = np.maximum(count, 1.0)
    log_p = -count * np.log1p(power / np.maximum(total, 1e-300))
    at = int(np.argmin(np.where(excluded, 0.0, log_p)))
    if log_p[at] + np.log(counted.sum()) > np.log(LINE_LEVEL):
        return NO_LINE
    frequency = resolution * (at + _between_bins(power, at))
    waves = np.column_stack([wave(frequency * (time - time[0])) for wave in (np.cos, np.sin, np.ones_like)])
    line = waves @ np.linalg.lstsq(waves, residual, rcond=None)[0]
    loud = np.std(line) > LOUD_PART * np.std(residual - line)
    return (frequency, float(np.sqrt(2.0) * np.std(line))) if loud else NO_LINE


def _harmonics(time: Array, motion: tuple[Array, Array], resolution: float, count: int) -> Mask:
    """Which lines are within two of a harmonic of the motion at its start, at its end, or between."""
    phase = np.unwrap(np.arctan2(-motion[1], motion[0]))
    quarter = max(2, len(time) // 4)
    rates = [(phase[b] - phase[a]) / (time[b] - time[a]) for a, b in ((0, quarter), (-quarter - 1, -1))]
    at = resolution * np.arange(count)
    low, high = min(np.abs(rates)), max(np.abs(rates))
    # What drifts slowly is no line.
    excluded = at <= SLOWEST * resolution
    for harmonic in range(1, MOTION_HARMONICS + 1):
        middle, half = 0.5 * harmonic * (low + high), 0.5 * harmonic * (high - low)
        excluded |= np.abs(at - middle) <= half + 2.0 * resolution
    return np.asarray(excluded)


def _between_bins(power: Array, at: int) -> float:
    """Where between the lines of a spectrum its peak is, by the ratio of the two highest amplitudes."""
    left, peak, right = np.sqrt(power[at - 1 : at + 2])
    return float(right / (peak + right) if right > left else -left / (peak + left))
