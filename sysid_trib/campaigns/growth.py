"""A store to which records come: what is done is kept, and put beside the others in their new order."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


def copy_rows(old: Any, new: Any, names: Sequence[str], block: int) -> None:
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
    """Put a store back that was taken away and not replaced; remove what a kill has left beside it."""
    shutil.rmtree(unfinished(path), ignore_errors=True)
    if _replaced(path).exists():
        if path.exists():
            shutil.rmtree(_replaced(path), ignore_errors=True)
        else:
            os.rename(_replaced(path), path)


def unfinished(path: Path) -> Path:
    """Where a store is made that is to come in this place."""
    return path.with_name(f".{path.name}.partial")


def _replaced(path: Path) -> Path:
    return path.with_name(f".{path.name}.replaced")
