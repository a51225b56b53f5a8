"""Samples that the smooth curve through all others misses: single ones, and short runs of one held value."""

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.ndimage import maximum_filter1d

from sysid_trib.arrays import Array, Mask
from sysid_trib.decays.cleaning import Indices
from sysid_trib.decays.half_periods import quantisation_step
from sysid_trib.decays.uniform import LONGEST_FILLED

# Of the spline: its degree, knots in a period, and fewest samples between knots.
OUTLIER_DEGREE, KNOTS, SAMPLES_PER_INTERVAL = 5, 12, 3
# Noise levels, and part of the swing.
OUTLIER_NOISE, OUTLIER_SHARE = 8.0, 3e-4
# An impact bends the motion: it leaves its neighbours off as well, by more than this part.
NEIGHBOURS, NEIGHBOURS_PART = 3, 0.2
# More of its neighbours are bad only where they hold one value, as of a sensor that drops out or freezes.
MOST_TOGETHER = 2
# Noise with so many samples in its tails has no outliers.
MOST_OUTLIERS = 0.05
MOST_REMOVALS = 12
# Samples that are looked at together.
LONGEST_PART = 20_000


def outliers(time: Array, signal: Array, period: float) -> Indices:
    """Indices of samples that are off what the others say, wherever in the swing they are.

    Parameters
    ----------
    time : (sample,) array of float, s
        Rising.
    signal : (sample,) array of float
        In any unit.
    period : float, s
        Of the swing.

    Notes
    -----
    A least-squares spline of twelve knots a period is fitted to each part without gaps. The sample that it
    misses most is left out, and the others are judged anew.
    """
    gaps = np.flatnonzero(np.diff(time) > LONGEST_FILLED * period) + 1
    pieces = np.split(np.arange(time.size), gaps)
    parts = [part for piece in pieces for part in np.array_split(piece, 1 + piece.size // LONGEST_PART)]
    least = OUTLIER_SHARE * float(np.ptp(signal))
    step = quantisation_step(signal)
    parts_off = [part[_off_the_others(time[part], signal[part], period, (least, step))] for part in parts]
    together = np.concatenate(parts_off)
    return together if together.size <= MOST_OUTLIERS * time.size else np.zeros(0, dtype=np.int64)


def _off_the_others(time: Array, signal: Array, period: float, least: tuple[float, float]) -> Mask:
    """Which samples of a part without gaps are off by more than the noise, the least and a step's noise."""
    bad = np.zeros(time.size, dtype=bool)
    knots = min(KNOTS * np.ptp(time) / period, time.size / SAMPLES_PER_INTERVAL)
    if knots < OUTLIER_DEGREE:
        return bad
    inner = np.linspace(time[0], time[-1], 1 + int(knots))
    clamped = np.concatenate([[time[0]] * OUTLIER_DEGREE, inner, [time[-1]] * OUTLIER_DEGREE])
    repeated = np.append(False, np.diff(signal) == 0.0)
    if np.mean(repeated) < MOST_OUTLIERS:
        bad = repeated
    for _ in range(MOST_REMOVALS):
        try:
            spline = make_lsq_spline(
                time, signal, clamped, OUTLIER_DEGREE, w=np.where(bad, 1e-6, 1.0), method="norm-eq"
            )
        except (ValueError, np.linalg.LinAlgError):
            return np.zeros(time.size, dtype=bool)
        off = np.abs(signal - spline(time))
        good = np.where(bad, 0.0, off)
        noise = max(1.5 * float(np.median(off[~bad])), least[1] / np.sqrt(12.0))
        largest = good == maximum_filter1d(good, 2 * NEIGHBOURS + 1)
        limit = max(OUTLIER_NOISE * noise, least[0])
        further = largest & (good > limit)
        if not further.any():
            break
        bad = bad | further
    # Where it stays at the end of its range a sensor is clipped.
    at_end = np.minimum(signal - np.min(signal), np.max(signal) - signal) <= limit
    clipped = at_end & (np.append(False, at_end[:-1]) | np.append(at_end[1:], False))
    bad &= (off > limit) & ~clipped
    by_themselves = [at for at in np.flatnonzero(bad).tolist() if _is_by_itself(at, signal, off, bad)]
    return np.isin(np.arange(time.size), by_themselves)


def _is_by_itself(at: int, signal: Array, off: Array, bad: Mask) -> bool:
    """Whether a bad sample is among good ones, or is one of several that hold one value."""
    near = slice(max(0, at - NEIGHBOURS), at + NEIGHBOURS + 1)
    values, others = signal[near][bad[near]], off[near][~bad[near]]
    few = values.size <= MOST_TOGETHER or np.ptp(values) == 0.0
    return bool(few and np.all(others <= NEIGHBOURS_PART * off[at]))
