"""Driven records: Silverbox, Bouc-Wen, EMPS, a frame that rubs, simulated ones beside their bound, a belt.

python benchmarks/driven.py [--only silverbox|search|bouc_wen|emps|frame|simulated|belt] [--seeds N]

Measured records are read from ../shared/data beside the project, or from the folder in SYSID_TRIB_DATA;
without it only `simulated` and `belt` run. Times are of the processor, of one call, with what it compiles.
"""

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table
from stopwatch import timed

import sysid_trib as st
from sysid_trib.forces import ForceLibrary
from sysid_trib.physics import per_input
from sysid_trib.records.inputs import KnownInput

DATA = Path(os.environ.get("SYSID_TRIB_DATA", Path(__file__).parents[2] / "shared" / "data"))
LIBRARIES = ("inputs", "contact_forces", "candidate_effects")
OFF: dict[str, Any] = {"random_force": "off"}

# Five of six realisations of the multisine, 8,700 samples each.
TRAINING = 43500
FIVE = ("gain", "zeta", "epsilon", "even_spring")
EIGHT = (*FIVE, "delta", "lambda", "quintic")
TWELVE = (*EIGHT, "nu", "van_der_pol", "tilted_damping", "gain_delay")

# N/V of the motor's drive, and the published least squares (Janot, Gautier & Brunot 2019), SI.
GTAU = 35.15065
PUBLISHED = {"mass": 95.11, "zeta": 203.5, "lambda": 20.39, "bias": -3.16}
SAID = {"mass": "M (kg)", "zeta": "Fv (Ns/m)", "lambda": "Fc (N)", "bias": "offset (N)"}

# Of ten frictions that were tried in turn the two that predict the last third best, fitted to the first two.
FURTHER = ((), ("even_drag",), ("even_drag", "three_halves_damping"))

LOADS = ("250", "350", "550")
# kg, as the authors of the frame weighed it.
MASS = 3.0799

TRUTH = {"gain": 0.05, "lambda": 1e-3, "zeta": 0.01, "epsilon": -0.1}
W, NOISE = 9.9, 2e-4
# Of records on a belt: what tells that a motion sticks was decided with the seeds below.
FRESH = 100


def offered(*symbols: str) -> ForceLibrary:
    """These forces of the libraries of the package."""
    known: dict[str, Any] = {}
    for name in LIBRARIES:
        for force in st.load_library(name):
            known.setdefault(force.symbol, force)
    return replace(st.load_library("inputs"), forces=tuple(known[symbol] for symbol in symbols))


