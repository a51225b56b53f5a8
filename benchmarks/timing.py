"""Times of simulations and identifications: medians of repeated calls in one process.

python -m benchmarks simulator
python -m benchmarks timing [--quick] [--only methods|random-force|discover|laws]

simulator: on the run of the paper beside scipy restarted at every switching; then its derivatives over the
motion alone, its core over a plain Taylor engine, identifications, driven motions, and what is lost over
10,000 periods; processor time.
methods: beside pysindy in the same run.

random-force: what `sysid-trib identify` does with a random force that is estimated, over the same without
one; processor time, no import. discover: how its processor time grows with candidates, samples and the
duration of a motion, over one direct identification in the same process, which separates slow machines from
slow code; before it, the slopes of lines through logarithms, where 1 is linear. laws: friction and restoring
force as curves of the example, of a long simulated record and of measured ones; in seconds and in direct
identifications of the example.
"""

import importlib
import sys
import tempfile
from argparse import Namespace
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from time import process_time
from unittest import mock

import numba
import numpy as np
import pandas as pd
import xarray as xr
from helpers import FIVE, W, decay, density_that_wanders, paper_run
from scipy_motion import reference_motion

from benchmarks import DATA, peers
from benchmarks.study.common import median_ms, timed, times
from sysid_trib import (
    Model,
    discover,
    free_decay,
    laws,
    load_library,
    read_record,
    simulate,
)
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.records import paper_twin
from sysid_trib.records.inputs import KnownInput
from sysid_trib.simulation import motions, under_way
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation.cross_check import cross_check

SAMPLING_RATES = (100.0, 1000.0)
# Forces of swings with and without a random force, and their noise, rad. These alone are offered: where a
# method without a random force has no motion, there is no cross-check whose time could be compared.
SWING, SWING_NOISE = {"zeta": 5e-5, "delta": 2e-4, "nu": 1e-2, "epsilon": -0.1}, 2e-4


def calls(sampling_rate: float) -> dict[str, tuple[Callable, int]]:
    """Return the timed calls on the paper's run at a sampling rate, and their numbers."""
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
    """Do the work of `sysid-trib identify` on a record."""
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
    times_at = {
        f"{25 * rate:,.0f} samples (ms)": {n: median_ms(*call) for n, call in calls(rate).items()}
        for rate in SAMPLING_RATES[: 1 if quick else 2]
    }
    table = pd.DataFrame(times_at)
    for peer in ("pysindy.SINDy.fit", "pysindy.WeakPDELibrary"):
        table.loc[f"Direct / {peer}"] = table.loc["Direct"] / table.loc[peer]
    return table.rename_axis("second call in a process").reset_index()


# Measured records: file, how it is read, the part that is a decay (s), the system.
MEASURED = {
    "string pendulum": ("string_pendulum/run_1.txt", {}, (None, None), "pendulum"),
    "ship": ("roll_decay/model_test_21337.csv", {"angle": "phi"}, (25.0, None), "ship"),
    "tank": ("sloshing/decay_0p953.csv", {}, (None, None), None),
}
EMPS = {"time": "t", "angle": "qm", "units": "m", "input": "35.15065*vir", "between": "linear"}


def curves(quick: bool) -> pd.DataFrame:
    """Processor time of laws, also over that of a direct identification of the example."""
    example = free_decay(paper_twin())
    unit = times(lambda: Direct(random_force="off").identify(example, load_library()), 5, process_time).min()
    long = paper_run(sampling_rate=400.0, duration=50.0).decay(0)
    records: dict[str, tuple[xr.Dataset, str | None]] = {"example": (example, None)}
    records["the paper's forces, simulated"] = (long, None)
    if not quick:
        for name, (file, how, part, system) in MEASURED.items():
            record = read_record(DATA / file, **how).sel(time=slice(*part))
            records[name] = (free_decay(record), system)
        records["EMPS, driven"] = (read_record(DATA / "emps" / "DATA_EMPS.mat", **EMPS), "axis")
    # The first call imports and compiles.
    laws(example)
    rows = []
    for name, (record, system) in records.items():
        _, seconds = timed(partial(laws, record, system), process_time)
        rows.append((name, record.sizes["time"], seconds, seconds / unit))
    return pd.DataFrame(rows, columns=["record", "samples", "laws (s)", "in direct identifications"])


PARTS = {"methods": methods, "random-force": random_forces, "discover": searches, "laws": curves}


def timing(asked: Namespace) -> None:
    for part in (part for name, part in PARTS.items() if asked.only in name):
        print(part(asked.quick).to_string(index=False, float_format="%.2f"), flush=True)


SIX, GRID = load_library(), np.linspace(0.0, 25.0, 2501)


def simulator(asked: Namespace) -> None:
    _, loading = timed(lambda: trajectory(Model(SIX, FIVE, W), GRID[:3]), process_time)
    print(f"first call (loads the engine, or compiles it)  {loading:8.2f} s")
    for friction in (FIVE["lambda"], 1e-3):
        of_the_paper(FIVE | {"lambda": friction})
    core_over_prototype()
    methods_over_scipy()
    driven()
    conserved()


