"""Rows of a store, one per record; and rows on disk: chunks, checksums, one writer.

Zarr itself takes each chunk through its own threads, which takes ten times as long as the file does.
"""

import errno
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeAlias
from zlib import crc32

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError
from sysid_trib.results.judged import SEARCH_OUTCOME
from sysid_trib.results.store import EFFECT_P_VALUE, JUDGED_NAMES, TIED
from sysid_trib.results.variables import RESULT_TABLES

# Ending of the remains of a chunk of a killed process, as with zarr.
UNFINISHED = ".partial"
Row: TypeAlias = dict[str, Any]

EDGES = ("lowest", "highest")
# Number of parts of a record's time: enough to show its decay, its end and foreign samples.
OUTLINE_PARTS = 60
# Variables of `discover` alone, and of a cross-check alone.
OF_SEARCH = frozenset({TIED, EFFECT_P_VALUE, SEARCH_OUTCOME, "named", "converged"})
OF_CROSS_CHECK = frozenset({"agreement_p_value"})
# CRC-32 of a record's name and row.
CHECKSUM = "checksum"


# Units in the tables of results that differ in a store: each record has its own signal unit; a text has no
# unit.
UNITS_IN_STORE = {"rad": "see signal_units", "text": ""}
# Dimensions other than the record, unit and meaning of each variable.
VARIABLES = {
    name: (tuple(dims.split()), UNITS_IN_STORE.get(units, units), meaning)
    for name, (dims, units, meaning, *_) in {
        **RESULT_TABLES["campaign"],
        **{name: RESULT_TABLES["judged"][name] for name in JUDGED_NAMES},
    }.items()
}
# NumPy's nan for missing numbers; texts with their length: a million records of 400 letters are 1.6 GB.
STORED_KINDS = {
    TIED: "U400",
    "message": "U400",
    "named": "U200",
    "failure": "U100",
    "preferred": "U100",
    "record_checksum": "U64",
    "signal_units": "U40",
    "verdict": "U30",
    SEARCH_OUTCOME: "U20",
    "converged": "b1",
    "status": "i1",
    CHECKSUM: "i8",
}
# Unknown values.
FILL = {"f": np.nan, "U": "", "i": 0, "b": False}


def empty(name: str, sizes: Mapping[str, int]) -> Array:
    """Return the fill value of a variable for a record without a result."""
    kind = STORED_KINDS.get(name, "f8")
    return np.full([sizes[dim] for dim in VARIABLES[name][0]], FILL[kind[0]], dtype=kind)


def write_chunk(folder: Path, array: Any, number: int, values: Array) -> None:
    """Write the chunk of a number along the first dimension; rename it only when it is complete.

    Parameters
    ----------
    folder : Path
        Folder of the array.
    array : zarr.Array
        Zarr array of format 2, without filters, with chunks along the first dimension only.
    number : int
    values : (record, ...) array
        Values of the chunk; the last one of an array may contain fewer values.

    Raises
    ------
    OSError
    """
    whole = np.full(array.chunks, array.fill_value, dtype=array.dtype)
    whole[: len(values)] = values
    place = _place(folder, array, number)
    if np.array_equal(whole, np.full_like(whole, array.fill_value), equal_nan=whole.dtype.kind == "f"):
        # As in zarr, a missing chunk has the fill value.
        place.unlink(missing_ok=True)
        return
    content: Any = np.ascontiguousarray(whole)
    for compressor in array.compressors:
        content = compressor.encode(content)
    unfinished = place.with_name(f"{place.name}.{os.getpid()}{UNFINISHED}")
    try:
        unfinished.write_bytes(content)
        unfinished.replace(place)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise


def read_chunk(folder: Path, array: Any, number: int) -> Array:
    """Read the chunk of a number along the first dimension; the last one is as large as the others.

    Raises
    ------
    OSError, RuntimeError, ValueError
        The chunk is damaged.
    """
    whole = np.full(array.chunks, array.fill_value, dtype=array.dtype)
    try:
        content: Any = _place(folder, array, number).read_bytes()
    except FileNotFoundError:
        return whole
    for compressor in reversed(array.compressors):
        # Exactly the expected number of bytes.
        content = compressor.decode(content, out=np.empty(whole.nbytes, dtype="uint8"))
    return np.frombuffer(content, dtype=array.dtype).reshape(array.chunks).copy()


