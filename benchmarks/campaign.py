"""Campaigns: speed of two workers, memory over many records, kills of the campaign and of its workers.

python -m benchmarks campaign [--records N] [--only speed|memory|kills|workers|scheduler] [--every S]

speed: N simulated runs of the paper's experiment by averaging, direct and trajectory, in this process, by one
worker and by two. memory: ten times as many by direct, the resident memory of each worker over time. kills: a
campaign that is killed (SIGKILL, all its processes) at 20 random moments and gone on with, against one that
never was. workers: a worker killed every few seconds. scheduler: what a block of a campaign
costs; from it the plan for a million records on a hundred workers follows.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from argparse import Namespace
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import RecordError
from sysid_trib.results.store import counts_of

PAPER = {"lambda": -2.3e-5, "zeta": 9.5e-3, "delta": 0.037, "nu": -0.4, "epsilon": 0.3}
LIBRARY = st.load_library("contact_forces").select(list(PAPER))
TIMES = np.arange(0.0, 25.0, 0.01)
METHODS = {
    "averaging": st.methods.Averaging(),
    "direct": st.methods.Direct(),
    "trajectory": st.methods.Trajectory(),
}
KILLS, KILLED_RECORDS = 20, 400
SETTLED_RECORDS = 500
# A thousand blocks of the size that a million records have.
REFUSED_RECORDS = 100_000


def task(*labels: str) -> st.campaigns.Task:
    """Identification by some methods, not cross-checked, of records that are drawn by their number."""
    chosen = {label: METHODS[label] for label in labels}
    return st.campaigns.Task("identify", LIBRARY, chosen, cross_checked=False, read=drawn)


def numbered(records: int) -> list[str]:
    """The names of so many records."""
    return [str(at) for at in range(records)]


def drawn(name: str) -> list[xr.Dataset]:
    """Draw a run of the paper's experiment by its number."""
    random = np.random.default_rng([1, int(name)])
    model = st.Model(LIBRARY, PAPER | {"zeta": random.uniform(9e-3, 10e-3)}, 9.91)
    angle = st.simulate(model, TIMES, 0.3).angle.values + 1e-4 * random.standard_normal(TIMES.size)
    return [st.free_decay(xr.Dataset({"angle": ("time", angle)}, {"time": TIMES}))]


def one_row(**cells: object) -> pd.DataFrame:
    """A table of a row."""
    return pd.DataFrame([cells])


def speed(folder: Path, records: int) -> pd.DataFrame:
    """Seconds in this process, by one worker and by two."""
    all_methods = task(*METHODS)
    # Compiled motions and imports are not the campaign's.
    st.campaign(numbered(20), all_methods, output=folder / "few.zarr", workers=0)
    spent = {}
    for workers in (0, 1, 2):
        start = time.perf_counter()
        st.campaign(numbered(records), all_methods, output=folder / f"speed{workers}.zarr", workers=workers)
        spent[workers] = time.perf_counter() - start
    names = ("this process (s)", "1 worker (s)", "2 workers (s)")
    ratios = {"2 / process": spent[2] / spent[0], "1 / 2": spent[1] / spent[2]}
    return one_row(records=records, **dict(zip(names, spent.values(), strict=True)), **ratios)


def memory(folder: Path, records: int) -> pd.DataFrame:
    """Resident memory of each process, at the first 500 records and at the last."""
    seen: list[tuple[float, dict[int, int]]] = []

    def tell(activity: str, done: float | None = None) -> None:
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        known = {}
        for process in processes:
            try:
                known[process.pid] = process.memory_info().rss
            except psutil.NoSuchProcess:
                continue
        seen.append((done or 0.0, known))

    st.campaign(numbered(records), task("direct"), output=folder / "memory.zarr", workers=2, tell=tell)
    settled = next(known for done, known in seen if done * records >= SETTLED_RECORDS)
    last = seen[-2][1]
    heads = [f"after {SETTLED_RECORDS} records (MB)", f"after {records:,} (MB)"]
    table = pd.DataFrame([settled, last], index=heads).T.dropna() / 1e6
    here = ["this" if pid == os.getpid() else "child" for pid in table.index]
    return table.assign(ratio=table[heads[1]] / table[heads[0]], process=here)


