"""A new Zarr store of a campaign: its coordinates, and arrays that are filled later."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sysid_trib.campaigns.checksums import CHECKSUM
from sysid_trib.campaigns.growth import copy_rows, unfinished
from sysid_trib.campaigns.outline import EDGES
from sysid_trib.campaigns.records import CampaignRecords
from sysid_trib.campaigns.task import (
    EFFECT_P_VALUE,
    LONGEST_TEXT,
    RECORD_TEXTS,
    SCALARS,
    TIED,
    Task,
    empty_row,
    error_of,
    shape_names,
)
from sysid_trib.results.schema import force_labels

STATUS = ("waiting", "done", "refused", "failed", "lost")
FINGERPRINT, TASK_FINGERPRINT = "fingerprint", "task_fingerprint"
DIMS = {
    "coefficient": ("method", "force"),
    "shape": ("method", "shape_parameter"),
    "outline": ("edge", "part"),
}
FORCE_UNIT = "see the coordinate unit"
UNITS = {"coefficient": FORCE_UNIT, "shape": "see the library", "random_force_density": "(rad/s^2)^2/Hz"}
UNITS["outline"] = "see signal_units"
UNITS |= dict.fromkeys(("reference_frequency", "asymptotic_frequency"), "rad/s")


def made_beside(path: Path, task: Task, records: CampaignRecords, block: int, known: Any = None) -> Path:
    """A new store beside its place, with the rows of the store `known` and no others."""
    import zarr

    temporary = unfinished(path)
    try:
        group = zarr.open_group(temporary, mode="w", zarr_format=2)
        _fill(group, task, records, block)
        if known is not None:
            copy_rows(known, group, records.names, block)
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
    checksum = _array(group, CHECKSUM, ("record",), (len(records),), np.dtype("int64"), block)
    checksum.attrs["long_name"] = "CRC-32 of the record's row"
    status.attrs.update(flag_values=list(range(len(STATUS))), flag_meanings=" ".join(STATUS))
    begun_with = {FINGERPRINT: records.fingerprint(task), TASK_FINGERPRINT: records.fingerprint_of_task(task)}
    group.attrs.update(begun_with | {"task": task.name, "coordinates": "unit speed_degree"})


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
