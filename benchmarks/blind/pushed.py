"""Motions that are pushed at random, nothing hidden in them: how often is the push explained by a force?

python -m benchmarks.blind.pushed [--records N] [--times K] [--jobs N] [--salt HASH]

Records of the confirmation set's kind "nothing white" that have a random force, K times as strong as drawn:
with K = 1 a wander of 1 to 20 noise levels. Those that are no decay any more are left out and counted. The
salt is `git rev-parse HEAD` by default: records that nobody tuned to.
"""

import argparse
import multiprocessing
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

if __package__ in (None, "", "benchmarks.blind"):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    __package__ = "blind"

from blind.confirmation import RECORDS, head, look
from blind.confirmation_report import share
from blind.generator import NoDecayError
from blind.wide_cases import Drawn, draw_case, kind_of
from sysid_trib.errors import SysidTribError


def pushed_case(salt: str, number: int, times: float) -> Drawn | None:
    """The record of this number, pushed so much harder; None if nothing pushes it."""
    case = draw_case(salt, number)
    drawn = case.experiment
    if not drawn.wander:
        return None
    harder = replace(drawn, wander=times * drawn.wander, growth=times**2 * drawn.growth)
    return replace(case, experiment=harder, angles=harder.measured([]))


def run(number: int, salt: str, times: float) -> dict[str, Any] | None:
    """What is found in a record; None of one that is not pushed."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            case = pushed_case(salt, number, times)
            found = None if case is None else look(case)
        except (NoDecayError, SysidTribError) as error:
            return {"number": number, "refused": str(error)}
    seconds = time.process_time() - begin
    return None if found is None else {"number": number, "found": found, "seconds": seconds}


def numbers() -> Iterator[int]:
    """Of records in which nothing is hidden, their sensor's noise white."""
    number = 0
    while True:
        if kind_of(number) == "nothing white":
            yield number
        number += 1


def rows_of(salt: str, times: float, count: int, jobs: int) -> Iterator[dict[str, Any]]:
    """Of so many records that are pushed."""
    context, came = multiprocessing.get_context("spawn"), 0
    with context.Pool(jobs, maxtasksperchild=RECORDS) as pool:
        upcoming = numbers()
        while came < count:
            some = [next(upcoming) for _ in range(4 * jobs)]
            for row in pool.imap(partial(run, salt=salt, times=times), some):
                if row is not None and came < count:
                    came += 1
                    print(f"{came} of {count}", end="\r", file=sys.stderr, flush=True)
                    yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--records", type=int, default=200, metavar="N")
    parser.add_argument("--times", type=float, default=1.0, metavar="K")
    parser.add_argument("--jobs", type=int, default=1, metavar="N")
    parser.add_argument("--salt", metavar="HASH")
    options = parser.parse_args()
    rows = list(rows_of(options.salt or head(), options.times, options.records, options.jobs))
    told = [row for row in rows if "found" in row]
    alarms = [row for row in told if row["found"]["verdict"] != "nothing missing"]
    with_names = [row for row in alarms if row["found"]["steps"]]
    for row in alarms:
        steps = [(step["symbol"], list(step["ties"])) for step in row["found"]["steps"]]
        print(row["number"], row["found"]["verdict"], *steps)
    seconds = [row["seconds"] for row in told]
    print(f"pushed {options.times:g} times as hard: {len(told)} records, {len(rows) - len(told)} no decay")
    print(f"any verdict but nothing missing: {share(len(alarms), len(told))}, {len(alarms)} of {len(told)}")
    print(f"of these with a name: {len(with_names)}")
    print(f"seconds: median {np.median(seconds):.1f}, slowest {np.max(seconds):.1f}")


if __name__ == "__main__":
    main()
