"""Units that a file does not state: what its numbers and names let one assume, with the evidence."""

import numpy as np
import xarray as xr
from scipy.special import ellipk

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, RecordError, UsageError
from sysid_trib.records.free_decay import free_decay
from sysid_trib.records.half_periods import dominant_periods
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.headers import names_quantity, split_header
from sysid_trib.records.numbers import is_clock_time, is_numeric, numbers
from sysid_trib.records.tables import FileTable
from sysid_trib.records.units import (
    OFFERED_TIME_UNITS,
    STANDARD_GRAVITY,
    TIME_UNITS,
    SignalUnit,
    plain_unit,
    signal_unit,
)

# Two columns lie on a circle about the origin if their radius scatters by less than this part of it,
ROUND = 0.02
# and its unit is one in which gravity comes out right, within this part.
GRAVITY_TOLERANCE = 0.05
SERIAL_DAYS = ((32874.0, 73051.0), (726834.0, 767011.0))
EPOCH_STAMPS = (("ms", 6.3e11, 4.1e12), ("us", 6.3e14, 4.1e15), ("ns", 6.3e17, 4.1e18))
# An accelerometer that rests shows gravity: near 1 in g, near 9.8 in m/s^2.
REST_IN_G = (0.5, 1.2)
# rad; from this amplitude on a pendulum's frequency shows whether it is one in rad: it rises as it decays, by
# more than this part of what it should.
FROM_AMPLITUDE, STEADY = 1.0, 0.25
_ARBITRARY = SignalUnit("au", "displacement", "au", 1.0)
# s; no laboratory has longer periods, or of whole stamps, which often are ms or us, or shorter ones.
LONGEST_PERIOD, LONGEST_OF_WHOLE, SHORTEST_PERIOD = 1000.0, 60.0, 5e-5


def time_factor(table: FileTable, name: str, given: str | None, source: str) -> tuple[str | None, float, str]:
    """Unit of a time column, its factor to s, and why where it was not stated; None if nothing tells it.

    Raises
    ------
    UsageError
        The option contradicts the header.
    RecordError
        The unit is unknown.
    """
    dated = is_clock_time(table.columns[name])
    base, in_header = split_header(name)
    stated = plain_unit(table.units.get(name, "")) or in_header
    stated = "" if stated in ("1", "none", "-") else stated
    if given and stated in TIME_UNITS and not dated and TIME_UNITS[stated] != TIME_UNITS[given]:
        raise UsageError(
            f"{source}: the header of column {name} says {stated}, but --time-units says {given} "
            "(time_units= in Python); leave the option out or correct the header."
        )
    if dated:
        return "s", 1.0, ""
    if given or stated:
        unit = given or stated
        if unit not in TIME_UNITS:
            raise RecordError(
                f"{source}: the unit {unit!r} of column {name} is unknown; give --time-units (time_units= in "
                f"Python): {OFFERED_TIME_UNITS}."
            )
        return unit, TIME_UNITS[unit], ""
    if base in ("millis", "micros"):
        return ("ms", 1e-3, "") if base == "millis" else ("us", 1e-6, "")
    return _by_steps(table, name, source)


def _by_steps(table: FileTable, name: str, source: str) -> tuple[str | None, float, str]:
    """The unit in which the steps of a time column are those that a column `dt (s)` states; else s.

    Stamps of these years that count from a known date tell their unit too.
    """
    stamps = numbers(table.columns[name], name, source)
    steps = np.diff(stamps[np.isfinite(stamps)])
    usual = float(np.median(steps)) if steps.size else 0.0
    for other in table.columns:
        base, unit = split_header(other)
        if base in ("dt", "delta t", "step") and unit in TIME_UNITS and is_numeric(table.columns[other]):
            stated = float(np.nanmedian(numbers(table.columns[other], other, source))) * TIME_UNITS[unit]
            for text in ("s", "ms", "us"):
                if np.isclose(usual * TIME_UNITS[text], stated, rtol=0.01):
                    return text, TIME_UNITS[text], f"time in {text}, by its steps in column {other}"
    middle = float(np.nanmedian(stamps)) if steps.size else 0.0
    for text, low, high in EPOCH_STAMPS:
        if low < middle < high:
            return text, TIME_UNITS[text], f"time in {text}: it counts from 1970"
    for low, high in SERIAL_DAYS:
        # Stamps that count from 1970, in the years 1990 to 2100.
        # MATLAB's days from the year 0 and spreadsheets' from 1900 are of the same years.
        if 0.0 < usual < 1e-2 and low < np.nanmin(stamps) and np.nanmax(stamps) < high:
            return "d", TIME_UNITS["d"], "time in days: it counts them as a calendar does"
    whole = "unit of time not stated: taken as s, though its stamps are whole"
    return None, 1.0, whole if are_whole(stamps) else ""


def are_whole(stamps: Array) -> bool:
    """True if stamps are whole numbers, one or more apart."""
    stamps = stamps[np.isfinite(stamps)]
    return bool(stamps.size > 1 and np.all(stamps == np.round(stamps)) and np.median(np.diff(stamps)) >= 1.0)


def check_period(time: Array, values: Array, whole: bool, source: str) -> None:
    """Ask for the unit of times that nothing states, where in seconds no laboratory has such a period.

    Parameters
    ----------
    time, values : (sample,) array of float
        The signal; times as they stand.
    whole : bool
        Whether the stamps are whole numbers.
    source : str
        Of whom the question speaks.

    Raises
    ------
    RecordError
        With the period, and what to give.
    """
    good = np.isfinite(values)
    periods = dominant_periods(time[good], values[good]) if np.count_nonzero(good) > 1 else []
    longest = LONGEST_OF_WHOLE if whole else LONGEST_PERIOD
    if periods and not SHORTEST_PERIOD < periods[0] < longest:
        raise RecordError(
            f"{source}: nothing states the unit of its times: the period would be {periods[0]:.3g} s in s, "
            f"{1e-3 * periods[0]:.3g} s in ms, {1e-6 * periods[0]:.3g} s in us; give it, --time-units "
            f"{OFFERED_TIME_UNITS} (time_units= in Python), or the sampling rate, --sampling-rate HZ."
        )


