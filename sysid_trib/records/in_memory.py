"""Records from memory (pandas, xarray, arrays): the same names and units as in files."""

import os
from collections.abc import Hashable, Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.records import clock, units as lab
from sysid_trib.records.column import Column
from sysid_trib.records.signal import ANGLE_UNIT

ANGLE = "angle"
TIME = "time"
# Forms of a record, for messages.
GIVE_A_RECORD = "give (t, angle), a pandas Series or DataFrame with times, or a Dataset with angle(time)"


def as_record(given: Any) -> Any:
    """Convert an object in memory into a Dataset with `angle(time)`; dates become s from the first on.

    Parameters
    ----------
    given : Dataset, DataArray, pandas Series or DataFrame, dict, (t, angle), or (sample, 2) array
        An object over time, or with a column of times. In a DataFrame or dict of columns, the signal is the
        column `angle`, or the only one that is an angle, or the only one. An array has samples along one
        dimension; the other contains times and angles. Names may state units as in files, `time (ms)`,
        `angle (deg)`. Any other object is returned unchanged.

    Raises
    ------
    UsageError
        The signal is not clear, there are no times, or their unit is implausible.
    """
    if isinstance(given, Mapping) and not isinstance(given, xr.Dataset | xr.DataTree):
        given = pd.DataFrame(dict(given))
    if isinstance(given, pd.DataFrame):
        return _of_frame(given)
    if isinstance(given, pd.Series):
        name = ANGLE if given.name is None else given.name
        return _of_columns(_of_index(given.index, "Series"), _column(name, given), "Series")
    if isinstance(given, np.ndarray):
        # A matrix has columns of two dimensions; masked values are missing.
        plain = np.ma.filled(given.astype(float), np.nan) if np.ma.isMaskedArray(given) else np.asarray(given)
        if plain.ndim == 2 and plain.shape[0] == 2 and plain.shape[1] > 2:
            plain = plain.T
        if plain.ndim == 1:
            raise UsageError(
                "An array of one dimension has no times: give (t, angle), with t = np.arange(len(angle)) / "
                "sampling_rate."
            )
        if plain.ndim != 2 or plain.shape[1] != 2:
            raise UsageError(f"An array is a record as (sample, 2), times and angles, not as {plain.shape}.")
        return _of_columns(_column(TIME, plain[:, 0]), _column(ANGLE, plain[:, 1]), "array")
    if isinstance(given, xr.DataArray):
        if given.ndim != 1:
            raise UsageError(f"A DataArray must have time as its only dimension; this one has {given.dims}.")
        given = _of_data_array(given)
    if is_pair(given):
        return _of_pair(*given)
    return _in_numbers(given) if isinstance(given, xr.Dataset) else given


def is_pair(given: Any) -> bool:
    """Return true if an object is times and angles: two columns of numbers or dates, and not two runs."""
    if not isinstance(given, tuple | list) or len(given) != 2:
        return False
    if all(_has_own_times(part) for part in given) and not _holds_times(given[0]):
        return False
    return all(_is_column(part) for part in given)


def _has_own_times(given: Any) -> bool:
    """Return true if an object is a signal over an index, which may contain its times."""
    if isinstance(given, xr.DataArray):
        return given.ndim == 1 and given.dims[0] in given.coords
    return isinstance(given, pd.Series)


def _holds_times(given: xr.DataArray | pd.Series) -> bool:
    """Return true if the values of a signal over an index can themselves be times.

    Times are named or dated, or they rise and state no other quantity.
    """
    column = _column("" if given.name is None else given.name, given)
    if _names_time(column) or lab.plain_unit(column.stated) in lab.TIME_UNITS:
        return True
    states_another = column.unit is not None or lab.names_quantity(column.base) != ""
    return column.is_plain and not states_another and bool(np.all(np.diff(column.numbers) > 0.0))