def kills(folder: Path) -> pd.DataFrame:
    """Killed at random moments and gone on with: equal to one that never was."""
    random, records = np.random.default_rng(3), numbered(KILLED_RECORDS)
    whole = st.campaign(records, task("direct"), output=folder / "whole.zarr", workers=0)
    part, done, readable, killed = folder / "part.zarr", [], 0, 0
    for _ in range(KILLS):
        command = [sys.executable, "-m", "benchmarks", "campaign", "--call", str(part)]
        before = written(part)
        process = subprocess.Popen(command, start_new_session=True)
        more = int(random.integers(0, 2 * KILLED_RECORDS // KILLS))
        while process.poll() is None and written(part) - before < more:
            time.sleep(0.01)
        # Of those that are killed before a first record some are killed while they start.
        time.sleep(random.uniform(0.0, 0.1 if more else 5.0))
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            killed += 1
        process.wait()
        if part.exists():
            store = st.campaigns.open_store(part).load()
            readable += 1
            done.append(counts_of(store)["done"])
    resumed = st.campaign(records, task("direct"), output=part, workers=2)
    same = resumed.drop_vars("seconds").load().identical(whole.drop_vars("seconds").load())
    stays = len(list(part.rglob("*.partial")))
    at_each = ", ".join(map(str, done))
    return one_row(kills=killed, read_after=readable, done_at_each=at_each, same_store=same, stays=stays)


def written(store: Path) -> int:
    """Chunks of the status of records: one a record, in a campaign of so few."""
    return len(list(store.glob("status/[0-9]*")))


def worker_kills(folder: Path, records: int, every: float) -> pd.DataFrame:
    """A worker killed every few seconds: nothing is lost."""
    ended, killed = threading.Event(), []

    def kill() -> None:
        while not ended.wait(every):
            workers = [
                p for p in psutil.Process().children(recursive=True) if "spawn" in " ".join(p.cmdline())
            ]
            if workers:
                killed.append(workers[len(killed) % len(workers)])
                killed[-1].kill()

    threading.Thread(target=kill, daemon=True).start()
    start = time.perf_counter()
    store = st.campaign(numbered(records), task("direct"), output=folder / "workers.zarr", workers=2)
    ended.set()
    counts, spent = counts_of(store), time.perf_counter() - start
    return one_row(records=records, killed=len(killed), done=counts["done"], lost=counts["lost"], s=spent)


def scheduler_load(folder: Path) -> pd.DataFrame:
    """Measure the cost of records that fail at once: a block is sent, scheduled, received and written."""
    names = [f"{at}.csv" for at in range(REFUSED_RECORDS)]
    nothing = st.campaigns.Task(
        "identify", LIBRARY, {"direct": METHODS["direct"]}, cross_checked=False, read=_refuse
    )
    start = time.process_time()
    st.campaign(names, nothing, output=folder / "refused.zarr", workers=2)
    here = time.process_time() - start
    blocks = len(list((folder / "refused.zarr" / "status").glob("[0-9]*")))
    figures = {"a block, here (ms)": 1e3 * here / blocks, "a record, here (ms)": 1e3 * here / len(names)}
    return one_row(records=len(names), blocks=blocks, **figures)


def _refuse(path: str) -> list:
    raise RecordError(f"{path} is no record")


def campaign(asked: Namespace) -> None:
    if asked.call:
        st.campaign(numbered(KILLED_RECORDS), task("direct"), output=asked.call[0], workers=2)
        return
    parts = {
        "speed": lambda folder: speed(folder, asked.seeds),
        "memory": lambda folder: memory(folder, 10 * asked.seeds),
        "kills": kills,
        "workers": lambda folder: worker_kills(folder, asked.seeds, asked.every),
        "scheduler": scheduler_load,
    }
    with tempfile.TemporaryDirectory() as name:
        for part in (part for title, part in parts.items() if asked.only in title):
            print(part(Path(name)).to_string(index=False, float_format="%.2f"), flush=True)
