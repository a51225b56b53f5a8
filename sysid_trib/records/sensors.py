"""Sensors that record one motion at several places, as columns of a file on one clock."""

import os
import re
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, RecordError, UsageError
from sysid_trib.records import assumed_units, drives, reading, tables, units as lab
from sysid_trib.records.column import Column
from sysid_trib.records.columns import own_time
from sysid_trib.records.in_memory import as_record
from sysid_trib.records.integration import uniform_pieces
from sysid_trib.records.published import named_file
from sysid_trib.records.row_times import row_times
from sysid_trib.records.runs import RecordLike
from sysid_trib.records.signal import unit_of_signal

# Least number of samples of a record for separating modes.
FEWEST_SAMPLES_OF_SENSORS = 500
# A sensor is clipped if it is at one end of its range in at least this number of stretches, with this number
# of samples in total.
CLIPPED_RUNS, CLIPPED_SAMPLES = 2, 4
# Clipping is not tested for a sensor with coarse steps, fewer than this in its range.
FEWEST_STEPS = 50
# Order of the quantities: the sensors of the first one in a file are used.
SENSOR_QUANTITIES = ("acceleration", "rate", "displacement", "angle")


class ClippedError(DecayError):
    """A record whose sensors are all clipped.

    Parameters
    ----------
    message : str
    quantity : str
        Measured quantity of the sensors.
    """

    def __init__(self, message: str, quantity: str) -> None:
        super().__init__(message)
        self.quantity = quantity

    def __reduce__(self) -> tuple[type["ClippedError"], tuple[str, str]]:
        """Return the class and its arguments, for another process."""
        return ClippedError, (str(self), self.quantity)


def read_sensors(
    path: str | os.PathLike[str],
    how: reading.Reading | None = None,
    *,
    window: tuple[float | None, float | None] = (None, None),
) -> xr.Dataset:
    """Read the sensors of a file that record one motion at several places.

    Parameters
    ----------
    path : str or path
        File, as `read_record` takes it.
    how : Reading, optional
        Options for reading; `angle` names the columns, separated by commas. Without it, they are all columns
        of one quantity: accelerations, else rates, else displacements.
    window : (float or None, float or None), s
        Times between which the file is read.

    Returns
    -------
    Dataset
        ``signal(sensor, time)`` on a uniform clock, in m/s^2, m/s or m (rad/s^2, rad/s, rad); attrs
        `quantity`, `position` (the unit after integration), `integrations`, `reading`, `source`.

    Raises
    ------
    UsageError
        An unknown column or file.
    RecordError, DecayError
        There are no sensors, or almost no samples.
    ClippedError
        All sensors are clipped.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> swing = st.records.paper_twin()
    >>> table = np.column_stack([swing.time, 2.0 * swing.angle, 3.0 * swing.angle])
    >>> np.savetxt("beam.csv", table, delimiter=",", header="time (s),left (mm),right (mm)", comments="")
    >>> sensors = st.read_sensors("beam.csv")
    >>> sensors.signal.sizes["sensor"], sensors.attrs["quantity"], sensors.signal.attrs["units"]
    (2, 'displacement', 'mm')
    """
    named_as = named_file(path)
    how = named_as.reading(how or reading.Reading())
    table = named_as.whole(tables.read_table(named_as.path))
    columns, unused = _columns(table, how)
    first = columns[0]
    time_column = table.find(how.time) if how.time is not None else own_time(table, first)
    columns = [column for column in columns if column.values.size == first.values.size]
    clock = row_times(table, time_column, first, first.values, how).clock
    rows, time = clock.rows, clock.time
    table_of = np.array([column.values[rows] for column in columns], dtype=float)
    start, stop = (-np.inf if window[0] is None else window[0]), (np.inf if window[1] is None else window[1])
    kept = (time >= start) & (time <= stop) & np.isfinite(table_of).all(axis=0)
    if np.count_nonzero(kept) < FEWEST_SAMPLES_OF_SENSORS:
        raise DecayError(
            f"{table.source}: {np.count_nonzero(kept)} samples are too few to separate modes; at least "
            f"{FEWEST_SAMPLES_OF_SENSORS} are needed: record longer, or widen the window."
        )
    time, table_of = time[kept], table_of[:, kept]
    one_by_one = replace(how, angle=None)
    units = [
        assumed_units.unit_of(table, c, one_by_one, time, v) for c, v in zip(columns, table_of, strict=True)
    ]
    time, table_of, said = _on_one_clock(time, table_of)
    values = table_of * np.array([unit.factor for unit, _ in units])[:, None]
    record = _dataset(time, values, _names(columns), units[0][0])
    in_file = list(dict.fromkeys(unit.text for unit, _ in units))
    if len(in_file) > 1:
        said.append(f"units of the sensors: {', '.join(unit.text for unit, _ in units)}")
    record.attrs |= {
        "source": table.source,
        "record_checksum": table.checksum,
        "time_column": time_column.name if time_column else "none",
        "angle_unit_in_file": in_file[0] if len(in_file) == 1 else str(record.signal.attrs["units"]),
        "reading": "; ".join(text for text in (*table.said, *said, *unused, units[0][1]) if text),
    }
    return _without_clipped(record)


