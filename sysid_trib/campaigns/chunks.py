"""A store's rows on this machine: chunks of Zarr arrays, their checksums, and one writer at a time.

Zarr itself takes each chunk through threads of its own, which takes ten times as long as the file does.
"""

import errno
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.campaigns.variables import CHECKSUM, STATUS
from sysid_trib.errors import RecordError

# What a killed process leaves of a chunk ends so, as with zarr.
UNFINISHED = ".partial"


def write_chunk(folder: Path, array: Any, number: int, values: Array) -> None:
    """Write the chunk of a number along the first dimension; it is in its place when it is whole.

    Parameters
    ----------
    folder : Path
        Of the array.
    array : zarr.Array
        Of format 2, without filters, its chunks parts of the first dimension alone.
    number : int
    values : (record, ...) array
        Of the chunk; the last one of an array may hold less than others.

    Raises
    ------
    OSError
    """
    whole = np.full(array.chunks, array.fill_value, dtype=array.dtype)
    whole[: len(values)] = values
    place = _place(folder, array, number)
    if np.array_equal(whole, np.full_like(whole, array.fill_value), equal_nan=whole.dtype.kind == "f"):
        # As zarr does: what is not there is the fill value.
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
    """The chunk of a number along the first dimension, as `write_chunk` takes it; whole at the end too.

    Raises
    ------
    OSError, RuntimeError, ValueError
        It is damaged.
    """
    whole = np.full(array.chunks, array.fill_value, dtype=array.dtype)
    try:
        content: Any = _place(folder, array, number).read_bytes()
    except FileNotFoundError:
        return whole
    for compressor in reversed(array.compressors):
        # Into as many bytes as it is of, and no more.
        content = compressor.decode(content, out=np.empty(whole.nbytes, dtype="uint8"))
    return np.frombuffer(content, dtype=array.dtype).reshape(array.chunks).copy()


def _place(folder: Path, array: Any, number: int) -> Path:
    return folder / ".".join(["0"] * array.ndim).replace("0", str(number), 1)


# Of numbers, texts and small integers; no other kind is read, as it may run code.
KINDS = "fUi"
# Bytes of the names that all records share; more is no name of a force or a method.
LARGEST_LABELS = 2**24


def arrays_of(path: Path) -> dict[str, Any]:
    """The arrays of a store, if they are such as a campaign makes.

    Raises
    ------
    ValueError, KeyError
        They are not; other errors of zarr where one is damaged.
    """
    import zarr

    # One after the other: of several at once those that are not waited for complain at exit.
    places = sorted(path.glob("*/.zarray"))
    arrays = {place.parent.name: zarr.open_array(place.parent, mode="r") for place in places}
    count, block = arrays["status"].shape[0], arrays["status"].chunks[0]
    for name, array in arrays.items():
        good = array.dtype.kind in KINDS and not array.filters and array.chunks[1:] == array.shape[1:]
        if _is_per_record(array):
            good = good and array.shape[0] == count and (name == "record" or array.chunks[0] == block)
        if not good or (not _is_per_record(array) and array.nbytes > LARGEST_LABELS):
            raise ValueError(f"{name} is of another kind or length")
    return arrays


def row_arrays(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """The arrays that hold the rows of the records, in the order of the checksum."""
    coordinates = ("record", CHECKSUM)
    return {
        name: array
        for name, array in sorted(arrays.items())
        if _is_per_record(array) and name not in coordinates
    }


def labels_checksum(arrays: Mapping[str, Any]) -> int:
    """CRC-32 of what all records share: methods, forces and their units."""
    checksum = 0
    for name, array in sorted(arrays.items()):
        if not _is_per_record(array):
            checksum = crc32(_bytes(array[:][None])[0], crc32(name.encode(), checksum))
    return checksum


def row_checksums(columns: Mapping[str, Array], names: Sequence[str], labels: int) -> Array:
    """CRC-32 of each record's name and row.

    Parameters
    ----------
    columns : mapping of str to (record, ...) array
        As `row_arrays` has them.
    names : sequence of str
        Of the records.
    labels : int
        See `labels_checksum`.
    """
    rows = np.hstack([_bytes(column) for column in columns.values()])
    sums = [crc32(row, crc32(name.encode(), labels)) for name, row in zip(names, rows, strict=True)]
    return np.array(sums, dtype="int64")


def check_rows(path: Path, arrays: Mapping[str, Any]) -> None:
    """Refuse a store in which a record is not as it was written.

    Raises
    ------
    RecordError
        With the first such record.
    """
    for name in _damaged(path, arrays):
        raise damaged(path, f"record {name} is not as it was written")


def damaged(path: Path, reason: object) -> RecordError:
    """What is said of a store that is damaged."""
    return RecordError(
        f"{path}: a part of the store is damaged ({reason}); remove the store, and repeat the command."
    )


def _damaged(path: Path, arrays: Mapping[str, Any]) -> Iterator[str]:
    rows, block = row_arrays(arrays), arrays["status"].chunks[0]
    names, labels = arrays["record"][:].astype(str).tolist(), labels_checksum(arrays)
    for number, first in enumerate(range(0, len(names), block)):
        of_block = names[first : first + block]
        columns = {
            name: read_chunk(path / name, array, number)[: len(of_block)] for name, array in rows.items()
        }
        status = columns["status"]
        if not status.any():
            continue
        known = read_chunk(path / CHECKSUM, arrays[CHECKSUM], number)[: len(of_block)]
        wrong = (status != 0) & (known != row_checksums(columns, of_block, labels))
        wrong |= (status < 0) | (status >= len(STATUS))
        yield from (of_block[at] for at in np.flatnonzero(wrong))


def _is_per_record(array: Any) -> bool:
    return bool(array.attrs["_ARRAY_DIMENSIONS"][0] == "record")


def _bytes(column: Array) -> Array:
    """The bytes of each record; what is not a number has many, of which one is taken."""
    if column.dtype.kind == "f":
        column = np.where(np.isnan(column), np.nan, column)
    return np.ascontiguousarray(column).reshape(len(column), -1).view(np.uint8)


# What says that another process has locked a file: EDEADLK is of Windows.
TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Hold the lock of a store: a file next to it, locked until this process lets it go or dies.

    Raises
    ------
    RecordError
        Another campaign holds it.
    """
    place = path.with_name(f".{path.name}.lock")
    held = _held(place, path)
    try:
        yield
    finally:
        if held is not None:
            # Removed while it is held: whoever opened it before finds that it is gone. Windows removes no
            # file that anyone has open.
            if sys.platform != "win32":
                place.unlink(missing_ok=True)
            os.close(held)
            if sys.platform == "win32":
                with suppress(OSError):
                    place.unlink()


def _held(place: Path, path: Path) -> int | None:
    """The lock, as an open file; None where files cannot be locked."""
    while True:
        try:
            file = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            # A place that cannot be written is refused by what writes the store.
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
        # The campaign that held it has removed it.
        os.close(file)


def _lock(file: int) -> None:
    """Lock an open file at once; an OSError with one of `TAKEN` where another process has locked it."""
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
        # File systems of a network may have locks of records alone.
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
