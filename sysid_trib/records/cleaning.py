"""Removal of samples that are not motion: spikes and outliers."""

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.ndimage import maximum_filter1d

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.records.half_periods import noise_level, quantisation_step
from sysid_trib.records.signal import LONGEST_FILLED, clamped_knots


def spikes(time: Array, signal: Array) -> Index:
    """Return the indices of samples that jump out of the swing and back, and of a bad first or last sample.

    Parameters
    ----------
    time : (sample,) array of float, s
    signal : (sample,) array of float
        Signal in any unit.
    """
    if signal.size < 20:
        return np.zeros(0, dtype=np.int64)
    swing = float(np.ptp(np.percentile(signal, [1.0, 99.0])))
    # Least deviation from the neighbours: this fraction of the swing, because neither motion nor impact
    # deviates so much in one sample; and this multiple of the noise.
    least = max(0.2 * swing, 15.0 * noise_level(time, signal))
    kept = np.arange(signal.size)
    bad = np.zeros(signal.size, dtype=bool)
    # A spike disturbs the expected values of its neighbours: remove the largest one first, then judge the
    # others again. At most four successive samples are bad together.
    for _ in range(4):
        if kept.size < 20:
            return np.zeros(0, dtype=np.int64)
        near = signal[kept]
        off = _off_neighbours(near)
        # The neighbours of a spike are close to each other, unlike those of a step.
        back = np.abs(near[2:] - near[:-2])
        candidates = (off > least) & np.concatenate([[True], off[1:-1] > 2.0 * back, [True]])
        if not candidates.any():
            break
        bad[kept[candidates & (off == maximum_filter1d(off, 5))]] = True
        kept = np.flatnonzero(~bad)
    return np.flatnonzero(bad)


def _off_neighbours(signal: Array) -> Array:
    """Return each sample's deviation from the cubic through its four neighbours; at an end, the next four.

    It is zero for the second sample from either end.
    """
    # Six times the deviation from the cubic through the other four samples, if the sample is between them.
    fourth = np.abs(np.diff(signal, 4))
    off = np.pad(fourth / 6.0, 2)
    # An extrapolation has several times the noise of an interpolation.
    off[[0, -1]] = fourth[[0, -1]] / 3.0
    return off


# Properties of the spline: its degree, knots in a period, and fewest samples between knots.
OUTLIER_DEGREE = 5
KNOTS = 12
SAMPLES_PER_INTERVAL = 3
# Number of neighbours. An impact bends the motion, so the neighbours deviate as well, by more than this
# fraction.
NEIGHBOURS = 3
NEIGHBOURS_PART = 0.2
# If more samples than this fraction are outliers, they are the tails of the noise instead.
MOST_OUTLIERS = 0.05


def outliers(time: Array, signal: Array, period: float) -> Index:
    """Return the indices of samples that deviate from their neighbours.

    Parameters
    ----------
    time : (sample,) array of float, s
        Increasing times.
    signal : (sample,) array of float
        Signal in any unit.
    period : float, s
        Period of the swing.

    Notes
    -----
    A least-squares spline with twelve knots a period is fitted to each part without gaps. The sample with the
    largest residual is removed, and the others are judged again.
    """
    gaps = np.flatnonzero(np.diff(time) > LONGEST_FILLED * period) + 1
    pieces = np.split(np.arange(time.size), gaps)
    # Limit the number of samples in each fit.
    parts = [part for piece in pieces for part in np.array_split(piece, 1 + piece.size // 20_000)]
    # Least deviation, as a fraction of the swing.
    least = 3e-4 * float(np.ptp(signal))
    step = quantisation_step(signal)
    parts_off = [part[_off_the_others(time[part], signal[part], period, (least, step))] for part in parts]
    together = np.concatenate(parts_off)
    return together if together.size <= MOST_OUTLIERS * time.size else np.zeros(0, dtype=np.int64)


def _off_the_others(time: Array, signal: Array, period: float, least: tuple[float, float]) -> Mask:
    """Return the mask of samples that deviate by more than the noise, the least and a step's noise."""
    bad = np.zeros(time.size, dtype=bool)
    knots = min(KNOTS * np.ptp(time) / period, time.size / SAMPLES_PER_INTERVAL)
    if knots < OUTLIER_DEGREE:
        return bad
    clamped = clamped_knots(time, int(knots), OUTLIER_DEGREE)
    repeated = np.append(False, np.diff(signal) == 0.0)
    if np.mean(repeated) < MOST_OUTLIERS:
        bad = repeated
    for _ in range(12):
        try:
            weight = np.where(bad, 1e-6, 1.0)
            spline = make_lsq_spline(time, signal, clamped, OUTLIER_DEGREE, w=weight, method="norm-eq")
        except (ValueError, np.linalg.LinAlgError):
            return np.zeros(time.size, dtype=bool)
        off = np.abs(signal - spline(time))
        good = np.where(bad, 0.0, off)
        noise = max(1.5 * float(np.median(off[~bad])), least[1] / np.sqrt(12.0))
        largest = good == maximum_filter1d(good, 2 * NEIGHBOURS + 1)
        # Limit in noise levels.
        limit = max(8.0 * noise, least[0])
        further = largest & (good > limit)
        if not further.any():
            break
        bad = bad | further
    # A signal that stays at an end of its range is clipped there.
    at_end = np.minimum(signal - np.min(signal), np.max(signal) - signal) <= limit
    clipped = at_end & (np.append(False, at_end[:-1]) | np.append(at_end[1:], False))
    bad &= (off > limit) & ~clipped
    by_themselves = [at for at in np.flatnonzero(bad).tolist() if _is_by_itself(at, signal, off, bad)]
    return np.isin(np.arange(time.size), by_themselves)


def _is_by_itself(at: int, signal: Array, off: Array, bad: Mask) -> bool:
    """Return true if a bad sample is among good ones, or is one of several with the same value."""
    near = slice(max(0, at - NEIGHBOURS), at + NEIGHBOURS + 1)
    values = signal[near][bad[near]]
    others = off[near][~bad[near]]
    # More neighbours may be bad only if they have the same value, as when a sensor drops out or freezes.
    few = values.size <= 2 or np.ptp(values) == 0.0
    return bool(few and np.all(others <= NEIGHBOURS_PART * off[at]))