def _place(folder: Path, array: Any, number: int) -> Path:
    return folder / ".".join(["0"] * array.ndim).replace("0", str(number), 1)


def row_arrays(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays with one row per record, in the order of the checksum."""
    return {
        name: array for name, array in sorted(arrays.items()) if is_per_record(array) and name != "record"
    }


def labels_checksum(arrays: Mapping[str, Any]) -> int:
    """Return the CRC-32 of the labels that are common to all records: methods, forces and their units."""
    checksum = 0
    for name, array in sorted(arrays.items()):
        if not is_per_record(array):
            checksum = crc32(_bytes(array[:][None])[0], crc32(name.encode(), checksum))
    return checksum


def row_checksums(columns: Mapping[str, Array], names: Sequence[str], labels: int) -> Array:
    """Return the CRC-32 of each record's name and row.

    Parameters
    ----------
    columns : mapping of str to (record, ...) array
        Arrays in the form of `row_arrays`.
    names : sequence of str
        Names of the records.
    labels : int
        See `labels_checksum`.
    """
    rows = np.hstack([_bytes(column) for name, column in columns.items() if name != CHECKSUM])
    sums = [crc32(row, crc32(name.encode(), labels)) for name, row in zip(names, rows, strict=True)]
    return np.array(sums, dtype="int64")


def is_per_record(array: Any) -> bool:
    """Return true if an array of a store has one row for each record."""
    return bool(array.attrs["_ARRAY_DIMENSIONS"][0] == "record")


def _bytes(column: Array) -> Array:
    """Return the bytes of each record, with one representation for all kinds of nan."""
    if column.dtype.kind == "f":
        column = np.where(np.isnan(column), np.nan, column)
    return np.ascontiguousarray(column).reshape(len(column), -1).view(np.uint8)


def new_array(
    group: Any, name: str, dims: tuple[str, ...], shape: tuple[int, ...], dtype: Any, block: int
) -> Any:
    """Create an array of a store with a given number of records in a chunk."""
    chunks = (max(1, min(block, shape[0])), *(max(1, size) for size in shape[1:]))
    array = group.create_array(name, shape=shape, dtype=dtype, chunks=chunks, fill_value=FILL[dtype.kind])
    array.attrs["_ARRAY_DIMENSIONS"] = list(dims)
    return array


def copy_rows(old: Any, new: Any, names: Sequence[str], block: int) -> None:
    """Copy the rows of an old group into a new one, a block of records at a time.

    `names`: records of the new group, including those of the old one.
    """
    place = {name: at for at, name in enumerate(np.asarray(old["record"][:]).astype(str).tolist())}
    known = np.array([place.get(name, -1) for name in names])
    for name, array in row_arrays(dict(old.arrays())).items():
        for first in range(0, len(known), block):
            at = known[first : first + block]
            rows = np.flatnonzero(at >= 0)
            if len(rows):
                values = new[name][first : first + block]
                values[rows] = array.oindex[at[rows]]
                new[name][first : first + block] = values


# Error numbers for a file that another process has locked: EDEADLK occurs on Windows.
TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Hold the lock of a store: a file next to it, locked until this process releases it or ends.

    Raises
    ------
    RecordError
        Another campaign holds the lock.
    """
    place = path.with_name(f".{path.name}.lock")
    held = _held(place, path)
    try:
        yield
    finally:
        if held is not None:
            # Removed while it is locked: any process that has opened it finds that it is gone. On Windows, an
            # open file cannot be removed.
            if sys.platform != "win32":
                place.unlink(missing_ok=True)
            os.close(held)
            if sys.platform == "win32":
                with suppress(OSError):
                    place.unlink()


def _held(place: Path, path: Path) -> int | None:
    """Return the lock as an open file; None if files cannot be locked."""
    while True:
        try:
            file = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            # If the path cannot be written, writing the store raises the error.
            return None
        try:
            _lock(file)
        except OSError as error:
            os.close(file)
            if error.errno not in TAKEN:
                return None
            raise RecordError(
                f"{path}: another campaign writes to this store; repeat the command when it has ended, or "
                "choose another store with -o."
            ) from None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), place.stat()):
                return file
        # The campaign with the lock has removed the file.
        os.close(file)


def _lock(file: int) -> None:
    """Lock an open file without waiting; raise an OSError of `TAKEN` if another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        # Network file systems may support only record locks.
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
