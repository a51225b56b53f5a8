"""Tables of numbers from files of many formats; the content decides, not the name."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, time as clock_time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.numbers import is_missing, is_number
from sysid_trib.records.probe import check_binary
from sysid_trib.records.text import check_width, header_names, json_columns, json_content, read_text

# Attributes of HDF5 that hold a unit.
UNIT_ATTRIBUTES = ("units", "unit")
ColumnValues = dict[str, Any]


@dataclass(frozen=True)
class FileTable:
    """What a file holds.

    Attributes
    ----------
    columns : dict of str to array
        Columns by name, in the order of the file.
    units : dict of str to str
        Their units, where the file states them apart from the names.
    notes : tuple of str
        What else it says: comment lines, texts and scalars as `name = value`.
    made : dict of str to (str, str)
        Columns that a formula made, not the file: what stands for the name and unit of a header.
    """

    columns: ColumnValues
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    made: dict[str, tuple[str, str]] = field(default_factory=dict)


def read_table(path: Path) -> FileTable:
    """Read every column of a file.

    Parameters
    ----------
    path : path
        The file; its content decides how it is read.

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        The file is empty, binary, truncated or holds no table; the message names it.
    """
    check_is_file(path)
    try:
        with path.open("rb") as file:
            head = file.read(1024)
        if not head.strip():
            raise RecordError(f"{path.name}: the file is empty.")
        reader = _reader(head, path)
        if reader is not _read_text:
            check_binary(path, reader.__name__)
        table = reader(path)
    except (RecordError, UsageError):
        raise
    except ImportError as error:
        package = f"the package {error.name}" if error.name else "a further package"
        raise RecordError(
            f"{path.name}: to read this format {package} is needed; install it with "
            "pip install pyarrow npTDMS."
        ) from error
    except PermissionError:
        raise RecordError(f"{path}: you may not read this file; change its permissions.") from None
    # Readers of foreign formats meet a damaged file with any exception at all.
    except Exception as error:
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise RecordError(f"{path.name}: cannot be read, it seems damaged or cut off ({reason}).") from error
    columns = {name: _native(column) for name, column in table.columns.items() if not _is_nested(column)}
    table = replace(table, columns=columns)
    if not any(np.size(column) for column in table.columns.values()):
        raise RecordError(f"{path.name}: there are no numbers in it.")
    check_width(path, len(table.columns))
    return table


def check_is_file(path: Path) -> None:
    """Refuse what cannot be read, or what would be waited for without end.

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        It is a folder, a pipe or a device.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        raise UsageError(f"{path}: there is no such file.") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}); name another file.") from None
    if path.is_dir():
        raise RecordError(f"{path}: this is a directory; name a file in it.")
    if not path.is_file():
        raise RecordError(
            f"{path}: this is a pipe or a device, not a file; save what it gives as a file first."
        )


def _native(column: Any) -> Any:
    """A column in the machine's own order of bytes: not all that follows knows the other one."""
    values = np.asarray(column)
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def _is_nested(column: Any) -> bool:
    """True if the cells of a column are lists, as netCDF and Parquet can have them."""
    values = np.asarray(column)
    return values.dtype.kind == "O" and any(isinstance(cell, np.ndarray | list | dict) for cell in values)


def is_hdf5(path: Path) -> bool:
    """True if a file is one of HDF5, by its beginning."""
    with path.open("rb") as file:
        return _is_hdf5(file.read(1024))


def _is_hdf5(head: bytes) -> bool:
    return head.startswith((b"\x89HDF", b"MATLAB 7.3")) or head[512:516] == b"\x89HDF"


def _reader(head: bytes, path: Path) -> Callable[[Path], FileTable]:
    if _is_hdf5(head):
        return read_netcdf if path.suffix in (".nc", ".nc4", ".cdf") else read_hdf5
    if head.startswith(b"\xd0\xcf\x11\xe0"):
        raise RecordError(
            f"{path.name}: this is a workbook of the old format (.xls); save it as .xlsx or CSV."
        )
    # Bytes of an archive in which the name of its first member is.
    if head.startswith(b"PK") and b".npy" in head[:128]:
        return read_numpy
    readers = {
        b"MATLAB 5.0": read_matlab,
        b"\x93NUMPY": read_numpy,
        b"CDF": read_netcdf,
        b"PK": read_excel,
        b"PAR1": read_parquet,
        b"TDSm": read_tdms,
    }
    for start, reader in readers.items():
        if head.startswith(start):
            return reader
    if path.suffix == ".mat" and b"\0" in head:
        return read_matlab
    return _read_text


