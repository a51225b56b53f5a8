"""The records of a campaign, and the store begun for them, empty or with the rows of a smaller one."""

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib._version import __version__
from sysid_trib.campaigns.study import Study
from sysid_trib.campaigns.task import Task, empty_row, shape_names
from sysid_trib.campaigns.variables import EDGES, STATUS, TRUTH, VARIABLES
from sysid_trib.errors import UsageError, readable
from sysid_trib.results.schema import force_labels

# Of what a store holds; one of another format is of another version.
STORE_FORMAT = 2
FINGERPRINT = "task_fingerprint"


@dataclass(frozen=True)
class CampaignRecords:
    """Files, decays in memory, or the numbers of a study, each with its name.

    Parameters
    ----------
    items : sequence of path or Dataset, or Study

    Raises
    ------
    UsageError
        There are none.
    """

    items: Sequence[Any] | Study

    def __post_init__(self) -> None:
        if isinstance(self.items, str | os.PathLike | xr.Dataset) or not len(self.items):
            raise UsageError("A campaign wants a list of records, of one at least.")

    def __len__(self) -> int:
        return len(self.items)

    @property
    def simulated(self) -> bool:
        """True if the truth of each is known."""
        return isinstance(self.items, Study)

    @property
    def names(self) -> list[str]:
        """The names of the records in the store."""
        if isinstance(self.items, Study):
            return [str(at) for at in range(len(self))]
        return [
            readable(
                str(item.attrs.get("source", f"record {at}")) if isinstance(item, xr.Dataset) else str(item)
            )
            for at, item in enumerate(self.items)
        ]

    def record(self, at: int) -> Any:
        """A record as `rows_of` takes it."""
        if isinstance(self.items, Study):
            return self.items, int(at)
        item = self.items[at]
        return item if isinstance(item, xr.Dataset) else os.fspath(item)

    def fingerprint(self, task: Task) -> str:
        """What a store must have been begun with to be gone on with; further records may come to it."""
        libraries = [library.to_toml() for library in (task.library, task.candidates) if library is not None]
        methods = {label: repr(method) for label, method in task.methods.items()}
        asked = [task.name, task.judged, methods, repr(task.constraints), repr(task.contactless)]
        options = sorted((name, repr(value)) for name, value in task.options.items())
        study, in_memory = None, []
        if isinstance(self.items, Study):
            study = asdict(self.items) | {"records": None}
        else:
            # Files say themselves when they change.
            held = [item for item in self.items if isinstance(item, xr.Dataset)]
            in_memory = [hashlib.sha256(item["angle"].values.tobytes()).hexdigest() for item in held]
        # What is called, without its address in memory.
        inner = getattr(task.read, "func", task.read)
        given = (getattr(task.read, "args", ()), getattr(task.read, "keywords", {}))
        read = f"{inner.__module__}.{inner.__qualname__} {given!r}"
        content = [__version__, STORE_FORMAT, study, in_memory, libraries, asked, options, read]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def made_near(path: Path, task: Task, records: CampaignRecords, block: int, known: Any = None) -> Path:
    """A new store next to its place, with the rows of the store `known` and no others."""
    import zarr

    temporary = _unfinished(path)
    try:
        group = zarr.open_group(temporary, mode="w", zarr_format=2)
        _fill(group, task, records, block)
        if known is not None:
            _copy_rows(known, group, records.names, block)
    except OSError:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return temporary


def _fill(group: Any, task: Task, records: CampaignRecords, block: int) -> None:
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
        row[TRUTH] = np.full(len(task.symbols), np.nan)
    for name, empty in row.items():
        if not empty.size:
            continue
        known, shape = VARIABLES[name], (len(records), *empty.shape)
        array = _array(group, name, ("record", *known.dims), shape, empty.dtype, block)
        flags = {"flag_values": list(range(len(STATUS))), "flag_meanings": " ".join(STATUS)}
        attrs = {"long_name": known.long_name} | ({"units": known.units} if known.units else {})
        array.attrs.update(attrs | (flags if name == "status" else {}))
    begun_with = {FINGERPRINT: records.fingerprint(task), "task": task.name}
    group.attrs.update(begun_with | {"coordinates": "unit speed_degree"})


def _array(
    group: Any, name: str, dims: tuple[str, ...], shape: tuple[int, ...], dtype: Any, block: int
) -> Any:
    fill = {"f": np.nan, "U": "", "i": 0}[dtype.kind]
    chunks = (max(1, min(block, shape[0])), *(max(1, size) for size in shape[1:]))
    array = group.create_array(name, shape=shape, dtype=dtype, chunks=chunks, fill_value=fill)
    array.attrs["_ARRAY_DIMENSIONS"] = list(dims)
    return array


def _copy_rows(old: Any, new: Any, names: Sequence[str], block: int) -> None:
    """Fill the rows of a new store that an old one has, a block at a time.

    Parameters
    ----------
    old, new : zarr.Group
    names : sequence of str
        Of the records of the new one, those of the old one among them.
    block : int
        Records in a chunk of the new one.
    """
    place = {name: at for at, name in enumerate(np.asarray(old["record"][:]).astype(str).tolist())}
    known = np.array([place.get(name, -1) for name in names])
    for name, array in old.arrays():
        if array.attrs["_ARRAY_DIMENSIONS"][0] != "record" or name == "record":
            continue
        for first in range(0, len(known), block):
            at = known[first : first + block]
            rows = np.flatnonzero(at >= 0)
            if len(rows):
                values = new[name][first : first + block]
                values[rows] = array.oindex[at[rows]]
                new[name][first : first + block] = values


def exchange(path: Path, grown: Path) -> None:
    """Put a grown store in the place of another; a kill between the two steps is mended by `recover`."""
    os.rename(path, _replaced(path))
    os.rename(grown, path)
    shutil.rmtree(_replaced(path), ignore_errors=True)


def recover(path: Path) -> None:
    """Put a store back that was taken away and not replaced; remove what a kill has left next to it."""
    shutil.rmtree(_unfinished(path), ignore_errors=True)
    if _replaced(path).exists():
        if path.exists():
            shutil.rmtree(_replaced(path), ignore_errors=True)
        else:
            os.rename(_replaced(path), path)


def _unfinished(path: Path) -> Path:
    """Where a store is made that is to come in this place."""
    return path.with_name(f".{path.name}.partial")


def _replaced(path: Path) -> Path:
    return path.with_name(f".{path.name}.replaced")
