"""Checks of a free decay: long enough, decreasing, not pushed, not clipped, not stopped by a hand."""

from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.records import no_decay
from sysid_trib.records.equilibrium import Swing
from sysid_trib.records.no_decay import NoDecayError

# Three full periods: five whole half periods and a fraction of one at either end.
FEWEST_EXTREMA = 5
# Least number of half periods in which a drive holds the amplitude.
DRIVEN_HALF_PERIODS = 8
# Least number of half periods in which a beat rises.
FEWEST_RISING = 5
# Between its maxima, the amplitude of a beat falls by at least this fraction of the largest one.
TROUGH = 0.3
PACE_TOLERANCE = 0.03


def _held(peak: Array, scatter: float) -> tuple[int, float]:
    """Return the half periods until the amplitude leaves the range of a drive, and this range."""
    held = float(np.median(peak[:DRIVEN_HALF_PERIODS]))
    # Relative range of the amplitude within which a drive holds it.
    allowed = 0.03 * held + scatter
    away = np.abs(peak - held) > allowed
    return int(np.argmax(away)) if away.any() else peak.size, allowed


def _falls_away(peak: Array, count: int, allowed: float) -> bool:
    """Return true if extrema at this pace would fall by several times the permitted amount."""
    pace = -float(np.polyfit(np.arange(FEWEST_EXTREMA), peak[:FEWEST_EXTREMA], 1)[0])
    return pace * count >= 8.0 * allowed


def after_the_drive(swing: Swing) -> Swing:
    """Cut the time before a decay in which a drive holds the amplitude."""
    run = swing.run
    if run.stop - run.start < DRIVEN_HALF_PERIODS + FEWEST_EXTREMA:
        return swing
    peak = swing.extrema
    end, allowed = _held(peak, swing.scatter)
    followed = DRIVEN_HALF_PERIODS <= end <= peak.size - FEWEST_EXTREMA
    if not (followed and _falls_away(peak[end - 1 :], end, allowed)):
        return swing
    return replace(swing, run=slice(run.start + end - 1, run.stop))


def is_held(swing: Swing, decay: Swing) -> bool:
    """Return true if a drive holds the amplitude of a swing throughout, unlike a decay of the same record."""
    peak = swing.extrema
    falling = decay.extrema
    end, allowed = _held(peak, swing.scatter)
    throughout = end == peak.size >= DRIVEN_HALF_PERIODS
    return throughout and _falls_away(falling * peak[0] / falling[0], end, allowed)


