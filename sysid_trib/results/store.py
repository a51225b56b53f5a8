"""Store of a campaign as it is read: the status of its records, and names of its variables."""

import numpy as np
import xarray as xr

TIED = "tied"
EFFECT_P_VALUE = "effect_p_value"
# Verdict of `compare` before the name of a method.
PREDICTS_BEST = "predicts best: "
# Status of a record, by its number in the store.
STATUS = ("waiting", "done", "refused", "failed", "lost")
WAITING, IDENTIFIED, REFUSED, FAILED, LOST = range(5)


def counts_of(store: xr.Dataset) -> dict[str, int]:
    """Count the records of a store by status."""
    counted = np.bincount(store.status.values, minlength=len(STATUS))
    return dict(zip(STATUS, counted.tolist(), strict=True))


def reported_method(store: xr.Dataset) -> str:
    """Return the label of the identification that a campaign compares between records.

    Among the methods that identify most forces, this is the one that most often predicts best, or else the
    last. Of laws it is the preferred one.
    """
    done = np.flatnonzero(store.status.values == IDENTIFIED)
    labels = store.model.values.astype(str)
    if not len(done):
        return str(labels[-1])
    known = np.isfinite(store.standard_error.values[done]).sum(axis=2)
    forces = np.median(known, axis=0)
    verdicts = store.verdict.values[done].astype(str)
    wins = np.array([np.sum(verdicts == f"{PREDICTS_BEST}{label}") for label in labels])
    rank = np.lexsort([np.arange(len(labels)), wins, forces])
    return str(labels[rank[-1]])
