"""Readers of many formats: vectors by their names, with units and notes; the content shows the format."""

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from sysid_trib.errors import RecordError
from sysid_trib.records import archives
from sysid_trib.records.text import TextTable, read_text, table_in

# HDF5 attributes that contain a unit.
UNIT_ATTRIBUTES = ("units", "unit")
# Vectors with fewer numbers are not a signal.
FEWEST_OF_A_RECORD = 20
# MATLAB objects without a signal.
WITHOUT_NUMBERS = ("string", "categorical", "datetime", "duration", "function_handle", "containers.Map")
# Largest number of texts in a list that is read as a note.
MOST_TEXTS = 100


class Contents(NamedTuple):
    """Contents of a file.

    Attributes
    ----------
    columns : dict of str to array_like
        Columns by name, in the order of the file.
    units : dict of str to str
        Units of columns, if the file states them separately from the names.
    notes : sequence of str
        Comment lines, and texts and scalars as `name = value`.
    said : sequence of str
        Sentences on what was left out.
    """

    columns: dict[str, Any]
    units: dict[str, str]
    notes: Sequence[str]
    said: Sequence[str] = ()


def reader_of(path: Path) -> Callable[[Path], Contents]:
    """Return the reader of a file, chosen by its first bytes.

    Raises
    ------
    RecordError
        The file is empty, or a workbook of the old format.
    """
    with path.open("rb") as file:
        head = file.read(1024)
    # HDF5 data may start after a block of 512 bytes.
    head = head[512:] if head[512:516] == b"\x89HDF" else head
    if not head.strip():
        raise RecordError(f"{path.name}: the file is empty.")
    if head.startswith(b"\xd0\xcf\x11\xe0"):
        raise RecordError(f"{path.name}: a workbook of the old format (.xls); save it as .xlsx or CSV.")
    archives.refuse_other_kinds(path, head)
    if head.startswith(b"PK") and archives.single_file(path) is not None:
        raise RecordError(f"{path.name}: this is an archive in another one; {archives.UNPACK}.")
    readers = {
        (b"\x89HDF", b"MATLAB 7.3"): read_netcdf if path.suffix in (".nc", ".nc4", ".cdf") else read_hdf5,
        (b"MATLAB 5.0",): read_matlab,
        (b"\x93NUMPY",): read_numpy,
        (b"CDF",): read_netcdf,
        # Bytes of an archive that contain the name of its first member.
        (b"PK",): read_numpy if b".npy" in head[:128] else read_excel,
        (b"PAR1",): read_parquet,
        (b"TDSm",): read_tdms,
    }
    for starts, reader in readers.items():
        if head.startswith(starts):
            return reader
    return read_matlab if path.suffix == ".mat" and b"\0" in head else read_lines


def read_lines(path: Path) -> Contents:
    """Return the tables of a text or JSON file."""
    content = _json_content(path)
    if content is None:
        return _from_table(read_text(path))
    return Contents(dict(_json_columns(content)), {}, _notes(content))


def _json_content(path: Path) -> Any:
    """Read JSON, as one value or one object per line; return None for any other file."""
    content = path.read_bytes().removeprefix(b"\xef\xbb\xbf").strip()
    if not content.startswith((b"{", b"[")) or not content.endswith((b"}", b"]")):
        return None
    lines = content.splitlines()
    # If the first line is complete, the others are rows too.
    for parts in ([content], lines if len(lines) > 1 else []):
        with suppress(ValueError, RecursionError):
            values = [json.loads(part) for part in parts if part.strip()]
            return values[0] if parts[:1] == [content] else values or None
    return None


# Keys under which a channel of JSON has its name and its unit.
CHANNEL_NAMES = ("name", "label", "channel", "title", "id")
CHANNEL_UNITS = ("unit", "units")


def _json_channel(value: Any) -> tuple[str, Any] | None:
    """Return the name, with the unit, and the numbers of a channel; None if a value is not a channel."""
    if not isinstance(value, dict):
        return None
    vectors = [item for item in value.values() if isinstance(item, list) and len(item) > 1]
    name = next((value[key] for key in CHANNEL_NAMES if isinstance(value.get(key), str)), "")
    unit = next((value[key] for key in CHANNEL_UNITS if isinstance(value.get(key), str)), "")
    if len(vectors) != 1 or not name or any(isinstance(item, list | dict) for item in vectors[0]):
        return None
    return (f"{name} ({unit})" if unit else name), np.asarray(vectors[0])