def _is_column(given: Any) -> bool:
    """Return true if an object is a single column of numbers or dates instead of a record."""
    if isinstance(given, np.ndarray | xr.DataArray):
        return given.ndim == 1
    if isinstance(given, pd.Series | pd.Index):
        return True
    return isinstance(given, list | tuple | range) and all(np.ndim(part) == 0 for part in given[:3])


def _of_pair(times: Any, signal: Any) -> xr.Dataset:
    """Return the record of times and a signal; their names state their units.

    Raises
    ------
    UsageError
        Their lengths differ.
    """
    if len(times) != len(signal):
        raise UsageError(
            f"(t, angle) has {len(times)} times and {len(signal)} angles; give one time an angle."
        )
    columns = []
    for usual, given in ((TIME, times), (ANGLE, signal)):
        name = getattr(given, "name", None)
        values = given if hasattr(given, "dtype") else np.asarray(given)
        columns.append(_column(usual if name is None else name, values))
    time, angle = columns
    return _of_columns(time, angle, "pair")


def as_decays(given: Any, function: str) -> xr.Dataset | list[xr.Dataset]:
    """Return the given record, or the list of several, as Datasets with `angle(time)`.

    Parameters
    ----------
    given : RecordsLike
        A record as `as_record` takes it, or several of them.
    function : str
        Name of the calling function, for the message.

    Returns
    -------
    Dataset or list of Dataset

    Raises
    ------
    UsageError
        The argument is another object, or a record without times.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time = np.arange(0.0, 10.0, 0.01)
    >>> decays = st.records.as_decays([(time, np.cos(time)), (time, np.sin(time))], "my_function")
    >>> [decay.angle[0].item() for decay in decays]
    [1.0, 0.0]
    """
    if _is_record(given):
        return _checked_record(given, function)
    if isinstance(given, Iterable) and not isinstance(given, str | bytes | Mapping | xr.DataTree):
        return [_checked_record(record, function) for record in given]
    return _checked_record(given, function)


def one_record(given: Any, function: str) -> xr.Dataset:
    """Return the one given record, as `as_decays` does.

    Parameters
    ----------
    given : RecordsLike
        A record as `as_record` takes it.
    function : str
        Name of the calling function, for the message.

    Returns
    -------
    Dataset

    Raises
    ------
    UsageError
        The argument is another object, or several records.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time = np.arange(0.0, 10.0, 0.01)
    >>> record = st.records.one_record((time, np.cos(time)), "my_function")
    >>> record.angle.dims, record.angle.attrs["units"]
    (('time',), 'rad')
    """
    records = as_decays(given, function)
    runs = [records] if isinstance(records, xr.Dataset) else records
    if len(runs) != 1:
        raise UsageError(f"{function} takes one record, not {len(runs)}; call it for each.")
    return runs[0]


def _is_record(given: Any) -> bool:
    """Return true if an object represents one record."""
    if isinstance(given, xr.Dataset | xr.DataArray | pd.DataFrame | pd.Series | np.ndarray):
        return True
    if isinstance(given, Mapping) and not isinstance(given, xr.DataTree):
        # Columns by their names.
        return bool(given) and all(_is_column(column) for column in given.values())
    return is_pair(given)


def _checked_record(given: Any, function: str) -> xr.Dataset:
    """Return one record as a Dataset; raise an error that describes any other object."""
    if isinstance(given, str | os.PathLike):
        raise UsageError(
            f"{function} takes a record, not the name of a file; read it: "
            f"st.free_decay(st.read_record({str(given)!r}))."
        )
    if not _is_record(given):
        raise UsageError(f"{function} takes a record: {GIVE_A_RECORD}; not {_kind(given)}.")
    record: xr.Dataset = as_record(given)
    if "angle" not in record.variables:
        if "coefficient" in record:
            raise UsageError(f"{function} takes a record, not a result; give the record of the result.")
        names = [str(name) for name, values in record.data_vars.items() if values.ndim == 1]
        remedy = f"rename its signal: record.rename({names[0] if len(names) == 1 else 'NAME'}='angle')"
        held = ", ".join(map(str, record.data_vars)) or "nothing"
        raise UsageError(
            f"{function} takes a Dataset with angle(time), and this one contains {held}; {remedy}."
        )
    return record


