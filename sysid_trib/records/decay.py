"""Decay: the free part of a record, or all of a short one; several runs as a list."""

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline
from scipy.optimize import curve_fit

from sysid_trib.arrays import Array, variable, with_error
from sysid_trib.errors import DecayError
from sysid_trib.records import free_motion_checks as checks, half_periods
from sysid_trib.records.equilibrium import Swing, find_swing
from sysid_trib.records.integration import Piece, as_position
from sysid_trib.records.signal import NOISE_IS_WHITE_IN, unit_of_signal

# Relative accuracy of the extremum before the first zero crossing, in half periods.
EXTREMUM_ERROR = 0.003
# Periods that are left out at both ends of the integral of a mode.
END_OF_A_MODE = 1.0


def free_part(swing: Swing) -> Swing:
    """Return the free part of a swing, the samples cut before and after it, and its final stop."""
    time = swing.time
    halves = swing.halves
    run = swing.run
    smoothed = swing.oscillation.time
    centred = swing.oscillation.signal - swing.equilibrium
    start = 0
    before = ""
    if run.start > 1 or not _mirrors(smoothed, centred, swing, leading=True):
        inside = (smoothed >= halves.crossing[run.start]) & (smoothed <= halves.crossing[run.start + 1])
        top = smoothed[inside][np.argmax(np.abs(centred[inside]))]
        start = int(np.searchsorted(time, top))
    else:
        start = _release(swing, smoothed, centred)
    if start:
        before = f"the {time[start] - time[0]:.4g} s before the first free extremum"
    stop = time.size
    after = ""
    stop_time = np.nan
    if run.stop < halves.sign.size - 1 or not _mirrors(smoothed, centred, swing, leading=False):
        free = checks.before_the_hand(swing)
        if free is None:
            stop, stop_time = _find_stop(swing)
        if free is None and np.isfinite(stop_time):
            after = f"the {time[-1] - stop_time:.4g} s after it stopped for good"
        else:
            stop = int(np.searchsorted(time, halves.crossing[(free or run).stop]))
            small = halves.peak[run.stop - 1] < 4.0 * swing.oscillation.floor
            reason = "is lost in the noise" if small else "does not swing freely"
            reason = ", in which it deviates from the decay" if free else f" in which it {reason}"
            after = f"the last {time[-1] - time[stop - 1]:.4g} s{reason}"
    return replace(swing, free=slice(start, stop), before=before, after=after, stop_time=float(stop_time))


def _release(swing: Swing, smoothed: Array, centred: Array) -> int:
    """Return the extremum before the first zero crossing, or 0 if the record is free before it, too.

    Before that extremum, a hand may hold the body or move it to its release. Free motion takes a quarter
    period from the extremum to the crossing, slightly more if it decays. Before the extremum, it is the
    mirror image of the motion after it, apart from the decay, for any elastic forces.
    """
    time = swing.time
    run = swing.run
    peak = swing.peaks
    duration = swing.halves.duration[run]
    if duration.size < 4:
        return 0
    # Half periods of the same sign: an error of the equilibrium changes their durations equally.
    half_period = duration[1] + np.clip(duration[1] - duration[3], -0.1 * duration[1], 0.1 * duration[1])
    decay = max(0.0, float(np.log(peak[0] / peak[2])) / 2.0)
    # Time of a cosine with a decaying amplitude; its extremum comes slightly earlier.
    middle = swing.halves.crossing[run.start] - 0.5 * half_period
    extremum = middle - half_period * np.arctan(decay / np.pi) / np.pi
    away = middle - smoothed[smoothed < extremum]
    if away.size == 0:
        return 0
    start = int(np.searchsorted(time, extremum))
    if away.max() > half_period:
        return start
    top, *image = CubicSpline(smoothed, centred)(middle + np.append(0.0, away))
    missed = np.abs(centred[: away.size] - np.array(image) * np.exp(2.0 * decay * away / half_period))
    slope = np.pi * abs(top) * np.sin(np.pi * away / half_period)
    allowed = (0.05 + decay) * np.abs(top - image) + 2.0 * EXTREMUM_ERROR * slope
    allowed += 5.0 * swing.oscillation.smoothed_noise + swing.oscillation.step
    return start if np.any(missed > allowed) else 0


