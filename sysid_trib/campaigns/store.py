"""The Zarr store of a campaign: made once, then filled a block of records at a time.

A chunk holds one block of records. A block is written by one process, its status last, and each chunk is
renamed into its place when it is whole: at any moment the store can be read, and what is done is known.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.campaigns import chunks
from sysid_trib.campaigns.new_store import FINGERPRINT, CampaignRecords, exchange, made_near, recover
from sysid_trib.campaigns.task import Task, checksum_of, empty_row
from sysid_trib.campaigns.variables import CHECKSUM, FAILED, LOST, REFUSED, STATUS, WAITING, Row
from sysid_trib.errors import RecordError, SysidTribError, UsageError


class Store:
    """A store that is open for writing.

    Parameters
    ----------
    path : Path
        The store, made if it is not there.
    task : Task
    records : CampaignRecords
    block : int
        Records in a chunk, of a new store.

    Raises
    ------
    UsageError
        The store is of another campaign.
    RecordError
        It cannot be made, or is no store.
    """

    def __init__(self, path: Path, task: Task, records: CampaignRecords, block: int) -> None:
        self.path, self._names = path, records.names
        with _readable(path):
            recover(path)
            if not path.exists():
                os.replace(made_near(path, task, records, block), path)
            group, arrays = _opened(path)
            same = group.attrs[FINGERPRINT] == records.fingerprint(task)
            if same:
                chunks.check_rows(path, arrays)
            known = np.asarray(arrays["record"][:]).astype(str).tolist()
            if same and set(known) < set(self._names):
                exchange(path, made_near(path, task, records, block, group))
                known, arrays = self._names, _opened(path)[1]
            same = same and known == self._names
        if not same:
            raise UsageError(
                f"{path}: is the store of another campaign (other task, options or version, or records that "
                "are not among these); choose another place with -o, or repeat the command that made it to "
                "go on."
            )
        # Opened once: each time takes as long as to write a record.
        self.arrays, self.rows, self.block = (
            arrays,
            chunks.row_arrays(arrays),
            int(arrays["status"].chunks[0]),
        )
        self._labels = chunks.labels_checksum(arrays)
        for partial in path.rglob(f"*{chunks.UNFINISHED}"):
            partial.unlink(missing_ok=True)

    def unfinished(self, changed: Mask) -> list[Index]:
        """The records of each block that are still to be done; those whose worker died are tried again.

        `changed` : (record,) array of bool; what was done of these is done anew.
        """
        status = self.arrays["status"][:]
        blocks = np.arange(len(status)) // self.block
        todo = np.flatnonzero((status == WAITING) | (status == LOST) | changed)
        return [todo[blocks[todo] == at] for at in np.unique(blocks[todo])]

    def changed(self, records: CampaignRecords) -> Mask:
        """Which records that were done, or refused, have another file now, (record,)."""
        changed = np.zeros(len(records), dtype=bool)
        if "record_checksum" not in self.arrays:
            return changed
        known = np.asarray(self.arrays["record_checksum"][:]).astype(str)
        for at in np.flatnonzero(self.arrays["status"][:] != WAITING).tolist():
            checksum = checksum_of(records.record(at))
            # One that is no longer there, or that only the workers see, is what it was.
            changed[at] = bool(checksum) and checksum != known[at]
        return changed

    def without_result(self, changed: Mask) -> int:
        """How many records were refused, or failed, without those that are done anew."""
        return int((np.isin(self.arrays["status"][:], (REFUSED, FAILED)) & ~changed).sum())

    def write(self, at: Index, rows: Sequence[Row]) -> None:
        """Write the rows of records of one block.

        Raises
        ------
        RecordError
            The disk is full, or the store is gone.
        """
        number = int(at[0]) // self.block
        first = number * self.block
        places, names = at - first, self._names[first : first + self.block]
        try:
            columns = {
                name: chunks.read_chunk(self.path / name, array, number)[: len(names)]
                for name, array in self.rows.items()
            }
            if columns["status"][places].any():
                # What is done anew does not count until all of it is there.
                columns["status"][places] = WAITING
                self._write("status", number, columns["status"])
            for name in columns.keys() & rows[0].keys():
                columns[name][places] = np.stack([np.asarray(row[name]) for row in rows])
            known = chunks.read_chunk(self.path / CHECKSUM, self.arrays[CHECKSUM], number)[: len(names)]
            rows_done = {name: column[places] for name, column in columns.items()}
            known[places] = chunks.row_checksums(rows_done, [names[place] for place in places], self._labels)
            columns[CHECKSUM] = known
            # Status last: a block counts when all of it is there.
            for name in sorted(columns, key=lambda name: name == "status"):
                self._write(name, number, columns[name])
        except OSError as error:
            raise RecordError(
                f"{self.path}: cannot be written ({error.strerror or error}); what was done is "
                "kept: make room, and repeat the command to go on."
            ) from None

    def _write(self, name: str, number: int, values: Array) -> None:
        chunks.write_chunk(self.path / name, self.arrays[name], number, values)


def counts_of(store: xr.Dataset) -> dict[str, int]:
    """How many records of a store are of each status."""
    counted = np.bincount(store.status.values, minlength=len(STATUS))
    return dict(zip(STATUS, counted.tolist(), strict=True))


def lost_row(task: Task, reason: str) -> Row:
    """The row of a record whose worker died."""
    return empty_row(task) | {"status": LOST, "message": reason}


def open_store(path: str | os.PathLike[str]) -> xr.Dataset:
    """The store of a campaign as a Dataset, read when it is used.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Dataset
        See `campaign`.

    Raises
    ------
    RecordError
        It is no such store.
    """
    place = Path(path)
    with _readable(place):
        chunks.check_rows(place, _opened(place)[1])
        return as_dataset(place)


def as_dataset(path: Path) -> xr.Dataset:
    """A store that has been checked as a Dataset."""
    store = xr.open_zarr(path, consolidated=False, chunks=None, mask_and_scale=False)
    # A directory lists its arrays in any order; the order of dims in what is printed is not to depend on it.
    store = store[sorted(name for name in map(str, store.data_vars) if name != CHECKSUM)]
    for array in store.variables.values():
        # No value is missing: what was not computed is nan, waiting, or an empty text.
        array.attrs.pop("_FillValue", None)
    return store


def _opened(path: Path) -> tuple[Any, dict[str, Any]]:
    """The group of a store, and its arrays."""
    import zarr

    group = zarr.open_group(path, mode="r")
    if FINGERPRINT not in group.attrs:
        raise RecordError(f"{path}: is no store of a campaign; choose another with -o.")
    return group, chunks.arrays_of(path)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Say of a store that cannot be read that it is chunks.damaged, or none."""
    try:
        yield
    except (SysidTribError, MemoryError):
        raise
    except OSError as error:
        raise RecordError(
            f"{path}: cannot be made, or is no store of a campaign ({error.strerror or error}); choose "
            "another with -o."
        ) from None
    # What is chunks.damaged meets its reader with any exception at all.
    except Exception as error:
        raise chunks.damaged(path, error) from None
