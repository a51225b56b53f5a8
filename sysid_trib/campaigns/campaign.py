"""`campaign`: many records by one task, on workers of dask or in this process, into one store."""

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

# Least number of blocks of a store, and the most records of a block: a killed process loses at most one
# block.
BLOCKS, LARGEST_BLOCK = 1000, 100
EXTRA = ("distributed", "zarr")
# Interval at which the workers are counted, s; on a busy machine a new worker takes more than the 15 s after
# which dask gives its place up.
LOOKED_AFTER, STARTS_WITHIN = 20.0, "120s"
# Number of workers that may die with a block before it is given up.
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
        Files, or decays in memory, `(t, angle)` too. What else names a record is a text that `Task.read`
        makes decays of.
    task : Task or str
        The task for each record: `identify`, `compare` or `discover` with its defaults, or a `Task`.
    output : path-like
        The store. One that is there is gone on with: what is done in it is not done again, unless a record's
        file has changed since; more records may come to it.
    workers : int or str
        Processes on this machine; 0: this process alone, without dask. Or the address of a scheduler of dask
        (tcp://...), whose workers see the files under the same names.
    memory : str
        Limit of each process on this machine ("2GB"), by default its share of all; a process that needs more
        is replaced.
    tell : Tell, optional
        Called with what is done and what failed.

    Returns
    -------
    Dataset
        Over `record`, `model`, `force`: `coefficient` with `standard_error`; over `record` and `model`
        reference and asymptotic frequency (rad/s), `noise`, density of the random force, with errors, and the
        variables of the group `judged` of the task's function (`verdict`, `residual_over_noise`, `p_value`,
        ...), those of each run left out; over `record`: `preferred`, the preferred model, `status` (0
        waiting, 1 done, 2 refused, 3 failed, 4 lost with its worker), `message` of a record without numbers,
        `seconds`; of a cross-check `agreement_p_value`; of `discover` `search_outcome`, `converged`, `named`
        effects, `tied`, what those named cannot be separated from ("epsilon or gravity"), and over `record`
        and `force` the corrected `effect_p_value` of each that is named. Values are read when they are used.
        `store.sel(model="direct")` chooses the model of one method; a method that does not apply to a record
        has nan and no verdict there.

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
    # A link to a store stays one when records come to it.
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
        With what installs them.
    """
    if lacking := [name for name in EXTRA if find_spec(name) is None]:
        raise UsageError(
            f"A campaign needs {' and '.join(lacking)}: pip install -e '.[campaigns]' in a clone."
        )


def _finished_blocks(
    task: Task, blocks: Sequence[Index], record_at: Callable[[int], Any], *, workers: int | str, memory: str
) -> Iterator[tuple[Index, list[Row]]]:
    """Yield the record numbers and the rows of each block, in the order of completion.

    See `campaign` for workers and memory; a block that waits is read when it is sent.
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

    # On this machine not all may have started yet.
    count = workers if isinstance(workers, int) else len(client.nthreads())
    # Blocks that wait at each worker: enough to keep it busy, few enough for the memory.
    running = as_completed([submit(block) for block in islice(waiting, 3 * max(1, count))])
    for future in running:
        block = sent.pop(future.key)
        if future.status == "finished":
            yield block, future.result()
        elif len(block) > 1:
            # One of them ends its workers: each by itself.
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
                # Without a page; the server in its place must not use the port of other servers.
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
    """Hide interrupts from threads and processes that start in this context.

    It is for this process, which ends them; each of theirs would print a traceback.
    """
    # The first process that is started would let interrupts through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_current_folder() -> Iterator[None]:
    """Keep processes that start in this context from importing from the current folder.

    A file `signal.py` next to the records would be executed. They get the path of this process, and find the
    imports of the user's script by it.
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