def circle_radius(table: FileTable, name: str) -> float | None:
    """Radius of the circle about the origin on which a column and another one lie; None if they do not."""
    values = np.asarray(table.columns[name])
    if values.dtype.kind not in "fiu":
        return None
    for other, column in table.columns.items():
        second = np.asarray(column)
        if other == name or second.dtype.kind not in "fiu" or second.size != values.size:
            continue
        radius = np.hypot(values.astype(float), second.astype(float))
        middle = float(np.nanmean(radius))
        moves = min(np.nanstd(values), np.nanstd(second)) > ROUND / 10.0 * middle
        if middle > 0.0 and moves and np.nanstd(radius) < ROUND / 10.0 * middle:
            return middle
    return None


def assumed_unit(
    base: str, time: Array, values: Array, radius: float | None, signal: str | None
) -> tuple[SignalUnit, str]:
    """Unit of a signal that nothing states, and the evidence for it.

    Parameters
    ----------
    base : str
        Name of the column.
    time, values : (sample,) array of float, s and the column's unit
    radius : float, optional
        Of the circle on which it moves.
    signal : str, optional
        The quantity, if it is given.

    Notes
    -----
    A bob on a circle of radius L about its pivot swings at w^2 = g/L: the unit of L is that in which g is
    9.81 m/s^2. No pendulum swings farther than pi: a larger angle is in degrees.
    """
    quantity = signal or names_quantity(base)
    half = 0.5 * float(np.ptp(np.percentile(values, [0.1, 99.9])))
    if radius is not None and quantity in ("", "displacement"):
        return _on_circle(time, values, radius)
    if quantity in ("", "angle"):
        # deg; what is not named as an angle and swings farther is none.
        if not quantity and half > 180.0:
            return _ARBITRARY, "unit not stated: coefficients are in its unit, au"
        if half > np.pi:
            return _unit(
                "deg"
            ), f"unit not stated: in degrees, since an angle does not swing to {half:.3g} rad"
        if half > FROM_AMPLITUDE and (moves := _frequency_shift(time, values)) is not None:
            seen, of_pendulum = moves
            if abs(seen) < STEADY * of_pendulum:
                return _unit("deg"), (
                    f"unit not stated: in degrees, since the frequency of a pendulum that swings to "
                    f"{half:.3g} rad would rise by {100.0 * of_pendulum:.2g} % as it decays, and this one "
                    f"moves by {100.0 * seen:.2g} % (--units rad if it is no pendulum)"
                )
        return _unit("rad"), "unit not stated: taken as rad"
    if quantity == "displacement":
        return _ARBITRARY, "unit not stated: coefficients are in its unit, au"
    if quantity == "rate":
        periods = dominant_periods(time, values)
        far = half * (periods[0] if periods else 1.0) / (2.0 * np.pi)
        text = "deg/s" if far > np.pi else "rad/s"
        return _unit(text), f"unit not stated: taken as {text}, which makes the swing {_swing(far, text)}"
    rest = float(np.median(values))
    in_g = REST_IN_G[0] < abs(rest) < REST_IN_G[1]
    reason = f", since it swings about {rest:.3g}, as gravity would" if in_g else ""
    return _unit("g" if in_g else "m/s^2"), f"unit not stated: taken as {'g' if in_g else 'm/s^2'}{reason}"


def _frequency_shift(time: Array, values: Array) -> tuple[float, float] | None:
    """Rise of the frequency over a decay, as a part of it, and that of a pendulum in rad.

    None where there is no decay.
    """
    try:
        curve = envelope(free_decay(xr.Dataset({"angle": ("time", values)}, {"time": time})))
    except DecayError:
        return None
    count = max(1, curve.sizes["instant"] // 4)
    pendulum = 0.5 * np.pi / ellipk(np.sin(0.5 * np.minimum(curve.amplitude.values, 3.1)) ** 2)
    first, last = (
        [float(np.median(part[ends])) for part in (curve.frequency.values, pendulum)]
        for ends in (slice(None, count), slice(-count, None))
    )
    return last[0] / first[0] - 1.0, last[1] / first[1] - 1.0


def _on_circle(time: Array, values: Array, radius: float) -> tuple[SignalUnit, str]:
    periods = dominant_periods(time, values)
    gravity = radius * (2.0 * np.pi / periods[0]) ** 2 if periods else 0.0
    for text, metres in (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)):
        if abs(gravity * metres / STANDARD_GRAVITY - 1.0) < GRAVITY_TOLERANCE:
            return _unit(text), (
                f"unit not stated: in {text}, since it moves on a circle of radius {radius:.4g} and swings "
                f"as a pendulum of {radius:.4g} {text} does (its angle: --angle 'atan2(...)')"
            )
    return _ARBITRARY, (
        f"unit not stated: coefficients are in its unit, au; it moves on a circle of radius {radius:.4g}"
    )


def _swing(far: float, text: str) -> str:
    return f"{far:.3g} {text.removesuffix('/s')}"


def _unit(text: str) -> SignalUnit:
    unit = signal_unit(text)
    if unit is None:
        raise RecordError(f"The unit {text!r} is unknown.")
    return unit
