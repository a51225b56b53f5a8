"""Known constants of a run, such as a gain, a load or a temperature: one number for all samples."""

import re
from collections.abc import Mapping

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import UsageError, did_you_mean
from sysid_trib.records.roles import CONSTANT, ROLE
from sysid_trib.records.tables import FileTable

# Relative variation of a constant due to rounding.
CONSTANT_BUT_ROUNDED = 1e-9
_NOTED = re.compile(r"\W*(?P<name>[^\W\d]\w*)\s*[=:]\s*(?P<value>[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?)", re.I)


def with_constants(
    record: xr.Dataset, table: FileTable, rows: Index, wanted: Mapping[str, str | float]
) -> xr.Dataset:
    """Return a record with its known constants as constant inputs.

    Parameters
    ----------
    record : Dataset
        `angle(time)`.
    table : FileTable
        Table of the record.
    rows : (time,) array of int
        Rows of the table, one for each time.
    wanted : mapping of str to str or float
        Wanted constants by their names in formulas. Each is a number, or the name of a constant column, or of
        a number that the file states once (`kp = 100` in a comment, a scalar of MATLAB).

    Raises
    ------
    UsageError
        The file has no such column or number, or the column varies.
    """
    for name, value in wanted.items():
        number, units = _number(table, name, value, rows, record.time.values.astype(float))
        attrs = {"role": ROLE, "between": "held", "long_name": f"constant {name}", CONSTANT: "yes"}
        if units:
            attrs["units"] = units
        record[name] = ("time", np.full(record.sizes["time"], number), attrs)
    return record


def _number(
    table: FileTable, name: str, wanted: str | float, rows: Index, time: Array
) -> tuple[float, str | None]:
    """Return the value and unit of a constant of a file."""
    if isinstance(wanted, int | float):
        if not np.isfinite(wanted):
            raise UsageError(
                f"{table.source}: the constant {name} is {wanted}, which is no finite number; give its value "
                f"(--constant {name}=100; constants= in Python)."
            )
        return float(wanted), None
    column = table.match(wanted)
    if column is None:
        noted = _noted(table)
        if wanted in noted:
            return noted[wanted], None
        offered = [*(other.name for other in table.columns), *noted]
        raise UsageError(
            f"{table.source}: the constant {name} is not known; there is no column and no "
            f"number '{wanted}'{did_you_mean(wanted, offered) or '.'} Give it by "
            f"--constant {name}=VALUE (constants= in Python), or the name of one of {', '.join(offered)}."
        )
    values = column.numbers[rows]
    known = values[np.isfinite(values)]
    if not known.size:
        raise UsageError(
            f"{table.source}: column '{column.name}' contains no number for the constant {name}."
        )
    if np.ptp(known) > CONSTANT_BUT_ROUNDED * np.max(np.abs(known)):
        finite = np.flatnonzero(np.isfinite(values))
        at = finite[np.flatnonzero(known != known[0])[0]]
        raise UsageError(
            f"{table.source}: the constant {name} changes within the run, from {known[0]:.12g} to "
            f"{values[at]:.12g} at {time[at]:.6g} s; cut the record there (--window), or name it as an "
            f"input (--input {name}={wanted})."
        )
    return float(known[0]), None if column.unit is None else column.unit.text


def _noted(table: FileTable) -> dict[str, float]:
    """Return the numbers that a file states once."""
    stated = (match for note in table.notes if (match := _NOTED.match(note)))
    return {match["name"]: float(match["value"]) for match in stated}