def of_the_paper(coefficients):
    """The paper's run: time over scipy's, errors, and the derivatives over the motion alone."""
    model, by = Model(SIX, coefficients, W), (*coefficients, BY_ANGLE, BY_RATE)
    exact = reference_motion(coefficients, W, GRID, rtol=3e-14)
    peer = median_ms(lambda: reference_motion(coefficients, W, GRID, rtol=1e-10), 5, process_time)
    print(f"lambda = {coefficients['lambda']:g}: scipy, rtol 1e-10  {peer:8.2f} ms")
    for function in (trajectory, simulate):
        ours = median_ms(lambda f=function: f(model, GRID), 101, process_time)
        error = np.abs(np.asarray(function(model, GRID).angle) - exact).max()
        name = function.__name__
        print(f"  {name:<12} {ours:8.2f} ms  error {error:.1e} rad  {peer / ours:5.0f} times faster")
    plain = median_ms(lambda: trajectory(model, GRID), 101, process_time)
    whole = median_ms(lambda: trajectory(model, GRID, by=by), 31, process_time)
    print(f"  with {len(by)} derivatives {whole:.2f} ms, {whole / plain:.1f} times the motion")


def core_over_prototype():
    """The compiled function of the paper's motion over a plain Taylor engine, if that is beside the project.

    Both of order 18, with the same events and samples, the least of many calls (bar: 1.5).
    """
    place = DATA.parent / "prototypes" / "taylor.py"
    if not place.is_file():
        print(f"no plain engine in {place}")
        return
    # Nothing is written beside it.
    folder = tempfile.mkdtemp()
    with (
        mock.patch.object(numba.config, "CACHE_DIR", folder),
        mock.patch.object(sys, "dont_write_bytecode", True),
        mock.patch.object(sys, "path", [str(place.parent), *sys.path]),
    ):
        plain = importlib.import_module(place.stem)
    forces = [(c, SIX[symbol].formula.text) for symbol, c in FIVE.items()]
    program, tau = plain.program(forces), W * GRID
    engine, given = motions._engine(), []

    def noted(*arguments):
        given.append(arguments)
        return engine(*arguments)

    model = Model(SIX.select(FIVE), FIVE, W)
    with mock.patch.object(motions, "_engine", return_value=noted):
        exact = trajectory(model, GRID).position
    instructions, motion, begun, limits = given[0]
    slots = slice(instructions.states + 1 + instructions.channels, instructions.inputs)

    def core():
        state = under_way.new_state(instructions, 0)
        state.J[slots, 0] = state.aside[:, slots, 0] = begun.J[slots, 0]
        engine(instructions, motion, state, limits)

    def other():
        return plain.run(*program, 0.3, 0.0, tau, 18, 1e-16)[0]

    error = np.abs(other() - exact).max()
    core()
    ours, theirs = (1e3 * times(call, 200, process_time).min() for call in (core, other))
    print(f"core {ours:.2f} ms, plain engine {theirs:.2f} ms: {ours / theirs:.2f}; apart {error:.1e} rad")


def methods_over_scipy():
    """Identifications of the paper's run with the sensor's noise alone, over scipy's motion."""
    peer = median_ms(lambda: reference_motion(FIVE, W, GRID, rtol=1e-10), 5, process_time)
    decay = paper_run().decay(0)
    for method in (Direct, Averaging, Trajectory):
        identify = partial(method(random_force="off").identify, decay, SIX.select(FIVE))
        ours = median_ms(identify, 5, process_time)
        print(f"  {method.__name__:<12} {ours:8.2f} ms, {ours / peer:.2f} of scipy's motion")


def driven():
    """Motions that an input drives: 2,501 samples with stick and slip, 131,072 of a Duffing oscillator."""
    push = W**2 * (0.2 * np.sin(0.7 * W * GRID) + 0.05 * np.sin(1.7 * W * GRID))
    for name, friction in (("stick and slip", {"lambda": 0.15}), ("without", {})):
        coefficients = friction | {"zeta": 0.01}
        model = replace(Model(SIX, coefficients, W), inputs={"input": KnownInput(GRID, push)})
        stuck = np.mean(trajectory(model, GRID, 0.0).rate == 0.0)
        ours = median_ms(lambda m=model: trajectory(m, GRID, 0.0), 31, process_time)
        print(f"driven, {name}: 2,501 samples {ours:.2f} ms, {100 * stuck:.0f} % at rest")
    time, w = np.arange(131_072) / 610.35, 2.0 * np.pi * 68.0
    push = 0.1 * w**2 * np.random.default_rng(0).standard_normal(len(time))
    model = Model(SIX, {"zeta": 0.023, "epsilon": 0.3}, w, inputs={"input": KnownInput(time, push)})
    ours = median_ms(lambda: trajectory(model, time), 3, process_time)
    print(f"driven Duffing, 131,072 samples: {ours:.0f} ms")


def conserved():
    """Report the energy lost over 10,000 periods without friction, and by dry friction per half period."""
    model = Model(SIX, {"alpha": 0.2, "nu": -0.4, "epsilon": 0.3}, W)
    found = trajectory(model, np.linspace(0.0, 20_000 * np.pi / W, 20_001), 0.3, 1.0)
    x, v = found.angle, found.rate / W
    energy = v**2 / 2 + 0.6 * x**2 - 0.4 * np.abs(x) ** 3 / 3 + 0.3 * x**4 / 4
    print(f"energy over 10,000 periods: {np.abs(energy / energy[0] - 1.0).max():.1e} of it")
    dry = Model(SIX, {"lambda": 0.003}, W)
    turned = trajectory(dry, np.concatenate([[0.0], trajectory(dry, GRID).reversals])).angle
    lost = np.abs(np.abs(turned) - (0.3 - 0.006 * np.arange(len(turned)))).max()
    print(f"dry friction: 2 lambda a half period to {lost:.1e} rad")
