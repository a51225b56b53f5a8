"""Columns that are not a plain signal: repeated frames, a wrapped angle, pulses of a counter."""

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.records.half_periods import quantisation_step

WRAP_SHARE = 0.75
# Number of samples on either side that show how the motion continues.
CUT_REACH = 3
# Weights of samples before and after a cut for the step of a cubic there, by least squares.
_AT = np.arange(-CUT_REACH - 0.5, CUT_REACH + 1.0)
_STEP_WITHIN_CUBIC = np.linalg.pinv(np.column_stack([_AT**0, _AT, _AT**2, _AT**3, _AT > 0.0]))[-1]


def new_frames(signal: Array) -> Index | None:
    """Return first rows of values held over several rows (a live camera's frames); None if none are held.

    Values also repeat if a fine clock meets a coarse sensor; but then a new value is the next step.
    """
    change = np.flatnonzero(np.diff(signal) != 0.0) + 1
    if change.size < 20 or np.median(np.diff(change)) < 2.0:
        return None
    usual_step = float(np.median(np.abs(np.diff(signal)[change - 1])))
    # Largest change of a new frame, in steps of the sensor, if repeated values are due to quantisation.
    if usual_step <= 3.0 * quantisation_step(signal):
        return None
    return np.concatenate(([0], change))


def unwrapped(signal: Array, turn: float | None = None) -> tuple[Array, float, int]:
    """Unwrap a signal that was cut at a full turn or at the end of its sensor range.

    Parameters
    ----------
    signal : (sample,) array of float
        Signal in any unit, such as an encoder's counts of one turn.
    turn : float, optional
        A whole turn, if it is known: the signal was cut to one turn.

    Returns
    -------
    whole : (sample,) array of float
    turn : float
        Step added or removed at each cut; nan without a cut.
    cuts : int
    """
    if turn is None:
        turn, cuts = _turn_and_cuts(signal)
    else:
        within = np.ptp(signal) <= turn * (1.0 + 1e-6)
        cuts = int(np.count_nonzero(np.abs(np.diff(signal)) > WRAP_SHARE * turn)) if within else 0
    whole = np.unwrap(signal, period=turn) if cuts else signal
    # A spike of a whole turn and back is not a cut.
    return (whole, turn, cuts) if cuts and np.ptp(whole) <= 2.0 * turn else (signal, float("nan"), 0)


def _turn_and_cuts(signal: Array) -> tuple[float, int]:
    """Return the jump at each cut at the end of the sensor range, and the number of cuts.

    At a cut, the signal jumps over most of its range in one step, opposite to its motion, which continues
    afterwards. The remaining step of a cubic through the samples on either side is a whole turn. The signal
    of a light barrier jumps too, but rests on either side.
    """
    span = float(np.ptp(signal))
    step = np.diff(signal)
    cut = np.flatnonzero(np.abs(step) > WRAP_SHARE * span)
    cut = cut[(cut >= CUT_REACH) & (cut < step.size - CUT_REACH)]
    if not cut.size:
        return float("nan"), 0
    before = signal[cut] - signal[cut - CUT_REACH]
    after = signal[cut + 1 + CUT_REACH] - signal[cut + 1]
    apart = np.maximum(np.abs(before), np.abs(after)) < WRAP_SHARE * span
    slope = 0.5 * (before + after) / CUT_REACH
    against = (before * after > 0.0) & (slope * step[cut] < 0.0)
    # Fraction of the cuts at which the motion continues on either side, and their least number.
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
    # Require a clear side: noise about the middle is not a crossing.
    clear = np.flatnonzero(np.abs(signal - 0.5 * (low + high)) > 0.2 * (high - low))
    above = signal[clear] > 0.5 * (low + high)
    crossings = np.flatnonzero(np.diff(above))
    # Fewer crossings do not show how long either side lasts.
    if crossings.size < 12:
        return False
    # Use medians, so that a single long rest, before a release or after a stop, has no effect.
    lasts = np.diff(clear[crossings])
    up = above[crossings[:-1] + 1]
    high_for = np.median(lasts[up])
    low_for = np.median(lasts[~up])
    # Pulses are shorter than the intervals between them by this factor; both sides of a swing last equally
    # long.
    return bool(max(high_for, low_for) > 3.0 * min(high_for, low_for))
