"""Ctrl-C at random moments of each command, imports included: 130, one word, nothing left behind.

python benchmarks/interrupts.py [--moments N] [--seed S] [--only COMMAND ...]

Each command is measured once, then interrupted N times, uniformly from the moment at which the program runs
its own first line to its end. One that is through by then may end with 0. Afterwards no temporary file is
left, and `look` reads the next binary file right.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import sysid_trib as st

PROGRAM = [sys.executable, "-m", "sysid_trib"]
COMMANDS = {
    "look": ["look", "a.xlsx"],
    "identify": ["identify", "a.csv", "--forces", "zeta", "-o", "b.nc", "--plot", "figures"],
    "discover": ["discover", "a.csv", "--forces", "zeta", "--max-effects", "1", "--time-limit", "5"],
    "compare": ["compare", "a.csv", "--forces", "zeta"],
    "simulate": ["simulate", "-o", "c.csv"],
    "report": ["report", "a.nc", "-o", "a.html"],
    "forces": ["forces"],
    "campaign": [
        "campaign",
        "a.csv",
        "--forces",
        "zeta",
        "--methods",
        "direct",
        "--workers",
        "0",
        "-o",
        "d.zarr",
    ],
}
# Seconds that Python itself takes before a line of the program runs.
BARE = [sys.executable, "-c", "import sysid_trib"]


def prepare(folder: Path) -> None:
    """The files that the commands read."""
    time_s = np.arange(0.0, 12.0, 0.02)
    angle = 0.3 * np.exp(-0.1 * time_s) * np.cos(9.9 * time_s)
    angle += 1e-4 * np.random.default_rng(0).standard_normal(time_s.size)
    np.savetxt(
        folder / "a.csv", np.c_[time_s, angle], "%.6g", ",", header="time (s),angle (rad)", comments=""
    )
    import pandas as pd

    pd.DataFrame({"time (s)": time_s, "angle (rad)": angle}).to_excel(folder / "a.xlsx", index=False)
    decay = st.free_decay(st.read_record(folder / "a.csv"))
    library = st.load_library().select(["zeta"])
    results = [
        st.identify(decay, library, method) for method in (st.methods.Averaging(), st.methods.Direct())
    ]
    st.save(st.cross_check(decay, *results), folder / "a.nc")


def interrupted(words: list[str], folder: Path, after: float) -> tuple[int, str]:
    """How a command ends that is interrupted after so many seconds."""
    with subprocess.Popen(
        [*PROGRAM, *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        time.sleep(after)
        os.killpg(process.pid, signal.SIGINT)
        said = process.stderr.read().decode()
    return process.returncode, said


def fault(status: int, said: str, folder: Path) -> str:
    """What is wrong with an ending; empty of a good one."""
    if status not in (0, 130) or said != ("sysid-trib: interrupted.\n" if status else ""):
        return f"status {status}: {said[-300:]!r}"
    # A store is made of such names itself.
    left = [
        place.name
        for place in folder.rglob("*")
        if place.name.startswith(".") and not place.parent.name.endswith(".zarr")
        if not place.parent.parent.name.endswith(".zarr")
    ]
    return f"left: {left}" if left else ""


def main() -> None:
    """Interrupt each command, and say what came of it."""
    options = argparse.ArgumentParser()
    options.add_argument("--moments", type=int, default=25)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--only", nargs="+", choices=list(COMMANDS), default=list(COMMANDS))
    given = options.parse_args()
    random, faults = np.random.default_rng(given.seed), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for command in given.only:
            words = COMMANDS[command]
            begin = time.perf_counter()
            subprocess.run(BARE, cwd=folder, check=True)
            bare = time.perf_counter() - begin
            subprocess.run([*PROGRAM, *words], cwd=folder, check=False, capture_output=True)
            whole = time.perf_counter() - begin - bare
            ends = []
            for after in random.uniform(1.5 * bare, max(whole, 2.0 * bare), given.moments):
                status, said = interrupted(words, folder, after)
                ends.append(status)
                if what := fault(status, said, folder):
                    faults += 1
                    print(f"{command} after {after:.2f} s: {what}", flush=True)
            looked = subprocess.run(
                [*PROGRAM, "look", "a.xlsx"], cwd=folder, capture_output=True, text=True, check=False
            )
            faults += looked.returncode != 0
            counts = f"{ends.count(130)} interrupted, {ends.count(0)} through"
            print(f"{command}: {whole:.1f} s; of {given.moments}: {counts}", flush=True)
    print(f"{faults} faults")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
