"""The modes in a decay: frequency, damping, amplitudes at the sensors, and influences between modes."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
import xarray as xr
from scipy.interpolate import BSpline

from sysid_trib.arrays import Array, Variables, variable
from sysid_trib.errors import DecayError
from sysid_trib.records.mode_history import (
    FEWEST_POINTS,
    POINTS_A_SPLINE,
    RISE_MEANS,
    History,
    history_of,
    rise_of,
)
from sysid_trib.records.mode_search import (
    Ringing,
    amplitude_at,
    central_frequency,
    find_ringing,
    other_blows,
    too_close,
    unresolved,
)
from sysid_trib.records.one_mode import nothing_decays
from sysid_trib.records.ringing import Component
from sysid_trib.records.sensors import as_sensors

# Rates at small amplitude are those of the last fall by this power of e, in which they are linear in the
# amplitude.
LAST_FALL = 3.0
# Powers of a mode's amplitude in its frequency, and alternative laws of its own amplitude that the influence
# of another mode has to beat: powers, and a spline of the log amplitude with this number of intervals.
OWN_POWERS = (0, 1, 2, 3)
OTHER_POWERS = (0.5, 4)
OWN_INTERVALS = 4
OWN_DEGREE = 3
# An influence counts if it lowers chi-square by at least this much, to at most this fraction, and to at most
# this much per point of the history. Noise alone gives a smaller chi-square per point; a law of the mode's
# own amplitude without these powers leaves a larger one.
LEAST_LOWERED = 10.0
LARGEST_PART = 0.4
LARGEST_A_POINT = 0.1


def modes(sensors: xr.Dataset) -> xr.Dataset:
    """List the modes in a decay.

    Parameters
    ----------
    sensors : Dataset
        ``signal(sensor, time)`` from `read_sensors`, or a record: ``angle(time)`` or ``(t, angle)``.

    Returns
    -------
    Dataset
        Over ``mode`` (1, 2, ... by increasing frequency): ``frequency`` (Hz) and ``damping_ratio``, both at
        small amplitude; ``first_amplitude(mode, sensor)`` and ``last_amplitude(mode, sensor)`` in the unit of
        the signals, ``duration`` (s) for which the mode exceeds the noise; ``noise(sensor)``, the standard
        deviation of a sample, and ``residual(sensor)``, the RMS that the modes leave. Attributes: `lines`
        (steady, Hz), `harmonics`, and sentences: `close_modes` on modes that the sensors do not separate
        reliably, `influences` on modes that act on each other.

    Raises
    ------
    DecayError
        The sensors show no free ringing.

    Examples
    --------
    Two modes that ring at 2 Hz and 5 Hz.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time = np.arange(0.0, 40.0, 0.01)
    >>> slow, fast = (np.exp(-0.2 * time) * np.cos(2.0 * np.pi * hertz * time) for hertz in (2.0, 5.0))
    >>> noise = np.random.default_rng(0).normal(0.0, 1e-3, time.size)
    >>> st.modes((time, slow + 0.5 * fast + noise)).frequency.round(2).values.tolist()
    [2.0, 5.0]
    """
    sensors = as_sensors(sensors)
    ringing = find_ringing(sensors.signal.values, float(np.mean(np.diff(sensors.time.values))))
    if not ringing.modes:
        source = sensors.attrs.get("source", "record")
        raise DecayError(nothing_decays(ringing, str(source)))
    units = str(sensors.signal.attrs["units"])
    names = [str(name) for name in sensors.sensor.values]
    histories = [history_of(component, ringing) for component in ringing.modes]
    limits = [_at_small_amplitude(history) for history in histories]
    ends = [amplitude_at(component, np.array([0.0, component.stop - 1.0])) for component in ringing.modes]
    data: Variables = {
        "frequency": variable(
            "mode", [w / (2.0 * np.pi) for w, _ in limits], "frequency at small amplitude", "Hz"
        ),
        "damping_ratio": variable("mode", [z for _, z in limits], "damping ratio at small amplitude", "1"),
        "duration": variable(
            "mode", [component.stop * ringing.interval for component in ringing.modes], "seen for", "s"
        ),
        "first_amplitude": variable(("mode", "sensor"), [end[0] for end in ends], "first amplitude", units),
        "last_amplitude": variable(("mode", "sensor"), [end[1] for end in ends], "last amplitude", units),
        "noise": variable("sensor", ringing.noise, "standard deviation of the white noise", units),
        "residual": variable("sensor", ringing.residual, "RMS residual of all modes", units),
    }
    start = float(sensors.time.values[0] + ringing.part.start * ringing.interval)
    attrs = dict(sensors.attrs) | {
        "start": start,
        "lines": _listed(ringing, "line"),
        "harmonics": _listed(ringing, "harmonic"),
        "close_modes": list(_close_modes(ringing)),
        "influences": list(_influences(histories, ringing.modes, units)),
        "second_blow": "; ".join(other_blows(ringing.part, sensors.time.values)),
    }
    return xr.Dataset(data, {"mode": np.arange(1, len(histories) + 1), "sensor": names}, attrs)


def _listed(ringing: Ringing, kind: str) -> str:
    """List the frequencies (Hz) of the components of a kind."""
    values = (central_frequency(component, ringing.interval) for component in ringing.of_kind(kind))
    return ", ".join(f"{value:.4g}" for value in values)


def _close_modes(ringing: Ringing) -> Iterator[str]:
    """Warn about neighbouring modes that the record, or its sensors, do not separate reliably."""
    for number, own in enumerate(ringing.modes, 1):
        for other in unresolved(own, ringing):
            frequency = central_frequency(other, ringing.interval)
            yield (
                f"{ringing.duration:.3g} s of free ringing do not separate mode {number} from what rings at "
                f"{frequency:.5g} Hz, so that its row is not reliable: record longer, or strike, or measure, "
                "where one of them does not move"
            )
    for number, (low, high) in enumerate(pairwise(ringing.modes), 1):
        if reason := too_close(low, high, ringing):
            ratio = central_frequency(high, ringing.interval) / central_frequency(low, ringing.interval)
            yield (
                f"the frequencies of modes {number} and {number + 1} differ by {100 * (ratio - 1.0):.2g} %: "
                f"{reason}; strike, or measure, where one of them does not move"
            )


def _at_small_amplitude(history: History) -> tuple[float, float]:
    """Return frequency (rad/s) and damping ratio at small amplitude, where both are linear in amplitude."""
    level = np.log(history.amplitude)
    low = level < level[-1] + LAST_FALL
    low[-POINTS_A_SPLINE * FEWEST_POINTS :] = True
    first = int(np.flatnonzero(~low)[-1]) + 1 if not low.all() else 0
    time, weight = history.time[first:], 1.0 / history.error[first:]
    columns = [np.ones_like(time), time - time[0], _integrated(time, history.amplitude[first:])]
    table = np.stack(columns, axis=1) * weight[:, None]
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0.0] = 1.0
    values = [
        np.linalg.lstsq(table / scale, part[first:] * weight, rcond=None)[0] / scale
        for part in (history.phase, level)
    ]
    frequency, rate = float(values[0][1]), -float(values[1][1])
    return frequency, rate / float(np.hypot(frequency, rate))


def _integrated(time: Array, values: Array) -> Array:
    """Integrate over time from the first point on, by trapezia."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _influences(histories: Sequence[History], modes: Sequence[Component], units: str) -> Iterator[str]:
    """Describe modes whose amplitude rises again, and frequencies that follow another mode."""
    for number, history in enumerate(histories, 1):
        if (rise := rise_of(history)) is not None:
            others = _fallen_most(histories, number, rise.time)
            yield f"the amplitude of mode {number} {rise.said(units)}{others}: {RISE_MEANS}"
        yield from _frequency_follows(histories, number)