def as_sensors(given: RecordLike) -> xr.Dataset:
    """Return a record with one signal as a single sensor; return sensors unchanged.

    Raises
    ------
    UsageError
        The object is neither a record nor sensors.
    """
    if isinstance(given, xr.Dataset) and "signal" in given and {"sensor", "time"} == set(given.signal.dims):
        return _without_clipped(_with_quantity(given.transpose("sensor", "time")))
    record = as_record(given)
    if not isinstance(record, xr.Dataset) or "angle" not in record:
        raise UsageError(
            "Sensors are a Dataset with signal(sensor, time) or angle(time): read_sensors(path)."
        )
    name = str(record.attrs.get("measured", "angle"))
    unit = lab.signal_unit(str(record[name].attrs.get("units", unit_of_signal(record))))
    unit = unit or lab.SignalUnit("rad", "angle", "rad", 1.0)
    time, values, _ = _on_one_clock(record.time.values.astype(float), record[name].values[None].astype(float))
    sensors = _dataset(time, values, [str(record.attrs.get("angle_column", name))], unit)
    kept = ("source", "record_checksum", "time_column", "angle_unit_in_file", "reading", "columns_in_file")
    sensors.attrs |= {key: record.attrs[key] for key in kept if key in record.attrs}
    return _without_clipped(sensors)


def _with_quantity(sensors: xr.Dataset) -> xr.Dataset:
    """Complete sensors from memory with the quantity of their unit."""
    if "quantity" in sensors.attrs:
        return sensors
    unit = lab.signal_unit(str(sensors.signal.attrs.get("units", "")))
    if unit is None:
        raise UsageError('The signals have no unit; give one, sensors.signal.attrs["units"] = "m/s^2".')
    values = sensors.signal.values.astype(float) * unit.factor
    time, values, _ = _on_one_clock(sensors.time.values.astype(float), values)
    made = _dataset(time, values, [str(name) for name in sensors.sensor.values], unit)
    return made.assign_attrs(made.attrs | dict(sensors.attrs))


def _dataset(time: Array, values: Array, names: list[str], unit: lab.SignalUnit) -> xr.Dataset:
    """Return sensors as a Dataset, in the unit of a position, its rate or its acceleration."""
    times = lab.INTEGRATIONS[unit.quantity]
    units = unit.position + ("", "/s", "/s^2")[times]
    attrs: dict[str, Any] = {"quantity": unit.quantity, "position": unit.position, "integrations": times}
    coordinates: dict[str, Any] = {
        "sensor": names,
        "time": ("time", time, {"units": "s", "long_name": "time"}),
    }
    signal = (("sensor", "time"), values, {"units": units, "long_name": f"{unit.quantity} at each sensor"})
    return xr.Dataset({"signal": signal}, coordinates, attrs)


