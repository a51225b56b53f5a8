"""Hostile input of every kind: each case ends in a result or in an error of the package's own.

python -m benchmarks.fuzz [--cases N] [--kind KIND ...] [--seed S] [--first N] [--out FILE]

Kinds: text, binary (files that are read); library, toml (libraries and their formulas, systems, studies);
formula (signals computed from columns); store (of campaigns, damaged; conditions); damaged, page (saved
results, pages of edited ones); record (datasets in memory); command (options, letters);
discover (random records and libraries). A case is drawn from the seed, its kind and its number alone: a fault
is repeated by --kind KIND --seed S --first N --cases 1. The cases of a kind run in one process, which is
replaced when it dies or hangs, and after some. A fault is any other exception, over 5 s of processor time to
read or parse, over 1 GiB of memory, numbers from another file, or a process or a connection that was begun.
"""

import argparse
import contextlib
import faulthandler
import multiprocessing
import os
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.hostile import commands, files, libraries, records, results, tables
from benchmarks.hostile.pieces import MARK, words
from benchmarks.study.common import added
from sysid_trib.errors import SysidTribError

Kind = Callable[[np.random.Generator, Path], Callable[[], object]]
# By kind: what draws a case, and its share of the cases.
KINDS: dict[str, tuple[Kind, int]] = {
    "text": (tables.case, 20),
    "binary": (files.case, 15),
    "library": (libraries.library_case, 25),
    "toml": (libraries.toml_case, 15),
    "damaged": (results.damaged_case, 5),
    "page": (results.page_case, 1),
    "formula": (tables.formula_case, 10),
    "store": (results.store_case, 5),
    "record": (records.case, 8),
    "command": (commands.case, 10),
    "discover": (records.discover_case, 1),
}
# Fits take their time; what is read, loaded or parsed must not.
WORKING = ("page", "store", "record", "command", "discover")
SLOWEST_S, SLOWEST_WORK_S, HUNG_S = 5.0, 60.0, 900.0
MOST_MEMORY = 2**30
# Cases after which a process makes room for another one: some libraries keep what they have seen.
AT_ONCE = 500
FORBIDDEN = words("os.system os.exec os.posix_spawn os.startfile socket.connect socket.getaddrinfo pty.spawn")
# Processes that the package starts itself.
OWN_PROCESSES = ("sysid_trib.records.probe", "lscpu", "uname", "fc-list")


# How a case ends that should not.
FAULTS = ("fault", "unreadable")
# Of a process that runs cases, once it is one.
WATCHED: "list[Watch]" = []


def random_of(kind: str, seed: int, number: int) -> np.random.Generator:
    """Return the random generator of a case, from its kind, the seed and its number."""
    return np.random.default_rng([seed, *kind.encode(), number])


class Watch:
    """Forbidden events while a case runs."""

    def __init__(self) -> None:
        self.on, self.events = False, []
        sys.addaudithook(self._hear)

    def _hear(self, event: str, args: Any) -> None:
        if not self.on:
            return
        if event in FORBIDDEN or (
            event == "subprocess.Popen" and not any(p in str(args) for p in OWN_PROCESSES)
        ):
            self.events.append(f"{event} {str(args)[:200]}")


