"""Reading the store of a campaign: the status of its records, and names of its variables."""

from collections import Counter
from enum import IntEnum

import numpy as np
import xarray as xr

from sysid_trib.results.variables import RESULT_TABLES

# Increase this with every change of the variables of a store.
STORE_FORMAT = 5
TIED = "tied"
EFFECT_P_VALUE = "effect_p_value"
# Variables of `judged` in a store. Those of single runs are omitted: records have different numbers of runs.
JUDGED_NAMES = tuple(name for name, (dims, *_) in RESULT_TABLES["judged"].items() if dims == "model")
# Label in place of a model: the preferred model of each record.
PREFERRED = "preferred"


class Status(IntEnum):
    """Status of a record of a campaign; its name in lower case is used in texts."""

    WAITING = 0
    DONE = 1
    REFUSED = 2
    FAILED = 3
    LOST = 4


def text_counts(store: xr.Dataset, name: str) -> dict[str, int]:
    """Count the texts of a variable over the records that have a result, the most frequent first.

    A text of each model is that of the preferred one. Empty texts do not count; a store without the variable
    has no texts.
    """
    if name not in store:
        return {}
    done = done_records(store)
    of = of_model(done, PREFERRED)[name] if "model" in done[name].dims else done[name]
    texts = sorted(text for text in of.values.tolist() if text)
    return dict(Counter(texts).most_common())


def unvisited_speeds(store: xr.Dataset) -> list[str]:
    """Return the quantities of laws at speeds that no record with a result visits."""
    done = done_records(store)
    if store.attrs.get("task") != "laws" or not done.sizes["record"]:
        return []
    known = np.isfinite(done.coefficient.values).any(axis=(0, 1))
    return [str(name) for name in store.force.values[~known].tolist()]


def counts_of(store: xr.Dataset) -> dict[str, int]:
    """Count the records of a store by status."""
    counted = np.bincount(store.status.values, minlength=len(Status))
    return {status.name.lower(): count for status, count in zip(Status, counted.tolist(), strict=True)}


def done_records(store: xr.Dataset) -> xr.Dataset:
    """Return the records of a store that have a result."""
    return store.isel(record=np.flatnonzero(store.status.values == Status.DONE))


def of_model(store: xr.Dataset, label: str) -> xr.Dataset:
    """Return a store with one model of each record.

    Parameters
    ----------
    store : Dataset
        Store of a campaign.
    label : str
        Label of a model, or `PREFERRED`; for a record without a result, this is the first model.
    """
    if label != PREFERRED:
        return store.sel(model=label)
    chosen = store.preferred.values.astype(str)[:, None] == store.model.values.astype(str)
    return store.isel(model=xr.DataArray(chosen.argmax(axis=1), dims="record"))


def reported_model(store: xr.Dataset) -> str:
    """Return the label of the identification that a campaign compares between records.

    Among the methods that identify most forces, this is the one preferred in most records, or else the last.
    For laws it is the preferred method of each record.
    """
    if store.attrs.get("task") == "laws":
        return PREFERRED
    done = done_records(store)
    labels = store.model.values.astype(str)
    if not done.sizes["record"]:
        return str(labels[-1])
    known = np.isfinite(done.standard_error.values).sum(axis=2)
    forces = np.median(known, axis=0)
    wins = [np.count_nonzero(done.preferred.values == label) for label in labels]
    rank = np.lexsort([np.arange(len(labels)), wins, forces])
    return str(labels[rank[-1]])