def _kind(given: Any) -> str:
    """Name the kind of object given in place of a record, in a few words."""
    if isinstance(given, xr.DataTree):
        return "a result"
    return f"an object of type {type(given).__name__}"


def _of_frame(frame: pd.DataFrame) -> xr.Dataset:
    """Return the record of a DataFrame; its times are a column or the index."""
    columns = {name: _column(name, frame.iloc[:, at]) for at, name in enumerate(frame.columns)}
    exact = [column for name, column in columns.items() if name == TIME]
    index_is_time = isinstance(frame.index, pd.DatetimeIndex | pd.TimedeltaIndex) or (
        frame.index.name is not None and _names_time(_column(frame.index.name, frame.index))
    )
    named = exact or [c for c in columns.values() if not index_is_time and _names_time(c)]
    if len(named) > 1:
        listed = ", ".join(column.name for column in named)
        raise UsageError(f"Which column holds the times? Name it time; there are {listed}.")
    time = named[0] if named else _of_index(frame.index, "DataFrame")
    others = [column for column in columns.values() if column is not time]
    # Try the name as it is, the name without its unit, and the only angle by unit or by name.
    for pool in (
        [column for column in others if column.name == ANGLE],
        [column for column in others if column.base == ANGLE],
        others if len(others) == 1 else [],
        [column for column in others if column.quantity == ANGLE],
    ):
        if len(pool) == 1:
            return _of_columns(time, pool[0], "DataFrame")
    names = ", ".join(column.name for column in columns.values())
    raise UsageError(f"Which column is the signal? Name it angle; there are {names}.")


def _names_time(column: Column) -> bool:
    """Return true if a header is that of times, also a short one such as `t`."""
    return column.is_dated or lab.is_time(column.base, lab.plain_unit(column.stated))


def _of_index(index: pd.Index, kind: str) -> Column:
    """Return the times in an index.

    Raises
    ------
    UsageError
        The index counts the rows, and no name shows that it contains times.
    """
    if isinstance(index, pd.MultiIndex):
        raise UsageError(f"The index of this {kind} has several levels; make the times alone its index.")
    column = _column(TIME if index.name is None else index.name, index)
    named = index.name is not None and _names_time(column)
    counts = column.is_plain and np.array_equal(column.cells, np.arange(len(index)))
    if counts and not named:
        raise UsageError(
            f"This {kind} has no times: its index counts the rows. Give the times (s) as its index, such as "
            "pd.Series(angle, index=np.arange(len(angle)) / sampling_rate)."
        )
    return column


def _column(name: Hashable, values: Any) -> Column:
    """Return the column of some values under a name that may contain a unit, with dates in UTC."""
    stated = str(getattr(values, "attrs", {}).get("units", ""))
    if isinstance(values, pd.PeriodIndex):
        values = values.to_timestamp()
    if isinstance(values, pd.Series | pd.Index):
        if isinstance(values.dtype, pd.DatetimeTZDtype):
            values = pd.DatetimeIndex(values).tz_convert("UTC").tz_localize(None)
        numeric = pd.api.types.is_numeric_dtype(values.dtype)
        values = values.to_numpy(dtype=float, na_value=np.nan) if numeric else values.to_numpy()
    return Column.of_file(str(name), np.asarray(values), "record", stated)