def _json_columns(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield columns of objects, of rows of objects or cells, or of a plain list, named like `run.theta`."""
    channels = [_json_channel(item) for item in value] if isinstance(value, list) else [None]
    if channels and None not in channels:
        yield from filter(None, channels)
    elif isinstance(value, dict):
        names = value.get("columns")
        rows = value.get("data")
        if isinstance(names, list) and isinstance(rows, list) and all(isinstance(row, list) for row in rows):
            # The format of pandas for a split table.
            yield from _json_columns([dict(zip(map(str, names), row, strict=False)) for row in rows], name)
        elif value and all(key.isdigit() for key in value):
            yield from _json_columns(list(value.values()), name)
        else:
            for key, item in value.items():
                yield from _json_columns(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value:
        objects, rows = (all(isinstance(item, kind) for item in value) for kind in (dict, list))
        if objects and all(any(isinstance(part, list) for part in item.values()) for item in value):
            for index, item in enumerate(value):
                yield from _json_columns(item, f"{name or 'data'}[{index}]")
            return
        frame = pd.json_normalize(value) if objects else pd.DataFrame(value)
        # Rows, or a few columns.
        frame = frame.T if rows and len(frame) < frame.shape[1] else frame
        for key, column in frame.items():
            place = f"{name or 'data'}[{key}]" if rows else name or "data"
            yield f"{name}.{key}".removeprefix(".") if objects else place, column.to_numpy()


def _from_table(table: TextTable) -> Contents:
    """Return the columns of a table in a text."""
    return _from_frame(table.frame, table.names, table.notes)._replace(said=table.said)


def _from_frame(frame: pd.DataFrame, names: list[str] | None, notes: Sequence[str] = ()) -> Contents:
    """Return columns by their names, or else by number from 0."""
    columns: dict[str, Any] = {}
    for index, name in zip(range(frame.shape[1]), names or map(str, range(frame.shape[1])), strict=False):
        columns[name if name and name not in columns else f"{name}#{index}"] = frame.iloc[:, index].to_numpy()
    return Contents(columns, {}, notes)


def read_excel(path: Path) -> Contents:
    """Return the sheet with the most rows of numbers, and sheets with the same columns as further runs."""
    tables: dict[str, TextTable] = {}
    for name, sheet in pd.read_excel(path, header=None, engine="openpyxl", sheet_name=None).items():
        cells = sheet.dropna(how="all").dropna(axis=1, how="all").to_numpy()
        texts = [["" if cell != cell else " ".join(str(cell).split()) for cell in row] for row in cells]
        with suppress(RecordError):
            tables[str(name)] = table_in("\n".join(map("\t".join, texts)), path)
    if not tables:
        raise RecordError(f"{path.name}: no rows of numbers were found on its sheets.")
    main = max(tables, key=lambda name: len(tables[name].frame))
    runs = {name: table for name, table in tables.items() if table.names == tables[main].names is not None}
    others = [name for name, table in tables.items() if name not in (main, *runs) and _is_long(table)]
    said = [f"sheet {main} is used, sheet{'s' * (len(others) > 1)} {', '.join(others)} left out"]
    contents = _from_table(tables[main]) if len(runs) < 2 else _side_by_side(runs)
    return contents._replace(said=[*contents.said, *said * bool(others)])


def _is_long(table: TextTable) -> bool:
    """Return true if a table could be a record."""
    return len(table.frame) >= FEWEST_OF_A_RECORD and table.frame.shape[1] > 1


def _side_by_side(runs: Mapping[str, TextTable]) -> Contents:
    """Return the columns of several sheets, one run per sheet, with the sheet's name before the column's."""
    columns: dict[str, Any] = {}
    notes: list[str] = []
    said: list[str] = []
    for number, (sheet, table) in enumerate(runs.items(), 1):
        contents = _from_table(table)
        columns |= {f"Run {number}: {name}": cells for name, cells in contents.columns.items()}
        notes += contents.notes
        said += [f"sheet {sheet}: {text}" for text in contents.said]
    return Contents(columns, {}, notes, [f"each sheet a run ({', '.join(runs)})", *said])


def read_parquet(path: Path) -> Contents:
    """Return the columns of a Parquet file."""
    frame = pd.read_parquet(path)
    # The times may be the index of the table.
    frame = frame.reset_index(drop=isinstance(frame.index, pd.RangeIndex))
    return _from_frame(frame, list(map(str, frame.columns)))


def read_netcdf(path: Path) -> Contents:
    """Return the vectors of a netCDF file, of either version."""
    import xarray as xr

    with path.open("rb") as file:
        engine = "scipy" if file.read(3) == b"CDF" else "h5netcdf"
    # Give dimensions to HDF5 variables without them.
    named: dict[str, Any] = {"phony_dims": "sort"} if engine == "h5netcdf" else {}
    with xr.open_dataset(path, engine=engine, decode_times=False, **named) as dataset:
        columns = {str(name): item.to_numpy() for name, item in dataset.variables.items() if item.ndim == 1}
        units = {name: str(dataset[name].attrs.get("units", "")) for name in columns}
        scalars = {name: item.to_numpy().item() for name, item in dataset.variables.items() if item.ndim == 0}
        notes = _notes({str(name): fact for name, fact in {**dataset.attrs, **scalars}.items()})
    return Contents(columns, units, notes)


def read_matlab(path: Path) -> Contents:
    """Return the vectors in the variables of a MATLAB file."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadWarning

    with warnings.catch_warnings():
        # The reader does not know the names of objects.
        warnings.simplefilter("ignore", MatReadWarning)
        loaded = loadmat(path, simplify_cells=True)
    content = {k: v for k, v in loaded.items() if not k.startswith("__")}
    columns = dict(_flatten(content))
    _check_objects(path, list(_classes_in(content)), columns)
    return Contents(columns, {}, _notes(content))


def _is_object(value: Any) -> bool:
    """Return true if a value is a MATLAB object, of which the file states only the class."""
    return isinstance(value, np.ndarray) and value.dtype.names == ("s0", "s1", "s2", "arr")


def _classes_in(value: Any) -> Iterator[str]:
    """Yield the classes of the objects in a MATLAB file."""
    if _is_object(value):
        yield str(_plain(value["s2"].ravel()[0]))
    elif isinstance(value, dict):
        for item in value.values():
            yield from _classes_in(item)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for item in value:
            yield from _classes_in(item)


def _check_objects(path: Path, kinds: Sequence[str], columns: Mapping[str, Any]) -> None:
    """Raise an error for a MATLAB file whose numbers are in objects, which only MATLAB can read.

    Raises
    ------
    RecordError
        The numbers are in objects; the message states how to save them.
    """
    kinds = [kind for kind in kinds if kind not in WITHOUT_NUMBERS]
    vectors = [values for values in columns.values() if np.size(values) >= FEWEST_OF_A_RECORD]
    # Times alone, such as Simulink's `tout`, are not a record.
    if not kinds or len(vectors) > 1 or any(np.any(np.diff(values) < 0) for values in vectors):
        return
    held = ", ".join(dict.fromkeys(kinds))
    how = {
        "table": "writetable(T, 'record.csv')",
        "timetable": "writetimetable(T, 'record.csv')",
        "Simulink.SimulationOutput": "x = out.NAME; t = x.Time; y = x.Data; save('record.mat', 't', 'y')",
        "Simulink.SimulationData.Dataset": (
            "x = logsout{1}.Values; t = x.Time; y = x.Data; save('record.mat', 't', 'y')"
        ),
    }.get(kinds[0], "t = x.Time; y = x.Data; save('record.mat', 't', 'y')")
    raise RecordError(
        f"{path.name}: contains objects of MATLAB ({held}), which only MATLAB can read; save them there as "
        f"arrays: {how}; or let Simulink save arrays (To Workspace, format Array)."
    )


def read_numpy(path: Path) -> Contents:
    """Return vectors in the array of a .npy, or in the arrays of an .npz; pickled objects are not read."""
    loaded = np.load(path, allow_pickle=False)
    arrays = {"data": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
    scalars = {name: array.item() for name, array in arrays.items() if array.size == 1}
    return Contents(dict(_flatten(arrays)), {}, _notes(scalars))


def _notes(content: Any, name: str = "") -> list[str]:
    """Return scalars and texts, as `name = value`."""
    if isinstance(content, dict):
        return [note for key, item in content.items() for note in _notes(item, str(key))]
    if isinstance(content, list | np.ndarray) and 0 < len(np.atleast_1d(content)) <= MOST_TEXTS:
        texts = np.ravel(np.atleast_1d(np.asarray(content, dtype=object))).tolist()
        if all(isinstance(text, str) for text in texts):
            return [f"{name} = {', '.join(text.strip() for text in texts)}"]
    return [f"{name} = {content}"] if isinstance(content, (str, int, float, np.number)) else []


def _flatten(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield vectors in structs, cells and matrices, named like `data.Y[0]`; the longer side is the time."""
    if _is_object(value):
        return
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = {field: value[field] for field in value.dtype.names}
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


def read_hdf5(path: Path) -> Contents:
    """Return the vectors in the datasets of an HDF5 file, including MATLAB's 7.3."""
    import h5py

    units: dict[str, str] = {}
    notes: list[str] = []
    objects: list[str] = []

    def content(item: Any, file: Any) -> Any:
        if "MATLAB_object_decode" in item.attrs and isinstance(item, h5py.Dataset):
            objects.append(str(_plain(item.attrs.get("MATLAB_class", "object"))))
            return None
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
        return _named_columns(values, item.attrs)

    with h5py.File(path, "r") as file:
        columns = dict(_flatten(content(file, file)))
    _check_objects(path, objects, columns)
    return Contents(columns, units, notes)


def _plain(value: Any) -> Any:
    return value.decode(errors="replace") if isinstance(value, bytes) else value


def _named_columns(values: Any, attrs: Any) -> Any:
    """Return the columns of a table by the names in one of its attributes; else the table."""
    for names in attrs.values():
        if np.ndim(values) == 2 and np.ndim(names) == 1 and np.asarray(names).dtype.kind in "OSU":
            for table in (values, values.T):
                if table.shape[1] == len(names):
                    return {str(_plain(name)): column for name, column in zip(names, table.T, strict=True)}
    return values


def read_tdms(path: Path) -> Contents:
    """Return the channels of a TDMS file."""
    from nptdms import TdmsFile

    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    for group in TdmsFile.read(path).groups():
        for channel in group.channels():
            name = f"{group.name}/{channel.name}"
            if "wf_increment" in channel.properties and f"{group.name}/time" not in columns:
                columns[f"{group.name}/time"] = channel.time_track()
            columns[name] = channel[:]
            units[name] = str(channel.properties.get("unit_string", ""))
    return Contents(columns, units, ())
