"""A swing that a hand, and not its friction, brings to rest."""

import numpy as np

from sysid_trib.decays.equilibrium import Swing

# A hand takes a few periods at most.
HAND_HALF_PERIODS = 8
# Friction alone stops a swing that, at its last pace, would end within so many half periods.
NATURAL_HALF_PERIODS = 4.0
PACE_TOLERANCE = 0.03


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
