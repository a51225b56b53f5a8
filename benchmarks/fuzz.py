"""Hostile input of every kind: each case ends in a result or in an error of the package's own.

python -m benchmarks.fuzz [--cases N] [--kind KIND ...] [--seed S] [--first N] [--out FILE]

Kinds: text, binary (files that are read); library, toml (libraries and their formulas, systems, studies);
formula (signals computed from columns); store (of campaigns, damaged; conditions); damaged, page (saved
results, pages of edited ones); record (datasets in memory); command (options, letters);
discover (random records and libraries). A case is drawn from the seed, its kind and its number alone: a fault
is repeated by --kind KIND --seed S --first N --cases 1. The cases of a kind run in one process, which is
replaced when it dies, hangs or has grown. A fault is any other exception, over 5 s of processor time to
read or parse, over 1 GiB of memory, numbers from another file, or a process or a connection that was begun.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.hostile.worker import KINDS

SHARES = dict(zip(KINDS, (20, 15, 25, 15, 5, 1, 10, 5, 8, 10, 1), strict=True))


def cases_of(kind: str, seed: int, first: int, count: int, folder: Path):
    """How each case of a kind ended."""
    number, last = first, first + count
    while number < last:
        command = [sys.executable, "-m", "benchmarks.hostile.worker", kind, str(seed), str(number)]
        command += [str(last - number), str(folder)]
        with (folder.parent / "stderr.txt").open("w+", errors="replace") as complaints:
            worker = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=complaints, text=True, cwd=Path(__file__).parents[1]
            )
            begun = None
            for line in worker.stdout:
                case = json.loads(line)
                if "end" in case:
                    begun, number = None, case["number"] + 1
                    yield case
                else:
                    begun = case["number"]
            status = worker.wait()
            complaints.seek(0)
            said = complaints.read()[-2000:]
        if begun is None and status:
            raise RuntimeError(f"the harness itself failed: {said}")
        if begun is not None:
            lost = {"where": "", "seconds": 0.0, "bytes": 0, "wall": 0.0}
            yield {"number": begun, "end": f"fault ended with {status}", "said": said, **lost}
            number = begun + 1


def main() -> None:
    """Run the cases, and say what they came to."""
    options = argparse.ArgumentParser()
    options.add_argument("--cases", type=int, default=1000)
    options.add_argument("--kind", nargs="+", choices=list(KINDS), default=list(KINDS))
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--out", type=Path)
    given = options.parse_args()
    table = Table(
        "kind", "cases", "results", "errors of the package", "faults", "longest (s)", "most memory (MiB)"
    )
    whole = sum(SHARES[kind] for kind in given.kind)
    print(f"seed {given.seed}", flush=True)
    for kind in given.kind:
        count = max(1, given.cases * SHARES[kind] // whole)
        ends, longest, memory = Counter(), 0.0, 0
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / "cases"
            place.mkdir()
            for case in cases_of(kind, given.seed, given.first, count, place):
                ends[case["end"]] += 1
                longest, memory = max(longest, case["seconds"]), max(memory, case["bytes"])
                if case["end"].startswith(("fault", "unreadable")):
                    print(kind, case["number"], case["end"], case["where"], case["said"], flush=True)
                if given.out:
                    with given.out.open("a") as file:
                        file.write(json.dumps({"kind": kind, "seed": given.seed, **case}) + "\n")
        faults = sum(n for end, n in ends.items() if end.startswith(("fault", "unreadable")))
        own = sum(ends.values()) - ends["result"] - faults
        counts = sum(ends.values()), ends["result"], own, faults
        table.add_row(kind, *map(str, counts), f"{longest:.1f}", f"{memory / 2**20:.0f}")
        print(kind, dict(ends), flush=True)
    Console().print(table)


if __name__ == "__main__":
    main()