def _of_columns(time: Column, signal: Column, kind: str) -> xr.Dataset:
    """Return the record of a column of times and one of the signal.

    Raises
    ------
    UsageError
        The unit of the times is unknown, no laboratory has such a period in s, or the signal is neither an
        angle nor a displacement.
    """
    stated = "" if time.is_dated else lab.plain_unit(time.stated)
    if stated and stated not in lab.TIME_UNITS:
        raise UsageError(
            f"The unit {time.stated!r} of the times ({time.name}) is unknown; convert them to s, or name "
            f"them with one of {lab.OFFERED_TIME_UNITS}."
        )
    seconds = time.numbers * lab.TIME_UNITS[stated or "s"]
    unit = signal.unit
    quantity = unit.quantity if unit and unit.known else lab.names_quantity(signal.base)
    if quantity not in ("", *lab.POSITIONS):
        raise UsageError(
            f"The signal of this {kind} ({signal.name}) is of a quantity ({quantity}) that must be "
            "integrated; save it as a file for read_record, or give an angle or a displacement."
        )
    values = signal.numbers * (unit.factor if unit else 1.0)
    rises = np.all(np.isfinite(values)) and np.all(np.diff(seconds) > 0.0)
    if not (time.is_dated or stated) and rises and clock.are_whole(seconds):
        remedy = 'name them with their unit, such as "time (ms)", or convert them to s.'
        clock.check_period(seconds, values, True, f"This {kind}", remedy)
    attrs = {"units": unit.position if unit else ANGLE_UNIT}
    return xr.Dataset({"angle": ("time", values, attrs)}, {"time": ("time", seconds, {"units": "s"})})


def _of_data_array(given: xr.DataArray) -> xr.Dataset:
    """Return the record of a DataArray over one dimension; names may state units that attrs do not."""
    dim = given.dims[0]
    name = ANGLE if given.name is None else given.name
    record = given.rename({dim: TIME}).rename(ANGLE).to_dataset()
    if TIME not in record.coords:
        raise UsageError(f"This DataArray has no times: give it the coordinate {dim}, in s.")
    stamps = record[TIME]
    if stamps.dtype.kind not in "mM" and "units" not in stamps.attrs:
        stated = lab.plain_unit(lab.split_header(str(dim))[1])
        if stated in lab.TIME_UNITS:
            seconds = stamps.values.astype(float) * lab.TIME_UNITS[stated]
            record = record.assign_coords(time=(TIME, seconds, stamps.attrs | {"units": "s"}))
    unit = Column.of_file(str(name), np.zeros(0), "record").unit
    if unit is not None and "units" not in given.attrs and unit.quantity in lab.POSITIONS:
        values = record[ANGLE].values * unit.factor
        record[ANGLE] = (TIME, values, given.attrs | {"units": unit.position})
    return record


def _in_numbers(record: xr.Dataset) -> xr.Dataset:
    """Convert dates of a Dataset to s from the first on, and numbers to the native byte order.

    Raises
    ------
    UsageError
        Some of its clocks contain dates and others numbers.
    """
    clocks = [str(name) for name in record.coords if name == TIME or str(name).endswith("_time")]
    dated = [name for name in clocks if record[name].dtype.kind == "M"]
    if dated and len(dated) < len(clocks):
        others = ", ".join(name for name in clocks if name not in dated)
        raise UsageError(
            f"In this record {dated[0]} contains dates and {others} none: their start is unknown; give "
            "both in s from one instant."
        )
    made = {}
    if TIME in clocks and record[TIME].size:
        origin = record[TIME].values[0]
        for name in clocks:
            if record[name].dtype.kind in "mM":
                seconds = (record[name].values - origin) / np.timedelta64(1, "ns") * 1e-9
                made[name] = (record[name].dims, seconds, {"units": "s"})
    for key, variable in record.variables.items():
        values = variable.dtype
        if values.kind in "fiu" and (not values.isnative or (values.kind == "f" and values.itemsize < 8)):
            made[str(key)] = (variable.dims, variable.values.astype(float), dict(variable.attrs))
    return record.assign({k: v for k, v in made.items() if k not in record.coords}).assign_coords(
        {k: v for k, v in made.items() if k in record.coords}
    )
