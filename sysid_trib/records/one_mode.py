"""Separation of one mode of a decay: subtract the others, combine the sensors by its shape, decimate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.signal import fftconvolve

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records.integration import as_position
from sysid_trib.records.mode_history import RISE_MEANS, history_of, rise_of
from sysid_trib.records.mode_search import (
    FEWEST_BEATS,
    Ringing,
    central_frequency,
    find_ringing,
    is_multiple,
    other_blows,
    too_close,
    unresolved,
)
from sysid_trib.records.ringing import (
    MOST_CANCELLING,
    Complex,
    Component,
    cancelling_weights,
    component_shape,
    noise_of_cancelling,
)
from sysid_trib.records.sensors import as_sensors
from sysid_trib.records.signal import NOISE_IS_WHITE_IN
from sysid_trib.records.smooth_rates import FEW_INTERVALS, MANY_INTERVALS, with_smooth_rates

# Samples kept per period, and the filter before: its roll-off, and its half length in kept samples.
KEPT_A_PERIOD, ROLL_OFF, HALF_LENGTH = 32, 0.3, 10
# Modes with a frequency ratio below this are fitted again together, with smooth rates.
NEIGHBOURING_MODES = 1.6
# Number of times at which the shape is compared with its mean; a change counts if it exceeds this number of
# standard errors and this fraction.
SHAPE_TIMES, SHAPE_ERRORS, LEAST_CHANGE = 9, 6.0, 0.01
# A mode that is visible for fewer periods is not used.
FEWEST_PERIODS = 10.0
# Largest fractions of a mode that its shape, and all modes together, may leave unexplained; the second counts
# only above this multiple of the noise.
MOST_OUT_OF_SHAPE, MOST_UNEXPLAINED, UNEXPLAINED_NOISE = 0.25, 0.3, 5.0
# Multiple of its white noise above which the residual of all modes at a sensor is reported.
LARGE_RESIDUAL = 1.5
# The end of a decay, where the amplitude is below this multiple of the noise of a kept sample, is left out if
# this number of periods remains: there, half-sines bias the frequency by more than its band.
LEAST_OVER_NOISE, PERIODS_KEPT = 15.0, 40.0


@dataclass(frozen=True, eq=False)
class SeparateMode:
    """Signal of a mode without the other modes.

    Attributes
    ----------
    first, every : int
        First kept sample of the ringing, and distance between two kept samples.
    signal : (kept,) array of float
        Signal at the reference sensor, where the mode is largest.
    reference : int
        Index of the reference sensor.
    shape : (sensor,) array of complex
        Amplitudes at the sensors over that at the reference sensor.
    residual, expected : float
        RMS residual of the shape at all sensors over the RMS of the mode, and its value due to noise alone.
    neighbours : int
        Number of modes fitted together with this one.
    """

    first: int
    every: int
    signal: Array
    reference: int
    shape: Complex
    residual: float
    expected: float
    neighbours: int


def one_mode(
    sensors: xr.Dataset, mode: int | None = None, *, band: tuple[float | None, float | None] | None = None
) -> xr.Dataset:
    """Return the record of one mode of a decay, from one or several sensors.

    Parameters
    ----------
    sensors : Dataset
        ``signal(sensor, time)``, as `read_sensors` returns it; or a record: ``angle(time)`` or
        ``(t, angle)``.
    mode : int, optional
        Number of the mode, from 1 by increasing frequency, as `modes` lists them.
    band : (float or None, float or None), Hz, optional
        Alternatively, the band in which the mode is the strongest.

    Returns
    -------
    Dataset
        Record in the form of `read_record`, at the sensor where the mode is largest: the measured quantity,
        and ``angle(time)``, which `free_decay`, `backbone`, `laws` and `identify` take. ``shape(sensor)`` and
        ``shape_imaginary(sensor)`` are the shape; attributes describe the steps.

    Raises
    ------
    UsageError
        There is no such mode, or none in the band.
    DecayError
        There are no decaying modes, or the mode is too short, or too close to another one.

    Notes
    -----
    The other modes are subtracted as decaying oscillations whose frequency and decay rate change slowly. The
    sensors are combined by least squares with their noises. A root-raised-cosine filter before decimation
    keeps white noise white: the noise of the record is that of the sensors, with a known colour.

    Examples
    --------
    The faster of two modes. Its damping ratio is 0.2/(2 pi 5) = 0.0064.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time = np.arange(0.0, 40.0, 0.01)
    >>> slow, fast = (np.exp(-0.2 * time) * np.cos(2.0 * np.pi * hertz * time) for hertz in (2.0, 5.0))
    >>> noise = np.random.default_rng(0).normal(0.0, 1e-3, time.size)
    >>> mode = st.one_mode((time, slow + 0.5 * fast + noise), mode=2)
    >>> st.backbone(st.free_decay(mode)).damping_ratio.mean().round(4).item()
    0.0064
    """
    sensors = as_sensors(sensors)
    source = str(sensors.attrs.get("source", "record"))
    ringing = find_ringing(sensors.signal.values, _interval(sensors))
    place = _place(ringing, mode, band, source)
    own = ringing.components[place]
    number = ringing.modes.index(own) + 1 if own in ringing.modes else 0
    _check_resolved(ringing, place, source)
    separate = separated(ringing, place)
    _check_one_shape(ringing, place, separate, source)
    return _as_record(sensors, ringing, place, separate, number)


def _interval(sensors: xr.Dataset) -> float:
    time = sensors.time.values
    return float((time[-1] - time[0]) / (time.size - 1))


def _place(
    ringing: Ringing, mode: int | None, band: tuple[float | None, float | None] | None, source: str
) -> int:
    """Return the index of a mode among the components."""
    if (mode is None) == (band is None):
        raise UsageError("Give the number of a mode, or a band in Hz.")
    modes = ringing.modes
    if not modes:
        raise DecayError(nothing_decays(ringing, source))
    frequencies = [central_frequency(component, ringing.interval) for component in modes]
    listed = ", ".join(f"{number}: {value:.4g} Hz" for number, value in enumerate(frequencies, 1))
    if mode is not None:
        if not 1 <= mode <= len(modes):
            count = "1 mode" if len(modes) == 1 else f"{len(modes)} modes"
            raise UsageError(f"{source}: --mode {mode} does not exist; the record has {count} ({listed}).")
        return ringing.components.index(modes[mode - 1])
    assert band is not None
    low, high = 0.0 if band[0] is None else band[0], np.inf if band[1] is None else band[1]
    if not 0.0 <= low < high:
        raise UsageError(f"--band {low:g}:{high:g} must be LOW:HIGH in Hz, the lower one first.")
    inside = [component for component, value in zip(modes, frequencies, strict=True) if low <= value <= high]
    if not inside:
        raise UsageError(f"{source}: no mode is in --band {low:g}:{high:g} Hz; the record has {listed}.")
    strongest = max(
        inside,
        key=lambda component: float(np.max(np.abs(component.envelope_at(np.zeros(1)))) + component.level[0]),
    )
    return ringing.components.index(strongest)


def nothing_decays(ringing: Ringing, source: str) -> str:
    """Return the message for signals in which no mode decays."""
    lines = ", ".join(
        f"{central_frequency(one_line, ringing.interval):.4g}" for one_line in ringing.of_kind("line")
    )
    if lines:
        return (
            f"{source}: the oscillation at {lines} Hz keeps its amplitude to the end: it is driven, "
            "or the record is too short for its damping, or two modes beat more slowly; record longer."
        )
    return f"{source}: no mode rings and decays in it; check columns and window."


def _check_resolved(ringing: Ringing, place: int, source: str) -> None:
    """Raise an error for a mode of a few periods, and for two modes that the record does not separate."""
    interval = ringing.interval
    own = ringing.components[place]
    frequency, duration = central_frequency(own, interval), own.stop * interval
    if duration * frequency < FEWEST_PERIODS:
        raise DecayError(
            f"{source}: the mode of {frequency:.4g} Hz exceeds the noise for "
            f"{duration * frequency:.2g} periods, fewer than {FEWEST_PERIODS:g}; strike harder, or where it "
            "moves more."
        )
    for other in unresolved(own, ringing):
        both = min(other.stop, own.stop) * interval
        raise DecayError(
            f"{source}: near {frequency:.5g} Hz a second oscillation fits at "
            f"{central_frequency(other, interval):.5g} Hz, and in the {both:.3g} s that they ring they beat "
            f"fewer than {FEWEST_BEATS:g} times: the record does not separate them; record longer, or "
            "strike, or measure, where one of them does not move."
        )


def _check_one_shape(ringing: Ringing, place: int, separate: SeparateMode, source: str) -> None:
    """Raise an error if the signal is not a single mode: sensors deviate from a shape, or the fit is poor."""
    own, reference = ringing.components[place], separate.reference
    size = float(np.sqrt(np.mean(own.signal(slice(reference, reference + 1)) ** 2)))
    unexplained = float(ringing.residual[reference]) / max(size, 1e-300)
    above = float(ringing.residual[reference]) > UNEXPLAINED_NOISE * float(ringing.noise[reference])
    if separate.residual > MOST_OUT_OF_SHAPE or (above and unexplained > MOST_UNEXPLAINED):
        raise DecayError(
            f"{source}: its free ringing of {ringing.duration:.3g} s does not separate the modes near "
            f"{central_frequency(own, ringing.interval):.4g} Hz; record longer, or strike, or measure, where "
            "one of them does not move."
        )


def separated(ringing: Ringing, place: int) -> SeparateMode:
    """Separate a component of a ringing from the others.

    Parameters
    ----------
    ringing : Ringing
    place : int
        Index of the component.
    """
    own, interval = ringing.components[place], ringing.interval
    frequency = central_frequency(own, interval)
    rest, neighbours = ringing.signals.copy(), dict[float, Component]()
    for other, kind in zip(ringing.components, ringing.kinds, strict=True):
        ratio = central_frequency(other, interval) / frequency
        if other is own or (kind == "harmonic" and is_multiple(ratio)):
            continue
        if 1.0 / NEIGHBOURING_MODES < ratio < NEIGHBOURING_MODES and kind != "weak":
            neighbours[abs(np.log(ratio))] = other
        else:
            rest -= other.signal()
    every = max(1, int(1.0 / (KEPT_A_PERIOD * frequency * interval)))
    rest, first = decimated(rest, every, frequency * interval)
    near = [
        kept_part
        for component in (own, *(neighbours[distance] for distance in sorted(neighbours)))
        if (kept_part := _resampled(component, first, every, rest.shape[1])) is not None
    ]
    noise = ringing.noise / np.sqrt(every)
    if len(near) > 1:
        intervals = MANY_INTERVALS if _have_own_shapes(near, noise) else FEW_INTERVALS
        near = with_smooth_rates(rest, near, interval * every, noise, intervals)
        for other in near[1:]:
            rest = rest - other.signal()
    return _combined(rest, near, noise, first, every)


def _combined(rest: Array, near: Sequence[Component], noise: Array, first: int, every: int) -> SeparateMode:
    """Combine sensors by the shape of a mode, the first in the list, by least squares with their noises."""
    own = near[0]
    points = np.linspace(0.0, own.stop - 1.0, 200)
    shape = component_shape(own, noise)
    reference = int(np.argmax(np.abs(shape)))
    # The part a quarter of a period behind is not used in the combination.
    real = shape.real
    weights = _weights(real, [component_shape(other, noise).real for other in near[1:]], noise)
    combined = weights @ rest
    of_combined = float(np.sqrt(np.sum((weights * noise) ** 2)))
    level = np.interp(points, np.arange(own.phase.size), own.level)
    size_of_own = np.abs(own.envelope_at(points)[:, reference]) * np.exp(level)
    stop = _above_noise(own, points, size_of_own / of_combined, combined.size)
    rest, combined = rest[:, :stop], combined[:stop]
    residual = rest - real[:, None] * combined
    size = float(np.sqrt(np.mean((real[:, None] * combined) ** 2)))
    of_noise = (np.eye(len(noise)) - np.outer(real, weights)) * noise
    expected = float(np.sqrt(np.mean(np.sum(of_noise**2, axis=1)))) / size
    return SeparateMode(
        first=first,
        every=every,
        signal=combined,
        reference=reference,
        shape=shape,
        residual=float(np.sqrt(np.mean(residual**2))) / size,
        expected=expected,
        neighbours=len(near) - 1,
    )


def _have_own_shapes(near: Sequence[Component], noise: Array) -> bool:
    """Return true if the sensors separate the first mode from all others by its shape."""
    own, *others = (component_shape(component, noise).real for component in near)
    return _cancelled(own, others, noise) == len(others)


def _weights(own: Array, others: Sequence[Array], noise: Array) -> Array:
    """Return the weights of sensors that keep a shape and cancel other ones, (sensor,).

    An error in the subtraction of a neighbouring mode then has no effect. Shapes are cancelled in order, as
    far as the noise allows it.
    """
    return cancelling_weights(own, others[: _cancelled(own, others, noise)], noise)


def _cancelled(own: Array, others: Sequence[Array], noise: Array) -> int:
    """Return the number of first shapes that the sensors can cancel."""
    count = 0
    while count < len(others) and noise_of_cancelling(own, others[: count + 1], noise) < MOST_CANCELLING:
        count += 1
    return count


def _above_noise(own: Component, points: Array, ratio: Array, count: int) -> int:
    """Return the number of samples in which a mode is well above the noise."""
    above = np.flatnonzero(ratio > LEAST_OVER_NOISE)
    if above.size == 0 or above[-1] == points.size - 1:
        return count
    stop = int(points[above[-1]])
    periods = abs(own.phase[stop] - own.phase[0]) / (2.0 * np.pi)
    return stop if periods > PERIODS_KEPT else count


def _resampled(component: Component, first: int, every: int, count: int) -> Component | None:
    """Resample a component at the kept samples; None if it ends before them."""
    stop = min(count, (component.stop - 1 - first) // every + 1)
    if stop < 2:
        return None
    spacing = component.spacing / every
    kept = replace(component, stop=stop, spacing=spacing)
    samples = np.linspace(0.0, stop - 1.0, 4 * kept.splines)
    table = np.zeros((samples.size, kept.splines))
    starts, values = kept.splines_at(samples)
    for k, row in enumerate(values):
        table[np.arange(samples.size), starts + k] = row
    envelope = np.linalg.lstsq(
        table.astype(complex), component.envelope_at(first + every * samples), rcond=1e-9
    )[0]
    return replace(
        kept,
        phase=component.phase[first::every][:count],
        level=component.level[first::every][:count],
        envelope=np.asarray(envelope, dtype=np.complex128),
        error=np.zeros(kept.splines),
    )


def decimated(signals: Array, every: int, line: float) -> tuple[Array, int]:
    """Filter and decimate signals so that white noise stays white; also return the first sample's index.

    It is a root-raised-cosine filter of zero phase: it reduces the noise below half of the new sampling rate
    by the amount that is folded back from above. Samples at both ends that the filter covers only in part are
    left out.

    Parameters
    ----------
    signals : (sensor, sample) array of float
    every : int
    line : float
        Frequency of the mode in cycles per sample; its amplitude is unchanged.
    """
    if every == 1:
        return signals, 0
    at = np.arange(-HALF_LENGTH * every, HALF_LENGTH * every + 1)
    taps = root_raised_cosine(at / every)
    taps /= taps @ np.cos(2.0 * np.pi * line * at)
    filtered = fftconvolve(signals, taps[None], "valid", axes=1)
    return filtered[:, ::every], HALF_LENGTH * every


def root_raised_cosine(time: Array) -> Array:
    """Return the impulse response of the filter at times in units of the kept samples."""
    b = ROLL_OFF
    with np.errstate(divide="ignore", invalid="ignore"):
        top = np.sin(np.pi * time * (1.0 - b)) + 4.0 * b * time * np.cos(np.pi * time * (1.0 + b))
        values = top / (np.pi * time * (1.0 - (4.0 * b * time) ** 2))
    values[time == 0.0] = 1.0 - b + 4.0 * b / np.pi
    quarter = np.pi / (4.0 * b)
    at_pole = np.isclose(np.abs(time), 1.0 / (4.0 * b))
    values[at_pole] = (
        b / np.sqrt(2.0) * ((1.0 + 2.0 / np.pi) * np.sin(quarter) + (1.0 - 2.0 / np.pi) * np.cos(quarter))
    )
    return values


def _as_record(
    sensors: xr.Dataset, ringing: Ringing, place: int, separate: SeparateMode, number: int
) -> xr.Dataset:
    """Return the record of a mode, with a description of the steps."""
    own, names = ringing.components[place], [str(name) for name in sensors.sensor.values]
    quantity, units = str(sensors.attrs["quantity"]), str(sensors.signal.attrs["units"])
    step = ringing.interval * separate.every
    time = sensors.time.values[0] + (ringing.part.start + separate.first) * ringing.interval
    time = time + step * np.arange(separate.signal.size)
    frequency = central_frequency(own, ringing.interval)
    position = str(sensors.attrs["position"])
    attrs: dict[str, Any] = {
        name: sensors.attrs[name]
        for name in ("source", "record_checksum", "angle_unit_in_file", "time_column", "columns_in_file")
        if name in sensors.attrs
    }
    attrs |= {
        "signal": quantity,
        "angle_column": names[separate.reference],
        "clock": f"{1.0 / step:.6g} Hz",
        "mode": number,
        "mode_frequency": frequency,
        "sensors": ", ".join(names),
        "separation": "; ".join(_sentences(sensors, ringing, place, separate)),
        "reading": str(sensors.attrs.get("reading", "")),
    }
    record = xr.Dataset(coords={"time": ("time", time, {"units": "s", "long_name": "time"})}, attrs=attrs)
    values = separate.signal
    times = int(sensors.attrs["integrations"])
    if times:
        made = {
            "measured": quantity,
            "integrations": times,
            f"{quantity}_bias": 0.0,
            NOISE_IS_WHITE_IN: "measured",
        }
        how_often = "once" if times == 1 else "twice"
        said = f"integrated {how_often}, without drift and without a period at both ends"
        record.attrs |= made | {"integration": said}
        record[quantity] = ("time", values, {"units": units, "long_name": f"{quantity} of the mode"})
        values = as_position(time, values, 1.0 / frequency, made)
    name = "angle" if position == "rad" else "displacement"
    record["angle"] = ("time", values, {"units": position, "long_name": f"{name} of the mode"})
    for part, of_shape, word in (
        ("shape", separate.shape.real, "in phase"),
        ("shape_imaginary", separate.shape.imag, "a quarter of a period ahead"),
    ):
        text = f"shape of the mode, {word}"
        record[part] = xr.DataArray(
            of_shape, {"sensor": names}, "sensor", attrs={"units": "1", "long_name": text}
        )
    return record


def _sentences(sensors: xr.Dataset, ringing: Ringing, place: int, separate: SeparateMode) -> list[str]:
    """Describe the steps of a separation, and its residual."""
    names = [str(name) for name in sensors.sensor.values]
    own, interval = ringing.components[place], ringing.interval
    others = sum(kind in ("mode", "line") for kind in ringing.kinds) - (
        ringing.kinds[place] in ("mode", "line")
    )
    said = other_blows(ringing.part, sensors.time.values)
    if others:
        said.append(f"{others} other mode{'s' * (others > 1)} subtracted as decaying oscillations")
    if separate.neighbours:
        said[-1] += f", {separate.neighbours} of them fitted together with it"
    if ringing.drifts.any():
        drifting = [name for name, drifts in zip(names, ringing.drifts.tolist(), strict=True) if drifts]
        said.append(f"a slow drift of {' and '.join(drifting)} subtracted")
    said += _close_modes(ringing, place)
    if (rise := rise_of(history_of(own, ringing))) is not None:
        units = str(sensors.signal.attrs["units"])
        said.append(f"its amplitude {rise.said(units)}: {RISE_MEANS}; the curves are not those of one mode")
    if separate.every > 1:
        a_period = 1.0 / (central_frequency(own, interval) * interval * separate.every)
        left_out = 1e3 * separate.first * interval
        said.append(
            f"1 of {separate.every} samples kept, {a_period:.3g} a period, after a filter of zero phase, "
            f"without {left_out:.3g} ms at both ends"
        )
    after = own.stop * interval - (separate.first + separate.signal.size * separate.every) * interval
    if after > 2.0 * separate.first * interval + 1e-9:
        said.append(
            f"the last {after:.3g} s left out, in which it is less than {LEAST_OVER_NOISE:g} times the noise"
        )
    said.append(
        f"free from {1e3 * (ringing.part.start - ringing.part.onset) * interval:.2g} ms after the blow on"
    )
    if len(names) > 1:
        shape = ", ".join(
            f"{name} {value:.3f}" for name, value in zip(names, separate.shape.real, strict=True)
        )
        said.append(
            f"{len(names)} sensors combined by the shape {shape}, residual "
            f"{100 * separate.residual:.2g} % ({100 * separate.expected:.2g} % from their noise alone)"
        )
        behind = float(np.max(np.abs(separate.shape.imag)))
        if behind > 0.05:
            said.append(f"sensors are out of phase by up to {100 * behind:.2g} % of the amplitude")
        said += _change_of_shape(ringing, place, separate, names)
    large = [
        f"{name} {ratio:.2g}"
        for name, ratio in zip(names, ringing.residual / ringing.noise, strict=True)
        if ratio > LARGE_RESIDUAL
    ]
    if large:
        said.append(
            f"the residual of all modes exceeds the white noise of the sensors (times {', '.join(large)})"
        )
    return said


def _close_modes(ringing: Ringing, place: int) -> list[str]:
    """Warn about modes that are too close to this one, in frequency and in shape."""
    own = ringing.components[place]
    frequency = central_frequency(own, ringing.interval)
    said = []
    for other in ringing.modes:
        reason = "" if other is own else too_close(own, other, ringing)
        if reason:
            second = central_frequency(other, ringing.interval)
            said.append(
                f"the mode of {second:.4g} Hz differs by {100 * abs(second / frequency - 1.0):.2g} % in "
                f"frequency; {reason}: curves can be wrong by more than their bands; strike, or measure, "
                "where one of them does not move"
            )
    return said


def _change_of_shape(ringing: Ringing, place: int, separate: SeparateMode, names: Sequence[str]) -> list[str]:
    """Describe a change of the shape along the decay that exceeds its errors."""
    own = ringing.components[place]
    times = np.linspace(0.0, own.stop - 1.0, SHAPE_TIMES + 2)[1:-1]
    envelope = own.envelope_at(times)
    reference = separate.reference
    shape = (envelope / envelope[:, [reference]]).real
    error = own.error_at(times)[:, None] * np.hypot(ringing.noise, np.abs(shape) * ringing.noise[reference])
    error = error / np.abs(envelope[:, [reference]])
    middle = np.sum(shape / error**2, axis=0) / np.sum(error**-2.0, axis=0)
    off = np.abs(shape - middle)
    changed = (off > SHAPE_ERRORS * error) & (off > LEAST_CHANGE)
    if not changed.any():
        return []
    sensor = int(np.argmax(np.max(np.where(changed, off, 0.0), axis=0)))
    known = np.flatnonzero(error[:, sensor] < 0.2 * off[:, sensor].max())
    low, high = known[0], known[-1]
    return [
        f"the shape changes with the amplitude: {names[sensor]} from {shape[low, sensor]:.3f} to "
        f"{shape[high, sensor]:.3f} of {names[reference]}, as of a joint, or of two modes closer than the "
        "record resolves"
    ]
