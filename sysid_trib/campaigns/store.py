"""The Zarr store of a campaign: made once, then filled a block of records at a time.

A chunk holds one block of records. A block is written by one process, its status last, and each chunk is
renamed into its place when it is whole: at any moment the store can be read, and what is done is known.
"""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Index, Mask
from sysid_trib.campaigns.outline import EDGES
from sysid_trib.campaigns.records import CampaignRecords
from sysid_trib.campaigns.task import (
    EFFECT_P_VALUE,
    FAILED,
    LONGEST_TEXT,
    RECORD_TEXTS,
    REFUSED,
    SCALARS,
    TIED,
    Row,
    Task,
    checksum_of,
    empty_row,
    error_of,
    shape_names,
)
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.results.schema import force_labels

STATUS = ("waiting", "done", "refused", "failed", "lost")
WAITING, LOST = 0, 4
# What a killed process leaves of a chunk.
PARTIAL = "*.partial"
FINGERPRINT = "fingerprint"
DIMS = {
    "coefficient": ("method", "force"),
    "shape": ("method", "shape_parameter"),
    "outline": ("edge", "part"),
}
FORCE_UNIT = "see the coordinate unit"
UNITS = {"coefficient": FORCE_UNIT, "shape": "see the library", "random_force_density": "(rad/s^2)^2/Hz"}
UNITS["outline"] = "see signal_units"
UNITS |= dict.fromkeys(("reference_frequency", "asymptotic_frequency"), "rad/s")


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
        import zarr

        self.path, fingerprint = path, records.fingerprint(task)
        try:
            if not path.exists():
                _make(path, task, records, fingerprint, block)
            group: Any = zarr.open_group(path, mode="r+")
            begun_with = dict(group.attrs).get(FINGERPRINT)
            # Opened once: each time takes as long as to write a record.
            self.arrays: dict[str, Any] = dict(group.arrays())
            self.block = int(self.arrays["status"].chunks[0])
        except (OSError, KeyError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise RecordError(
                f"{path}: cannot be made, or is no store of a campaign ({reason}); choose another with -o."
            ) from None
        if begun_with != fingerprint:
            raise UsageError(
                f"{path}: is the store of another campaign (other records, task, options or version); choose "
                "another place with -o, or repeat the command that made it to go on."
            )
        for partial in path.rglob(PARTIAL):
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
        first = int(at[0]) // self.block * self.block
        chunk = slice(first, first + self.block)
        try:
            # Status last: a block counts when all of it is there.
            for name in sorted((n for n in rows[0] if n in self.arrays), key=lambda name: name == "status"):
                array = self.arrays[name]
                values = array[chunk] if len(at) < self.block else None
                new = np.stack([np.asarray(row[name]) for row in rows])
                if values is None or len(values) == len(at):
                    values = new.astype(array.dtype)
                else:
                    values[at - first] = new
                array[chunk] = values
        except OSError as error:
            raise RecordError(
                f"{self.path}: cannot be written ({error.strerror or error}); what was done is "
                "kept: make room, and repeat the command to go on."
            ) from None


def counts_of(store: xr.Dataset) -> dict[str, int]:
    """How many records of a store are of each status."""
    counted = np.bincount(store.status.values, minlength=len(STATUS))
    return dict(zip(STATUS, counted.tolist(), strict=True))


def lost_row(task: Task, reason: str) -> Row:
    """The row of a record whose worker died."""
    return empty_row(task) | {"status": LOST, "message": reason[: LONGEST_TEXT["message"]]}


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
    try:
        store = xr.open_zarr(path, consolidated=False, chunks=None, mask_and_scale=False)
        if FINGERPRINT not in store.attrs or "status" not in store:
            raise ValueError("no status of records")
    except (OSError, ValueError, KeyError) as error:
        raise RecordError(f"{path}: is no store of a campaign ({error}).") from None
    # A directory lists its arrays in any order; the order of dims in what is printed is not to depend on it.
    store = store[sorted(map(str, store.data_vars))]
    for array in store.variables.values():
        # No value is missing: what was not computed is nan, waiting, or an empty text.
        array.attrs.pop("_FillValue", None)
    return store


def _make(path: Path, task: Task, records: CampaignRecords, fingerprint: str, block: int) -> None:
    """An empty store: coordinates, and arrays of which no chunk is written."""
    import zarr

    temporary = path.with_name(f".{path.name}.partial")
    try:
        _fill(zarr.open_group(temporary, mode="w", zarr_format=2), task, records, fingerprint, block)
        os.replace(temporary, path)
    except OSError:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _fill(group: Any, task: Task, records: CampaignRecords, fingerprint: str, block: int) -> None:
    """Make the arrays of a store."""
    forces = {force.symbol: force for lib in (task.library, task.candidates or ()) for force in lib}
    labels = force_labels([forces[symbol] for symbol in task.symbols])
    coordinates: dict[str, tuple[str, Sequence[Any]]] = {
        "record": ("record", records.names),
        "method": ("method", task.labels),
        "force": ("force", task.symbols),
        "unit": ("force", labels["unit"][1]),
        "speed_degree": ("force", labels["speed_degree"][1]),
        "shape_parameter": ("shape_parameter", shape_names(task)),
        "edge": ("edge", EDGES),
    }
    for name, (dim, texts) in coordinates.items():
        values = np.asarray(list(texts), dtype=float if name == "speed_degree" else str)
        if len(values):
            _array(group, name, (dim,), values.shape, values.dtype, len(values))[:] = values
    row = empty_row(task)
    if records.simulated:
        row["true_coefficient"] = np.full(len(task.symbols), np.nan)
    for name, empty in row.items():
        if not np.size(empty):
            continue
        dims = _dims(name)
        kind = f"<U{LONGEST_TEXT[name]}" if name in LONGEST_TEXT else float
        array = _array(
            group, name, ("record", *dims), (len(records), *np.shape(empty)), np.dtype(kind), block
        )
        array.attrs["long_name"], units = _described(name)
        if units:
            array.attrs["units"] = units
    status = _array(group, "status", ("record",), (len(records),), np.dtype("int8"), block)
    status.attrs.update(flag_values=list(range(len(STATUS))), flag_meanings=" ".join(STATUS))
    group.attrs.update({FINGERPRINT: fingerprint, "task": task.name, "coordinates": "unit speed_degree"})


def _array(
    group: Any, name: str, dims: tuple[str, ...], shape: tuple[int, ...], dtype: Any, block: int
) -> Any:
    fill = {"f": np.nan, "U": "", "i": 0}[dtype.kind]
    chunks = (max(1, min(block, shape[0])), *(max(1, size) for size in shape[1:]))
    array = group.create_array(name, shape=shape, dtype=dtype, chunks=chunks, fill_value=fill)
    array.attrs["_ARRAY_DIMENSIONS"] = list(dims)
    return array


def _dims(name: str) -> tuple[str, ...]:
    """Dimensions of a variable beside the record."""
    if name in ("true_coefficient", EFFECT_P_VALUE):
        return ("force",)
    for known, dims in DIMS.items():
        if name in (known, error_of(known)):
            return dims
    per_method = {key for scalar in SCALARS for key in (scalar, error_of(scalar))}
    return ("method",) if name in per_method else ()


def _described(name: str) -> tuple[str, str]:
    """Long name and unit of a variable."""
    texts = {
        "coefficient": "coefficient",
        "shape": "shape parameter",
        "true_coefficient": "coefficient that the record was simulated with",
        "p_value": "p-value of the agreement of both methods",
        EFFECT_P_VALUE: "corrected p-value of an effect that a discovery named",
        TIED: "effects that those named cannot be separated from",
        "seconds": "time that the record took",
        "outline": "lowest and highest value of the record in each part of its time",
        **SCALARS,
        **RECORD_TEXTS,
    }
    if name in texts:
        units = {"p_value": "1", EFFECT_P_VALUE: "1", "seconds": "s", "true_coefficient": FORCE_UNIT}
        default = units.get(name, "")
        return texts[name], UNITS.get(name, default)
    value = next(value for value in texts if error_of(value) == name)
    return f"standard error of the {texts[value]}", UNITS.get(value, "")