def _read_text(path: Path) -> FileTable:
    content = json_content(path)
    if content is None:
        return _from_frame(*read_text(path))
    return FileTable(dict(json_columns(content)), {}, tuple(_notes(content)))


def _from_frame(frame: pd.DataFrame, names: list[str] | None, notes: Sequence[str] = ()) -> FileTable:
    """Columns by their names, or else by number from 0."""
    columns: ColumnValues = {}
    for index, name in zip(range(frame.shape[1]), names or map(str, range(frame.shape[1])), strict=False):
        columns[name if name and name not in columns else f"{name}#{index}"] = frame.iloc[:, index].to_numpy()
    return FileTable(columns, {}, tuple(notes))


def read_excel(path: Path) -> FileTable:
    """The sheet with the most rows of numbers."""
    sheets = pd.read_excel(path, header=None, engine="openpyxl", sheet_name=None)
    cut = [sheet.dropna(how="all").dropna(axis=1, how="all") for sheet in sheets.values()]
    parts = [(sheet, sheet.map(_is_number)) for sheet in cut if sheet.size]
    counts = [int(numbers.any(axis=1).sum()) for _, numbers in parts]
    if not any(counts):
        raise RecordError(f"{path.name}: no rows of numbers were found on its sheets.")
    sheet, numbers = parts[int(np.argmax(counts))]
    full = np.flatnonzero(numbers.all(axis=1))
    some = np.flatnonzero(numbers.any(axis=1))
    start = int(full[0] if full.size else some[0])
    while start > 0 and numbers.iloc[start - 1].any() and not sheet.iloc[start - 1].map(_is_text).any():
        start -= 1
    # What stands below the numbers is no row of them: a text where they have a number.
    texts = sheet.map(_is_text)
    below = np.flatnonzero((texts & numbers.iloc[start]).iloc[start:].any(axis=1))
    stop = (
        start + int(below[0]) if below.size and not _goes_on(numbers, start + int(below[0])) else len(sheet)
    )
    notes = [" ".join(str(cell) for cell in row if cell == cell) for row in sheet.iloc[:start].to_numpy()]
    names = header_names(
        [[_cell(cell) for cell in row] for row in sheet.iloc[max(0, start - 2) : start].to_numpy()]
    )
    return _from_frame(sheet.iloc[start:stop].infer_objects(), names, notes)


def _goes_on(numbers: pd.DataFrame, row: int) -> bool:
    """True if more rows of numbers follow below a row than a summary has."""
    # Rows of a summary below the numbers, at most.
    return int(numbers.iloc[row:].any(axis=1).sum()) > 20


def _cell(cell: Any) -> str:
    return str(cell).strip() if cell is not None and cell == cell else ""


def _is_text(cell: Any) -> bool:
    """True if a cell holds words: neither a number nor a sign of a missing one."""
    return isinstance(cell, str) and not is_number(cell) and not is_missing(cell)


def _is_number(cell: Any) -> bool:
    """True if a cell holds a number, as such or as a text, or a time."""
    if isinstance(cell, str):
        return is_number(cell)
    return isinstance(cell, (int, float, datetime, clock_time)) and cell == cell


def read_parquet(path: Path) -> FileTable:
    """The columns of a Parquet file."""
    frame = pd.read_parquet(path)
    # Times may be its index.
    frame = frame.reset_index(drop=isinstance(frame.index, pd.RangeIndex))
    return _from_frame(frame, list(map(str, frame.columns)))


def read_netcdf(path: Path) -> FileTable:
    """The vectors of a netCDF file, of either version."""
    import xarray as xr

    with path.open("rb") as file:
        engine = "scipy" if file.read(3) == b"CDF" else "h5netcdf"
    # Of HDF5 without dimensions, so that it has some.
    named: dict[str, Any] = {"phony_dims": "sort"} if engine == "h5netcdf" else {}
    with xr.open_dataset(path, engine=engine, decode_times=False, **named) as dataset:
        columns = {str(name): item.to_numpy() for name, item in dataset.variables.items() if item.ndim == 1}
        units = {name: str(dataset[name].attrs.get("units", "")) for name in columns}
    return FileTable(columns, units)