def _mirrors(time: Array, angle: Array, swing: Swing, *, leading: bool) -> bool:
    """Return true if an end of the record mirrors the next swing at a zero crossing.

    Free motion under odd forces does, apart from the decay. Motion that a hand or friction holds, drives or
    stops does not.
    """
    halves = swing.halves
    run = swing.run
    peak = swing.peaks
    duration = halves.duration[run]
    crossing = halves.crossing[run.start] if leading else halves.crossing[run.stop]
    # The sign is the same two half periods further: an error of the equilibrium does not look like a decay.
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


def _find_stop(swing: Swing) -> tuple[int, float]:
    """Return the first sample of the stuck tail, and its time; nan if the motion faded or continued."""
    time = swing.time
    angle = swing.signal - swing.equilibrium
    halves = swing.halves
    run = swing.run
    end = halves.crossing[run.stop]
    duration = float(halves.duration[run.stop - 1])
    first, last = np.searchsorted(time, (end + duration, end + 12.0 * duration))
    if last - first < 5:
        return time.size, np.nan
    rest = float(np.median(angle[first + 2 * (last - first) // 3 : last]))
    # At rest the noise may vanish, and before rest there may be no repeated value.
    noise = half_periods.noise_level(time[first:last], angle[first:last])
    # As a fraction of the largest swing: samples this near to rest do not move in a record without noise.
    still = 3e-9 * float(swing.peaks.max())
    allowed = max(4.5 * noise, 1.2 * swing.oscillation.step, still)
    # A motion hidden in the noise of single samples still shows in averages; much later samples are noise.
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
    # Fading below the noise looks the same, unless the next extremum would have been visible, or the body
    # rests off centre.
    peak = swing.peaks
    expected = peak[-1] ** 2 / peak[-2]
    centred = 3.0 * float(np.nan_to_num(swing.standard_error))
    off_centre = abs(rest) > centred + 3.0 * oscillation.smoothed_noise + 0.5 * oscillation.step
    seen = expected > centred + 2.0 * oscillation.floor or off_centre
    return (stop, float(time[stop])) if seen else (time.size, np.nan)


def decay_dataset(record: xr.Dataset, swing: Swing, said: str) -> xr.Dataset:
    """Return the decay as a part of its record, with the record's own samples where nothing was changed.

    Parameters
    ----------
    record : Dataset
        Record with `angle(time)`, and the rate or acceleration to be integrated (attribute `measured`).
    swing : Swing
        Swing in the angle, or in the measured signal.
    said : str
        Sentence on earlier changes of the samples.

    Returns
    -------
    Dataset
        Decay in the form of `free_decay`.
    """
    time = swing.time[swing.free]
    signal = swing.signal[swing.free] - swing.equilibrium
    attrs = record["angle"].attrs
    units = centred_in = unit_of_signal(record)
    equilibrium = swing.equilibrium, swing.standard_error
    measured = record.attrs.get("measured")
    variables: dict[str, Any] = {}
    if measured:
        own_attrs = dict(record[measured].attrs) | {"long_name": f"{measured} as measured, about its mean"}
        at = {"measured_time": ("measured_time", time, {"units": "s", "long_name": "time"})}
        variables = {"measured": xr.DataArray(signal, at, "measured_time", attrs=own_attrs)}
        period = swing.oscillation.period
        signal = as_position(time, signal, period, record.attrs)
        # Number of samples per period kept of an integrated signal: integration leaves almost no noise at
        # higher frequencies.
        every = max(1, int(period / 32 * (time.size - 1) / (time[-1] - time[0])))
        every = every if record.attrs["integrations"] else 1
        # At the ends of a mode its integral has several times the noise.
        ends = END_OF_A_MODE * period if record.attrs.get(NOISE_IS_WHITE_IN) else 0.0
        inside = (time >= time[0] + ends) & (time <= time[-1] - ends)
        time = time[inside][::every]
        signal = signal[inside][::every]
        equilibrium = (0.0, np.nan)
        centred_in = str(record[measured].attrs["units"])
    cut = _on_own_samples(record, time, bare=bool(measured))
    cut["angle"] = ("time", signal, attrs)
    cut = cut.assign(variables | with_error("equilibrium", (), equilibrium, "equilibrium", units))
    if np.isfinite(swing.stop_time):
        cut["stop_time"] = variable((), swing.stop_time, "time at which it stopped for good", "s")
    cut.attrs["free_decay"] = _sentence(swing, centred_in, said)
    return cut


def _on_own_samples(record: xr.Dataset, time: Array, *, bare: bool) -> xr.Dataset:
    """Return the record's part at these times with all variables; at other times the coordinate only."""
    first = int(np.searchsorted(record["time"].to_numpy(), time[0]))
    part = record.isel(time=slice(first, first + time.size))
    if np.array_equal(part["time"].to_numpy(), time) and not bare:
        return part.copy()
    return xr.Dataset(coords={"time": ("time", time, record["time"].attrs)}, attrs=record.attrs)


def _sentence(swing: Swing, units: str, said: str) -> str:
    time = swing.time[swing.free]
    cut = " and ".join(text for text in (swing.before, swing.after) if text)
    kept = f"kept {time[0]:.6g} s to {time[-1]:.6g} s ({time.size} samples)"
    known = np.isfinite(swing.standard_error)
    size = f"{swing.equilibrium:.6g} ± {swing.standard_error:.2g}" if known else f"{swing.equilibrium:.6g}"
    middle = f"equilibrium {size} {units}{'' if known else ' as given'}, subtracted"
    done = "".join(f"; {text}" for text in (said, swing.mended) if text)
    return f"Free decay: {kept}; cut {cut or 'nothing'}{done}; {middle}."


def short_decay(piece: Piece, value: float | None, refusal: DecayError) -> Swing:
    """Return the swing of a piece about a given value, or about the constant of the best damped sine.

    Raises
    ------
    DecayError
        Nothing swings: this is the refusal, which states why the piece is not a proven decay.
    """
    time, signal, mended = piece
    swing = find_swing(time, signal, value)
    if swing is None:
        raise refusal
    # Number of half periods from which a final stop can be detected.
    if swing.peaks.size >= 3 and swing.peaks[-1] <= swing.peaks[0]:
        seen = free_part(swing)
        if np.isfinite(seen.stop_time):
            swing = replace(seen, free=slice(0, seen.free.stop), before="")
    fitted = _damped_sine(time[swing.free], signal[swing.free], swing.oscillation.period)
    if fitted is None:
        raise refusal
    middle = fitted if value is None else (swing.equilibrium, swing.standard_error)
    return replace(swing, equilibrium=middle[0], standard_error=middle[1], mended=mended)


def _damped_sine(time: Array, signal: Array, period: float) -> tuple[float, float] | None:
    """Return the constant of a damped sine, and its standard error; None if there is no damped sine."""
    w = 2.0 * np.pi / period
    size = float(np.std(signal))
    at = w * (time - time[0])
    y = signal / size

    def motion(at: Array, *values: float) -> Array:
        constant, cosine, sine, exponent, ratio = values
        fall = np.exp(np.clip(-exponent * at, -50.0, 50.0))
        return np.asarray(constant + fall * (cosine * np.cos(ratio * at) + sine * np.sin(ratio * at)))

    fits = []
    # First values of the decay exponent over the frequency, for the fit of the damped sine.
    for exponent in -0.02, 0.02, 0.2, 0.6:
        columns = np.stack([motion(at, *unit, exponent, 1.0) for unit in np.eye(3)], axis=1)
        start = np.linalg.lstsq(columns, y, rcond=None)[0]
        try:
            fits.append(curve_fit(motion, at, y, [*start, exponent, 1.0]))
        except (RuntimeError, ValueError):
            continue
    residuals = [float(np.std(y - motion(at, *values))) for values, _ in fits]
    # Largest relative residual of a damped sine; otherwise there is no swing.
    if not fits or min(residuals) > 0.5:
        return None
    values, covariance = fits[int(np.argmin(residuals))]
    return float(values[0] * size), float(np.sqrt(covariance[0, 0]) * size)
