"""The process that runs hostile cases, and says how each ended.

It takes a kind, the seed, the first case, how many, and a folder; it writes a line of JSON for each case on
standard output. It may die: who started it sees at which case, and goes on after it with another one.
"""

import contextlib
import faulthandler
import json
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import numpy as np

from benchmarks.hostile import (
    commands,
    discoveries,
    files,
    formulas,
    libraries,
    records,
    results,
    stores,
    tables,
)
from benchmarks.hostile.pieces import MARK, words
from sysid_trib.errors import SysidTribError

Kind = Callable[[np.random.Generator, Path], Callable[[], object]]
KINDS: dict[str, Kind] = {
    "text": tables.case,
    "binary": files.case,
    "library": libraries.library_case,
    "toml": libraries.toml_case,
    "damaged": results.damaged_case,
    "page": results.page_case,
    "formula": formulas.case,
    "store": stores.case,
    "record": records.case,
    "command": commands.case,
    "discover": discoveries.case,
}
# Fits take their time; what is read, loaded or parsed must not.
WORKING = ("page", "store", "record", "command", "discover")
SLOWEST_S, SLOWEST_WORK_S, HUNG_S = 5.0, 60.0, 900.0
MOST_MEMORY = 2**30
# After which a process makes room for another one: some libraries keep what they have seen.
GROWN = 2**29
FORBIDDEN = words("os.system os.exec os.posix_spawn os.startfile socket.connect socket.getaddrinfo pty.spawn")
# Processes that the package starts itself.
OWN_PROCESSES = ("sysid_trib.records.probe", "lscpu", "uname", "fc-list")


def random_of(kind: str, seed: int, number: int) -> np.random.Generator:
    """What a case is drawn from: its kind, the seed and its number alone."""
    return np.random.default_rng([seed, *kind.encode(), number])


class Watch:
    """Peak memory and forbidden events while a case runs."""

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
        action = KINDS[kind](random_of(kind, seed, number), folder)
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


def main(kind: str, seed: int, first: int, count: int, folder: Path) -> None:
    """Run cases one after another, until all are done or the process has grown."""
    # What a library prints must not stand among the lines of the cases.
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    faulthandler.enable()
    faulthandler.register(signal.SIGPROF, chain=True)
    watch = Watch()
    os.chdir(folder)
    begun_with = _memory("VmRSS")
    for number in range(first, first + count):
        print(json.dumps({"number": number}), file=out)
        print(json.dumps(run(kind, seed, number, folder, watch)), file=out)
        if _memory("VmRSS") - begun_with > GROWN:
            break


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), Path(sys.argv[5]))
