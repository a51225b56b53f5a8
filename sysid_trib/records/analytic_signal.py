"""Extrema of half periods by the analytic signal."""

import numpy as np
import scipy
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array, Index
from sysid_trib.records.half_periods import HalfPeriods


def analytic_extrema(time: Array, angle: Array, halves: HalfPeriods) -> tuple[Array, Array, Array, Array]:
    """Return extrema of half periods by lines through log amplitude and phase of the analytic signal.

    Parameters
    ----------
    time, angle : (sample,) s, rad; the angle about its equilibrium.
    halves : whole half periods, three or more.

    Returns
    -------
    (half_period,) each: extremum (rad, signed), its time (s), and the standard errors of both at a noise
    of 1.

    Notes
    -----
    A decay of the amplitude within the half period, which a half-sine does not follow, causes no error here;
    harmonics of the motion average out over the half period, as for half-sines.
    """
    grid, log_amplitude, phase = _analytic_signal(time, angle, halves)
    count = halves.sign.size
    half = np.searchsorted(halves.crossing[1:-1], grid, side="right")
    middle = 0.5 * (halves.crossing[1:] + halves.crossing[:-1])
    s = grid - middle[half]
    level, slope = _lines(s, phase, half, count)
    # The phase is zero at the first extremum and increases by pi from one extremum to the next.
    late = (np.pi * np.arange(count) - level) / slope
    log_level, log_slope = _lines(s, log_amplitude, half, count)
    extremum = np.exp(log_level + log_slope * late)
    samples = halves.duration * (time.size - 1) / (time[-1] - time[0])
    # N times the variance of the mean of N demodulated samples over half a period, for unit noise. A single
    # half period has 1.77; it shares 7 % with each neighbour, and a slow variation over many half periods has
    # 2.
    error: Array = np.sqrt(2.0 / samples)
    return np.copysign(extremum, halves.sign), middle + late, error, error / (extremum * slope)


def _analytic_signal(time: Array, angle: Array, halves: HalfPeriods) -> tuple[Array, Array, Array]:
    """Return uniform times from the first crossing to the last, log amplitude, and unwrapped phase."""
    crossing = halves.crossing
    span = crossing[-1] - crossing[0]
    count = max(8 * halves.sign.size, round(span * (time.size - 1) / (time[-1] - time[0])))
    grid = crossing[0] + (np.arange(count) + 0.5) * span / count
    # Make the amplitude steady first: this removes the leakage of a decay from the record's start to its end.
    trend = _log_trend(halves, grid)
    steady = CubicSpline(time, angle)(grid) * np.exp(-trend) * halves.sign[0]
    # Extend the signal as an odd function about both ends: apart from its decay, it is odd about a zero
    # crossing.
    signal = scipy.signal.hilbert(np.concatenate([steady, -steady[::-1]]))[:count]
    phase = np.unwrap(np.angle(signal))
    # Choose the branch on which the first extremum has the phase zero.
    first = grid < crossing[1]
    phase -= 2.0 * np.pi * np.round(np.mean(phase[first]) / (2.0 * np.pi))
    return grid, np.log(np.abs(signal)) + trend, phase


def _log_trend(halves: HalfPeriods, grid: Array) -> Array:
    """Return the smooth trend of the logarithm of the amplitude."""
    middle = 0.5 * (halves.crossing[1:] + halves.crossing[:-1])
    degree = min(5, halves.sign.size - 2)
    trend = np.polynomial.Polynomial.fit(middle, np.log(halves.peak), degree, w=halves.peak)
    return np.asarray(trend(grid))


def _lines(s: Array, y: Array, half: Index, count: int) -> tuple[Array, Array]:
    """Return least-squares line y = level + slope s of each half period."""
    n, sx, sxx, sy, sxy = (np.bincount(half, w, count) for w in (np.ones_like(s), s, s * s, y, s * y))
    slope = (n * sxy - sx * sy) / (n * sxx - sx**2)
    return (sy - slope * sx) / n, slope
