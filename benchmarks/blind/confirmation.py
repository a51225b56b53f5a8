"""The confirmation set: records that nobody tuned to, drawn from the hash of the program that is tested.

python -m benchmarks.blind.confirmation [--records N] [--jobs N] [--salt HASH] [--keep FILE] [--report]
                                         [--only KIND] [--setting NAME=VALUE]

Frequency, amplitude, noise, length, runs and random force vary over wide ranges (`draws.py`), by the
integrator of the blind tests; what names the effects sees files alone, and predicts the last third of a run.
The strength z of an effect is the root of the deviance that the truth gains beside both noises (`seen.py`).
Rows are appended to FILE as they come, failures too, and a study that was stopped goes on where it was. By
default the salt is `git rev-parse HEAD` and FILE build/confirmation-HASH.jsonl. With --report nothing is run.
`python -m benchmarks.blind` is the same on development records: their salt is a word, and constants
may be chosen by them. With --setting it says what another value of a setting of `discover` decides.
"""

import argparse
import json
import multiprocessing
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import numpy as np
import xarray as xr

from benchmarks.blind.cases import Drawn, draw_case, kind_of
from benchmarks.blind.confirmation_report import report
from benchmarks.blind.generator import NoDecayError
from benchmarks.blind.seen import CONTACT, offered
from sysid_trib import free_decay, read_record
from sysid_trib.discovery.discover import discover
from sysid_trib.discovery.engine.trials import DEFAULTS, Settings
from sysid_trib.errors import SysidTribError
from sysid_trib.results.effects import credible_set

# Seconds of the processor after which a record is given up, and counted as a failure.
LIMIT = 300
# Records of a worker: compiled motions are kept, some 100 MB in ten records.
RECORDS = 25
ROOT = Path(__file__).resolve().parents[2]


class TooLongError(Exception):
    """A record that takes longer than the limit."""


@contextmanager
def limited(seconds: int) -> Iterator[None]:
    def give_up(number: int, frame: FrameType | None) -> NoReturn:
        raise TooLongError(f"more than {seconds} s")

    # Of the processor, whatever else the machine does.
    signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def run(place: tuple[str, int, Settings]) -> dict[str, Any]:
    """Draw a record, write its files, have them named: the answers beside what was found."""
    salt, number, settings = place
    begin = time.perf_counter()
    row: dict[str, Any] = {"number": number}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with limited(LIMIT):
                case = draw_case(salt, number)
        except Exception:
            return row | {"not_drawn": traceback.format_exc()}
        row |= _answers(case) | {"drawing": time.perf_counter() - begin}
        # Of the processor: a record does not wait for what else the machine does.
        begin = time.process_time()
        try:
            with limited(LIMIT):
                row["found"] = look(case, settings)
        except (NoDecayError, SysidTribError) as error:
            row["refused"] = f"{type(error).__name__}: {error}"
        except Exception:
            row["error"] = traceback.format_exc()
    return row | {"seconds": time.process_time() - begin}


def _answers(case: Drawn) -> dict[str, Any]:
    experiment = asdict(case.experiment)
    del experiment["oscillator"]
    return {
        "kind": case.kind,
        "w": case.experiment.oscillator.w,
        "base": case.experiment.oscillator.base,
        "experiment": experiment | {"weights": case.experiment.weights.tolist()},
        "hidden": [asdict(one) for one in case.hidden],
        "left_out": case.left_out,
        "left_by_others": case.left_by_others,
    }


def look(case: Drawn, settings: Settings) -> dict[str, Any]:
    """Return the names that the program finds in the files of a case."""
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        for number, angle in enumerate(case.angles):
            paths.append(Path(folder) / f"run_{number}.csv")
            data = np.stack([case.experiment.time, angle], axis=1)
            np.savetxt(paths[-1], data, "%.12g", ",", header="time (s),angle (rad)", comments="")
        return named(paths, list(case.experiment.oscillator.base), case.left_out, settings)


