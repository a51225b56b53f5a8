"""The blind tests: random oscillators, hidden effects, files in, names out, scored.

python benchmarks/blind/study.py [--quick] [--only CLASS] [--seeds N] [--keep FILE] [--processes N]

Records are drawn by an integrator of their own (`generator.py`); what names the effects sees files only.
With --keep, results are appended to FILE as they come, and a study that was stopped goes on.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import ExitStack, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    __package__ = "blind"

from blind.cases import Case, UnseenError
from blind.naming import named
from blind.plan import Planned, planned
from blind.scoring import table

QUICK = 4
# Records of a worker.
RECORDS = 25


def run(one: Planned) -> dict[str, Any]:
    """Draw a case, write its files, have them named: the answers beside what was found."""
    begin = time.perf_counter()
    try:
        case = one.draw()
    except UnseenError as error:
        return {"key": one.key, "kind": one.kind, "unseen": str(error)}
    drawn = time.perf_counter()
    row = {
        "key": one.key,
        "kind": one.kind,
        "runs": len(case.runs) - 1,
        "colour": case.setting.colour,
        "base": case.setting.oscillator.base,
        "start": case.setting.starts[0],
        "hidden": [asdict(hidden) for hidden in case.hidden],
        "left_out": case.left_out,
        "beyond": case.beyond,
        "drawing": drawn - begin,
    }
    try:
        row["found"] = found = look(case)
        # Against the noise that is there: its level is not known to a hundredth of a weak effect's gap.
        first, last = (rms**2 - case.noise**2 for rms in found["holdout"])
        found["gap"] = last / first
    except Exception:
        row["error"] = traceback.format_exc()
    return row | {"seconds": time.perf_counter() - drawn}


def look(case: Case) -> dict[str, Any]:
    """What is named from the case's files."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        paths = []
        for number, (seconds, angle) in enumerate(case.runs):
            paths.append(Path(folder) / f"run_{number}.csv")
            data = np.stack([seconds, angle], axis=1)
            np.savetxt(paths[-1], data, "%.12g", ",", header="time (s),angle (rad)", comments="")
        return named(paths, list(case.setting.oscillator.base), case.left_out)


def study(cases: list[Planned], keep: Path | None, processes: int) -> list[dict[str, Any]]:
    """Rows of all cases; those kept already are not run again."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn

    rows = [json.loads(line) for line in keep.read_text().splitlines()] if keep and keep.exists() else []
    wanted = {one.key for one in cases}
    rows = [row for row in rows if row["key"] in wanted]
    done = {row["key"] for row in rows}
    left = [one for one in cases if one.key not in done]
    columns = (*Progress.get_default_columns()[:2], MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress, ExitStack() as stack:
        task = progress.add_task("blind tests", total=len(cases), completed=len(rows))
        came = map(run, left)
        if processes > 1:
            # Compiled motions are kept, some 100 MB in ten records: a worker ends after so many.
            context = multiprocessing.get_context("spawn")
            pool = stack.enter_context(context.Pool(processes, maxtasksperchild=RECORDS))
            came = pool.imap_unordered(run, left)
        # Stopped by hand, it shows the table of what there is.
        with suppress(KeyboardInterrupt):
            for row in came:
                rows.append(row)
                if keep:
                    with keep.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                progress.advance(task)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} records of each class")
    parser.add_argument("--only", default="", metavar="CLASS", help="classes whose name holds this")
    parser.add_argument("--seeds", type=int, metavar="N", help="records of each class")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="JSON lines, one for each record")
    parser.add_argument("--processes", type=int, default=min(2, os.cpu_count() or 1))
    options = parser.parse_args()
    cases = planned(options.only, options.seeds or (QUICK if options.quick else None))
    print(table(study(cases, options.keep, options.processes)))


if __name__ == "__main__":
    main()
