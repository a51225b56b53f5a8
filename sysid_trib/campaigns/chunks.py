"""A chunk of a Zarr array on this machine, written or read in one go.

Zarr itself takes each chunk through threads of its own, which takes ten times as long as the file does.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np

from sysid_trib.arrays import Array

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
    if _is_fill(whole, array.fill_value):
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


def _is_fill(values: Array, fill: Any) -> bool:
    if values.dtype.kind == "f" and np.isnan(fill):
        return bool(np.isnan(values).all())
    return bool((values == fill).all())