def named(
    paths: Sequence[Path], base: Sequence[str], left_out: Sequence[str], settings: Settings
) -> dict[str, Any]:
    """Verdict, effects and base coefficients of the runs in these files, the last third of each held out.

    It sees files, the base model's symbols and what to leave out, nothing else.
    """
    runs = [free_decay(read_record(path)) for path in paths]
    tree = discover(runs, CONTACT.select(list(base)), offered(base, left_out), settings=settings)
    steps, after = tree["steps"].dataset, tree["after"].dataset
    by_symbol = after.sel(force=list(base))
    return {
        "verdict": tree.attrs["search_outcome"],
        "converged": bool(tree["converged"]),
        "failed_fits": tree.attrs["failed_fits"],
        "steps": [_step(steps.isel(step=i)) for i in range(steps.sizes.get("step", 0))],
        "base": dict(zip(base, by_symbol.coefficient.values.tolist(), strict=True)),
        "base_errors": dict(zip(base, by_symbol.standard_error.values.tolist(), strict=True)),
        "random_force_p_value": np.atleast_1d(after.get("random_force_p_value", np.nan)).tolist(),
    }


def _step(row: xr.Dataset) -> dict[str, Any]:
    words = {name: str(row[name].item()) for name in ("symbol", "family")}
    numbers = {name: float(row[name]) for name in ("coefficient", "standard_error", "p_value")}
    flags = {name: bool(row[name]) for name in ("collinear", "worsens_holdout", "significant")}
    deviance = row.penalised_deviance.dropna("candidate").to_series().round(2).to_dict()
    more = {"ties": credible_set(row), "costs": json.dumps(deviance), "chance": float(row.chance_probability)}
    return words | numbers | flags | more


def study(salt: str, numbers: Sequence[int], keep: Path, jobs: int, settings: Settings) -> None:
    """Run the records that FILE does not have."""
    keep.parent.mkdir(parents=True, exist_ok=True)
    done = {row["number"] for row in kept(keep)}
    left = [(salt, number, settings) for number in numbers if number not in done]
    context = multiprocessing.get_context("spawn")
    with context.Pool(jobs, maxtasksperchild=RECORDS) as pool:
        for came, row in enumerate(pool.imap_unordered(run, left), 1):
            with keep.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(f"{came} of {len(left)}", end="\r", file=sys.stderr, flush=True)


def kept(keep: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in keep.read_text().splitlines()] if keep.exists() else []


def head() -> str:
    """Hash of the commit that is checked out."""
    command = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    return subprocess.run(command, capture_output=True, check=True, text=True).stdout.strip()


def main(salt: str = "") -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--records", type=int, default=1000, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first record")
    parser.add_argument("--jobs", type=int, default=1, metavar="N")
    parser.add_argument("--salt", metavar="HASH", default=salt)
    parser.add_argument("--only", metavar="KIND", default="", help="records of kinds that begin so")
    parser.add_argument("--setting", metavar="NAME=VALUE", help="of discover, in place of its own")
    parser.add_argument("--keep", type=Path, metavar="FILE")
    # Where the direct identification of commit 2d1a9b1 takes 77 ms.
    parser.add_argument("--slow", type=float, default=60.0, metavar="SECONDS", help="too slow here")
    parser.add_argument("--report", action="store_true", help="of what there is")
    options = parser.parse_args()
    salt, settings, name = options.salt or head(), DEFAULTS, ""
    if options.setting:
        name, _, value = options.setting.partition("=")
        settings = replace(DEFAULTS, **{name: type(getattr(DEFAULTS, name))(value)})
        name = f"-{options.setting}"
    keep = options.keep or ROOT / "build" / f"confirmation-{salt[:12]}{name}.jsonl"
    if not options.report:
        numbers = range(options.first, options.first + options.records)
        some = [number for number in numbers if kind_of(number).startswith(options.only)]
        study(salt, some, keep, options.jobs, settings)
    print(report(kept(keep), salt, options.slow))


if __name__ == "__main__":
    main()