def read_matlab(path: Path) -> FileTable:
    """The vectors in the variables of a MATLAB file."""
    from scipy.io import loadmat

    content = {k: v for k, v in loadmat(path, simplify_cells=True).items() if not k.startswith("__")}
    return FileTable(dict(_flatten(content)), {}, tuple(_notes(content)))


def read_numpy(path: Path) -> FileTable:
    """The vectors in the array of a .npy, or in the arrays of an .npz; what they pickled is not read."""
    loaded = np.load(path, allow_pickle=False)
    arrays = {"data": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
    content = {
        name: {field: array[field] for field in array.dtype.names} if array.dtype.names else array
        for name, array in arrays.items()
    }
    scalars = {name: array.item() for name, array in arrays.items() if array.size == 1}
    return FileTable(dict(_flatten(content)), {}, tuple(_notes(scalars)))


def _notes(value: Any, name: str = "") -> Iterator[str]:
    """Scalars and texts, as `name = value`."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _notes(item, str(key))
    elif isinstance(value, (str, int, float, np.number)):
        yield f"{name} = {value}"


def _flatten(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Vectors in structs, cells and matrices, named like `data.Y[0]`; samples run along the longer side."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flatten(item, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for index, item in enumerate(value):
            yield from _flatten(item, f"{name}[{index}]")
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiubmM":
        value = np.squeeze(value)
        if value.ndim == 1:
            yield name, value
        elif value.ndim == 2:
            for index, row in enumerate(value if value.shape[1] > value.shape[0] else value.T):
                yield f"{name}[{index}]", row


def read_hdf5(path: Path) -> FileTable:
    """The vectors in the datasets of an HDF5 file, MATLAB's 7.3 among them."""
    import h5py

    units: dict[str, str] = {}
    notes: list[str] = []

    def content(item: Any, file: Any) -> Any:
        facts = {key: _plain(value) for key, value in item.attrs.items() if np.ndim(value) == 0}
        unit = next((value for key, value in facts.items() if key.lower() in UNIT_ATTRIBUTES), "")
        notes.extend(f"{key} = {value}" for key, value in facts.items() if key.lower() not in UNIT_ATTRIBUTES)
        if isinstance(item, h5py.Group):
            return {key: content(item[key], file) for key in item if not key.startswith("#")}
        if h5py.check_ref_dtype(item.dtype) is not None:
            return [content(file[reference], file) for reference in np.ravel(item[()])]
        name = item.name.strip("/").replace("/", ".")
        if unit:
            units[name] = str(unit)
        if item.attrs.get("MATLAB_class") == b"char" or item.shape is None:
            return None
        values = item[()]
        if np.size(values) == 1:
            notes.append(f"{name.rpartition('.')[2]} = {_plain(np.ravel(values)[0])}")
        if item.dtype.names:
            return {field: values[field] for field in item.dtype.names}
        return _named_columns(values, item.attrs)

    with h5py.File(path, "r") as file:
        columns = dict(_flatten(content(file, file)))
    return FileTable(columns, units, tuple(notes))


def _plain(value: Any) -> Any:
    return value.decode(errors="replace") if isinstance(value, bytes) else value


def _named_columns(values: Any, attrs: Any) -> Any:
    """The columns of a table by the names that an attribute of it lists; else the table."""
    for names in attrs.values():
        if np.ndim(values) == 2 and np.ndim(names) == 1 and np.asarray(names).dtype.kind in "OSU":
            for table in (values, values.T):
                if table.shape[1] == len(names):
                    return {str(_plain(name)): column for name, column in zip(names, table.T, strict=True)}
    return values


def read_tdms(path: Path) -> FileTable:
    """The channels of a TDMS file."""
    from nptdms import TdmsFile

    columns: ColumnValues = {}
    units: dict[str, str] = {}
    for group in TdmsFile.read(path).groups():
        for channel in group.channels():
            name = f"{group.name}/{channel.name}"
            if "wf_increment" in channel.properties and f"{group.name}/time" not in columns:
                columns[f"{group.name}/time"] = channel.time_track()
            columns[name] = channel[:]
            units[name] = str(channel.properties.get("unit_string", ""))
    return FileTable(columns, units)
