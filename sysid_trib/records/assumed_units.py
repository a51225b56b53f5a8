"""Units of times and signals: as stated by the user or the file, else assumed from numbers and names."""

from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.special import ellipk

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, RecordError, UsageError
from sysid_trib.records import half_periods, half_sines, reading, tables, units as lab
from sysid_trib.records.clock import are_whole
from sysid_trib.records.column import Column
from sysid_trib.records.free_decay import free_decay
from sysid_trib.records.unit_tables import STANDARD_GRAVITY


def time_factor(table: tables.FileTable, time: Column, given: str | None) -> tuple[str | None, float, str]:
    """Return a time column's unit, factor to s, and the reason if assumed; None if nothing states it.

    Raises
    ------
    UsageError
        The option contradicts the header.
    RecordError
        The unit is unknown.
    """
    if time.is_dated:
        return "s", 1.0, ""
    stated = lab.plain_unit(time.stated)
    stated = "" if stated in ("1", "none", "-") else stated
    if given and lab.TIME_UNITS.get(stated, lab.TIME_UNITS[given]) != lab.TIME_UNITS[given]:
        raise _contradicted(time, stated, "time-units", given)
    unit = given or stated or {"millis": "ms", "micros": "us"}.get(time.base)
    unit = unit or lab.noted_time_unit(table.notes) or None
    if unit and unit not in lab.TIME_UNITS:
        wrong = f"{time.source}: the unit {unit!r} of column {time.name} is unknown"
        raise RecordError(f"{wrong}; give --time-units (time_units= in Python): {lab.OFFERED_TIME_UNITS}.")
    if unit is None:
        unit, why = _by_steps(table, time)
        return unit, lab.TIME_UNITS[unit or "s"], why
    return unit, lab.TIME_UNITS[unit], ""


def _contradicted(column: Column, stated: str, option: str, given: object, known: str = "") -> UsageError:
    """Return the error that an option contradicts the header of the file."""
    return UsageError(
        f"{column.source}: the header of column {column.name} says {stated}, but --{option} says {given} "
        f"({option.replace('-', '_')}= in Python){known}; leave the option out or correct the header."
    )


def _by_steps(table: tables.FileTable, time: Column) -> tuple[str | None, str]:
    """Return the time unit that agrees with the steps in a column `dt (s)`, and the reason; else None.

    Stamps of these years that count from a known date show their unit too.
    """
    stamps = time.numbers[np.isfinite(time.numbers)]
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if steps.size else 0.0
    for other in table.columns:
        unit = lab.plain_unit(other.stated)
        if other.base in ("dt", "delta t", "step") and unit in lab.TIME_UNITS and other.is_numeric:
            stated = float(np.nanmedian(other.numbers)) * lab.TIME_UNITS[unit]
            for text in ("s", "ms", "us"):
                if np.isclose(usual * lab.TIME_UNITS[text], stated, rtol=0.01):
                    return text, f"time in {text}, by its steps in column {other.name}"
    middle = float(np.median(stamps)) if steps.size else 0.0
    for text, low, high in (("ms", 6.3e11, 4.1e12), ("us", 6.3e14, 4.1e15), ("ns", 6.3e17, 4.1e18)):
        if low < middle < high:
            return text, f"time in {text}: it counts from 1970"
    # Ranges of day numbers: days from 1900 as in spreadsheets, and from the year 0 as in MATLAB.
    for low, high in ((32874.0, 73051.0), (726834.0, 767011.0)):
        # The years 1990 to 2100.
        if 0.0 < usual < 1e-2 and low < stamps.min() and stamps.max() < high:
            return "d", "time in days: its numbers are dates, as of Excel or MATLAB"
    return None, "unit of time not stated: taken as s, though its stamps are whole" * are_whole(stamps)


