"""Records: an angle or displacement over time from a file, with its unit, and how it was understood."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records import units as lab
from sysid_trib.records.as_angle import as_felt, as_position
from sysid_trib.records.assumed_units import assumed_unit
from sysid_trib.records.cleaning import spikes, unwrapped
from sysid_trib.records.column import Column
from sysid_trib.records.columns import Chosen, choose_columns
from sysid_trib.records.inputs import named_inputs
from sysid_trib.records.reading import Reading, is_expression, with_expression
from sysid_trib.records.row_times import input_columns, inputs_near, row_times, with_inputs
from sysid_trib.records.tables import FileTable, read_table

POSITIONS = ("angle", "displacement")


def _unit_of(
    table: FileTable, column: Column, how: Reading, time: Array, values: Array
) -> tuple[lab.SignalUnit, str]:
    """Unit of a signal without bad samples, and why that one where neither user nor file says it.

    Raises
    ------
    UsageError
        The header says another unit, or another quantity, than the user.
    RecordError
        An amplitude that no oscillation has in this unit.
    """
    stated = column.unit or lab.signal_unit(lab.noted_unit(table.notes))
    header = f"{table.source}: the header of column {column.name} says {stated.text if stated else ''}"
    given = lab.signal_unit(how.units or "")
    if given and how.signal and given.quantity in POSITIONS:
        # "deg" of a rate is deg/s.
        given = replace(given, quantity=how.signal)
    if given and stated and stated.known and not _agree(stated, given):
        known = "" if given.known else f", which is none of those that are known ({lab.OFFERED_UNITS})"
        raise UsageError(
            f"{header}, but --units says {how.units} (units= in Python){known}; leave the option out or "
            "correct the header."
        )
    if given and not given.known and given.quantity == "angle":
        # In whatever it is, no coefficient would have its size.
        raise UsageError(
            f"{table.source}: --units '{how.units}' (units= in Python) is no unit of an angle that is known; "
            f"give {lab.OFFERED_ANGLES}."
        )
    unit, why = given or stated, ""
    if unit is None:
        meant = how.quantity or lab.names_quantity(column.base) or how.usual
        unit, why = assumed_unit(table, column, time, values, meant)
    if how.quantity not in (None, unit.quantity):
        if unit.quantity in POSITIONS and (times := lab.INTEGRATIONS[how.quantity]):
            unit = replace(unit, text=f"{unit.text}{'/s' if times == 1 else '/s^2'}", quantity=how.quantity)
        elif stated is not None and stated.known:
            article = "an" if stated.quantity[0] == "a" else "a"
            raise UsageError(
                f"{header}: {article} {stated.quantity}; but --signal says {how.signal} (signal= in Python); "
                "leave the option out."
            )
    if not unit.known:
        known = f"none of those that are known ({lab.OFFERED_UNITS})"
        why = f"unit {unit.text} is {known}: coefficients are in it"
    # Two whole turns to either side are more than an oscillation.
    swing = 0.5 * float(np.ptp(values)) * unit.factor
    if unit.quantity == "angle" and swing > 4.0 * np.pi and unit.text.lower().startswith("rad"):
        raise RecordError(
            f"{table.source}: an amplitude of {swing:.3g} rad (column {column.name}) is too much for an "
            "oscillation; if it is in degrees say so with --units deg (units= in Python), if it is no angle "
            "name its unit."
        )
    return unit, why


def _agree(stated: lab.SignalUnit, given: lab.SignalUnit) -> bool:
    alike = stated.quantity == given.quantity or lab.plain_unit(stated.text) == lab.plain_unit(given.text)
    return alike and stated.position == given.position and bool(np.isclose(stated.factor, given.factor))


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
    input: str | Sequence[str] | Mapping[str, str | int] | None = None,
    between: str = "smooth",
) -> xr.Dataset:
    """Read an oscillation from a file.

    Parameters
    ----------
    path : str or path
        Text, CSV or JSON, MATLAB, NumPy, Excel, netCDF, HDF5, Parquet or TDMS, or one of them as .gz; the
        content decides, not the name. `-` is standard input.
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
    time_units : {"s", "ms", "us", "ns", "min", "h", "d"}, optional
        Where the file does not say it; if not given either, s.
    length : float, m, optional
        Of a pendulum: turns a displacement in a unit of length into an angle.
    input : str, sequence of str, or mapping of str to str, optional
        Columns of what drives the motion: `"V1"` is the input `u` of formulas, `{"u": "V1", "b": "V2"}` are
        several by their names; `"base.mat:y"` is a column of another file, with its own clock, and
        `"*_y.mat:y"` of that whose name is most like the record's.
    between : {"smooth", "linear", "held", "cubic"}
        What inputs are between their samples: smooth, as of a signal that was measured without aliasing;
        held, as a converter puts it out.

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
    how = Reading(
        time,
        angle,
        signal,
        units,
        sampling_rate,
        time_units,
        length,
        inputs=named_inputs(input),
        between=between,
    )
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
    how = replace(how, inputs=inputs_near(how.inputs, path))
    if how.time is not None and how.sampling_rate is not None:
        raise UsageError(f"{path.name}: give a time column or a sampling rate, not both.")
    table = read_table(path)
    if is_expression(table, how.angle):
        table = with_expression(table, str(how.angle), how.units)
    chosen = choose_columns(table, how, input_columns(how.inputs, table))
    records = [_read(table, columns, how) for columns in chosen]
    # A run that hardly swings does not show that it is in degrees; another one of the file does.
    if {record.attrs["angle_unit_in_file"] for record in records} == {"rad", "deg"} and how.units is None:
        hows = [how if columns[1].stated else replace(how, units="deg") for columns in chosen]
        records = [_read(table, *pair) for pair in zip(chosen, hows, strict=True)]
    for number, record in enumerate(records, 1):
        # Two runs of one file are two records.
        record.attrs["record_checksum"] = table.checksum + f"-{number}" * (len(chosen) > 1)
    return records


