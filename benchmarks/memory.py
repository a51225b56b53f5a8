"""Peak memory of discover: of a child process for each size, which imports, searches once and ends.

python benchmarks/memory.py [--samples N] [--where]

A decay with nothing hidden, one with cubic damping hidden, all candidates offered; the last of many periods:
no sample of it is left out (others are decimated to some sixty samples a period). With --where the largest
allocations at the end of a search by their lines (tracemalloc), which takes longer.
"""

import argparse
import resource
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
# Samples, periods, bar in MB.
SIZES = ((5_000, 40, 500), (100_000, 40, 1500), (100_000, 1000, 1500))
W, NOISE = 9.9, 3e-4
# Of 40 periods; friction of more is weaker, so that the motion decays as far.
BASE = {"lambda": 2e-4, "zeta": 0.004, "nu": -0.3, "epsilon": 0.3}
LINES = 12


def search_once(samples: int, periods: int, coefficient: float, where: bool) -> None:
    """Search a record of so many samples, and print the peak memory of this process in MB."""
    import xarray as xr

    from sysid_trib import ForceLibrary, Model, discover, free_decay, load_library, simulate

    contact, others = load_library(), load_library("candidate_effects")
    values = BASE | ({"cubic_damping": coefficient} if coefficient else {})
    values = {name: c if name in ("nu", "epsilon") else c * 40.0 / periods for name, c in values.items()}
    every = ForceLibrary("all", (*contact, *others))
    time = np.arange(samples) * 2.0 * np.pi * periods / W / samples
    angle = simulate(Model(every.select(list(values)), values, W), time, 0.4).angle.values
    angle = angle + NOISE * np.random.default_rng(0).standard_normal(samples)
    decay = free_decay(xr.Dataset({"angle": ("time", angle)}, {"time": time}))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    if where:
        tracemalloc.start(5)
    found = discover(decay, contact.select(list(BASE)), every)
    if where:
        print(f"traced: {tracemalloc.get_traced_memory()[1] / 1e6:.0f} MB at its peak")
        for line in tracemalloc.take_snapshot().statistics("lineno")[:LINES]:
            print(line)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"{before:.0f} {peak:.0f} {found.attrs['verdict']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--samples", type=int, help="of one size only")
    parser.add_argument("--where", action="store_true")
    parser.add_argument("--periods", type=int, help="of one length only")
    parser.add_argument("--child", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child is not None:
        search_once(options.samples, options.periods, options.child, options.where)
        return
    print(
        "| samples | periods | hidden | before the search (MB) | peak (MB) | bar | verdict |\n"
        + "| --- " * 7
        + "|"
    )
    for samples, periods, bar in SIZES:
        if options.samples not in (None, samples) or options.periods not in (None, periods):
            continue
        for coefficient in (0.0, 0.02):
            command = [sys.executable, __file__, "--child", str(coefficient)]
            command += ["--samples", str(samples), "--periods", str(periods)]
            command += ["--where"] * options.where
            *lines, last = subprocess.run(
                command, capture_output=True, check=True, text=True
            ).stdout.splitlines()
            before, peak, verdict = last.split(maxsplit=2)
            hidden = "cubic damping" if coefficient else "nothing"
            print(
                f"| {samples:,} | {periods} | {hidden} | {before} | {peak} | {bar} | {verdict} |",
                *lines,
                sep="\n",
            )


if __name__ == "__main__":
    main()
