"""Checksums of a store's rows: what a disk or a hand has changed since they were written is noticed."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.campaigns.chunks import read_chunk
from sysid_trib.errors import RecordError

# The array of checksums, beside those that it is of.
CHECKSUM = "checksum"
# Of numbers, texts and small integers; no other kind is read, as it may run code.
KINDS = "fUi"
STATUSES = 5
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
        if array.dtype.kind not in KINDS or array.filters:
            raise ValueError(f"{name} is of another kind")
        if _is_per_record(array) and (
            array.shape[0] != count or (name != "record" and array.chunks[0] != block)
        ):
            raise ValueError(f"{name} is of another length")
        if not _is_per_record(array) and array.nbytes > LARGEST_LABELS:
            raise ValueError(f"{name} is of another length")
        if array.chunks[1:] != array.shape[1:]:
            raise ValueError(f"{name} is in other chunks")
    return arrays


def row_arrays(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Those that hold the rows of the records, in the order of the checksum."""
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
        wrong |= (status < 0) | (status >= STATUSES)
        yield from (of_block[at] for at in np.flatnonzero(wrong))


def _is_per_record(array: Any) -> bool:
    return bool(array.attrs["_ARRAY_DIMENSIONS"][0] == "record")


def _bytes(column: Array) -> Array:
    """The bytes of each record; what is not a number has many, of which one is taken."""
    if column.dtype.kind == "f":
        column = np.where(np.isnan(column), np.nan, column)
    return np.ascontiguousarray(column).reshape(len(column), -1).view(np.uint8)