def after_the_largest(swing: Swing, source: str) -> Swing:
    """Cut the time before the largest extremum; raise an error if the amplitude does not decay after it."""
    run = swing.run
    time = swing.time
    per_half_period = 0.5 * swing.oscillation.period * (time.size - 1) / (time[-1] - time[0])
    # Each half-sine has two unknowns.
    if per_half_period < 2.5:
        raise NoDecayError(source, no_decay.coarse_sampling(per_half_period))
    count = run.stop - run.start
    if count < FEWEST_EXTREMA:
        raise NoDecayError(source, no_decay.few_half_periods(count, swing.oscillation.period))
    peak = swing.extrema
    scatter = swing.scatter
    largest = int(np.argmax(peak))
    first = largest if peak[largest] > 1.03 * peak[0] + scatter else 0
    quarter = max(1, (count - first) // 4)
    fall = float(np.mean(peak[first : first + quarter]) - np.mean(peak[-quarter:]))
    falling = fall >= 1e-4 * peak[first] + scatter / np.sqrt(quarter)
    if (count - first < FEWEST_EXTREMA and largest) or not falling:
        _refuse_rise_and_fall(peak, scatter, source)
    if count - first < FEWEST_EXTREMA and largest:
        growth = 100.0 * ((peak[largest] / peak[0]) ** (2.0 / largest) - 1.0)
        raise NoDecayError(source, no_decay.grows(growth))
    if not falling:
        change = -200.0 * fall / peak[first] / (count - first)
        raise NoDecayError(source, no_decay.does_not_decay(peak[first], change))
    swing = _without_rises(peak[first:], replace(swing, run=slice(run.start + first, run.stop)), source)
    _refuse_beats(swing, source)
    return swing


def _refuse_rise_and_fall(peak: Array, scatter: float, source: str) -> None:
    """Raise an error for an amplitude that falls and rises again as far: beats, unless it began from rest."""
    trough = int(np.argmin(peak))
    before = peak[: trough + 1].max()
    after = peak[trough:].max()
    least = TROUGH * peak.max()
    if min(before, after) - peak[trough] > least + 2.0 * scatter and peak[0] > least:
        raise NoDecayError(source, no_decay.falls_and_rises(before, peak[trough], after))


def _refuse_beats(swing: Swing, source: str) -> None:
    """Raise an error for the fall of a beat: the amplitude falls to zero, ever faster, and rises again.

    If two modes are equally strong, the sign changes at the node, which ends the run there.
    """
    run = swing.run
    peak = swing.halves.peak
    fall = peak[run]
    quarter = fall.size // 4
    rise = peak[run.stop : min(run.stop + fall.size, peak.size - 1)]
    if quarter < 1 or rise.size < FEWEST_RISING:
        return
    lasts = swing.halves.duration[run.stop : run.stop + rise.size] / (0.5 * swing.oscillation.period)
    # In most half periods the motion continues, and in most of them its amplitude rises.
    swings_on = np.mean((lasts > 0.4) & (lasts < 2.5)) > 0.7
    # The fall does not slow down: in the last quarter it is at least this fraction of that in the first.
    hollow = fall[-quarter - 1] - fall[-1] < 0.8 * (fall[0] - fall[quarter])
    top = int(np.argmax(rise))
    gradual = top >= FEWEST_RISING - 1 and np.mean(np.diff(rise[: top + 1]) > 0.0) > 0.8
    if swings_on and not hollow and gradual and rise[top] > 0.5 * fall[0]:
        instant = swing.halves.crossing[run.stop]
        raise NoDecayError(source, no_decay.beats(fall[0], fall[-1], instant, rise[top]))


def _without_rises(peak: Array, swing: Swing, source: str) -> Swing:
    """Raise an error if the amplitude rises again, for extrema of one sign: a push, or two beating modes.

    If a small motion at the end of a decay is shaken and becomes larger again, the decay ends before it.
    """
    rises = []
    for side in (0, 1):
        same = peak[side::2]
        larger = _first_rise(same, swing)
        if larger is not None:
            rises.append((side + 2 * larger, float(same[:larger].min())))
    if not rises:
        return swing
    rise, lowest_before = min(rises)
    level = float(peak[rise:].max())
    stop = int(np.argmax(peak <= level))
    # A motion after a decay below this fraction of the largest amplitude has another cause.
    if level <= 0.25 * peak[0] and stop >= FEWEST_EXTREMA:
        return replace(swing, run=slice(swing.run.start, swing.run.start + stop))
    instant = swing.halves.crossing[swing.run.start + rise]
    raise NoDecayError(source, no_decay.rises_again(instant, lowest_before, peak[rise]))


def _first_rise(peak: Array, swing: Swing) -> int | None:
    """Return the first extremum of one sign that is larger than one before it; None if there is none."""
    lowest = np.minimum.accumulate(peak)
    larger = np.flatnonzero(peak > 1.1 * lowest + 2.0 * swing.oscillation.floor)
    return int(larger[0]) if larger.size else None


# A half period is wrong if its amplitude differs by this fraction from its neighbours on both sides, while
# these continue to decay.
WRONG_PART = 0.08
# Wrong half periods are at most one in this number, and at least this number is allowed; few are consecutive.
WRONG_OF = 30
FEWEST_WRONG = 4


def wrong_swings(swing: Swing) -> Index:
    """Return half periods that a sensor shows wrongly, such as a tracker that follows another object.

    Parameters
    ----------
    swing : Swing

    Returns
    -------
    (wrong,) array of int
        Indices of the wrong half periods in `swing.halves`. Their amplitude differs from that of the
        neighbours on both sides, while the neighbours continue to decay; after a push they do not.
    """
    none = np.zeros(0, dtype=np.int64)
    run = swing.run
    count = run.stop - run.start
    if count < 3 * FEWEST_EXTREMA:
        return none
    peak = swing.halves.peak[run]
    level = np.log(np.maximum(peak, 1e-300))
    scatter = (4.0 * swing.oscillation.smoothed_noise + 0.5 * swing.oscillation.step) / peak
    good = np.ones(count, dtype=bool)
    for _ in range(max(FEWEST_WRONG, count // WRONG_OF) + 1):
        # Compare with the nearest good half periods of the same sign, because the middle may be wrong.
        off = np.zeros(count)
        for side in (0, 1):
            kept = np.flatnonzero(good[side::2])
            if kept.size < FEWEST_EXTREMA:
                return none
            off[side::2][kept] = _deviation_from_decay(level[side::2][kept])
        far = np.where(np.abs(off) > WRONG_PART + scatter, np.abs(off), 0.0)
        if not far.any():
            break
        good[int(np.argmax(far))] = False
    else:
        return none
    # The sensor alone is not wrong if the others are no single decay.
    if any(_first_rise(peak[side::2][good[side::2]], swing) is not None for side in (0, 1)):
        return none
    return np.flatnonzero(~good) + run.start


def _deviation_from_decay(level: Array) -> Array:
    """Return the deviation of log amplitudes from their neighbours if these decay; else 0."""
    off = np.zeros(level.size)
    before = level[1:-3]
    after = level[3:-1]
    around = np.stack([level[:-4], before, after, level[4:]])
    off[2:-2] = level[2:-2] - np.median(around, axis=0)
    # After a push, and in beats, the amplitude rises.
    off[2:-2][after > before + 0.5 * WRONG_PART] = 0.0
    return off


def end_of_clipping(swing: Swing, source: str) -> tuple[int, str]:
    """Return the first sample after the last clipped half period, and a sentence.

    Returns
    -------
    int
        First sample; 0 if nothing is clipped.
    str
        Description of the samples left out, with the reason.

    Raises
    ------
    NoDecayError
        Too few half periods remain.
    """
    time = swing.time
    last = -1
    limits = []
    for side in (-1, 1) if swing.run.stop - swing.run.start >= FEWEST_EXTREMA else ():
        reached, limit = _clipped(swing, side)
        if reached.size:
            last = max(last, int(reached[-1]))
            limits.append(f"{limit:.6g}")
    if last < 0:
        return 0, ""
    if swing.run.stop - last - 1 < FEWEST_EXTREMA:
        raise NoDecayError(source, no_decay.clipped(limits))
    first = int(np.searchsorted(time, swing.halves.crossing[last + 1]))
    cut = f"the first {time[first] - time[0]:.4g} s, clipped at {' and '.join(limits)}, left out"
    return first, cut


def _clipped(swing: Swing, side: int) -> tuple[Index, float]:
    """Return clipped half periods of one sign, which stay too long at the extreme value, and this value.

    They stay there exactly, or within the noise, which may be added after clipping.
    """
    halves = swing.halves
    run = swing.run
    angle = swing.signal
    starts, stops = halves.samples(swing.time)
    part = slice(int(starts[run.start]), int(stops[run.stop - 1]))
    limit = float(side * np.max(side * angle[part]))
    height = max(side * (limit - swing.equilibrium), 1e-300)
    inside = (np.arange(len(starts)) >= run.start) & (np.arange(len(starts)) < run.stop)
    noise = swing.oscillation.smoothed_noise * np.sqrt(swing.oscillation.samples)

    samples = np.minimum(stops - starts, np.median(stops - starts))

    def near_limit(width: float) -> Index:
        near = np.concatenate(([0], np.cumsum(np.abs(limit - angle) <= width)))
        return np.where(halves.sign == side, near[stops] - near[starts], 0)

    # Samples at the end of the sensor's range, exactly or within this number of noise levels.
    for width in (1e-9 * height, 6.0 * noise):
        # Fraction of a half period for which a cosine stays within this distance of its top.
        usual_width = max(width, swing.oscillation.step)
        usual = 2.0 / np.pi * np.arccos(max(0.0, 1.0 - usual_width / height)) * samples
        at_limit = near_limit(width)
        # A broad top has many samples slightly below it (a parabola has half of those within four times the
        # width), a flat top almost none. A single flat top may be chance.
        tops = (at_limit > 1.5 * usual + 1) & (at_limit > 0.75 * near_limit(4.0 * usual_width))
        if np.any(tops & inside) and np.count_nonzero(tops) >= 2:
            return np.flatnonzero((at_limit > 0) & (inside | tops)), limit
    return np.zeros(0, dtype=np.int64), limit


def before_the_hand(swing: Swing) -> slice | None:
    """Return the run up to the last free half period; None if no hand ends the swing.

    This is for a record that continues differently after its run of half periods.
    """
    run = swing.run
    end = run.stop
    # A hand takes a few periods at most.
    for half in range(max(run.stop - 8, run.start + 4), run.stop):
        if _disturbed(swing, half):
            end = half
            break
    # The arrest by friction also breaks the pace, but at a small amplitude.
    if end - run.start < 5 or _nearly_stopped(swing, end - 1):
        return None
    return slice(run.start, end)


def _disturbed(swing: Swing, half: int) -> bool:
    """Return true if amplitude or duration deviate from the trend of half periods of the same sign before."""
    peak = swing.halves.peak
    duration = swing.halves.duration
    noise = 4.0 * swing.oscillation.smoothed_noise + swing.oscillation.step
    fall = peak[half - 4] - peak[half - 2]
    expected = peak[half - 2] - fall
    off_pace = abs(peak[half] - expected) > PACE_TOLERANCE * peak[half - 2] + abs(fall) + noise
    drift = abs(duration[half - 2] - duration[half - 4])
    shift = noise / peak[half - 2] * duration[half - 2] / np.pi
    longer = abs(duration[half] - duration[half - 2])
    return bool(off_pace or longer > PACE_TOLERANCE * duration[half - 2] + 2.0 * drift + 2.0 * shift)


def _nearly_stopped(swing: Swing, half: int) -> bool:
    """Return true if the amplitude, at its present rate, soon ends or is lost in the noise."""
    peak = swing.halves.peak
    pace = (peak[half - 4] - peak[half]) / 4.0
    # Friction alone stops a swing that would end, at its last rate, within this number of half periods.
    return bool(peak[half] < 4.0 * pace + 4.0 * swing.oscillation.floor)
