"""Removal of samples that are no motion: spikes, outliers, repeated frames, a wrapped angle."""

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.ndimage import maximum_filter1d

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.records.half_periods import noise_level, quantisation_step
from sysid_trib.records.signal import LONGEST_FILLED, clamped_knots

WRAP_SHARE = 0.75
# Samples on either side that show how the motion continues.
CUT_REACH = 3


def spikes(time: Array, signal: Array) -> Index:
    """Return the indices of samples that jump out of the swing and back, and of a bad first or last one.

    Parameters
    ----------
    time : (sample,) array of float, s
    signal : (sample,) array of float
        In any unit.
    """
    if signal.size < 20:
        return np.zeros(0, dtype=np.int64)
    swing = float(np.ptp(np.percentile(signal, [1.0, 99.0])))
    # Deviation from the neighbours in parts of the swing: neither motion nor impact deviates so much in one
    # sample; and deviation over the noise.
    least = max(0.2 * swing, 15.0 * noise_level(time, signal))
    kept = np.arange(signal.size)
    bad = np.zeros(signal.size, dtype=bool)
    # A spike disturbs the expected values of its neighbours: the largest is removed first, then the others
    # are judged anew. At most so many successive samples are bad together.
    for _ in range(4):
        if kept.size < 20:
            return np.zeros(0, dtype=np.int64)
        near = signal[kept]
        off = _off_neighbours(near)
        # The neighbours of a spike are near each other: a step is none.
        back = np.abs(near[2:] - near[:-2])
        candidates = (off > least) & np.concatenate([[True], off[1:-1] > 2.0 * back, [True]])
        if not candidates.any():
            break
        bad[kept[candidates & (off == maximum_filter1d(off, 5))]] = True
        kept = np.flatnonzero(~bad)
    return np.flatnonzero(bad)


def _off_neighbours(signal: Array) -> Array:
    """Return each sample's distance from the cubic through its four neighbours; at an end, the next four.

    Zero of the second from either end.
    """
    # Six times the distance from the cubic through the other four, where it is between them.
    fourth = np.abs(np.diff(signal, 4))
    off = np.pad(fourth / 6.0, 2)
    # The noise of an extrapolation is several times that of an interpolation.
    off[[0, -1]] = fourth[[0, -1]] / 3.0
    return off


def new_frames(signal: Array) -> Index | None:
    """Return first rows of values held over several rows (a live camera's frames); None if none are held.

    Values repeat too where a fine clock meets a coarse sensor; but then a new value is the next step.
    """
    change = np.flatnonzero(np.diff(signal) != 0.0) + 1
    if change.size < 20 or np.median(np.diff(change)) < 2.0:
        return None
    usual_step = float(np.median(np.abs(np.diff(signal)[change - 1])))
    # Most a new frame moves, in steps of the sensor, where repeated values are its quantisation.
    if usual_step <= 3.0 * quantisation_step(signal):
        return None
    return np.concatenate(([0], change))


# Weights of samples before and after a cut that give the step of a cubic there, by least squares.
_AT = np.arange(-CUT_REACH - 0.5, CUT_REACH + 1.0)
_STEP_WITHIN_CUBIC = np.linalg.pinv(np.column_stack([_AT**0, _AT, _AT**2, _AT**3, _AT > 0.0]))[-1]


def unwrapped(signal: Array, turn: float | None = None) -> tuple[Array, float, int]:
    """Unwrap a signal that was cut at a full turn or at the end of its sensor range.

    Parameters
    ----------
    signal : (sample,) array of float
        In any unit, such as an encoder's counts of one turn.
    turn : float, optional
        A whole turn, where that is known: what was cut there is within one.

    Returns
    -------
    whole : (sample,) array of float
    turn : float
        Step that was added or removed at each cut; nan where there is none.
    cuts : int
    """
    if turn is None:
        turn, cuts = _turn_and_cuts(signal)
    else:
        within = np.ptp(signal) <= turn * (1.0 + 1e-6)
        cuts = int(np.count_nonzero(np.abs(np.diff(signal)) > WRAP_SHARE * turn)) if within else 0
    whole = np.unwrap(signal, period=turn) if cuts else signal
    # A spike of a whole turn and back is none.
    return (whole, turn, cuts) if cuts and np.ptp(whole) <= 2.0 * turn else (signal, float("nan"), 0)