def _columns(table: tables.FileTable, how: reading.Reading) -> tuple[list[Column], list[str]]:
    """Return the columns of the sensors, and sentences on columns that are left out."""
    if how.angle is not None:
        names = str(how.angle).split(",")
        if len(names) > 1 and table.match(how.angle) is None:
            sensors = [table.find(name.strip()) for name in names]
            in_order = [column.name for column in sensors]
            if twice := [name for name in in_order if in_order.count(name) > 1]:
                raise UsageError(
                    f"{table.source}: --angle names column {twice[0]} twice; name each sensor once."
                )
            return sensors, []
        return [table.find(how.angle)], []
    times = [table.find(how.time)] if how.time is not None else table.times
    numeric = [c for c in table.columns if c not in times and c.is_numeric and not c.is_empty]
    moving = [c for c in numeric if not c.is_level and drives.moves(c)]
    sensors = [c for c in moving if not drives.is_named_as_drive(c)] or moving
    if not sensors:
        raise RecordError(f"{table.source}: there is no column of a sensor, only the time.")
    kinds = {column: _quantity(table, column, how) for column in sensors}
    chosen = next((kind for kind in SENSOR_QUANTITIES if kind in kinds.values()), "")
    said = [
        f"{column.name} left out, a {kind} and no {chosen}"
        for column, kind in kinds.items()
        if kind != chosen
    ]
    still = [c for c in numeric if c not in moving and _quantity(table, c, how) == chosen]
    said += [f"{column.name} left out, it does not move" for column in still if not column.rises]
    return [column for column, kind in kinds.items() if kind == chosen], said


def _names(columns: list[Column]) -> list[str]:
    """Return the names of the columns, without units if they remain different."""
    bare = [re.sub(r"\s*[(\[][^()\[\]]*[)\]]$", "", column.name) for column in columns]
    return bare if all(bare) and len({*bare}) == len(bare) else [column.name for column in columns]


def _quantity(table: tables.FileTable, column: Column, how: reading.Reading) -> str:
    """Return the quantity of a column, from the user, its unit, the notes of the file, or its name."""
    if how.quantity is not None:
        return how.quantity
    signals = [c for c in table.columns if c not in table.times]
    noted = lab.signal_unit(lab.noted_unit(table.notes, signals.index(column), len(signals)))
    given = lab.signal_unit(how.units or "")
    unit = given or column.unit or noted
    return unit.quantity if unit is not None and unit.known else column.quantity


def _on_one_clock(time: Array, signals: Array) -> tuple[Array, Array, list[str]]:
    """Return signals on a uniform clock; the longest piece if there are gaps."""
    usual = float(np.median(np.diff(time)))
    pieces = [uniform_pieces(time, signal, 8.0 * usual) for signal in signals]
    longest = int(np.argmax([piece[0].size for piece in pieces[0]]))
    said = [pieces[0][longest][2]]
    if len(pieces[0]) > 1:
        said.append(f"gaps divide the record into {len(pieces[0])} pieces, the longest is used")
    return pieces[0][longest][0], np.array([parts[longest][1] for parts in pieces]), said


def _without_clipped(sensors: xr.Dataset) -> xr.Dataset:
    """Leave out clipped sensors, with a sentence; raise an error if none remains."""
    time, clipped, ends = sensors.time.values, [], []
    for name in sensors.sensor.values:
        values = sensors.signal.sel(sensor=name).values
        at = _clipped(values)
        if at is not None:
            clipped.append(name)
            ends.append((float(np.max(np.abs(values))), float(time[at])))
    if not clipped:
        return sensors
    unit, source = sensors.signal.attrs["units"], sensors.attrs.get("source", "record")
    said = "; ".join(
        f"sensor {name} is clipped at {limit:.4g} {unit} until {until:.4g} s"
        for name, (limit, until) in zip(clipped, ends, strict=True)
    )
    if len(clipped) == sensors.sizes["sensor"]:
        after = max(until for _, until in ends)
        raise ClippedError(
            f"{source}: {said}; use what comes after it (--window {after:.4g}:), or record with a lower "
            "gain.",
            str(sensors.attrs["quantity"]),
        )
    kept = sensors.drop_sel(sensor=clipped)
    return kept.assign_attrs(
        reading="; ".join(filter(None, [kept.attrs.get("reading"), f"{said}, left out"]))
    )


def _clipped(values: Array) -> int | None:
    """Return the last sample at which a signal is clipped; None if it is not."""
    steps = np.abs(np.diff(values))
    smallest = float(np.min(steps[steps > 0.0], initial=np.inf))
    if not np.ptp(values) > FEWEST_STEPS * smallest:
        return None
    last = None
    for limit in (values.max(), values.min()):
        at = np.flatnonzero(values == limit)
        runs = 1 + int(np.count_nonzero(np.diff(at) > 1))
        # Tops that are flat for several samples, more than once.
        if runs >= CLIPPED_RUNS and at.size - runs >= CLIPPED_SAMPLES - CLIPPED_RUNS:
            last = max(last or 0, int(at[-1]))
    return last
