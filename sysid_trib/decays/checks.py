"""Whether a swing is a free decay: long enough, falling, never pushed, not clipped, not stopped by a hand."""

from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.decays.equilibrium import Swing, signed_extrema
from sysid_trib.errors import DecayError, RecordError

# Three full periods: five whole half periods and a part of one at either end.
FEWEST_EXTREMA = 5
FEWEST_PER_HALF_PERIOD = 3
STEP_TOLERANCE = 0.02
# A hand takes a few periods at most.
HAND_HALF_PERIODS = 8
# Friction alone stops a swing that, at its last pace, would end within so many half periods.
NATURAL_HALF_PERIODS = 4.0
PACE_TOLERANCE = 0.03


def refuse_outliers(time: Array, angle: Array, source: str) -> None:
    """Refuse single samples that leap out of the swing and back: least squares would follow them."""
    middle = 0.5 * (angle[2:] + angle[:-2])
    swing = float(np.ptp(np.percentile(angle, [1.0, 99.0])))
    leap = np.abs(angle[1:-1] - middle)
    # Off both neighbours alike, by half the swing: no motion that is sampled at all does this.
    outliers = np.flatnonzero((leap > 0.5 * swing) & (leap > 2.0 * np.abs(angle[2:] - angle[:-2])))
    if outliers.size:
        at = outliers[0] + 1
        raise DecayError(
            f"{source}: the sample at {time[at]:.6g} s leaps to {angle[at]:.4g} and back ({outliers.size} "
            "such in all); remove them from the file, or choose a window without them (--window)."
        )