def cpu(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call returns, and the processor's time (s)."""
    return timed(call, time.process_time)


def silverbox() -> Table:
    """Trained on five realisations; free run on the sixth, whose start is fitted."""
    record = st.read_record(DATA / "silverbox" / "multisine_1_to_6.csv", input="V1")
    train, test = (record.isel(time=part) for part in (slice(TRAINING), slice(TRAINING, None)))
    table = Table(
        "method", "forces and w", "parameters", "training", "last realisation", "largest", "time (s)"
    )
    table.title = "Silverbox, RMS of record minus free run (mV)"
    direct, trajectory = st.methods.Direct(**OFF), st.methods.Trajectory(**OFF)
    for method, symbols in ((direct, FIVE), (direct, EIGHT), (direct, TWELVE), (trajectory, FIVE)):
        result, seconds = cpu(lambda m=method, s=symbols: m.identify(train, offered(*s)))
        seen, unseen = (st.predict(result, part) for part in (train, test))
        largest = 1e3 * float(np.abs(unseen.residual).max())
        rms = [f"{1e3 * part.residual_rms.item():.4f}" for part in (seen, unseen)]
        name = type(method).__name__
        row = (name, " ".join(symbols), str(len(symbols) + 1), *rms, f"{largest:.2f}", f"{seconds:.0f}")
        table.add_row(*row)
    return table


def search() -> Table:
    """`discover` on five realisations from the linear model, with nothing named; free run on the sixth."""
    record = st.read_record(DATA / "silverbox" / "multisine_1_to_6.csv", input="V1")
    tree, seconds = cpu(lambda: st.discover(record.isel(time=slice(TRAINING))))
    unseen = st.predict(tree["after"].to_dataset(), record.isel(time=slice(TRAINING, None)))
    last = 1e3 * unseen.residual_rms.item()
    title = f"Silverbox, discover: {seconds:.0f} s; last realisation {last:.4f} mV"
    table = Table("added", "coefficient", "held out, RMS (mV)")
    table.title = f"{title}; verdict: {tree.attrs['verdict']}"
    steps, held_out = tree["steps"].to_dataset(), 1e3 * tree["holdout"].rms.values
    table.add_row("(linear)", "", f"{held_out[0]:.4f}")
    for at, symbol in enumerate(steps.symbol.values.tolist()):
        one = steps.isel(step=at)
        cell = f"{one.coefficient.item():.4f} ± {one.standard_error.item():.4f}"
        table.add_row(symbol, cell, f"{held_out[at + 1]:.4f}")
    return table


def emps() -> Table:
    """The motor axis: no restoring force; everything in the unit of the force."""
    path = DATA / "emps" / "DATA_EMPS.mat"
    record = st.read_record(path, angle="qm", time="t", units="m", input=f"{GTAU}*vir", between="linear")
    table = Table("method", "parameters", *SAID.values(), "open loop (mm)", "time of both (s)")
    table.title = "EMPS, each model by both methods"
    table.add_row("published least squares", "4", *(f"{value:g}" for value in PUBLISHED.values()), "6.85", "")
    for further in FURTHER:
        library = offered("free_axis", "gain", "zeta", "lambda", "bias", *further)
        tree, seconds = cpu(lambda those=library: st.identify(record, those, constraints={"free_axis": 1.0}))
        compared = tree["comparison"].to_dataset()
        for name in compared.model.values.tolist():
            found = per_input(tree[name].to_dataset()).sel(quantity=list(SAID))
            pairs = zip(found.value.values, found.standard_error.values, strict=True)
            cells = [f"{value:.2f} ± {error:.2f}" for value, error in pairs]
            left = f"{1e3 * compared.residual_rms.sel(model=name).item():.2f}"
            row = (" ".join((name, *further)), str(len(SAID) + len(further)), *cells, left, f"{seconds:.0f}")
            table.add_row(*row)
    return table


def bouc_wen() -> Table:
    """`discover` on four fifths of the training record from the linear model, with nothing named."""
    record = st.read_record(DATA / "bouc_wen" / "train.csv", input="u")
    fifth = record.sizes["time"] // 5
    parts = {"four fifths": slice(4 * fifth), "the last fifth": slice(4 * fifth, None)}
    tree, seconds = cpu(lambda: st.discover(record.isel(time=parts["four fifths"])))
    after = tree["after"].to_dataset()
    left = ", ".join(
        f"{name} {st.predict(after, record.isel(time=part), warm_up=1.0).residual_rms.item():.3g} m"
        for name, part in parts.items()
    )
    title = f"Bouc-Wen, discover: {seconds:.0f} s; left after a warm-up of 1 s: {left}"
    table = Table("parameter", "found", "standard error")
    table.title = f"{title}; added: {' '.join(tree['steps'].symbol.values.tolist())}"
    for kind, name in (("force", "coefficient"), ("shape_parameter", "shape")):
        errors = after["standard_error" if kind == "force" else "shape_standard_error"]
        for at, label in enumerate(after[kind].values.tolist() if kind in after else []):
            table.add_row(label, f"{after[name].values[at]:.6g}", f"{errors.values[at]:.2g}")
    w, of_w = after.reference_frequency.item(), after.reference_frequency_standard_error.item()
    table.add_row("w (rad/s)", f"{w:.6g}", f"{of_w:.2g}")
    return table


def frame() -> Table:
    """Three loads on one frame: the friction is each run's own, frequency and damping are common."""
    folder = DATA / "friction_frame"
    runs = []
    for load in LOADS:
        base = {"base": f"{folder / f's_b_{load}g_y.mat'}:y"}
        runs.append(st.read_record(folder / f"s_b_{load}g_x.mat", time="t", units="mm", input=base))
    library = offered("base_spring", "base_damping", "lambda")
    methods = [kind(own=("lambda",)) for kind in (st.methods.Direct, st.methods.Trajectory)]
    tree, seconds = cpu(lambda: st.identify(runs, library, methods, constraints={"base_spring": 1.0}))
    heads = ("method", "frequency (Hz)", "zeta", *(f"F of {load} g (N)" for load in LOADS), "left (mm)")
    table = Table(*heads, title=f"Frame, three loads; both methods take {seconds:.0f} s")
    compared = tree["comparison"].to_dataset()
    for name in compared.model.values.tolist():
        result = tree[name].to_dataset()
        w, of_w = result.reference_frequency.item(), result.reference_frequency_standard_error.item()
        newton = 1e-3 * MASS * w**2
        cells = [f"{w / (2 * np.pi):.4f} ± {of_w / (2 * np.pi):.4f}", with_error(result, "base_damping", 1.0)]
        cells += [with_error(result, f"lambda_{at}", newton) for at in range(1, len(LOADS) + 1)]
        table.add_row(name, *cells, f"{compared.residual_rms.sel(model=name).item():.3f}")
    return table


def with_error(result: xr.Dataset, symbol: str, scale: float) -> str:
    """A coefficient and its standard error, both in another unit."""
    one = result.sel(force=symbol)
    return f"{scale * one.coefficient.item():.4f} ± {scale * one.standard_error.item():.4f}"


def driven_model(between: str = "smooth") -> tuple[st.Model, np.ndarray]:
    """A pendulum under a multisine about its resonance, and the times: 30 periods of 40 samples."""
    elapsed = np.arange(1200) * 2.0 * np.pi / W / 40
    lines = np.arange(1, 61) / 30 * W
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, len(lines))
    u = np.cos(np.outer(elapsed, lines) + phases).sum(axis=1) / np.sqrt(len(lines) / 2)
    inputs = {"u": KnownInput(elapsed, u, between)}
    return st.Model(offered(*TRUTH), TRUTH, W, inputs=inputs), elapsed