def _read(table: FileTable, columns: Chosen, how: Reading) -> xr.Dataset:
    time_column, column, why_this = columns
    values, absent = column.signal
    clock, time_unit, said = row_times(table, time_column, column, values, how)
    time, rows, breaks, seen = clock
    kept = np.isfinite(values[rows])
    missing = int(np.count_nonzero(~kept))
    said = [why_this, *said, absent]
    if missing and not absent:
        said.append(f"{missing} values missing" if missing > 1 else "1 value missing")
    time, rows = time[kept], rows[kept]
    values = values[rows]
    if values.size < 2:
        raise RecordError(f"{table.source}: a single sample is not a record.")
    # A bad sample says nothing of the unit.
    calm = np.delete(np.arange(values.size), spikes(time, values))
    unit, why = _unit_of(table, column, how, time[calm], values[calm])
    values = values * unit.factor
    if unit.quantity in POSITIONS:
        is_angle = unit.quantity == "angle"
        values, turn, cuts = unwrapped(values, 2.0 * np.pi if is_angle else None)
        at_end = f"the end of its range ({cuts} times, {turn:.6g} {unit.text})"
        where = f"a whole turn ({cuts} times)" if is_angle else at_end
        said += [f"put together again where it was cut at {where}"] if cuts else []
    attrs: dict[str, Any] = {
        "source": table.source,
        "signal": unit.quantity,
        "time_column": time_column.name if time_column else f"none, {1.0 / np.median(np.diff(time)):g} Hz",
        "time_unit_in_file": time_unit,
        "angle_column": column.name,
        "angle_unit_in_file": unit.text,
        "clock": "; ".join(seen),
        "reading": "; ".join(text for text in (*said, why) if text),
    }
    if breaks:
        attrs["breaks"] = list(breaks)
    if how.signal == lab.ACCELEROMETER:
        record = as_felt(time, values, attrs, float(how.distance or 0.0))
    else:
        record = as_position(time, values, unit, attrs, how.length)
    return with_inputs(record, table, rows, how)
