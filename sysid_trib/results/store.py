"""Reading the store of a campaign: the status of its records, and names of its variables."""

from enum import IntEnum

import numpy as np
import xarray as xr

TIED = "tied"
EFFECT_P_VALUE = "effect_p_value"
# Text of `compare` before the name of a method.
PREDICTS_BEST = "predicts best: "


class Status(IntEnum):
    """Status of a record of a campaign; its name in lower case is used in texts."""

    WAITING = 0
    DONE = 1
    REFUSED = 2
    FAILED = 3
    LOST = 4


def counts_of(store: xr.Dataset) -> dict[str, int]:
    """Count the records of a store by status."""
    counted = np.bincount(store.status.values, minlength=len(Status))
    return {status.name.lower(): count for status, count in zip(Status, counted.tolist(), strict=True)}


def reported_method(store: xr.Dataset) -> str:
    """Return the label of the identification that a campaign compares between records.

    Among the methods that identify most forces, this is the one with the best prediction in most records, or
    else the last. For laws it is the preferred one.
    """
    done = np.flatnonzero(store.status.values == Status.DONE)
    labels = store.model.values.astype(str)
    if not len(done):
        return str(labels[-1])
    known = np.isfinite(store.standard_error.values[done]).sum(axis=2)
    forces = np.median(known, axis=0)
    verdicts = store.verdict.values[done].astype(str)
    wins = np.array([np.sum(verdicts == f"{PREDICTS_BEST}{label}") for label in labels])
    rank = np.lexsort([np.arange(len(labels)), wins, forces])
    return str(labels[rank[-1]])