def unit_of(
    table: tables.FileTable, column: Column, how: reading.Reading, time: Array, values: Array
) -> tuple[lab.SignalUnit, str]:
    """Return the unit of a signal without bad samples, and the reason if it is not stated.

    Raises
    ------
    UsageError
        The header states another unit, or another quantity, than the user.
    RecordError
        No oscillation has such an amplitude in this unit.
    """
    signals = [c for c in table.columns if c not in table.times]
    place = signals.index(column) if column in signals else None
    stated = column.unit or lab.signal_unit(lab.noted_unit(table.notes, place, len(signals)))
    given = lab.signal_unit(how.units or "")
    if given and how.signal and given.quantity in lab.POSITIONS:
        # For a rate, "deg" means deg/s.
        given = replace(given, quantity=how.signal)
    if given and stated and stated.known and not _agree(stated, given):
        known = "" if given.known else f", which is unknown (known are {lab.OFFERED_UNITS})"
        raise _contradicted(column, stated.text, "units", how.units, known)
    if given and not given.known and given.quantity == "angle":
        # With an unknown unit of an angle, no coefficient would have the correct size.
        wrong = f"{table.source}: --units '{how.units}' is not a known unit of an angle"
        raise UsageError(f"{wrong}; give {lab.OFFERED_ANGLES}.")
    unit = given or stated
    why = ""
    if unit is None:
        meant = how.quantity or lab.names_quantity(column.base) or how.usual
        # A column without a name, or named by its axis alone, may be an accelerometer.
        nameless = how.quantity is None and lab.names_quantity(column.base) in ("", "displacement")
        felt = _gravity_on_axes(table, column, signals, values) if nameless else ""
        if not felt and meant in (None, ""):
            _ask_at_gravity(column, values)
        meant = "acceleration" if felt else meant
        unit, why = _assumed_unit(table, column, time, values, meant, how.gravity)
        why = felt or why
    if how.quantity not in (None, unit.quantity):
        if unit.quantity in lab.POSITIONS and (times := lab.INTEGRATIONS[how.quantity]):
            unit = replace(unit, text=f"{unit.text}{'/s' if times == 1 else '/s^2'}", quantity=how.quantity)
        elif stated is not None and stated.known:
            article = "an" if stated.quantity[0] == "a" else "a"
            raise _contradicted(column, f"{stated.text}, {article} {stated.quantity}", "signal", how.signal)
    if not unit.known:
        known = f"unknown (known are {lab.OFFERED_UNITS})"
        why = f"unit {unit.text} is {known}: coefficients are in this unit"
    # More than two whole turns to either side are not an oscillation.
    swing = 0.5 * float(np.ptp(values)) * unit.factor
    if unit.quantity == "angle" and swing > 4.0 * np.pi and unit.text.lower().startswith("rad"):
        wrong = f"{table.source}: an amplitude of {swing:.3g} rad (column {column.name}) is too much"
        raise RecordError(
            f"{wrong} for an oscillation; give --units deg if it is in degrees, or its unit if it "
            "is no angle."
        )
    return unit, why


def _agree(stated: lab.SignalUnit, given: lab.SignalUnit) -> bool:
    alike = stated.quantity == given.quantity or lab.plain_unit(stated.text) == lab.plain_unit(given.text)
    return alike and stated.position == given.position and bool(np.isclose(stated.factor, given.factor))


def _assumed_unit(
    table: tables.FileTable,
    signal: Column,
    time: Array,
    values: Array,
    meant: str | None,
    gravity: bool = True,
) -> tuple[lab.SignalUnit, str]:
    """Return the assumed unit of a signal whose unit is not stated, and the evidence for it.

    Parameters
    ----------
    table : FileTable
    signal : Column
        Signal among its columns.
    time, values : (sample,) array of float, s and the column's unit
        The signal without bad samples.
    meant : str, optional
        The measured quantity, if it is known.
    gravity : bool
        Whether the body may be a pendulum.

    Raises
    ------
    UsageError
        An angle may be in rad or in degrees, and the body is not a pendulum.

    Notes
    -----
    A bob on a circle of radius L about its pivot swings at w^2 = g/L: the unit of L is that in which g is
    9.81 m/s^2. A pendulum does not swing farther than pi: a larger angle is in degrees.
    """
    half = 0.5 * float(np.ptp(np.percentile(values, [0.1, 99.9])))
    radius = _circle_radius(table, signal)
    if radius is not None and meant in (None, "", "displacement"):
        text, why = _on_circle(time, values, radius)
    elif meant == "displacement" or (not meant and half > 180.0):
        # In degrees: a signal that swings farther and is not named as an angle is not an angle.
        text = "au"
        why = "coefficients are in its unit, au"
    elif meant in (None, "", "angle"):
        text, why = _of_angle(time, values, half) if gravity else _of_angle_without_gravity(signal, half)
    elif meant == "rate":
        periods = half_periods.dominant_periods(time, values)
        far = half * (periods[0] if periods else 1.0) / (2.0 * np.pi)
        text = "deg/s" if far > np.pi else "rad/s"
        why = f"taken as {text}, which makes the swing {far:.3g} {text.removesuffix('/s')}"
    else:
        # An accelerometer at rest shows gravity: near 1 in g, near 9.8 in m/s^2.
        rest = float(np.median(values))
        text = "g" if 0.5 < abs(rest) < 1.2 else "m/s^2"
        since = f", since it swings about {rest:.3g}, as gravity would" if text == "g" else ""
        why = f"taken as {text}{since}"
    unit = lab.signal_unit(text)
    assert unit is not None
    return unit, f"unit not stated: {why}"


# Relative error of gravity on an axis that points down, for a sensor that is not calibrated; and for the
# three axes of one sensor together.
OF_GRAVITY = 0.055
OF_GRAVITY_ON_AXES = 0.02


def _gravity_on_axes(table: tables.FileTable, column: Column, signals: list[Column], values: Array) -> str:
    """Return the reason for an accelerometer axis in m/s^2 (gravity on three axes), or nothing."""
    axes = [c for c in signals if c.is_numeric and not c.stated and c.cells.size == column.cells.size]
    # Among more columns, some combination may have the size of gravity by chance.
    if len(axes) != 3 or column not in axes:
        return ""
    rests = [float(np.nanmedian(values if axis is column else axis.values)) for axis in axes]
    together = float(np.sqrt(np.sum(np.square(rests))))
    if abs(together / STANDARD_GRAVITY - 1.0) > OF_GRAVITY_ON_AXES:
        return ""
    names = ", ".join(axis.name for axis in axes)
    return f"unit not stated: taken as m/s^2, since {names} rest at {together:.3g} together, as gravity"


