"""The part of a record that is asked for: where its motion is free, or driven, as it is."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records import free_motion_checks as checks
from sysid_trib.records.equilibrium import Swing
from sysid_trib.records.half_periods import noise_level
from sysid_trib.records.signal import FEWEST_SAMPLES, Piece


@dataclass(frozen=True)
class CutDecay:
    """A decay within a piece of a record.

    Attributes
    ----------
    piece : Piece
    swing : Swing
        Its run is what decays.
    start, stop : int
        First sample of the free motion, and one past its last.
    before, after : str
        What was cut.
    stop_time : float, s
        The stop for good; nan without one.
    """

    piece: Piece
    swing: Swing
    start: int
    stop: int
    before: str = ""
    after: str = ""
    stop_time: float = float("nan")


def free_part(piece: Piece, swing: Swing) -> CutDecay:
    """The free part of the swing of a piece."""
    time, halves, run = piece.time, swing.halves, swing.run
    smoothed, centred = swing.oscillation.time, swing.oscillation.signal - swing.equilibrium
    start, before = 0, ""
    if run.start > 1 or not _mirrors(smoothed, centred, swing, leading=True):
        inside = (smoothed >= halves.crossing[run.start]) & (smoothed <= halves.crossing[run.start + 1])
        top = smoothed[inside][np.argmax(np.abs(centred[inside]))]
        start = int(np.searchsorted(time, top))
        before = f"the {time[start] - time[0]:.4g} s before the first free extremum"
    if run.stop == halves.sign.size - 1 and _mirrors(smoothed, centred, swing, leading=False):
        return CutDecay(piece, swing, start, time.size, before)
    free = checks.before_the_hand(swing)
    if free is not None:
        stop = int(np.searchsorted(time, halves.crossing[free.stop]))
        cut = f"the last {time[-1] - time[stop - 1]:.4g} s, in which it leaves the course of the decay"
        return CutDecay(piece, swing, start, stop, before, cut)
    stop, stop_time = _find_stop(time, piece.signal - swing.equilibrium, swing)
    if np.isfinite(stop_time):
        after = f"the {time[-1] - stop_time:.4g} s after it stopped for good"
        return CutDecay(piece, swing, start, stop, before, after, stop_time)
    stop = int(np.searchsorted(time, halves.crossing[run.stop]))
    small = halves.peak[run.stop - 1] < 4.0 * swing.oscillation.floor
    reason = "in which it is lost in the noise" if small else "in which it does not swing freely"
    after = f"the last {time[-1] - time[stop - 1]:.4g} s {reason}"
    return CutDecay(piece, swing, start, stop, before, after)


def _mirrors(time: Array, angle: Array, swing: Swing, *, leading: bool) -> bool:
    """True if an end of the record is the mirror image, through a zero crossing, of the swing next to it.

    Free motion under odd forces is, up to the decay; motion held, pushed or stopped by hand or by friction is
    not.
    """
    halves, run = swing.halves, swing.run
    peak, duration = swing.peaks, halves.duration[run]
    crossing = halves.crossing[run.start] if leading else halves.crossing[run.stop]
    # Two half periods further the sign is the same: an error of the equilibrium does not look like decay.
    near, further = (0, 2) if leading else (-1, -3)
    outside = time < crossing if leading else time > crossing
    away = np.abs(time[outside] - crossing)
    if away.size == 0:
        return True
    if away.max() > 1.5 * duration[near]:
        return False
    decay = np.log(peak[near] / peak[further]) / (2.0 * duration[near])
    inwards = crossing + away if leading else crossing - away
    mirrored = -np.interp(inwards, time, angle) * np.exp(2.0 * decay * away)
    drift = 6.0 * float(np.nan_to_num(swing.standard_error))
    allowed = 0.08 * peak[near] + 5.0 * swing.oscillation.smoothed_noise + swing.oscillation.step + drift
    return bool(np.all(np.abs(angle[outside] - mirrored) < allowed))


def _find_stop(time: Array, angle: Array, swing: Swing) -> tuple[int, float]:
    """First sample of the stuck tail, and its time; nan if the motion did not stop but fade or go on."""
    halves, run = swing.halves, swing.run
    end, duration = halves.crossing[run.stop], float(halves.duration[run.stop - 1])
    first, last = np.searchsorted(time, (end + duration, end + 12.0 * duration))
    if last - first < 5:
        return time.size, np.nan
    rest = float(np.median(angle[first + 2 * (last - first) // 3 : last]))
    # In the rest itself there may be no noise at all, and on the way to it no repeated value.
    noise = noise_level(time[first:last], angle[first:last])
    # Of the largest swing: what is as near to where it rests does not move, where there is no noise at all.
    still = 3e-9 * float(swing.peaks.max())
    allowed = max(4.5 * noise, 1.2 * swing.oscillation.step, still)
    # Motion that a single sample's noise hides still shows in the averages: a sample long after is noise.
    oscillation = swing.oscillation
    least = max(oscillation.floor, oscillation.step, still)
    shown = np.abs(oscillation.signal - swing.equilibrium - rest) > least
    shown &= oscillation.time < time[last - 1]
    moves = float(oscillation.time[shown].max(initial=time[0]))
    near = min(last, int(np.searchsorted(time, moves + duration)))
    away = np.flatnonzero(np.abs(angle[:near] - rest) > allowed)
    stop = max(int(away[-1]) + 1 if away.size else 0, int(np.searchsorted(time, moves)))
    if stop >= last or time[stop] > end + 5.0 * duration or time[last - 1] - time[stop] < duration:
        return time.size, np.nan
    # Fading below the noise looks the same unless the next extremum would have been seen, or the rest is off
    # centre.
    peak = swing.peaks
    expected = peak[-1] ** 2 / peak[-2]
    centred = 3.0 * float(np.nan_to_num(swing.standard_error))
    off_centre = abs(rest) > centred + 3.0 * oscillation.smoothed_noise + 0.5 * oscillation.step
    seen = expected > centred + 2.0 * oscillation.floor or off_centre
    return (stop, float(time[stop])) if seen else (time.size, np.nan)


def driven_part(
    record: xr.Dataset, window: tuple[float | None, float | None], names: list[str]
) -> xr.Dataset:
    """A driven record within a window, with a sentence on it (attrs `free_decay`).

    Parameters
    ----------
    record : Dataset
        `angle(time)` with inputs.
    window : (float or None, float or None), s
        First and last time; open where None.
    names : list of str
        Its inputs.

    Raises
    ------
    DecayError
        The window holds too few samples.
    UsageError
        What was measured is a rate or an acceleration, which is fitted of free decays alone.
    """
    if record.attrs.get("integrations"):
        raise UsageError(
            "A driven record is an angle or a displacement; this one is integrated. Name a column of these "
            "(--angle), or leave the input out."
        )
    low, high = window
    part = record.sel(time=slice(low, high))
    if part.sizes["time"] < FEWEST_SAMPLES:
        raise DecayError(
            f"The window holds {part.sizes['time']} samples of {record.sizes['time']}; give a longer one."
        )
    time, between = part.time.values, {str(part[name].attrs["between"]) for name in names}
    units = [f"{name} ({part[name].attrs.get('units', 'unit not stated')})" for name in names]
    step = float(np.median(np.diff(time)))
    said = (
        f"Driven record: {time[0]:.6g} s to {time[-1]:.6g} s ({len(time)} samples, {step:.4g} s apart); "
        f"inputs {', '.join(units)}, {' and '.join(sorted(between))} between samples."
    )
    return part.assign_attrs(free_decay=said)
