"""How long identifications take, beside pysindy in the same run: medians of repeated calls in one process.

python -m benchmarks timing [--quick] [--only methods|random-force|discover]

random-force: what `sysid-trib identify` does with a random force that is estimated, over the same without
one; processor time, no import. discover: how its processor time grows with candidates, samples and the
duration of a motion, over one direct identification in the same process, which separates slow machines from
slow code; before it, the slopes of lines through logarithms, where 1 is linear.
"""

from argparse import Namespace
from collections.abc import Callable, Iterable
from functools import partial
from time import process_time

import numpy as np
import pandas as pd
import xarray as xr
from helpers import FIVE, W, decay, density_that_wanders, paper_run

from benchmarks import peers
from benchmarks.stopwatch import median_ms, timed, times
from sysid_trib import ForceLibrary, Model, discover, load_library, simulate
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.validation.cross_check import cross_check

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

    def fit_alone() -> None:
        peers.sindy(library, W, time, angle, lambda *_: states)

    return {
        "Direct": (lambda: Direct(W).identify(record, library), 15),
        "Direct, frequency fitted": (lambda: Direct().identify(record, library.select(FIVE)), 15),
        "Direct, unrefined": (lambda: Direct(W, refine=False).identify(record, library), 15),
        "Averaging": (lambda: Averaging().identify(record, library), 9),
        "Averaging, uncorrected": (lambda: Averaging(correct=False).identify(record, library), 15),
        "Trajectory": (lambda: Trajectory(W).identify(record, library), 5),
        "cross_check": (lambda: cross_check(record, *pair), 2),
        "pysindy.SINDy.fit": (fit_alone, 15),
        "pysindy.WeakPDELibrary": (lambda: peers.weak_sindy(library, W, time, angle), 2),
    }


def swing(periods: int, wander: float) -> xr.Dataset:
    """A decay of 200 samples a period, with a wander of so many noise levels (RMS) at its end."""
    time = np.arange(200 * periods) * 2.0 * np.pi / W / 200
    density = density_that_wanders(wander, SWING_NOISE, time, W)
    model = Model(load_library("contact_forces").select(SWING), SWING, W)
    return decay(time, simulate(model, time, 0.3, random_force=density, seed=1).angle.values, 2, SWING_NOISE)


def identified(decay: xr.Dataset, forces: Iterable[str], random_force: str) -> None:
    """What `sysid-trib identify` does with a record."""
    library = load_library("contact_forces").select(forces)
    pair = (method(random_force=random_force) for method in (Averaging, Direct))
    cross_check(decay, *(method.identify(decay, library) for method in pair))


def random_forces(quick: bool) -> pd.DataFrame:
    """Times of `identified` with a random force that is estimated, and without."""
    records = {"the paper's run": (paper_run().decay(0), FIVE)}
    for periods in (50,) if quick else (50, 500):
        for wander in (0.0, 5.0):
            records[f"{periods} periods, wander of {wander:g} noise levels"] = swing(periods, wander), SWING
    # The first call imports and compiles.
    identified(*records["the paper's run"], "estimated")
    options = {"random force (s)": "estimated", "none (s)": "off"}
    rows = [
        {"record": name, "samples": record.sizes["time"]}
        | {t: timed(partial(identified, record, forces, o), process_time)[1] for t, o in options.items()}
        for name, (record, forces) in records.items()
    ]
    return pd.DataFrame(rows).assign(ratio=lambda d: d["random force (s)"] / d["none (s)"])


def searches(quick: bool) -> pd.DataFrame:
    """Least processor time of discover, against what grows."""
    contact = load_library()
    start = contact.select(["lambda", "zeta", "delta"])
    effects = (*contact.select(["nu", "epsilon"]), *load_library("candidate_effects"))
    paper = paper_run().decay(0)
    unit = times(lambda: Direct().identify(paper, contact.select(FIVE)), 5, process_time).min()
    cases = [("candidates", 100.0, 25.0, count) for count in (10, 20, 40, len(effects))]
    cases += [("samples", rate, 25.0, 40) for rate in (50.0, 100.0, 1000.0)]
    cases += [("duration", 100.0, duration, 40) for duration in (12.5, 25.0, 50.0)]
    rows = []
    for what, rate, duration, count in cases[:2] if quick else cases:
        record = paper_run(sampling_rate=rate, duration=duration).decay(0)
        offered = ForceLibrary("candidates", effects[:count])
        seconds = times(lambda r=record, o=offered: discover(r, start, o), 1, process_time).min()
        size = {"candidates": count, "samples": rate, "duration": duration}[what]
        rows.append((what, rate * duration, count, seconds, seconds / unit, size))
    heads = ["grows", "samples", "candidates", "time (s)", "in direct identifications", "size"]
    table = pd.DataFrame(rows, columns=heads)
    for what, part in table.groupby("grows", sort=False):
        slope = np.polyfit(np.log(part["size"]), np.log(part["time (s)"]), 1)[0]
        print(f"slope with {what}: {slope:.2f}")
    return table.drop(columns="size")


def methods(quick: bool) -> pd.DataFrame:
    """Medians of second calls, ms, and their ratios to pysindy."""
    table = pd.DataFrame(
        {
            f"{25 * rate:,.0f} samples (ms)": {n: median_ms(*call) for n, call in calls(rate).items()}
            for rate in SAMPLING_RATES[: 1 if quick else 2]
        }
    )
    for peer in ("pysindy.SINDy.fit", "pysindy.WeakPDELibrary"):
        table.loc[f"Direct / {peer}"] = table.loc["Direct"] / table.loc[peer]
    return table.rename_axis("second call in a process").reset_index()


PARTS = {"methods": methods, "random-force": random_forces, "discover": searches}


def main(asked: Namespace) -> None:
    for part in (part for name, part in PARTS.items() if asked.only in name):
        print(part(asked.quick).to_string(index=False, float_format="%.2f"), flush=True)