def _ask_at_gravity(column: Column, values: Array) -> None:
    """Raise an error that asks for the quantity of an unnamed column that swings about 9.8.

    Raises
    ------
    UsageError
        An accelerometer would swing about 9.8; an angle hardly would.
    """
    rest = float(np.median(values))
    if abs(abs(rest) / STANDARD_GRAVITY - 1.0) <= OF_GRAVITY:
        raise UsageError(
            f"{column.source}: the quantity of column {column.name} is not stated; it swings about "
            f"{rest:.3g}, like an accelerometer in m/s^2 under gravity: give --units "
            f"m/s^2, or its true unit, "
            "such as --units deg (units= in Python)."
        )


def _of_angle(time: Array, values: Array, half: float) -> tuple[str, str]:
    """Return the unit of an angle with this range, and the reason."""
    if half > np.pi:
        return "deg", f"in degrees, since an angle does not swing to {half:.3g} rad"
    # rad; from this amplitude on the frequency shows whether a pendulum's angle is in rad: it must rise
    # during the decay, by at least a quarter of the expected shift.
    if half > 1.0 and (moves := _frequency_shift(time, values)) is not None:
        seen, of_pendulum = moves
        if abs(seen) < 0.25 * of_pendulum:
            return "deg", (
                f"in degrees, since the frequency of a pendulum that swings to "
                f"{half:.3g} rad would rise by {100.0 * of_pendulum:.2g} % as it decays, and this one "
                f"moves by {100.0 * seen:.2g} % (--units rad if it is no pendulum)"
            )
    return "rad", "taken as rad"


# rad; a wire or a spring does not twist by more than this to either side.
MOST_TURNED = 4.0 * np.pi


def _of_angle_without_gravity(signal: Column, half: float) -> tuple[str, str]:
    """Assume the unit of an angle of a body without gravity, which may turn farther than a pendulum.

    Raises
    ------
    UsageError
        The angle may be in either unit.
    """
    if half > MOST_TURNED:
        return "deg", f"in degrees, since a body does not swing to {half:.3g} rad"
    if half > np.pi:
        raise UsageError(
            f"{signal.source}: nothing states the unit of column {signal.name}, which swings to {half:.3g}: "
            "a body without gravity may turn so far in rad, or so little in degrees; give --units rad or deg "
            "(units= in Python)."
        )
    return "rad", "taken as rad"


def _frequency_shift(time: Array, values: Array) -> tuple[float, float] | None:
    """Return the relative rise of the frequency over a decay, and that of a pendulum with the angle in rad.

    Return None if there is no decay.
    """
    try:
        curve = half_sines.envelope(free_decay(xr.Dataset({"angle": ("time", values)}, {"time": time})))
    except DecayError:
        return None
    count = max(1, curve.sizes["instant"] // 4)
    pendulum = 0.5 * np.pi / ellipk(np.sin(0.5 * np.minimum(curve.amplitude.values, 3.1)) ** 2)
    seen, of_pendulum = (
        float(np.median(frequency[-count:]) / np.median(frequency[:count])) - 1.0
        for frequency in (curve.frequency.values, pendulum)
    )
    return seen, of_pendulum


def _circle_radius(table: tables.FileTable, signal: Column) -> float | None:
    """Return the radius of the circle about the origin on which two columns lie; None if they do not."""
    values = signal.cells
    for column in table.columns:
        second = column.cells
        if column is signal or not (signal.is_plain and column.is_plain) or second.size != values.size:
            continue
        if column.is_empty:
            continue
        radius = np.hypot(values.astype(float), second.astype(float))
        middle = float(np.nanmean(radius))
        # The radius of a circle scatters by less than this, and each coordinate by more.
        scatter = 2e-3 * middle
        if middle > 0.0 and np.nanstd(radius) < scatter < min(np.nanstd(values), np.nanstd(second)):
            return middle
    return None


def _on_circle(time: Array, values: Array, radius: float) -> tuple[str, str]:
    """Return the unit of a motion on a circle, and the reason."""
    periods = half_periods.dominant_periods(time, values)
    gravity = radius * (2.0 * np.pi / periods[0]) ** 2 if periods else 0.0
    for text, metres in (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)):
        # The frequency gives gravity within this relative error.
        if abs(gravity * metres / STANDARD_GRAVITY - 1.0) < 0.05:
            return text, (
                f"in {text}, since it moves on a circle of radius {radius:.4g} and swings "
                f"as a pendulum of {radius:.4g} {text} does (its angle: --angle 'atan2(...)')"
            )
    return "au", f"coefficients are in its unit, au; it moves on a circle of radius {radius:.4g}"
