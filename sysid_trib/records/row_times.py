"""Data of the rows other than the signal: times, and inputs, also from a file with its own clock."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records import assumed_units, columns, units
from sysid_trib.records.clock import (
    CLOCKS,
    COUNTED_FROM_1970,
    Clock,
    Origin,
    are_whole,
    check_period,
    read_clock,
    seconds_between,
)
from sysid_trib.records.column import DAY, Column
from sysid_trib.records.inputs import is_switch, usual_between
from sysid_trib.records.reading import Reading, evaluated, is_expression
from sysid_trib.records.roles import ROLE, input_label
from sysid_trib.records.tables import FileTable, read_table

# Least fraction of steps of one in a counter.
MOSTLY = 0.9
_PACKETS = re.compile(r"\b(packet|paket|paquet|pkt|block|burst|seq|sequence)")


# Text about a missing unit of the times.
GIVE_UNIT = (
    f"give it, --time-units {units.OFFERED_TIME_UNITS} (time_units= in Python), or the sampling rate, "
    "--sampling-rate HZ."
)
# Day numbers of 1970-01-01 in spreadsheets and MATLAB, and of the years 1990 to 2100.
SERIAL_DAYS = ((25569.0, 32874.0, 73051.0), (719529.0, 726834.0, 767011.0))


class RowTimes(NamedTuple):
    """Times of the rows of a signal.

    Attributes
    ----------
    clock : Clock
        Times in s, and their rows.
    unit : str
        Unit of the times in the file.
    said : list of str
        Sentences on the times.
    origin : Origin
        Instant that is 0 s in these times.
    """

    clock: Clock
    unit: str
    said: list[str]
    origin: Origin = Origin("rows")


def row_times(table: FileTable, time: Column | None, signal: Column, values: Array, how: Reading) -> RowTimes:
    """Return the times of the rows of a signal.

    Parameters
    ----------
    table : FileTable
    time : Column or None
        Time among its columns, if any.
    signal : Column
    values : (row,) array of float
        Values of the signal.
    how : Reading

    Returns
    -------
    RowTimes

    Raises
    ------
    RecordError
        There is no time, or its length differs from that of the signal.
    UsageError
        Time stamps contradict the given sampling rate.
    """
    given = how.sampling_rate
    source = table.source
    # A column of another length, or a constant one, cannot contradict a sampling rate.
    idle = time is None or time.cells.size != values.size or not time.is_plain or np.ptp(time.cells) == 0
    # A column that counts the rows cannot contradict a sampling rate either.
    idle = idle or (time is not None and not time.is_time and bool(np.all(np.diff(time.cells) == 1)))
    numbered, gaps = _numbered(table, (time, signal), values.size)
    if time is None or (given is not None and idle):
        rate = given or table.rate
        if rate is None:
            raise RecordError(table.no_clock)
        rows = np.arange(values.size)
        said = "" if given else f"sampling rate of {rate:g} Hz from its notes"
        counted = rows if numbered is None else numbered
        return RowTimes(Clock(counted / rate, rows, (), (f"{rate:g} Hz",)), "s", [said, gaps])
    stamps = time.numbers
    if stamps.size != values.size:
        raise RecordError(f"{source}: {stamps.size} times, {values.size} angles; name columns of one length.")
    unit, factor, why = assumed_units.time_factor(table, time, how.time_units)
    if given is not None:
        rows = np.flatnonzero(np.isfinite(stamps))
        _check_rate(stamps[rows] * factor, given, time)
        return RowTimes(Clock(rows / given, rows, (), (f"{given:g} Hz as given",)), unit or "s", [])
    clock = read_clock(stamps, factor, source, values, numbered)
    if unit is None:
        check_period(clock.time, values[clock.rows], are_whole(stamps), source, GIVE_UNIT)
    said = "; ".join(text for text in (why, gaps) if text)
    return RowTimes(clock, unit or "s", [said], _origin(time, clock, unit))


def _origin(time: Column, clock: Clock, unit: str | None) -> Origin:
    """Return the instant that is 0 s in the times of a clock; calendar-like stamps are dates."""
    kind, instant = time.first_instant
    counted = Origin(kind, instant).later(clock.counted_from)
    low, high = COUNTED_FROM_1970
    if kind == "stamps" and low < clock.counted_from < high and unit != "d":
        return counted._replace(kind="universal")
    days = clock.counted_from / units.TIME_UNITS["d"]
    for epoch, first, last in SERIAL_DAYS if kind == "stamps" and unit == "d" else ():
        if first < days < last:
            return Origin("dates").later((days - epoch) * units.TIME_UNITS["d"])
    return counted


def _check_rate(stamps: Array, given: float, time: Column) -> None:
    """Raise an error for a sampling rate that contradicts the stamps (s)."""
    # The last stamp of a coarse clock lasts for as many samples as the others.
    distinct = np.unique(stamps).size
    rate = (stamps.size - stamps.size / max(1, distinct)) / max(float(np.ptp(stamps)), 1e-300)
    if distinct > 1 and abs(given / rate - 1.0) > 0.01 + 1.0 / stamps.size:
        say = f"time stamps of column {time.name} say {rate:.6g} Hz, but --sampling-rate says {given:g} Hz"
        raise UsageError(f"{time.source}: {say} (sampling_rate=); leave it out, or give --time-units.")


def _numbered(table: FileTable, others: Sequence[Column | None], samples: int) -> tuple[Index | None, str]:
    """Return sample numbers from 0 if a column counts them and some are lost, and a sentence on these.

    A counter of packets has the same number in each row of a packet: all packets but the first and the last
    have the same size. A counter that restarts at a power of two is continued.
    """
    for column in table.columns:
        cells = column.cells
        if column in others or not column.is_plain or cells.size != samples or samples < 3:
            continue
        # Larger numbers are not exact.
        if not np.all((cells >= 0) & (cells <= 2.0**53) & (cells == np.round(cells))):
            continue
        steps = _counted_on(cells)
        counted = None
        if np.mean(steps == 1) > MOSTLY and np.all(steps >= 1):
            counted = np.append(0, np.cumsum(steps))
        elif (_PACKETS.search(column.base) or column.counts_rows) and np.all(steps >= 0) and np.any(steps):
            counted = _of_packets(steps)
        if counted is not None:
            missing = int(counted[-1]) + 1 - samples
            return (counted, f"{missing} samples lost, by column {column.name}") if missing else (None, "")
    return None, ""


def _counted_on(column: Array) -> Index:
    """Return the steps of a counter that may restart after all values of this number of bits."""
    whole = column.astype(np.int64)
    turn = 1 << int(whole.max()).bit_length()
    steps = np.diff(whole)
    anew = (steps < 0) & (whole[:-1] > 0.9 * turn) & (whole[1:] < 0.1 * turn)
    return np.where(anew, steps + turn, steps)


def _of_packets(steps: Index) -> Index | None:
    """Return numbers of samples in packets of equal size; None if the sizes differ."""
    packet = np.append(0, np.cumsum(steps))
    _, begins, sizes = np.unique(packet, return_index=True, return_counts=True)
    # The first and the last packet may be incomplete.
    whole = sizes[1:-1]
    size = int(whole.max(initial=0))
    if len(whole) < 2 or np.mean(whole == size) < MOSTLY or sizes[0] > size:
        return None
    place = np.arange(len(packet)) - np.repeat(begins, sizes)
    place[: sizes[0]] += size - sizes[0]
    numbers = packet * size + place
    return np.asarray(numbers - numbers[0])


def input_columns(inputs: Mapping[str, str | int], table: FileTable) -> list[Column]:
    """Return the columns of a table that are inputs, and so cannot be the signal."""
    own = [wanted for _, wanted, other in _sources(inputs) if other is None]
    return [table.find(wanted) for wanted in own if not is_expression(table, wanted)]


def inputs_near(inputs: Mapping[str, str | int], record: Path) -> dict[str, str | int]:
    """Return inputs of other files, also in the record's folder; `*` stands for the record's name.

    If several files match, such as `*_y.mat`, the file is used that has the longest common beginning of its
    name with the record's. Raise a UsageError if there is none, or several are equal.
    """
    return {
        name: wanted if other is None else f"{_near(other, record)}:{wanted}"
        for name, wanted, other in _sources(inputs)
    }


def _near(pattern: Path, record: Path) -> Path:
    if "*" not in pattern.name:
        near = record.parent / pattern
        return near if not pattern.is_file() and near.is_file() else pattern
    folder = record.parent / pattern.parent
    fitting = sorted(other for other in folder.glob(pattern.name) if other.name != record.name)
    # Number of equal letters from the beginning of both names.
    alike = [[a == b for a, b in zip(file.name, record.name, strict=False)] for file in fitting]
    common = [[*letters, False].index(False) for letters in alike]
    nearest = [file for file, length in zip(fitting, common, strict=True) if length == max(common)]
    if len(nearest) != 1:
        said = ", ".join(file.name for file in nearest[:2]) or "none"
        raise UsageError(f"{record.name}: the input {pattern} must fit one file in {folder}, not {said}.")
    return nearest[0]


def with_inputs(
    record: xr.Dataset, table: FileTable, rows: Index, how: Reading, origin: Origin
) -> xr.Dataset:
    """Return a record with its inputs, each by its name.

    Parameters
    ----------
    record : Dataset
        `angle(time)`.
    table : FileTable
        Table of the record.
    rows : (time,) array of int
        Rows of the table, one for each time.
    how : Reading
        Options. `inputs` are columns by name or number, formulas of columns, or columns of another file as
        `base.mat:y`; `between` is their interpolation.
    origin : Origin
        Instant that is 0 s in the times of the record.

    Returns
    -------
    Dataset
        Angles in rad; other inputs in the unit of their column. An input of another file has its own time,
        `NAME_time`.

    Raises
    ------
    UsageError
        There is no such column or file, or the clock of another file has no common instant with that of the
        record.
    RecordError
        The input is not a number at each time.
    """
    if not how.inputs:
        return record
    record = record.assign_attrs(input_columns=json.dumps(dict(how.inputs)))
    if how.between is not None:
        record.attrs["between"] = how.between
    for name, wanted, other in _sources(how.inputs):
        if other is None:
            whole, unit = _column(table, wanted)
            time = None
            values = whole[rows]
        else:
            time, values, unit = _of_file(other, wanted, how, record, origin)
        if not np.all(np.isfinite(values)):
            wrong = f"{table.source}: the input {input_label(record, name)} is not a number at each time"
            raise RecordError(f"{wrong}; fill it, or cut (--window).")
        asked = how.between
        if len(how.inputs) > 1 and is_switch(values):
            # What is between the samples of the other inputs is not asked of a switch.
            asked = None
        between = asked or usual_between(values)
        attrs: dict[str, Any] = {"role": ROLE, "between": between, "long_name": f"input {name}"}
        if unit is not None:
            is_angle = unit.position == "rad"
            values = values * unit.factor if is_angle else values
            attrs["units"] = f"rad{unit.text[len(unit.text.partition('/')[0]) :]}" if is_angle else unit.text
        dim = "time" if time is None else f"{name}_time"
        record[name] = (dim, values, attrs)
        if time is not None:
            record = record.assign_coords({dim: (dim, time, {"units": "s"})})
    return record


def _column(table: FileTable, wanted: str | int) -> tuple[Array, units.SignalUnit | None]:
    """Return values and unit of a column; a formula of columns, `35.15*vir`, has no unit."""
    if is_expression(table, wanted):
        return evaluated(table, str(wanted), "--input")[0], None
    column = table.find(wanted)
    return column.numbers, column.unit


def _sources(inputs: Mapping[str, str | int]) -> Iterator[tuple[str, str | int, Path | None]]:
    """Yield the name, column, and the other file if the column is in one."""
    for name, wanted in inputs.items():
        file, colon, column = str(wanted).rpartition(":")
        yield (name, column, Path(file)) if colon and file else (name, wanted, None)


def _of_file(
    path: Path, wanted: str | int, how: Reading, record: xr.Dataset, origin: Origin
) -> tuple[Array, Array, units.SignalUnit | None]:
    """Read a column of another file: times by the clock of the record, values and unit.

    `origin` : instant that is 0 s in the times of the record.
    """
    if not path.is_file():
        raise UsageError(f"The input's file {path} does not exist; give FILE:COLUMN.")
    table = read_table(path)
    column = table.find(wanted)
    how = replace(how, time=None)
    times = row_times(table, columns.own_time(table, column), column, column.numbers, how)
    later = seconds_between(origin, times.origin)
    if later is None:
        raise UsageError(
            f"{record.attrs['source']} counts its times {CLOCKS[origin.kind]}, "
            f"and {table.source} {CLOCKS[times.origin.kind]}: nothing says how the two clocks belong "
            "together; write both files by one clock, or the input as a column of the record."
        )
    time = times.clock.time + later
    if origin.kind == "day":
        # Midnight may be between them: choose the nearest start.
        time += DAY * np.round((record.time.values[0] - time[0]) / DAY)
    return time, column.numbers[times.clock.rows], column.unit