def simulated(seeds: int) -> Table:
    """White noise in a driven pendulum: errors over the bound, and intervals that hold the truth."""
    model, elapsed = driven_model()
    clean = st.simulate(model, elapsed, 0.1, inputs=model.inputs)
    bound = st.cramer_rao_bound(model, elapsed, 0.1, 0.0, NOISE, free=True)
    smallest = np.append(bound.standard_error.values, bound.reference_frequency_standard_error.item())
    table = Table("method", *TRUTH, "w", "time of one (s)")
    table.title = f"RMS error over the Cramér-Rao bound / 95 % intervals that hold (%), {seeds} seeds"
    for method in (st.methods.Direct(), st.methods.Trajectory()):
        errors, stated, seconds = repeated(method, clean, model.library, seeds)
        ratios = np.sqrt(np.mean(errors**2, axis=0)) / smallest
        held = 100.0 * np.mean(np.abs(errors) < 1.96 * stated, axis=0)
        cells = [f"{ratio:.2f} / {share:.0f}" for ratio, share in zip(ratios, held, strict=True)]
        table.add_row(type(method).__name__, *cells, f"{seconds / seeds:.2f}")
    return table


def repeated(
    method: Any, clean: xr.Dataset, library: ForceLibrary, seeds: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Errors and stated errors of coefficients and w, (seed, parameter), and the time (s)."""

    def identified(seed: int) -> xr.Dataset:
        noise = NOISE * np.random.default_rng(seed).standard_normal(clean.sizes["time"])
        return st.identify(clean.assign(angle=clean.angle + noise), library, method).sel(force=list(TRUTH))

    results, seconds = cpu(lambda: [identified(seed) for seed in range(seeds)])
    values, stated = (
        np.array([[*r[name].values, r[f"reference_frequency{of}"].item()] for r in results])
        for name, of in (("coefficient", ""), ("standard_error", "_standard_error"))
    )
    return values - [*TRUTH.values(), W], stated, seconds


def belt_record(seed: int) -> tuple[xr.Dataset, dict[str, float], float, float]:
    """A pushed mass on a belt: the record, the truth, and how long it sticks and overtakes the belt."""
    random = np.random.default_rng(seed)
    truth = {"zeta": random.uniform(0.003, 0.02), "gain": random.uniform(0.015, 0.03)}
    truth["surface_friction"] = random.uniform(0.02, 0.06)
    speed = random.uniform(0.01, 0.05)
    elapsed = np.arange(1200) * 2.0 * np.pi / W / 40
    lines, phases = W * random.uniform(0.7, 1.3, 5), random.uniform(0.0, 2.0 * np.pi, 5)
    u = np.cos(np.outer(elapsed, lines) + phases).sum(axis=1)
    surface = speed * W * elapsed
    inputs = {"u": KnownInput(elapsed, u, "smooth"), "surface": KnownInput(elapsed, surface, "linear")}
    clean = st.simulate(st.Model(offered(*truth), truth, W), elapsed, 0.05, inputs=inputs)
    faster = np.gradient(clean.angle.values, elapsed) / W / speed - 1.0
    angle = clean.angle.values + NOISE * random.standard_normal(len(elapsed))
    smooth, linear = ({"role": "input", "between": between} for between in ("smooth", "linear"))
    record = xr.Dataset(
        {
            "angle": ("time", angle, {"units": "rad"}),
            "u": ("time", u, smooth),
            "surface": ("time", surface, linear | {"units": "rad"}),
        },
        {"time": elapsed},
    )
    return record, truth, float(np.mean(np.abs(faster) < 0.02)), float(np.mean(faster > 0.1))


def belt(seeds: int) -> Table:
    """`discover` of the friction to a belt, from the push and viscous friction, on records that stick."""
    table = Table()
    for head in ("seed", "sticks (%)", "overtakes (%)", "named", "friction", "its error", "true", "time (s)"):
        table.add_column(head)
    right = 0
    for seed in range(FRESH, FRESH + seeds):
        record, truth, sticks, overtakes = belt_record(seed)
        tree, seconds = cpu(lambda record=record: st.discover(record, offered("zeta", "gain")))
        names = tree["steps"].to_dataset().symbol.values.tolist() if tree["steps"].attrs["count"] else []
        right += names[:1] == ["surface_friction"]
        cells = ["", ""]
        if "surface_friction" in names:
            found = tree["after"].to_dataset().sel(force="surface_friction")
            cells = [f"{found.coefficient.item():.4f}", f"{found.standard_error.item():.4f}"]
        shares = f"{100 * sticks:.0f}", f"{100 * overtakes:.0f}"
        true = f"{truth['surface_friction']:.4f}"
        table.add_row(str(seed), *shares, " ".join(names), *cells, true, f"{seconds:.0f}")
    table.title = f"Stick-slip on a belt: the friction to the belt is named first in {right} of {seeds}"
    return table


MEASURED = {"silverbox": silverbox, "search": search, "bouc_wen": bouc_wen, "emps": emps, "frame": frame}
FOLDERS = {name: name for name in MEASURED} | {"search": "silverbox", "frame": "friction_frame"}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", choices=[*MEASURED, "simulated", "belt"])
    parser.add_argument("--seeds", type=int, help="of the simulated records (200), of those on a belt (10)")
    options = parser.parse_args(arguments)
    console = Console(width=180)
    for name, table_of in MEASURED.items():
        if options.only not in (None, name):
            continue
        if not (DATA / FOLDERS[name]).is_dir():
            print(f"{name}: left out, {DATA} has no measured records; name their folder in SYSID_TRIB_DATA.")
            continue
        console.print(table_of())
    if options.only in (None, "simulated"):
        console.print(simulated(options.seeds or 200))
    if options.only in (None, "belt"):
        console.print(belt(options.seeds or 10))


if __name__ == "__main__":
    main()
