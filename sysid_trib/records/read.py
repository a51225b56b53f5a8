"""Records: an angle or displacement over time from a file, with its unit, and how it was understood."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.cleaning import spikes, unwrapped, unwrapped_anywhere
from sysid_trib.decays.equilibrium import find_swing
from sysid_trib.decays.integration import integrated
from sysid_trib.errors import RecordError, UsageError, readable
from sysid_trib.records.assumed_units import assumed_unit, circle_radius, time_factor
from sysid_trib.records.clock import Clock, read_clock
from sysid_trib.records.columns import Chosen, choose_columns, has_column
from sysid_trib.records.expression import is_expression, with_expression
from sysid_trib.records.headers import as_written, names_quantity, split_header
from sysid_trib.records.notes import noted_rate, noted_unit
from sysid_trib.records.numbers import numbers
from sysid_trib.records.tables import FileTable, read_table
from sysid_trib.records.units import (
    ACCELEROMETER,
    INTEGRATIONS,
    METRES,
    OFFERED_TIME_UNITS,
    OFFERED_UNITS,
    SIGNALS,
    STANDARD_GRAVITY,
    TIME_UNITS,
    SignalUnit,
    plain_unit,
    signal_unit,
)

LARGEST_AMPLITUDE = 4.0 * np.pi
RATE_TOLERANCE = 0.01
# An accelerometer that feels less of gravity than this part shows no angle.
LEAST_FELT = 0.02


@dataclass(frozen=True)
class Reading:
    """How a file is to be read; what is not given is taken from the file.

    Parameters
    ----------
    time, angle : str or int, optional
        Columns of time and signal, by name or number from 0.
    signal : {"angle", "displacement", "rate", "acceleration", "accelerometer"}, optional
        What was measured; an accelerometer on a pendulum feels gravity's component along its path too.
    units : str, optional
        Unit of the signal.
    sampling_rate : float, Hz, optional
        Instead of a time column.
    time_units : {"s", "ms", "us", "min"}, optional
        Unit of the time column.
    length : float, m, optional
        Of a pendulum: turns a displacement in a unit of length into an angle.
    distance : float, m, optional
        Of an accelerometer from the axis of the pendulum that it is on.
    usual : str, optional
        What is usually measured of such a system: the signal's quantity where nothing says it.
    """

    time: str | int | None = None
    angle: str | int | None = None
    signal: str | None = None
    units: str | None = None
    sampling_rate: float | None = None
    time_units: str | None = None
    length: float | None = None
    distance: float | None = None
    usual: str | None = None

    def __post_init__(self) -> None:
        if self.signal is not None and self.signal not in SIGNALS:
            raise UsageError(f"signal {self.signal!r} is unknown: give {', '.join(SIGNALS)}.")
        if self.time_units is not None and self.time_units not in TIME_UNITS:
            raise UsageError(f"time units {self.time_units!r} are unknown: give {OFFERED_TIME_UNITS}.")
        if self.units is not None and signal_unit(self.units) is None:
            raise UsageError(f"units {self.units!r} are unknown: give {OFFERED_UNITS}.")
        if self.sampling_rate is not None and not 1e-9 <= self.sampling_rate <= 1e9:
            raise UsageError(
                f"sampling rate {self.sampling_rate:g}: give a positive number of samples a second."
            )
        if (self.signal == ACCELEROMETER) != (self.distance is not None):
            raise UsageError(
                "An accelerometer on a pendulum is read by its distance from the axis in m: give both "
                "--signal accelerometer and --distance M (signal= and distance= in Python), or neither."
            )
        if self.distance is not None and not 0.0 <= self.distance < 1e6:
            raise UsageError(f"distance {self.distance:g}: give the distance from the axis in m.")
        if self.length is not None and not 0.0 < self.length < 1e6:
            raise UsageError(f"length {self.length:g}: give the pendulum's length in m.")


def read_record(
    path: str | os.PathLike[str],
    *,
    time: str | int | None = None,
    angle: str | int | None = None,
    signal: str | None = None,
    units: str | None = None,
    sampling_rate: float | None = None,
    time_units: str | None = None,
    length: float | None = None,
) -> xr.Dataset:
    """Read an oscillation from a file.

    Parameters
    ----------
    path : str or path
        Text or CSV, MATLAB, Excel, netCDF, HDF5, Parquet or TDMS; the content decides, not the name.
    time : str or int, optional
        Name of the time column, or its number from 0. If not given, it is recognised by its name or because
        it rises. The columns of MATLAB and HDF5 files are named like `data.Y[0]`.
    angle : str or int, optional
        Name or number of the signal's column, or a formula of columns, `atan2(x - 3.1, -y)`; else the column
        that can be meant alone.
    signal : {"angle", "displacement", "rate", "acceleration"}, optional
        What was measured; else what unit and name say. A rate is integrated once and an acceleration twice,
        without the drift of their bias.
    units : str, optional
        Its unit, where the file does not say it: rad, deg, mrad, mm, px, V, au, rad/s, g, ...
    sampling_rate : float, Hz, optional
        Instead of a time column.
    time_units : {"s", "ms", "us", "min"}, optional
        Where the file does not say it; if not given either, s.
    length : float, m, optional
        Of a pendulum: turns a displacement in a unit of length into an angle.

    Returns
    -------
    Dataset
        `angle(time)` in rad, or a displacement in the file's unit (its attribute `units`), and `rate(time)`
        or `acceleration(time)` where that was measured. Times are those of the file. Attrs say how it was
        understood: `signal`, `angle_unit_in_file`, `clock`, `reading`.

    Raises
    ------
    UsageError
        An unknown column, option or file; an option that contradicts the header; several columns that could
        be the signal; several runs side by side (`read_records` gives all).
    RecordError
        A file without such a record: malformed, not finite, times out of order.
    """
    how = Reading(time, angle, signal, units, sampling_rate, time_units, length)
    records = read_records(path, how)
    if len(records) > 1:
        names = ", ".join(str(record.attrs["angle_column"]) for record in records)
        raise UsageError(
            f"{Path(path).name}: {len(records)} runs side by side ({names}); name a column, or take all with "
            "read_records."
        )
    return records[0]


def read_records(path: str | os.PathLike[str], how: Reading | None = None) -> list[xr.Dataset]:
    """Read every run of a file: one, or several side by side.

    Parameters
    ----------
    path : str or path
        As in `read_record`.
    how : Reading, optional
        How it is to be read.

    Returns
    -------
    list of Dataset
        Each as `read_record` returns it.

    Raises
    ------
    UsageError, RecordError
        As `read_record`.
    """
    how = how or Reading()
    path = Path(path)
    if how.time is not None and how.sampling_rate is not None:
        raise UsageError(f"{path.name}: give a time column or a sampling rate, not both.")
    table, source = read_table(path), readable(path.name)
    if is_expression(how.angle) and not has_column(table, how.angle):
        table = with_expression(table, str(how.angle), source)
    signal = "acceleration" if how.signal == ACCELEROMETER else how.signal
    chosen = choose_columns(table, source, time=how.time, angle=how.angle, signal=signal)
    checksum = hashlib.sha256(path.read_bytes()).hexdigest()
    records = []
    for number, columns in enumerate(chosen):
        record = _read(table, columns, how, source)
        # Two runs of one file are two records.
        record.attrs["record_checksum"] = checksum if len(chosen) == 1 else f"{checksum}-{number + 1}"
        records.append(record)
    return records


def _read(table: FileTable, columns: Chosen, how: Reading, source: str) -> xr.Dataset:
    values = numbers(table.columns[columns.signal], columns.signal, source)
    clock, time_unit, said = _clock(table, columns, how, values, source)
    kept = np.isfinite(values[clock.rows])
    missing = int(np.count_nonzero(~kept))
    said = [columns.sentence, *said]
    if missing:
        said.append(f"{missing} values missing" if missing > 1 else "1 value missing")
    time, values = clock.time[kept], values[clock.rows][kept]
    if values.size < 2:
        raise RecordError(f"{source}: a single sample is not a record.")
    # A bad sample says nothing of the unit.
    calm = np.delete(np.arange(values.size), spikes(time, values))
    unit, why = _unit(table, columns, how, time[calm], values[calm], source)
    values = values * unit.factor
    if unit.quantity == "angle":
        values, cuts = unwrapped(values, 2.0 * np.pi)
        said += [f"put together again where it was cut at a whole turn ({cuts} times)"] if cuts else []
    elif unit.quantity == "displacement":
        values, turn, cuts = unwrapped_anywhere(values)
        times = f"({cuts} times, {turn:.6g} {unit.text})"
        said += [f"put together again where it was cut at the end of its range {times}"] if cuts else []
    attrs: dict[str, Any] = {
        "source": source,
        "signal": unit.quantity,
        "time_column": columns.time or f"none, {1.0 / np.median(np.diff(time)):g} Hz",
        "time_unit_in_file": time_unit,
        "angle_column": columns.signal,
        "angle_unit_in_file": unit.text,
        "clock": "; ".join(clock.sentences),
        "reading": "; ".join(text for text in (*said, why) if text),
    }
    if clock.breaks:
        attrs["breaks"] = list(clock.breaks)
    if how.signal == ACCELEROMETER:
        return _felt(time, values, attrs, float(how.distance or 0.0), source)
    return _record(time, values, unit, attrs, how.length)


def _clock(
    table: FileTable, columns: Chosen, how: Reading, values: Array, source: str
) -> tuple[Clock, str, list[str]]:
    """Times of the rows, the unit they have in the file, and what is to be said of it."""
    noted = noted_rate(table.notes)
    if columns.time is None or (how.sampling_rate is not None and _idle(table, columns.time, values.size)):
        rate = how.sampling_rate or noted
        if rate is None:
            over = [name for name in table.columns if split_header(name)[0].startswith("freq")]
            if over:
                raise RecordError(
                    f"{source}: its columns are over {over[0]}, not over time: it is a response; a record "
                    "is needed."
                )
            raise RecordError(
                f"{source}: there is no time column; give the sampling rate (--sampling-rate HZ)."
            )
        said = [] if how.sampling_rate else [f"sampling rate of {rate:g} Hz from its notes"]
        rows = np.arange(values.size)
        return Clock(rows / rate, rows, (), (f"{rate:g} Hz",)), "s", said
    stamps = numbers(table.columns[columns.time], columns.time, source)
    if stamps.size != values.size:
        raise RecordError(
            f"{source}: {stamps.size} times but {values.size} angles; choose columns that belong together."
        )
    unit, factor, why = time_factor(table, columns.time, how.time_units, source)
    if how.sampling_rate is not None:
        rows = np.flatnonzero(np.isfinite(stamps))
        counted = max(float(np.ptp(stamps[rows])) * factor, 1e-300)
        # A coarse clock's last stamp lasts for as many samples as the others do.
        rate = (rows.size - rows.size / np.unique(stamps[rows]).size) / counted
        if abs(how.sampling_rate / rate - 1.0) > RATE_TOLERANCE + 1.0 / rows.size:
            raise UsageError(
                f"{source}: the time stamps of column {columns.time} say {rate:.6g} Hz, but --sampling-rate "
                f"says {how.sampling_rate:g} Hz (sampling_rate= in Python); leave the option out, or give "
                "the unit of the stamps, --time-units."
            )
        return Clock(rows / how.sampling_rate, rows, (), (f"{how.sampling_rate:g} Hz as given",)), unit, []
    clock = read_clock(stamps, factor, source)
    return clock, unit, [why] if why else []


def _idle(table: FileTable, name: str, samples: int) -> bool:
    """Whether a time column cannot contradict a sampling rate: it is of another length, or does not move."""
    stamps = np.asarray(table.columns[name])
    return stamps.size != samples or stamps.dtype.kind not in "fiu" or bool(np.ptp(stamps) == 0)


def _unit(
    table: FileTable, columns: Chosen, how: Reading, time: Array, values: Array, source: str
) -> tuple[SignalUnit, str]:
    """Unit of the signal: as the option says, as the file says, or as its numbers let one assume."""
    name = columns.signal
    # What an accelerometer feels is in the units of an acceleration.
    signal = "acceleration" if how.signal == ACCELEROMETER else how.signal
    base, in_header = split_header(name)
    in_header = as_written(name, in_header)
    stated = signal_unit(table.units.get(name, "") or in_header or noted_unit(table.notes))
    given = None if how.units is None else signal_unit(how.units)
    if given and how.signal and given.quantity in ("angle", "displacement") and how.signal != given.quantity:
        # "deg" of a rate is deg/s.
        given = SignalUnit(given.text, how.signal, given.position, given.factor, given.known)
    if given and stated and stated.known and _differs(stated, given):
        raise UsageError(
            f"{source}: the header of column {name} says {stated.text}, but --units says {how.units} (units= "
            "in Python); leave the option out or correct the header."
        )
    unit, why = given or stated, ""
    if unit is None:
        meant = signal or names_quantity(base) or how.usual
        unit, why = assumed_unit(base, time, values, circle_radius(table, name), meant)
    if signal is not None and signal != unit.quantity:
        per_second = "/s" if signal == "rate" else "/s^2" if signal == "acceleration" else ""
        if unit.quantity in ("angle", "displacement") and per_second:
            unit = SignalUnit(f"{unit.text}{per_second}", signal, unit.position, unit.factor, unit.known)
        elif stated is not None and stated.known:
            raise UsageError(
                f"{source}: the header of column {name} says {stated.text}: {_article(stated.quantity)}; but "
                f"--signal says {how.signal} (signal= in Python); leave the option out."
            )
    swing = 0.5 * float(np.ptp(values)) * unit.factor
    if unit.quantity == "angle" and swing > LARGEST_AMPLITUDE and unit.text.lower().startswith("rad"):
        raise RecordError(
            f"{source}: an amplitude of {swing:.3g} rad (column {name}) is too much for an oscillation; if "
            "it is in degrees say so with --units deg (units= in Python), if it is no angle name its unit."
        )
    return unit, why


def _differs(stated: SignalUnit, given: SignalUnit) -> bool:
    same_kind = stated.position == given.position and np.isclose(stated.factor, given.factor)
    return not (
        same_kind and (stated.quantity == given.quantity or plain_unit(stated.text) == plain_unit(given.text))
    )


def _article(quantity: str) -> str:
    return f"an {quantity}" if quantity[0] in "a" else f"a {quantity}"


def _record(
    time: Array, values: Array, unit: SignalUnit, attrs: dict[str, Any], length: float | None
) -> xr.Dataset:
    record = xr.Dataset(coords={"time": ("time", time, {"units": "s", "long_name": "time"})}, attrs=attrs)
    position, times = unit.position, INTEGRATIONS[unit.quantity]
    if times:
        measured = f"{position}/s" if times == 1 else f"{position}/s^2"
        long_name = f"{unit.quantity} as measured"
        record[unit.quantity] = ("time", values, {"units": measured, "long_name": long_name})
        swing = find_swing(time, values)
        bias = float(np.median(values)) if swing is None else swing.equilibrium
        period = float(np.ptp(time)) if swing is None else swing.oscillation.period
        values = values - bias
        for _ in range(times):
            values = integrated(time, values, period)
        record.attrs["measured"] = unit.quantity
        record.attrs[f"{unit.quantity}_bias"] = bias
        count = "once" if times == 1 else "twice"
        record.attrs["integrations"] = times
        record.attrs["integration"] = (
            f"integrated {count}, without the drift of its bias (splines, knots two periods apart)"
        )
    if length is not None and position in METRES:
        values, by_length, position = values * METRES[position] / length, METRES[position] / length, "rad"
        if times:
            per = str(record[unit.quantity].attrs["units"]).partition("/")[2]
            record[unit.quantity] = (record[unit.quantity] * by_length).assign_attrs(
                record[unit.quantity].attrs | {"units": f"rad/{per}"}
            )
        record.attrs["length"] = length
    name = "angle" if position == "rad" else "displacement"
    record["angle"] = ("time", values, {"units": position, "long_name": name})
    return record


def _felt(time: Array, values: Array, attrs: dict[str, Any], distance: float, source: str) -> xr.Dataset:
    """The record of an accelerometer on a pendulum, with the angle to first order.

    It feels g sin(x) + r x'' along its path. Without friction x'' = -w^2 sin(x): the angle is the arcsine of
    what it feels over g - r w^2.
    """
    swing = find_swing(time, values)
    if swing is None:
        raise RecordError(f"{source}: no oscillation stands out of the noise; choose another axis.")
    felt = STANDARD_GRAVITY - distance * (2.0 * np.pi / swing.oscillation.period) ** 2
    if felt < LEAST_FELT * STANDARD_GRAVITY:
        raise RecordError(
            f"{source}: at {distance:g} m from the axis an accelerometer feels next to nothing of this swing "
            f"along its path ({felt:.3g} m/s^2 of 9.81): correct --distance, or choose another axis."
        )
    sine = np.clip((values - swing.equilibrium) / felt, -1.0, 1.0)
    record = xr.Dataset(coords={"time": ("time", time, {"units": "s", "long_name": "time"})}, attrs=attrs)
    long_name = "acceleration that was felt"
    record[ACCELEROMETER] = ("time", values, {"units": "m/s^2", "long_name": long_name})
    record["angle"] = ("time", np.arcsin(sine), {"units": "rad", "long_name": "angle"})
    record.attrs |= {
        "signal": ACCELEROMETER,
        "measured": ACCELEROMETER,
        "integrations": 0,
        "distance": distance,
        "felt_per_sine": felt,
        "integration": "its angle by the arcsine, as if there were no friction",
    }
    return record


def scale_translation(record: xr.Dataset, mass: float, natural_frequency: float, load: float) -> xr.Dataset:
    """Turn the position of a translational tribometer into the dimensionless angle of the theory.

    Parameters
    ----------
    record : Dataset
        `angle(time)` in a unit of length.
    mass : float, kg
        m.
    natural_frequency : float, rad/s
        w0.
    load : float, N
        P.

    Returns
    -------
    Dataset
        `angle(time)` = m w0^2 x / P; a friction force T then acts as f = -T/P (Le Bot et al. 2019, Sec. 2).

    Raises
    ------
    UsageError
        The record is not a position in a unit of length, or a value is not positive.
    """
    source = record.attrs.get("source", "record")
    unit = str(record["angle"].attrs.get("units"))
    if unit not in METRES:
        raise UsageError(f"{source}: only a position can be scaled; read the record with units=m (or mm).")
    for name, value in (("mass", mass), ("natural frequency", natural_frequency), ("load", load)):
        if not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} of {value}: give a positive number.")
    factor = METRES[unit] * mass * natural_frequency**2 / load
    scaled = record.copy()
    scaled["angle"] = (record["angle"] * factor).assign_attrs(units="rad", long_name="scaled position")
    scaled.attrs = record.attrs | {
        "translation": f"angle = m w0^2 x / P with m = {mass:g} kg, w0 = {natural_frequency:g} rad/s, "
        f"P = {load:g} N",
        "translation_factor": factor,
    }
    return scaled
