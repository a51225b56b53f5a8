"""The Zarr store of a campaign: created once, then filled a block of records at a time.

A chunk contains one block of records. A block is written by one process, its status last, and each chunk is
renamed when it is complete: at any moment the store can be read, and finished records are known.
"""

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.campaigns import rows as stored
from sysid_trib.campaigns.rows import CHECKSUM, Row
from sysid_trib.campaigns.task import (
    CampaignRecords,
    Task,
    checksum_of,
    empty_row,
    fingerprint,
    names_of,
    record_at,
)
from sysid_trib.errors import RecordError, SysidTribError, UsageError
from sysid_trib.results.store import STORE_FORMAT, Status

FINGERPRINT = "task_fingerprint"
FORMAT = "format_version"
# Kinds of arrays: numbers, texts, small integers and booleans; other kinds are not read, because they could
# run code.
KINDS = "fUib"
# Largest size in bytes of the names common to all records.
LARGEST_LABELS = 2**24


class Store:
    """An existing store with the arrays of a campaign.

    Parameters
    ----------
    path : Path

    Raises
    ------
    RecordError
        The path is not the store of a campaign, or its format has another version.
    ValueError, KeyError
        Its arrays are of other kinds; zarr raises other errors if an array is damaged.
    """

    def __init__(self, path: Path) -> None:
        import zarr

        self.path, self.group = path, zarr.open_group(path, mode="r")
        if FINGERPRINT not in self.group.attrs:
            raise RecordError(f"{path}: is not the store of a campaign; choose another place with -o.")
        if self.group.attrs.get(FORMAT) != STORE_FORMAT:
            raise RecordError(
                f"{path}: this store of a campaign has {_format_text(self.group.attrs)}, and this version of "
                f"sysid_trib reads and continues format {STORE_FORMAT}; run the campaign again with another "
                "place -o, or read the old numbers with xarray.open_zarr."
            )
        # One after the other: several at once cause warnings at exit if they are not awaited. And only once:
        # each opening takes as long as writing a record.
        folders = [place.parent for place in sorted(path.glob("*/.zarray"))]
        self.arrays: dict[str, Any] = {at.name: zarr.open_array(at, mode="r") for at in folders}
        count, self.block = self.arrays["status"].shape[0], int(self.arrays["status"].chunks[0])
        for name, array in self.arrays.items():
            plain = array.dtype.kind in KINDS and not array.filters and array.chunks[1:] == array.shape[1:]
            in_blocks = array.shape[0] == count and (name == "record" or array.chunks[0] == self.block)
            sized = in_blocks if stored.is_per_record(array) else array.nbytes <= LARGEST_LABELS
            if not (plain and sized):
                raise ValueError(f"{name} is of another kind or length")
        self.names: list[str] = np.asarray(self.arrays["record"][:]).astype(str).tolist()
        self._rows, self._labels = stored.row_arrays(self.arrays), stored.labels_checksum(self.arrays)

    def _block(self, number: int) -> tuple[list[str], dict[str, Array]]:
        """Return the names and rows of the records of a block."""
        names = self.names[number * self.block : (number + 1) * self.block]
        rows = self._rows.items()
        return names, {k: stored.read_chunk(self.path / k, array, number)[: len(names)] for k, array in rows}

    def check(self) -> None:
        """Raise an error that names the first record whose row differs from what was written."""
        for number in range(-(-len(self.names) // self.block)):
            names, columns = self._block(number)
            status, known = columns["status"], columns[CHECKSUM]
            wrong = (status != Status.WAITING) & (known != stored.row_checksums(columns, names, self._labels))
            wrong |= (status < 0) | (status >= len(Status))
            if wrong.any():
                raise _damaged(self.path, f"record {names[np.argmax(wrong)]} differs from what was written")

    def unfinished(self, records: CampaignRecords) -> tuple[list[Index], int, int]:
        """Return the unfinished records of a campaign.

        Returns
        -------
        blocks : list of (record,) arrays of int
            Records of each block that wait, whose worker died, or whose file has changed.
        changed, bad : int
            Number of records with changed files; number of others that were refused, or failed.
        """
        status, known = (np.asarray(self.arrays[name][:]) for name in ("status", "record_checksum"))
        changed = np.zeros(len(status), dtype=bool)
        for at in np.flatnonzero(status != Status.WAITING).tolist():
            checksum = checksum_of(record_at(records, at))
            # A record that no longer exists, or that only the workers can read, counts as unchanged.
            changed[at] = bool(checksum) and checksum != str(known[at])
        blocks = np.arange(len(status)) // self.block
        bad = np.isin(status, (Status.REFUSED, Status.FAILED))
        todo = np.flatnonzero(np.isin(status, (Status.WAITING, Status.LOST)) | changed)
        of_blocks = [todo[blocks[todo] == at] for at in np.unique(blocks[todo])]
        return of_blocks, int(changed.sum()), int((bad & ~changed).sum())

    def write(self, at: Index, rows: Sequence[Row]) -> None:
        """Write the rows of records of one block.

        Raises
        ------
        RecordError
            The disk is full, or the store is missing.
        """
        number = int(at[0]) // self.block
        places = at - number * self.block
        try:
            names, columns = self._block(number)
            if columns["status"][places].any():
                # A new row is invalid until it is complete.
                columns["status"][places] = Status.WAITING
                stored.write_chunk(self.path / "status", self.arrays["status"], number, columns["status"])
            for name in columns.keys() & rows[0].keys():
                columns[name][places] = np.stack([np.asarray(row[name]) for row in rows])
            rows_done = {name: column[places] for name, column in columns.items()}
            names_done = [names[place] for place in places]
            columns[CHECKSUM][places] = stored.row_checksums(rows_done, names_done, self._labels)
            # Status last: a block is valid only when it is complete.
            for name in sorted(columns, key=lambda name: name == "status"):
                stored.write_chunk(self.path / name, self.arrays[name], number, columns[name])
        except OSError as error:
            raise RecordError(
                f"{self.path}: cannot be written ({error.strerror or error}); finished records "
                "are kept: free some space, and repeat the command to continue."
            ) from None


def store_for(path: Path, task: Task, records: CampaignRecords, block: int) -> Store:
    """Open the store of a campaign for writing: create it, continue it, or add further records.

    Parameters
    ----------
    path : Path
    task : Task
    records : CampaignRecords
    block : int
        Number of records in a chunk of a new store.

    Raises
    ------
    UsageError
        The store belongs to another campaign.
    RecordError
        The store cannot be created, or the path is not a store.
    """
    names = names_of(records)
    if path.is_file():
        raise RecordError(f"{path}: is a file, not the store of a campaign; choose another place with -o.")
    with _readable(path):
        _recover(path)
        if not path.exists():
            _make(path, task, records, block)
        store = Store(path)
        same = store.group.attrs[FINGERPRINT] == fingerprint(records, task)
        if same:
            store.check()
        if same and set(store.names) < set(names):
            _make(path, task, records, block, store.group)
            store = Store(path)
    if not same or store.names != names:
        raise UsageError(
            f"{path}: is the store of another campaign (other task, options or version, or records that "
            "are not among these); choose another place with -o, or repeat the original command to "
            "continue it."
        )
    for partial in path.rglob(f"*{stored.UNFINISHED}"):
        partial.unlink(missing_ok=True)
    return store


def open_store(path: str | os.PathLike[str]) -> xr.Dataset:
    """Return the store of a campaign as a Dataset that is read on access.

    Parameters
    ----------
    path : path-like
        The store, which `campaign` wrote.

    Returns
    -------
    Dataset
        The results of all records so far (see `campaign`).

    Raises
    ------
    RecordError
        The path is not such a store, or its format has another version.

    Examples
    --------
    >>> import sysid_trib as st
    >>> task = st.campaigns.Task("identify", "zeta,delta,nu,epsilon", methods={"direct": st.methods.Direct()})
    >>> _ = st.campaign([st.records.paper_twin()], task, output="runs.zarr", workers=0)
    >>> store = st.campaigns.open_store("runs.zarr")
    >>> store.coefficient.sel(force="nu").round(1).values.tolist()
    [[-0.4]]
    """
    place = Path(path)
    with _readable(place):
        Store(place).check()
        return as_dataset(place)


def as_dataset(path: Path) -> xr.Dataset:
    """Return a checked store as a Dataset."""
    store = xr.open_zarr(path, consolidated=False, chunks=None, mask_and_scale=False)
    # A directory lists its arrays in any order, but the printed order of dims must be fixed.
    store = store[sorted(name for name in map(str, store.data_vars) if name != CHECKSUM)]
    for array in store.variables.values():
        # No value is missing: a value that has not been computed is nan, waiting, or an empty text.
        array.attrs.pop("_FillValue", None)
    return store


def _format_text(attrs: Mapping[str, Any]) -> str:
    """Return the format of a store in words; stores of formats before 5 do not state it."""
    return f"format {attrs[FORMAT]}" if FORMAT in attrs else "a format before 5"


def _damaged(path: Path, reason: object) -> RecordError:
    """Return the error of a damaged store."""
    return RecordError(
        f"{path}: a part of the store is damaged ({reason}); remove the store, and repeat the command."
    )


def _make(path: Path, task: Task, records: CampaignRecords, block: int, old: Any = None) -> None:
    """Create a store next to its final place and rename it: empty, or with the rows of a replaced one.

    If the process is killed between these two steps, `_recover` restores the store.
    """
    import zarr

    made, taken_away = _near(path, "partial"), _near(path, "replaced")
    try:
        group = zarr.open_group(made, mode="w", zarr_format=2)
        _fill(group, task, records, block)
        if old is not None:
            stored.copy_rows(old, group, names_of(records), block)
            os.rename(path, taken_away)
    except OSError:
        shutil.rmtree(made, ignore_errors=True)
        raise
    os.rename(made, path)
    shutil.rmtree(taken_away, ignore_errors=True)


def _recover(path: Path) -> None:
    """Restore a store that was moved but not replaced; remove temporary files of a killed process."""
    shutil.rmtree(_near(path, "partial"), ignore_errors=True)
    taken_away = _near(path, "replaced")
    if taken_away.exists() and not path.exists():
        os.rename(taken_away, path)
    shutil.rmtree(taken_away, ignore_errors=True)


def _near(path: Path, ending: str) -> Path:
    """Return a path next to that of a store."""
    return path.with_name(f".{path.name}.{ending}")


def _fill(group: Any, task: Task, records: CampaignRecords, block: int) -> None:
    """Create the arrays of a store."""
    labels = task.axes
    units, degrees = zip(*task.quantities.values(), strict=True)
    coordinates: dict[str, tuple[str, Sequence[Any]]] = {
        "record": ("record", names_of(records)),
        **{dim: (dim, names) for dim, names in labels.items()},
        "unit": ("force", units),
        "speed_degree": ("force", degrees),
    }
    for name, (dim, texts) in coordinates.items():
        values = np.asarray(list(texts), dtype=float if name == "speed_degree" else str)
        if len(values):
            stored.new_array(group, name, (dim,), values.shape, values.dtype, len(values))[:] = values
    row = empty_row(task)
    for name, empty in row.items():
        if not empty.size:
            continue
        (dims, units, meaning), shape = stored.VARIABLES[name], (len(records), *empty.shape)
        array = stored.new_array(group, name, ("record", *dims), shape, empty.dtype, block)
        flags = {
            "flag_values": list(range(len(Status))),
            "flag_meanings": " ".join(status.name.lower() for status in Status),
        }
        attrs = {"long_name": meaning} | ({"units": units} if units else {})
        array.attrs.update(attrs | (flags if name == "status" else {}))
    begun_with = {FINGERPRINT: fingerprint(records, task), FORMAT: STORE_FORMAT, "task": task.name}
    group.attrs.update(begun_with | {"coordinates": "unit speed_degree"})


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise an error that states that a store is damaged or missing, if it cannot be read."""
    try:
        yield
    except (SysidTribError, MemoryError):
        raise
    except OSError as error:
        raise RecordError(
            f"{path}: cannot be created, or is not the store of a campaign ({error.strerror or error}); "
            "choose another with -o."
        ) from None
    # Reading a damaged store can raise any exception.
    except Exception as error:
        raise _damaged(path, error) from None