def _fallen_most(histories: Sequence[History], number: int, at: float) -> str:
    """Name the mode that loses most energy until a time."""
    others = [other for other in range(1, len(histories) + 1) if other != number]
    if not others:
        return ""
    falls = []
    for other in others:
        history = histories[other - 1]
        before, then = np.interp([0.5 * at, at], history.time, history.amplitude**2)
        falls.append(float(before - then))
    return f", while mode {others[int(np.argmax(falls))]} falls"


def _frequency_follows(histories: Sequence[History], number: int) -> Iterator[str]:
    """Name the other mode whose amplitude changes the frequency of a mode, if there is one."""
    history = histories[number - 1]
    base = [_integrated(history.time, history.amplitude**power) for power in OWN_POWERS]
    base.append(np.ones_like(history.time))
    rivals = [[_integrated(history.time, history.amplitude**power)] for power in OTHER_POWERS]
    rivals.append(_splines_of_amplitude(history))
    beaten = min(_fit([*base, *columns], history)[1] for columns in ([], *rivals))
    fits = [
        (*_influence(base, history, of_other), other)
        for other, of_other in enumerate(histories, 1)
        if other != number
    ]
    if not fits:
        return
    least, change, other = min(fits)
    fits_to_noise = least < LARGEST_A_POINT * history.time.size
    if fits_to_noise and least < LARGEST_PART * beaten and beaten - least > LEAST_LOWERED:
        yield (
            f"the frequency of mode {number} depends on the amplitude of mode {other}, in addition to its "
            f"own: by {change:+.2g} Hz at the largest amplitude"
        )


def _splines_of_amplitude(history: History) -> list[Array]:
    """Return integrals over time of B-splines of the log amplitude."""
    level = np.log(history.amplitude)
    part = (level - level.min()) / max(float(np.ptp(level)), 1e-300)
    inner = np.linspace(0.0, 1.0, OWN_INTERVALS + 1)
    knots = np.concatenate([np.zeros(OWN_DEGREE), inner, np.ones(OWN_DEGREE)])
    splines = BSpline.design_matrix(np.clip(part, 0.0, 1.0), knots, OWN_DEGREE).toarray()
    return [_integrated(history.time, column) for column in splines.T]


def _influence(base: Sequence[Array], history: History, of_other: History) -> tuple[float, float]:
    """Return chi-square with the square of another mode's amplitude, and the largest change (Hz)."""
    squares = np.interp(history.time, of_other.time, of_other.amplitude**2, right=0.0)
    values, chi_square = _fit([*base, _integrated(history.time, squares)], history)
    return chi_square, float(values[-1] * squares.max() / (2.0 * np.pi))


def _fit(columns: Sequence[Array], history: History) -> tuple[Array, float]:
    """Fit columns to the phase of a mode; return their coefficients and chi-square."""
    weight = 1.0 / history.error
    table = np.stack(columns, axis=1) * weight[:, None]
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    values = np.linalg.lstsq(table / scale, history.phase * weight, rcond=1e-12)[0]
    residual = history.phase * weight - table / scale @ values
    return values / scale, float(residual @ residual)
