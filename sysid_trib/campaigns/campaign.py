"""`campaign`: many records by one task, into one store that can be gone on with."""

import os
from collections.abc import Sequence
from importlib.util import find_spec
from multiprocessing import current_process
from pathlib import Path

import xarray as xr

from sysid_trib.campaigns.chunks import sole_writer
from sysid_trib.campaigns.new_store import CampaignRecords
from sysid_trib.campaigns.run import finished_blocks
from sysid_trib.campaigns.store import Store, as_dataset
from sysid_trib.campaigns.study import Study
from sysid_trib.campaigns.task import Task
from sysid_trib.errors import Tell, UsageError, silent

# Blocks of a store at least, and the most records that a block holds: what a kill may cost.
BLOCKS, LARGEST_BLOCK = 1000, 100
EXTRA = ("distributed", "zarr")


def campaign(
    records: Sequence[str | os.PathLike[str] | xr.Dataset] | Study,
    task: Task,
    *,
    output: str | os.PathLike[str],
    workers: int | str = 2,
    memory: str = "auto",
    tell: Tell = silent,
) -> xr.Dataset:
    """Do one task with many records, on several processes or machines, into one Zarr store.

    Parameters
    ----------
    records : sequence of path or Dataset, or Study
        Files, decays in memory, or simulated records drawn from a description (`load_study`).
    task : Task
        What is done with each.
    output : path-like
        The store. One that is there is gone on with: what is done in it is not done again, unless a record's
        file has changed since; more records may come to it.
    workers : int or str
        Processes on this machine; 0: this process alone, without dask. Or the address of a scheduler of dask
        (tcp://...), whose workers see the files under the same names.
    memory : str
        Of each process on this machine ("2GB"), by default its part of all; one that needs more is replaced.
    tell : Tell, optional
        Called with what is done and what failed.

    Returns
    -------
    Dataset
        Over `record`, `method`, `force`: `coefficient` with `standard_error`; over `record` and `method`
        reference and asymptotic frequency (rad/s), `noise`, density of the random force, with errors; over
        `record`: `status` (0 waiting, 1 done, 2 refused, 3 failed, 4 lost with its worker), `message` of a
        record without numbers, `verdict`, `named` effects, `p_value` of the agreement of both methods,
        `seconds`; of `discover` besides `tied`, what those named cannot be separated from ("epsilon or
        gravity"), and over `record` and `force` the corrected `effect_p_value` of each that is named; of a
        study `true_coefficient`. Values are read when they are used. `method` is an argument of xarray's
        `sel`, so that a method is chosen by `store.sel({"method": "direct"})`.

    Raises
    ------
    UsageError
        No records, a store of another campaign, no scheduler, or no dask or zarr.
    RecordError
        The store cannot be written.

    Notes
    -----
    Records of a study have seeds of their own (`SeedSequence` by the record's number): results depend neither
    on the number of workers nor on the order. One bad record ends nothing; one whose worker died eleven times
    is given up, and tried again when the campaign is gone on with.
    """
    check_extra()
    _check_process()
    whole = CampaignRecords(records)
    # A link to a store stays one when records come to it.
    path = Path(output).resolve() if Path(output).is_symlink() else Path(output)
    with sole_writer(path):
        store = Store(path, task, whole, max(1, min(LARGEST_BLOCK, len(whole) // BLOCKS)))
        _fill(store, task, whole, workers, memory, tell)
        return as_dataset(path)


def _fill(
    store: Store, task: Task, records: CampaignRecords, workers: int | str, memory: str, tell: Tell
) -> None:
    """Do what is still to be done in a store."""
    changed, count = store.changed(records), len(records)
    blocks = store.unfinished(changed)
    done, bad = count - sum(len(at) for at in blocks), store.without_result(changed)
    tell(f"workers; {changed.sum():,} records have changed" if changed.any() else "workers")
    for at, rows in finished_blocks(task, blocks, records.record, workers=workers, memory=memory):
        store.write(at, rows)
        done += len(at)
        bad += sum(row["status"] > 1 for row in rows)
        tell(f"{done:,} of {count:,} records, {bad:,} without a result", done / count)


def _check_process() -> None:
    """Refuse a campaign that a process which it starts would begin again, as its script is read there."""
    if getattr(current_process(), "_inheriting", False):
        raise UsageError(
            'A script that starts processes wants if __name__ == "__main__": around its campaign; '
            "or take workers=0."
        )


def check_extra() -> None:
    """Refuse a campaign where dask or zarr is not there.

    Raises
    ------
    UsageError
        With what installs them.
    """
    if lacking := [name for name in EXTRA if find_spec(name) is None]:
        raise UsageError(
            f"A campaign needs {' and '.join(lacking)}: pip install -e '.[campaigns]' in a clone."
        )
