"""The free decay within a record: from the release to the stop, about its equilibrium."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays import checks
from sysid_trib.decays.equilibrium import Swing, find_swing
from sysid_trib.decays.half_periods import noise_level
from sysid_trib.decays.half_sines import with_standard_error
from sysid_trib.errors import DecayError, UsageError

# rad or m, far below any measurement; the squares of still smaller numbers underflow.
SMALLEST_SWING = 1e-15


@dataclass(frozen=True)
class Part:
    """First sample of the free motion, one past its last, what was cut, and the stop for good (or nan)."""

    start: int
    stop: int
    before: str
    after: str
    stop_time: float = float("nan")


def free_decay(
    record: xr.Dataset,
    *,
    window: tuple[float | None, float | None] = (None, None),
    equilibrium: float | str = "auto",
) -> xr.Dataset:
    """Cut a record to its free decay and centre it on its equilibrium.

    Parameters
    ----------
    record
        With ``angle(time)``.
    window : s
        Times between which to look; None for the record's end.
    equilibrium : rad, or "auto"
        ``auto``: the robust mean of (b[i-1] + 2 b[i] + b[i+1])/4 over signed extrema. It is not the rest
        position, which dry friction may put anywhere in the stick band.

    Returns
    -------
    Dataset
        The record from the release to the stop, ``angle`` centred, times unchanged; scalars ``equilibrium``
        and ``equilibrium_standard_error`` (nan if given), ``stop_time`` if it stopped for good; attrs
        ``free_decay``: a sentence on what was cut. A record that is free from its first sample on loses none.

    Raises
    ------
    UsageError
        The window is no interval.
    RecordError
        Uneven time steps within the window.
    DecayError
        Less than three periods, or flat, only noise, not decaying, growing, clipped.
    """
    source = str(record.attrs.get("source", "record"))
    inside = _in_window(record, window, source)
    time, angle = inside["time"].to_numpy().astype(float), inside["angle"].to_numpy().astype(float)
    _check_signal(time, angle, source)
    value = None if equilibrium == "auto" else _given(equilibrium)
    if value is not None and not angle.min() < value < angle.max():
        raise DecayError(
            f"{source}: an equilibrium of {value:g} is outside of the record, which runs from "
            f"{angle.min():.4g} to {angle.max():.4g} {inside['angle'].attrs.get('units', 'rad')}; "
            "correct it, or let it be found (auto)."
        )
    swing = find_swing(time, angle, value)
    if swing is None:
        raise DecayError(
            f"{source}: no oscillation stands out of the noise; check the column and the window."
        )
    swing = checks.after_the_largest(time, angle, swing, source)
    checks.refuse_outliers(time, angle, source)
    checks.refuse_clipping(time, angle, swing, source)
    part = _free_part(time, angle - swing.equilibrium, swing)
    decay = inside.isel(time=slice(part.start, part.stop)).copy()
    attrs = decay["angle"].attrs
    decay["angle"] = (decay["angle"] - swing.equilibrium).assign_attrs(attrs)
    units = str(attrs.get("units", "rad"))
    equilibrium_of = swing.equilibrium, swing.standard_error
    decay = decay.assign(with_standard_error((), "equilibrium", *equilibrium_of, units, "equilibrium"))
    if np.isfinite(part.stop_time):
        stop_attrs = {"units": "s", "long_name": "time at which it stopped for good"}
        decay["stop_time"] = ((), part.stop_time, stop_attrs)
    decay.attrs["free_decay"] = _sentence(time, part, swing, units)
    return decay


def _given(equilibrium: float | str) -> float:
    try:
        value = float(equilibrium)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise UsageError(f"equilibrium {equilibrium!r}: give a number, or auto.")
    return value


def _in_window(record: xr.Dataset, window: tuple[float | None, float | None], source: str) -> xr.Dataset:
    start = -np.inf if window[0] is None else float(window[0])
    stop = np.inf if window[1] is None else float(window[1])
    if not start < stop:
        raise UsageError(f"window {window[0]}:{window[1]}: its start must come before its end.")
    time = record["time"].to_numpy()
    first, last = int(np.searchsorted(time, start)), int(np.searchsorted(time, stop, "right"))
    inside = record.isel(time=slice(first, last))
    if inside.sizes["time"] < 20:
        raise DecayError(
            f"{source}: only {inside.sizes['time']} samples between {max(start, time[0]):g} s and "
            f"{min(stop, time[-1]):g} s (the record runs from {time[0]:g} s to {time[-1]:g} s); "
            "widen the window."
        )
    return inside


def _check_signal(time: Array, angle: Array, source: str) -> None:
    bad = np.flatnonzero(~np.isfinite(angle))
    if bad.size:
        raise DecayError(f"{source}: the angle at {time[bad[0]]:.6g} s is not a finite number; cut it out.")
    checks.check_sampling(time, source)
    if np.ptp(angle) <= max(1e-12 * np.max(np.abs(angle)), SMALLEST_SWING):
        raise DecayError(f"{source}: the angle is flat at {angle[0]:.6g}; choose another column or window.")


def _free_part(time: Array, angle: Array, swing: Swing) -> Part:
    halves, run = swing.halves, swing.run
    smoothed, centred = swing.oscillation.time, swing.oscillation.signal - swing.equilibrium
    start, before = 0, ""
    if run.start > 1 or not _mirrors(smoothed, centred, swing, leading=True):
        inside = (smoothed >= halves.crossing[run.start]) & (smoothed <= halves.crossing[run.start + 1])
        top = smoothed[inside][np.argmax(np.abs(centred[inside]))]
        start = int(np.searchsorted(time, top))
        before = f"the {time[start] - time[0]:.4g} s before the first free extremum"
    if run.stop == halves.sign.size - 1 and _mirrors(smoothed, centred, swing, leading=False):
        return Part(start, time.size, before, "")
    free = checks.before_the_hand(swing)
    if free is not None:
        stop = int(np.searchsorted(time, halves.crossing[free.stop]))
        cut = f"the last {time[-1] - time[stop - 1]:.4g} s, in which not friction but a hand, it seems,"
        return Part(start, stop, before, f"{cut} stops it")
    stop, stop_time = _find_stop(time, angle, swing)
    if np.isfinite(stop_time):
        after = f"the {time[-1] - stop_time:.4g} s after it stopped for good"
        return Part(start, stop, before, after, stop_time)
    stop = int(np.searchsorted(time, halves.crossing[run.stop]))
    small = halves.peak[run.stop - 1] < 4.0 * swing.oscillation.floor
    reason = "in which it is lost in the noise" if small else "in which it does not swing freely"
    return Part(start, stop, before, f"the last {time[-1] - time[stop - 1]:.4g} s {reason}")


def _mirrors(time: Array, angle: Array, swing: Swing, *, leading: bool) -> bool:
    """Whether an end of the record is the mirror image, through a zero crossing, of the swing next to it.

    Free motion under odd forces is, up to the decay; motion held, pushed or stopped by hand or by friction is
    not.
    """
    halves, run = swing.halves, swing.run
    peak, duration = halves.peak[run], halves.duration[run]
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
    allowed = max(4.5 * noise, 1.2 * swing.oscillation.step, 1e-9)
    away = np.flatnonzero(np.abs(angle[:last] - rest) > allowed)
    stop = int(away[-1]) + 1 if away.size else 0
    # Motion that a single sample's noise hides may still show in the averages.
    oscillation = swing.oscillation
    least = max(oscillation.floor, oscillation.step, 1e-9)
    hidden = np.abs(oscillation.signal - swing.equilibrium - rest) > least
    hidden &= oscillation.time < time[last - 1]
    stop = max(stop, int(np.searchsorted(time, oscillation.time[hidden].max(initial=time[0]))))
    if stop >= last or time[stop] > end + 5.0 * duration or time[last - 1] - time[stop] < duration:
        return time.size, np.nan
    # Fading below the noise looks the same unless the next extremum would have been seen, or the rest is off
    # centre.
    peak = halves.peak[run]
    expected = peak[-1] ** 2 / peak[-2]
    centred = 3.0 * float(np.nan_to_num(swing.standard_error))
    off_centre = abs(rest) > centred + 3.0 * oscillation.smoothed_noise + 0.5 * oscillation.step
    seen = expected > centred + 2.0 * oscillation.floor or off_centre
    return (stop, float(time[stop])) if seen else (time.size, np.nan)


def _sentence(time: Array, part: Part, swing: Swing, units: str) -> str:
    cut = " and ".join(text for text in (part.before, part.after) if text)
    kept = f"kept {time[part.start]:.6g} s to {time[part.stop - 1]:.6g} s ({part.stop - part.start} samples)"
    error = f" ± {swing.standard_error:.2g}" if np.isfinite(swing.standard_error) else " as given"
    return f"Free decay: {kept}; cut {cut or 'nothing'}; centred on {swing.equilibrium:.6g}{error} {units}."
