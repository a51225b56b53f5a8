"""Inputs of a record from columns of its file, or of another one with a clock of its own."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.columns import Chosen, find_column, has_column, time_of_column
from sysid_trib.records.expression import evaluated, is_expression
from sysid_trib.records.headers import unit_of_column
from sysid_trib.records.inputs import ROLE
from sysid_trib.records.numbers import numbers
from sysid_trib.records.reading import Reading, opened
from sysid_trib.records.row_times import row_times
from sysid_trib.records.tables import FileTable, read_table
from sysid_trib.records.units import SignalUnit


def input_columns(inputs: Mapping[str, str | int], table: FileTable, source: str) -> list[str]:
    """The columns of a table that are inputs, and so no signal."""
    columns = [wanted for _, wanted, other in _sources(inputs) if other is None]
    return [find_column(table, wanted, source) for wanted in columns if not _is_formula(table, wanted)]


def inputs_near(inputs: Mapping[str, str | int], record: Path) -> dict[str, str | int]:
    """Inputs of other files, looked for in its folder too; a `*` in a name stands for the record's own.

    Of several files that fit, as `*_y.mat`, it is the one whose name agrees with the record's for longest.

    Raises
    ------
    UsageError
        There is no such file, or several agree as long.
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
    common = [_letters_alike(file.name, record.name) for file in fitting]
    nearest = [file for file, length in zip(fitting, common, strict=True) if length == max(common)]
    if len(nearest) != 1:
        said = ", ".join(file.name for file in nearest[:2]) or "none"
        raise UsageError(
            f"{record.name}: the input's file {pattern} must fit one file in {folder}, not {said}."
        )
    return nearest[0]


def _letters_alike(first: str, second: str) -> int:
    """From the beginning of both."""
    return len(list(takewhile(lambda pair: pair[0] == pair[1], zip(first, second, strict=False))))


def with_inputs(record: xr.Dataset, table: FileTable, rows: Index, how: Reading, source: str) -> xr.Dataset:
    """A record with its inputs, each by its name.

    Parameters
    ----------
    record : Dataset
        `angle(time)`.
    table : FileTable
        That it is from.
    rows : (time,) array of int
        Of the table, one for each time.
    how : Reading
        `inputs` are columns by name or number, formulas of them, or of another file as `base.mat:y`;
        `between` is what is between their samples.
    source : str
        Of whom sentences speak.

    Returns
    -------
    Dataset
        Angles in rad; other inputs in the unit of their column. An input of another file has a time of its
        own, `NAME_time`.

    Raises
    ------
    UsageError
        There is no such column or file.
    RecordError
        The input is constant, or not a number at each time.
    """
    if not how.inputs:
        return record
    record = record.assign_attrs(input_columns=json.dumps(dict(how.inputs)), between=how.between)
    for name, wanted, other in _sources(how.inputs):
        if other is None:
            whole, unit = _column(table, wanted, source)
            time, values = None, whole[rows]
        else:
            time, values, unit = _of_file(other, wanted, how)
        if not np.all(np.isfinite(values)):
            raise RecordError(
                f"{source}: the input {name} is not a number at each time; cut the record (--window), or "
                "fill it in."
            )
        # An input that varies by less than this part of its size is constant.
        if np.ptp(values) <= 1e-12 * np.max(np.abs(values), initial=0.0):
            raise RecordError(
                f"{source}: the input {name} is {values[0]:g} throughout and drives nothing; name another "
                "column, or leave it out."
            )
        attrs: dict[str, Any] = {"role": ROLE, "between": how.between, "long_name": f"input {name}"}
        if unit is not None:
            is_angle = unit.position == "rad"
            values = values * unit.factor if is_angle else values
            attrs["units"] = f"rad{unit.text[len(unit.text.partition('/')[0]) :]}" if is_angle else unit.text
        dim = "time" if time is None else f"{name}_time"
        record[name] = (dim, values, attrs)
        if time is not None:
            record = record.assign_coords({dim: (dim, time, {"units": "s"})})
    return record


def _is_formula(table: FileTable, wanted: str | int) -> bool:
    return is_expression(wanted) and not has_column(table, wanted)


def _column(table: FileTable, wanted: str | int, source: str) -> tuple[Array, SignalUnit | None]:
    """Values and unit of a column; of a formula of columns, `35.15*vir`, no unit follows."""
    if _is_formula(table, wanted):
        return evaluated(table, str(wanted), "--input", source)[0], None
    column = find_column(table, wanted, source)
    return numbers(table.columns[column], column, source), unit_of_column(table, column)


def _sources(inputs: Mapping[str, str | int]) -> Iterator[tuple[str, str | int, Path | None]]:
    """Name, column, and the other file where it is of one."""
    for name, wanted in inputs.items():
        file, colon, column = str(wanted).rpartition(":")
        yield (name, column, Path(file)) if colon and file else (name, wanted, None)


def _of_file(path: Path, wanted: str | int, how: Reading) -> tuple[Array, Array, SignalUnit | None]:
    """Times, values and unit of a column of another file."""
    if not path.is_file():
        raise UsageError(f"The input's file {path} does not exist; give FILE:COLUMN.")
    with opened(path) as file:
        table = read_table(file)
    column = find_column(table, wanted, path.name)
    values = numbers(table.columns[column], column, path.name)
    columns = Chosen(time_of_column(column, table), column)
    clock, _, _ = row_times(table, columns, replace(how, time=None), values, path.name)
    return clock.time, values[clock.rows], unit_of_column(table, column)
