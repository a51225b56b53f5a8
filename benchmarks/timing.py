"""How long identifications take, beside pysindy in the same run: medians of repeated calls in one process.

python benchmarks/timing.py [--quick] [--random-force]

With --random-force: what `sysid-trib identify` does with a random force that is estimated, over the same
without one; processor time, no import.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
import peers  # noqa: E402
from helpers import FIVE, W, paper_run  # noqa: E402
from stopwatch import median_ms, timed  # noqa: E402

from sysid_trib import ForceLibrary, Model, discover, load_library, simulate  # noqa: E402
from sysid_trib.likelihood.random_force import RandomForce  # noqa: E402
from sysid_trib.methods import Averaging, Direct, Trajectory  # noqa: E402
from sysid_trib.validation.cross_check import cross_check  # noqa: E402

SAMPLING_RATES = (100.0, 1000.0)
# Forces of swings with and without a random force, and their noise, rad. These alone are offered: where a
# method without a random force has no motion, there is no cross-check whose time could be compared.
SWING, SWING_NOISE = {"zeta": 5e-5, "delta": 2e-4, "nu": 1e-2, "epsilon": -0.1}, 2e-4


def calls(sampling_rate: float) -> dict[str, tuple[Callable, int]]:
    """What is timed on the paper's run at a sampling rate, and how often."""
    run = paper_run(sampling_rate=sampling_rate)
    record, library = run.decay(0), run.model.library
    time, angle = run.time, record.angle.values
    pair = [method.identify(record, library) for method in (Averaging(), Direct())]
    states = peers.savitzky_golay(time, angle, 0.18)

    start = library.select(["lambda", "zeta", "delta"])
    effects = (*library.select(["nu", "epsilon"]), *load_library("candidate_effects"))

    def discovered(candidates: int) -> None:
        discover(record, start, ForceLibrary("candidates", effects[:candidates]))

    def fit_alone() -> None:
        peers.sindy(library, W, time, angle, lambda *_: states)

    return {
        "Direct": (lambda: Direct(W).identify(record, library), 15),
        "Direct, frequency fitted": (lambda: Direct().identify(record, library.select(FIVE)), 15),
        "Direct, unrefined": (lambda: Direct(W, refine=False).identify(record, library), 15),
        "Averaging": (lambda: Averaging().identify(record, library), 9),
        "Averaging, uncorrected": (lambda: Averaging(correct=False).identify(record, library), 15),
        "Trajectory": (lambda: Trajectory(W).identify(record, library), 5),
        "discover, 20 candidates": (lambda: discovered(20), 1),
        "discover, 40 candidates": (lambda: discovered(40), 1),
        f"discover, {len(effects)} candidates": (lambda: discovered(len(effects)), 1),
        "cross_check": (lambda: cross_check(record, *pair), 2),
        "pysindy.SINDy.fit": (fit_alone, 15),
        "pysindy.WeakPDELibrary": (lambda: peers.weak_sindy(library, W, time, angle), 2),
    }


def swing(periods: int, wander: float) -> xr.Dataset:
    """A decay of 200 samples a period, with a wander of so many noise levels (RMS) at its end."""
    time = np.arange(200 * periods) * 2.0 * np.pi / W / 200
    density = RandomForce.density_of(2.0 * (wander * SWING_NOISE) ** 2 / (W * time[-1]), W)
    model = Model(load_library("contact_forces").select(SWING), SWING, W)
    angle = simulate(model, time, 0.3, random_force=density, seed=1).angle
    return xr.Dataset({"angle": angle + SWING_NOISE * np.random.default_rng(2).standard_normal(len(time))})


def identified(decay: xr.Dataset, forces: Iterable[str], random_force: str) -> None:
    """What `sysid-trib identify` does with a record."""
    library = load_library("contact_forces").select(forces)
    pair = (method(random_force=random_force) for method in (Averaging, Direct))
    cross_check(decay, *(method.identify(decay, library) for method in pair))


def random_force_table() -> Table:
    """Times of `identified` with a random force that is estimated, and without."""
    records = {"the paper's run": (paper_run().decay(0), FIVE)}
    for periods in (50, 500):
        for wander in (0.0, 5.0):
            records[f"{periods} periods, wander of {wander:g} noise levels"] = swing(periods, wander), SWING
    # The first call imports and compiles.
    identified(*records["the paper's run"], "estimated")
    table = Table("both methods, cross-checked", "samples", "random force (s)", "none (s)", "ratio")
    for name, (decay, forces) in records.items():
        spent = [
            timed(partial(identified, decay, forces, option), process_time)[1]
            for option in ("estimated", "off")
        ]
        times = (f"{value:.2f}" for value in (*spent, spent[0] / spent[1]))
        table.add_row(name, f"{decay.sizes['time']:,}", *times)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="2,500 samples only")
    parser.add_argument("--random-force", action="store_true", help="with a random force over without")
    options = parser.parse_args()
    if options.random_force:
        Console(width=110).print(random_force_table())
        return
    rates = SAMPLING_RATES[:1] if options.quick else SAMPLING_RATES
    spent = {}
    for rate in rates:
        for name, (call, repeats) in calls(rate).items():
            spent[name, rate] = median_ms(call, repeats)
    table = Table("second call in a process", *(f"{25 * rate:,.0f} samples (ms)" for rate in rates))
    for name in dict.fromkeys(name for name, _ in spent):
        table.add_row(name, *(f"{spent[name, rate]:.1f}" for rate in rates))
    for peer in ("pysindy.SINDy.fit", "pysindy.WeakPDELibrary"):
        ratios = (f"{spent['Direct', rate] / spent[peer, rate]:.2f}" for rate in rates)
        table.add_row(f"Direct / {peer}", *ratios)
    command = [sys.executable, "-m", "sysid_trib", "--help"]
    help_time = median_ms(lambda: subprocess.run(command, capture_output=True, check=True), 5)
    table.add_row("sysid-trib --help", f"{help_time:.0f}")
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