def _memory(of: str) -> int:
    """Resident memory in bytes, VmRSS now or VmHWM at its peak; 0 where the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(of))


def _reset_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def run(kind: str, seed: int, number: int, folder: Path, watch: Watch | None = None) -> dict[str, Any]:
    """Run one case.

    Returns
    -------
    dict
        `end`: `result`, the package's error, or what is wrong; with `seconds`, `bytes` and `said`.
    """
    with warnings.catch_warnings(action="ignore"):
        action = KINDS[kind][0](random_of(kind, seed, number), folder)
    _reset_peak()
    before, start, wall, said, where = _memory("VmHWM"), process_time(), monotonic(), "", ""
    slowest = SLOWEST_WORK_S if kind in WORKING else SLOWEST_S
    if watch:
        # A hang ends the process with a traceback: one that computes, or waits.
        signal.setitimer(signal.ITIMER_PROF, 2.0 * slowest)
        faulthandler.dump_traceback_later(HUNG_S, exit=True)
        watch.on, watch.events = True, []
    try:
        with warnings.catch_warnings(action="ignore"):
            action()
        end = "result"
    except SysidTribError as error:
        end, said = type(error).__name__, str(error)
        if not said.strip() or not said.isprintable():
            end = "unreadable"
    except Exception as error:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if "sysid_trib" in f.filename]
        end, said = f"fault {type(error).__name__}", str(error)[:300]
        where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    finally:
        if watch:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            faulthandler.cancel_dump_traceback_later()
            watch.on = False
    seconds, memory = process_time() - start, _memory("VmHWM") - before
    if watch and watch.events:
        end, said = "fault executed", "; ".join(watch.events)
    if (folder / MARK).exists() or Path(MARK).exists():
        end = "fault executed"
    if seconds > slowest:
        end, said = "fault slow", f"{seconds:.1f} s ({end})"
    if memory > MOST_MEMORY:
        end, said = "fault memory", f"{memory / 2**20:.0f} MiB ({end})"
    ended = {"number": number, "end": end, "said": said[:300], "where": where, "bytes": memory}
    return ended | {"seconds": round(seconds, 3), "wall": round(monotonic() - wall, 3)}


def begun(folder: Path) -> None:
    """Make this process one that runs cases."""
    # What a library prints must not stand among the table.
    os.dup2(2, 1)
    faulthandler.enable()
    faulthandler.register(signal.SIGPROF, chain=True)
    os.chdir(folder)
    WATCHED.append(Watch())


def watched(kind: str, seed: int, number: int, folder: Path) -> dict[str, Any]:
    return run(kind, seed, number, folder, WATCHED[0])


def cases_of(kind: str, seed: int, first: int, count: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the outcome of each case of a kind; a process that dies is a fault, too."""
    spawn, left = multiprocessing.get_context("spawn"), list(range(first, first + count))
    lost = {"end": "fault ended its process", "said": "", "where": "", "seconds": 0.0, "bytes": 0}
    while left:
        with ProcessPoolExecutor(1, spawn, begun, (folder,)) as pool:
            for number in left[:AT_ONCE]:
                left.remove(number)
                try:
                    yield pool.submit(watched, kind, seed, number, folder).result()
                except BrokenProcessPool:
                    yield {"number": number, **lost}
                    break


def main() -> None:
    """Run the cases, and say what they came to."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--cases", type=int, default=1000)
    options.add_argument("--kind", nargs="+", choices=list(KINDS), default=list(KINDS))
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--out", type=Path)
    given = options.parse_args()
    heads = ("kind", "cases", "results", "errors of the package", "faults", "longest (s)", "memory (MiB)")
    table, whole = Table(*heads), sum(KINDS[kind][1] for kind in given.kind)
    print(f"seed {given.seed}", flush=True)
    for kind in given.kind:
        count, ends, longest, memory = max(1, given.cases * KINDS[kind][1] // whole), Counter(), 0.0, 0
        with tempfile.TemporaryDirectory() as folder:
            for case in cases_of(kind, given.seed, given.first, count, Path(folder)):
                ends[case["end"]] += 1
                longest, memory = max(longest, case["seconds"]), max(memory, case["bytes"])
                if case["end"].startswith(FAULTS):
                    print(kind, case["number"], case["end"], case["where"], case["said"], flush=True)
                added(given.out, {"kind": kind, "seed": given.seed, **case})
        faults = sum(n for end, n in ends.items() if end.startswith(FAULTS))
        own = sum(ends.values()) - ends["result"] - faults
        counts = sum(ends.values()), ends["result"], own, faults
        table.add_row(kind, *map(str, counts), f"{longest:.1f}", f"{memory / 2**20:.0f}")
        print(kind, dict(ends), flush=True)
    Console().print(table)


if __name__ == "__main__":
    main()