def after_the_largest(time: Array, angle: Array, swing: Swing, source: str) -> Swing:
    """Leave out what comes before the largest extremum, and refuse what does not decay after it."""
    run = swing.run
    per_half_period = 0.5 * swing.oscillation.period * (time.size - 1) / (time[-1] - time[0])
    if per_half_period < FEWEST_PER_HALF_PERIOD:
        raise DecayError(f"{source}: only {per_half_period:.2g} samples in a half period; sample faster.")
    count = run.stop - run.start
    if count < FEWEST_EXTREMA:
        raise DecayError(
            f"{source}: only {count} whole half periods of steady oscillation were found (period about "
            f"{swing.oscillation.period:.3g} s), at least five are needed, three full periods in all; record "
            "longer or widen the window."
        )
    peak = np.abs(signed_extrema(time, angle - swing.equilibrium, swing.halves.select(run)))
    # Generous for an extremum's own scatter: by noise, which averaging over a third of a period would leave,
    # and steps.
    scatter = 3.0 * swing.oscillation.smoothed_noise + 0.5 * swing.oscillation.step
    largest = int(np.argmax(peak))
    first = largest if peak[largest] > 1.03 * peak[0] + scatter else 0
    quarter = max(1, (count - first) // 4)
    fall = float(np.mean(peak[first : first + quarter]) - np.mean(peak[-quarter:]))
    if count - first < FEWEST_EXTREMA and largest:
        growth = 100.0 * ((peak[largest] / peak[0]) ** (2.0 / largest) - 1.0)
        raise DecayError(
            f"{source}: the oscillation grows by {growth:.2g} % a period; a free decay is needed."
        )
    if fall < 1e-4 * peak[first] + scatter / np.sqrt(quarter):
        change = -200.0 * fall / peak[first] / (count - first)
        raise DecayError(
            f"{source}: the oscillation does not decay: of {peak[first]:.3g}, {change:.2g} % a period."
        )
    swing = replace(swing, run=slice(run.start + first, run.stop))
    _refuse_pushes(peak[first:], swing, source)
    return swing


def _refuse_pushes(peak: Array, swing: Swing, source: str) -> None:
    """Refuse an amplitude that rises again, comparing extrema of one sign: a push, or two modes that beat."""
    for side in (0, 1):
        same = peak[side::2]
        lowest = np.minimum.accumulate(same)
        rises = np.flatnonzero(same > 1.1 * lowest + 2.0 * swing.oscillation.floor)
        if rises.size:
            instant = swing.halves.crossing[swing.run.start + side + 2 * int(rises[0])]
            raise DecayError(
                f"{source}: the amplitude rises again at {instant:.4g} s, from {lowest[rises[0]]:.3g} to "
                f"{same[rises[0]]:.3g}; a free decay does not: end the window before or start it after."
            )


def refuse_clipping(time: Array, angle: Array, swing: Swing, source: str) -> None:
    """Refuse flat tops at one and the same extreme value in three or more half periods."""
    starts, stops = swing.halves.select(swing.run).samples(time)
    sign = swing.halves.sign[swing.run]
    part = slice(int(starts[0]), int(stops[-1]))
    for side, limit in ((1, angle[part].max()), (-1, angle[part].min())):
        at_limit = np.concatenate(([0], np.cumsum(np.abs(angle - limit) <= 1e-9 * np.ptp(angle))))
        flat = (at_limit[stops] - at_limit[starts])[sign == side]
        height = side * (limit - swing.equilibrium)
        # A cosine stays within a quantisation step of its top for this part of a half period.
        within = max(0.0, 1.0 - swing.oscillation.step / max(height, 1e-300))
        usual = 2.0 / np.pi * np.arccos(within) * np.median(stops - starts)
        if np.count_nonzero(flat > 1.5 * usual + 2) >= 3:
            raise DecayError(
                f"{source}: {np.count_nonzero(flat)} half periods are clipped at {limit:.6g}; "
                "start the window after them, or record with a wider range."
            )


def before_the_hand(swing: Swing) -> slice | None:
    """The run up to the last half period that is free, or None if the swing does not end by a hand.

    For a record that goes on after its run of half periods otherwise than the swing would.
    """
    run = swing.run
    end = run.stop
    for half in range(max(run.stop - HAND_HALF_PERIODS, run.start + 4), run.stop):
        if _disturbed(swing, half):
            end = half
            break
    # Friction's own arrest also breaks the pace, but at a small amplitude.
    if end - run.start < 5 or _nearly_stopped(swing, end - 1):
        return None
    return slice(run.start, end)


def _disturbed(swing: Swing, half: int) -> bool:
    """Whether amplitude or duration leave the course of the half periods of the same sign before."""
    peak, duration = swing.halves.peak, swing.halves.duration
    noise = 4.0 * swing.oscillation.smoothed_noise + swing.oscillation.step
    fall = peak[half - 4] - peak[half - 2]
    expected = peak[half - 2] - fall
    off_pace = abs(peak[half] - expected) > PACE_TOLERANCE * peak[half - 2] + abs(fall) + noise
    drift = abs(duration[half - 2] - duration[half - 4])
    shift = noise / peak[half - 2] * duration[half - 2] / np.pi
    longer = abs(duration[half] - duration[half - 2])
    return bool(off_pace or longer > PACE_TOLERANCE * duration[half - 2] + 2.0 * drift + 2.0 * shift)


def _nearly_stopped(swing: Swing, half: int) -> bool:
    """Whether the amplitude, at its pace, is about to end or to be off_pace in the noise."""
    peak = swing.halves.peak
    pace = (peak[half - 4] - peak[half]) / 4.0
    return bool(peak[half] < NATURAL_HALF_PERIODS * pace + 4.0 * swing.oscillation.floor)


def check_sampling(time: Array, source: str) -> None:
    """Refuse time steps more than 2 % from their median: a gap, dropped frames, or a coarse clock.

    Raises
    ------
    RecordError
        With the worst step, where it is, and the remedy.
    """
    steps = np.diff(time)
    median = float(np.median(steps))
    # A clock printed with a few digits is off by rounding; 1e-9 s keeps the limit itself on the good side.
    worst = int(np.argmax(np.abs(steps - median)))
    if abs(steps[worst] - median) <= STEP_TOLERANCE * median + 1e-9:
        return
    raise RecordError(
        f"{source}: a time step of {steps[worst]:.3g} s at {time[worst]:.6g} s, "
        f"but {median:.3g} s is usual and 2 % is allowed. "
        "Keep a part without gaps, --window START:STOP (window= in Python), "
        "resample first (record.interp in Python), or give the sampling rate if the time column is wrong, "
        "--sampling-rate HZ (sampling_rate=)."
    )