def _turn_and_cuts(signal: Array) -> tuple[float, int]:
    """Return the jump at each cut at the end of the sensor range, and the number of cuts.

    At a cut the signal leaps over most of its range in one step, against its motion, which goes on beyond.
    The step that a cubic through the samples on either side leaves is a whole turn. A light barrier leaps as
    well, but rests on either side.
    """
    span = float(np.ptp(signal))
    step = np.diff(signal)
    cut = np.flatnonzero(np.abs(step) > WRAP_SHARE * span)
    cut = cut[(cut >= CUT_REACH) & (cut < step.size - CUT_REACH)]
    if not cut.size:
        return float("nan"), 0
    before, after = signal[cut] - signal[cut - CUT_REACH], signal[cut + 1 + CUT_REACH] - signal[cut + 1]
    apart = np.maximum(np.abs(before), np.abs(after)) < WRAP_SHARE * span
    slope = 0.5 * (before + after) / CUT_REACH
    against = (before * after > 0.0) & (slope * step[cut] < 0.0)
    # Part of the cuts at which the motion continues on either side, and fewest of them.
    if np.count_nonzero(against & apart) < max(4, 0.6 * np.count_nonzero(apart)):
        return float("nan"), 0
    # The step between the two ends of a cubic through the samples on either side.
    near = np.lib.stride_tricks.sliding_window_view(signal, 2 * CUT_REACH + 2)[cut - CUT_REACH]
    turn = float(np.median(np.abs(near @ _STEP_WITHIN_CUBIC)[against & apart]))
    whole = np.all(signal == np.round(signal))
    return float(round(turn)) if whole else turn, int(cut.size)


def pulses(signal: Array) -> bool:
    """Return true if a signal rests at one level and leaves it in pulses, like light behind a barrier."""
    low, high = np.percentile(signal, [0.5, 99.5])
    # Clearly on either side: noise about the middle is no crossing.
    clear = np.flatnonzero(np.abs(signal - 0.5 * (low + high)) > 0.2 * (high - low))
    above = signal[clear] > 0.5 * (low + high)
    crossings = np.flatnonzero(np.diff(above))
    # Fewer do not show how long either side lasts.
    if crossings.size < 12:
        return False
    # By medians: a single long rest, before a release or after a stop, is none of them.
    lasts, up = np.diff(clear[crossings]), above[crossings[:-1] + 1]
    high_for, low_for = np.median(lasts[up]), np.median(lasts[~up])
    # Pulses are so many times shorter than the intervals between them; both sides of a swing last equally
    # long.
    return bool(max(high_for, low_for) > 3.0 * min(high_for, low_for))


# Properties of the spline: its degree, knots in a period, and fewest samples between knots.
OUTLIER_DEGREE, KNOTS, SAMPLES_PER_INTERVAL = 5, 12, 3
# An impact bends the motion: then the neighbours deviate as well, by more than this part.
NEIGHBOURS, NEIGHBOURS_PART = 3, 0.2
# Noise with this number of samples in its tails has no outliers.
MOST_OUTLIERS = 0.05


def outliers(time: Array, signal: Array, period: float) -> Index:
    """Return the indices of samples that deviate from their neighbours.

    Parameters
    ----------
    time : (sample,) array of float, s
        Rising.
    signal : (sample,) array of float
        In any unit.
    period : float, s
        Period of the swing.

    Notes
    -----
    A least-squares spline of twelve knots a period is fitted to each part without gaps. The sample that it
    misses most is left out, and the others are judged anew.
    """
    gaps = np.flatnonzero(np.diff(time) > LONGEST_FILLED * period) + 1
    pieces = np.split(np.arange(time.size), gaps)
    # Samples that are looked at together.
    parts = [part for piece in pieces for part in np.array_split(piece, 1 + piece.size // 20_000)]
    # Part of the swing.
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
        # Noise levels.
        limit = max(8.0 * noise, least[0])
        further = largest & (good > limit)
        if not further.any():
            break
        bad = bad | further
    # A signal that stays at the end of its range is clipped.
    at_end = np.minimum(signal - np.min(signal), np.max(signal) - signal) <= limit
    clipped = at_end & (np.append(False, at_end[:-1]) | np.append(at_end[1:], False))
    bad &= (off > limit) & ~clipped
    by_themselves = [at for at in np.flatnonzero(bad).tolist() if _is_by_itself(at, signal, off, bad)]
    return np.isin(np.arange(time.size), by_themselves)


def _is_by_itself(at: int, signal: Array, off: Array, bad: Mask) -> bool:
    """Return true if a bad sample is among good ones, or is one of several that hold one value."""
    near = slice(max(0, at - NEIGHBOURS), at + NEIGHBOURS + 1)
    values, others = signal[near][bad[near]], off[near][~bad[near]]
    # More of its neighbours are bad only if they have one value, as of a sensor that drops out or freezes.
    few = values.size <= 2 or np.ptp(values) == 0.0
    return bool(few and np.all(others <= NEIGHBOURS_PART * off[at]))
