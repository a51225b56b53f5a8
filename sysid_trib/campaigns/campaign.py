"""`campaign`: many records with one task, on workers of dask or in this process, into one store."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from itertools import islice
from logging import CRITICAL
from multiprocessing import current_process, resource_tracker
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Index
from sysid_trib.campaigns.rows import Row, sole_writer
from sysid_trib.campaigns.store import as_dataset, store_for
from sysid_trib.campaigns.task import TASKS, CampaignRecords, Name, Task, empty_row, record_at, rows_of
from sysid_trib.errors import Tell, UsageError, silent
from sysid_trib.results.store import Status

# Smallest number of blocks of a store, and largest number of records in a block: if a process is killed, at
# most one block is lost.
BLOCKS, LARGEST_BLOCK = 1000, 100
EXTRA = ("distributed", "zarr")
# Interval at which the workers are counted, s. On a busy machine a new worker needs more than the 15 s after
# which dask gives up on it.
LOOKED_AFTER, STARTS_WITHIN = 20.0, "120s"
# Number of workers that may die during a block before the block is given up.
DEATHS = 10
# Intervals at which each process checks its loop, and the load of the machine; at dask's defaults (20 ms, 0.5
# s) idle processes take a twentieth of a core.
TICK, MONITOR = "500ms", "5s"
# Variable by which Python leaves out the current folder.
SAFE_PATH = "PYTHONSAFEPATH"


def campaign(
    records: CampaignRecords,
    task: Task | Name = "identify",
    *,
    output: str | os.PathLike[str],
    workers: int | str = 2,
    memory: str = "auto",
    tell: Tell = silent,
) -> xr.Dataset:
    """Run one task on many records, on several processes or machines, and write a Zarr store.

    Parameters
    ----------
    records : sequence of path or record
        Files, or decays in memory, also as `(t, angle)`. Other records are named by texts from which
        `Task.read` makes decays.
    task : Task or str
        The task for each record: `identify`, `compare` or `discover` with its defaults, or a `Task`.
    output : path-like
        Path of the store. An existing store is continued: finished records are not computed again unless
        their files have changed; further records may be added.
    workers : int or str
        Number of processes on this machine; 0 means this process alone, without dask. Or the address of a
        scheduler of dask (tcp://...), whose workers see the files under the same names.
    memory : str
        Memory limit of each process on this machine ("2GB"), by default an equal share of all memory; a
        process that needs more is replaced.
    tell : Tell, optional
        Function that is called with the progress and the failures.

    Returns
    -------
    Dataset
        Over `record`, `model`, `force`: `coefficient` with `standard_error`; over `record` and `model`:
        reference and asymptotic frequency (rad/s), `noise`, density of the random force, with errors, and the
        variables of the group `judged` of the task's function (`verdict`, `residual_over_noise`, `p_value`,
        ...), without those of single runs; over `record`: `preferred` (the preferred model), `status` (0
        waiting, 1 done, 2 refused, 3 failed, 4 lost with its worker), `message` for a record without numbers,
        `seconds`; for a cross-check `agreement_p_value`; for `discover` also `search_outcome`, `converged`,
        `named` effects, `tied`, the effects that cannot be separated from the named ones ("epsilon or
        gravity"), and over `record` and `force` the corrected `effect_p_value` of each named effect. Values
        are read on access. `store.sel(model="direct")` selects the model of one method; a method that does
        not apply to a record has nan and no verdict there.

    Raises
    ------
    UsageError
        There are no records, the store belongs to another campaign, there is no scheduler, or dask or zarr is
        missing.
    RecordError
        The store cannot be written.

    Notes
    -----
    Each record of a study has its own seed (`SeedSequence` with the record's number): results depend neither
    on the number of workers nor on the order. An invalid record does not stop the campaign. A record whose
    worker died eleven times is given up, and tried again when the campaign is continued.

    Examples
    --------
    >>> import sysid_trib as st
    >>> records = [st.records.paper_twin(seed=seed) for seed in (1, 2)]
    >>> task = st.campaigns.Task("identify", methods={"direct": st.methods.Direct()})
    >>> store = st.campaign(records, task, output="runs.zarr", workers=0)
    >>> store.coefficient.sel(model="direct", force="zeta").round(4).values.tolist()
    [0.0096, 0.0097]
    """
    check_extra()
    if getattr(current_process(), "_inheriting", False):
        # A process that it started would begin it again, as its script is read there.
        raise UsageError(
            'A script that starts processes needs if __name__ == "__main__": around its campaign; '
            "or take workers=0."
        )
    task = Task(task) if isinstance(task, str) else task
    if not isinstance(task, Task):
        raise UsageError(f"campaign needs a Task, or one of {', '.join(TASKS)}; not {task!r}.")
    if isinstance(records, str | os.PathLike | xr.Dataset) or not len(records):
        raise UsageError("A campaign needs a list of at least one record.")
    # A link to a store remains a link when records are added.
    path = Path(output).resolve() if Path(output).is_symlink() else Path(output)
    with sole_writer(path):
        count = len(records)
        store = store_for(path, task, records, max(1, min(LARGEST_BLOCK, count // BLOCKS)))
        blocks, changed, bad = store.unfinished(records)
        done = count - sum(len(at) for at in blocks)
        tell(f"workers; {changed:,} records have changed" if changed else "workers")
        for at, rows in _finished_blocks(
            task, blocks, partial(record_at, records), workers=workers, memory=memory
        ):
            store.write(at, rows)
            done += len(at)
            bad += sum(row["status"] > 1 for row in rows)
            tell(f"{done:,} of {count:,} records, {bad:,} without a result", done / count)
        return as_dataset(path)


def check_extra() -> None:
    """Raise an error if dask or zarr is not installed.

    Raises
    ------
    UsageError
        The message states how to install it.
    """
    if lacking := [name for name in EXTRA if find_spec(name) is None]:
        raise UsageError(
            f"A campaign needs {' and '.join(lacking)}: pip install -e '.[campaigns]' in a clone."
        )


def _finished_blocks(
    task: Task, blocks: Sequence[Index], record_at: Callable[[int], Any], *, workers: int | str, memory: str
) -> Iterator[tuple[Index, list[Row]]]:
    """Yield the record numbers and the rows of each block, in the order of completion.

    See `campaign` for workers and memory; a waiting block is read when it is sent.
    """
    if not workers:
        for block in blocks:
            yield block, rows_of(task, [record_at(at) for at in block])
        return
    with _without_current_folder(), _client(workers, memory) as client:
        yield from _through(client, task, blocks, record_at, workers)


def _through(
    client: Any, task: Task, blocks: Sequence[Index], record_at: Callable[[int], Any], workers: int | str
) -> Iterator[tuple[Index, list[Row]]]:
    from distributed import as_completed

    waiting = iter(blocks)
    sent: dict[str, Index] = {}

    def submit(block: Index) -> Any:
        future = client.submit(rows_of, task, [record_at(at) for at in block], pure=False)
        sent[future.key] = block
        return future

    # Some workers on this machine may not have started yet.
    count = workers if isinstance(workers, int) else len(client.nthreads())
    # Blocks that wait at each worker: enough to keep it busy, few enough for the memory.
    running = as_completed([submit(block) for block in islice(waiting, 3 * max(1, count))])
    for future in running:
        block = sent.pop(future.key)
        if future.status == "finished":
            yield block, future.result()
        elif len(block) > 1:
            # One of its records kills its workers, so the records are run one by one.
            for at in block:
                running.add(submit(np.array([at])))
        else:
            reason = f"its worker died {DEATHS + 1} times ({future.exception()}); it may need more memory"
            yield block, [empty_row(task) | {"status": Status.LOST, "message": reason}]
        future.release()
        for following in islice(waiting, 1):
            running.add(submit(following))


@contextmanager
def _client(workers: int | str, memory: str) -> Iterator[Any]:
    """Yield a client of an existing scheduler, or of a cluster of this machine."""
    import dask
    from distributed import Client, LocalCluster

    # Workers return messages with their rows; profiles and logs of all events only grow. Memory that is
    # returned at each chance is allocated anew with each array: 5 % of the time of a record.
    quiet = {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.comm.timeouts.connect": "10s",
        "distributed.deploy.lost-worker-timeout": STARTS_WITHIN,
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": TICK,
        "distributed.admin.system-monitor.interval": MONITOR,
        "distributed.admin.log-length": 100,
        "distributed.admin.low-level-log-length": 100,
        "distributed.admin.system-monitor.log-length": 100,
    }
    with dask.config.set(quiet):
        if isinstance(workers, str):
            try:
                with Client(workers) as client:
                    yield client
            except (OSError, ValueError) as error:
                raise UsageError(
                    f"No scheduler of dask answers at {workers} ({error}); start one (dask scheduler), "
                    "or leave --scheduler out."
                ) from None
            return
        with _interrupts_held():
            local = LocalCluster(
                # A worker that dies while it starts must not end the others: they are awaited below.
                n_workers=0,
                threads_per_worker=1,
                memory_limit=memory,
                # Without a web page; the minimal server in its place must not use the port of other servers.
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False},
                silence_logs=CRITICAL,
            )
        with local as cluster, Client(cluster) as client, _looked_after(cluster, workers):
            try:
                client.wait_for_workers(1, timeout=STARTS_WITHIN)
            except TimeoutError:
                raise UsageError(
                    f"No worker has started within {STARTS_WITHIN}; a script that starts processes needs "
                    'if __name__ == "__main__": around its campaign. Else give them more memory, or take '
                    "workers=0."
                ) from None
            yield client


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Block interrupts in threads and processes that start in this context.

    Only this process handles an interrupt, and ends them; each of them would print a traceback.
    """
    # The first started process would otherwise enable interrupts again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_current_folder() -> Iterator[None]:
    """Keep processes that start in this context from importing from the current folder.

    A file `signal.py` next to the records would be executed. The processes get the path of this process, in
    which they find the imports of the user's script.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before


@contextmanager
def _looked_after(cluster: Any, workers: int) -> Iterator[None]:
    """Start workers, and replace those that dask gave up because they died while starting."""
    ended = Event()
    cluster.scale(workers)

    def look() -> None:
        while not ended.wait(LOOKED_AFTER):
            for name, worker in list(cluster.workers.items()):
                if worker.status.name in ("closed", "failed"):
                    cluster.workers.pop(name, None)
            cluster.scale(workers)

    Thread(target=look, daemon=True).start()
    try:
        yield
    finally:
        ended.set()
