"""Driven records: Silverbox, Bouc-Wen, EMPS, a frame that rubs, simulated ones beside their bound, a belt.

python -m benchmarks driven [--only silverbox|search|bouc_wen|emps|frame|simulated|belt] [--seeds N]

Measured records are read from ../shared/data beside the project, or from the folder in SYSID_TRIB_DATA;
without it only `simulated` and `belt` run. Times are of the processor, of one call, with what it compiles.
"""

import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from helpers import rms

import sysid_trib as st
from benchmarks import DATA, peers
from benchmarks.study.coefficients import estimated
from benchmarks.study.common import columns, covered, shown, timed
from sysid_trib.forces import ForceLibrary
from sysid_trib.likelihood.pysindy_features import ForceFeatures
from sysid_trib.physics import per_input
from sysid_trib.records.inputs import KnownInput

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
# Of tables, letters.
WIDTH = 180
# Of records on a belt: what tells that a motion sticks was decided with the seeds below.
FRESH = 100


def offered(*symbols: str) -> ForceLibrary:
    """Return these forces of the libraries of the package."""
    known: dict[str, Any] = {}
    for name in LIBRARIES:
        for force in st.load_library(name):
            known.setdefault(force.symbol, force)
    return replace(st.load_library("inputs"), forces=tuple(known[symbol] for symbol in symbols))


def cpu(call: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result of a call, and its processor time (s)."""
    return timed(call, time.process_time)


def silverbox_parts() -> tuple[xr.Dataset, xr.Dataset]:
    """Five realisations of the multisine, and the sixth."""
    record = st.read_record(DATA / "silverbox" / "multisine_1_to_6.csv", input="V1")
    return record.isel(time=slice(TRAINING)), record.isel(time=slice(TRAINING, None))


def pysindy_driven(library: ForceLibrary, record: xr.Dataset, w: float) -> np.ndarray:
    """Coefficients by `pysindy.SINDy` on local polynomials with u=; stiffness is among the unknowns."""
    import pysindy

    time, signal = record.time.values, record.angle.values
    # The shortest that its order allows: a period has nine samples.
    window = (peers.ORDER + 2) * (time[1] - time[0])
    x, rate, acceleration = peers.savitzky_golay(time, signal, window)
    features = ForceFeatures(library, reference_frequency=w)
    model = pysindy.SINDy(feature_library=features, optimizer=peers.plain_optimizer())
    target = (acceleration / w**2 + x)[:, None]
    states, u = np.column_stack([x, rate / w]), record["u"].values[:, None]
    model.fit(states, t=time[1] - time[0], x_dot=target, u=u)
    return -model.coefficients()[0]


def silverbox() -> None:
    """Trained on five realisations; free run on the sixth, whose start is fitted."""
    (train, test), rows = silverbox_parts(), []
    direct, trajectory = st.methods.Direct(**OFF), st.methods.Trajectory(**OFF)
    for method, symbols in ((direct, FIVE), (direct, EIGHT), (direct, TWELVE), (trajectory, FIVE)):
        result, seconds = cpu(lambda m=method, s=symbols: m.identify(train, offered(*s)))
        seen, unseen = (st.predict(result, part) for part in (train, test))
        left = [f"{1e3 * part.residual_rms.item():.4f}" for part in (seen, unseen)]
        largest = f"{1e3 * float(np.abs(unseen.residual).max()):.2f}"
        name = type(method).__name__
        rows.append([name, " ".join(symbols), str(len(symbols) + 1), *left, largest, f"{seconds:.0f}"])
    library, w = offered("alpha", *FIVE), result.reference_frequency.item()
    values, seconds = cpu(lambda: pysindy_driven(library, train, w))
    # A result with these coefficients in the place of ours: predicted alike.
    its = st.methods.Direct(w, **OFF).identify(train, library).assign(coefficient=("force", values))
    left = f"{1e3 * st.predict(its, test).residual_rms.item():.4f}"
    words = f"alpha {' '.join(FIVE)}", str(len(library))
    rows.append(["pysindy.SINDy, u=", *words, "", left, "", f"{seconds:.0f}"])
    heads = ("method", "forces and w", "parameters", "training", "last realisation", "largest", "time (s)")
    shown("Silverbox, RMS of record minus free run (mV)", heads, rows, WIDTH)


def search() -> None:
    """`discover` on five realisations from the linear model, with nothing named; free run on the sixth."""
    train, test = silverbox_parts()
    tree, seconds = cpu(lambda: st.discover(train))
    last = 1e3 * st.predict(tree["after"].to_dataset(), test).residual_rms.item()
    steps, held_out = tree["steps"].to_dataset(), 1e3 * tree["holdout"].rms.values
    rows = [["(linear)", "", f"{held_out[0]:.4f}"]]
    for at, symbol in enumerate(steps.symbol.values.tolist()):
        one = steps.isel(step=at)
        cell = f"{one.coefficient.item():.4f} ± {one.standard_error.item():.4f}"
        rows.append([symbol, cell, f"{held_out[at + 1]:.4f}"])
    title = f"Silverbox, discover: {seconds:.0f} s; last realisation {last:.4f} mV"
    heads = ("added", "coefficient", "held out, RMS (mV)")
    shown(f"{title}; outcome: {tree.attrs['search_outcome']}", heads, rows, WIDTH)


def emps() -> None:
    """The motor axis: no restoring force; everything in the unit of the force."""
    path = DATA / "emps" / "DATA_EMPS.mat"
    record = st.read_record(path, angle="qm", time="t", units="m", input=f"{GTAU}*vir", between="linear")
    rows = [["published least squares", "4", *(f"{value:g}" for value in PUBLISHED.values()), "6.85", ""]]
    for further in FURTHER:
        library = offered("free_axis", "gain", "zeta", "lambda", "bias", *further)
        tree, seconds = cpu(lambda those=library: st.identify(record, those, constraints={"free_axis": 1.0}))
        compared = tree["judged"].to_dataset()
        for name in compared.model.values.tolist():
            found = per_input(tree[name].to_dataset()).sel(quantity=list(SAID))
            pairs = zip(found.value.values, found.standard_error.values, strict=True)
            cells = [f"{value:.2f} ± {error:.2f}" for value, error in pairs]
            left = f"{1e3 * compared.residual_rms.sel(model=name).item():.2f}"
            count = str(len(SAID) + len(further))
            rows.append([" ".join((name, *further)), count, *cells, left, f"{seconds:.0f}"])
    heads = ("method", "parameters", *SAID.values(), "open loop (mm)", "time of both (s)")
    shown("EMPS, each model by both methods", heads, rows, WIDTH)


def bouc_wen() -> None:
    """`discover` on four fifths of the training record from the linear model, with nothing named."""
    record = st.read_record(DATA / "bouc_wen" / "train.csv", input="u")
    fifth = record.sizes["time"] // 5
    parts = {"four fifths": slice(4 * fifth), "the last fifth": slice(4 * fifth, None)}
    tree, seconds = cpu(lambda: st.discover(record.isel(time=parts["four fifths"])))
    after, rows = tree["after"].to_dataset(), []
    left = ", ".join(
        f"{name} {st.predict(after, record.isel(time=part), warm_up=1.0).residual_rms.item():.3g} m"
        for name, part in parts.items()
    )
    for kind, name in (("force", "coefficient"), ("shape_parameter", "shape")):
        errors = after["standard_error" if kind == "force" else "shape_standard_error"]
        for at, label in enumerate(after[kind].values.tolist() if kind in after else []):
            rows.append([label, f"{after[name].values[at]:.6g}", f"{errors.values[at]:.2g}"])
    w, of_w = after.reference_frequency.item(), after.reference_frequency_standard_error.item()
    rows.append(["w (rad/s)", f"{w:.6g}", f"{of_w:.2g}"])
    title = f"Bouc-Wen, discover: {seconds:.0f} s; left after a warm-up of 1 s: {left}"
    title = f"{title}; added: {' '.join(tree['steps'].symbol.values.tolist())}"
    shown(title, ("parameter", "found", "standard error"), rows, WIDTH)


def frame() -> None:
    """Three loads on one frame: the friction is each run's own, frequency and damping are common."""
    folder, runs, rows = DATA / "friction_frame", [], []
    for load in LOADS:
        base = {"base": f"{folder / f's_b_{load}g_y.mat'}:y"}
        runs.append(st.read_record(folder / f"s_b_{load}g_x.mat", time="t", units="mm", input=base))
    library = offered("base_spring", "base_damping", "lambda")
    methods = [kind(own=("lambda",)) for kind in (st.methods.Direct, st.methods.Trajectory)]
    tree, seconds = cpu(lambda: st.identify(runs, library, methods, constraints={"base_spring": 1.0}))
    compared = tree["judged"].to_dataset()
    for name in compared.model.values.tolist():
        result = tree[name].to_dataset()
        w, of_w = result.reference_frequency.item(), result.reference_frequency_standard_error.item()
        newton = 1e-3 * MASS * w**2
        cells = [f"{w / (2 * np.pi):.4f} ± {of_w / (2 * np.pi):.4f}", with_error(result, "base_damping", 1.0)]
        cells += [with_error(result, f"lambda_{at}", newton) for at in range(1, len(LOADS) + 1)]
        rows.append([name, *cells, f"{compared.residual_rms.sel(model=name).item():.3f}"])
    heads = ("method", "frequency (Hz)", "zeta", *(f"F of {load} g (N)" for load in LOADS), "left (mm)")
    shown(f"Frame, three loads; both methods take {seconds:.0f} s", heads, rows, WIDTH)


def with_error(result: xr.Dataset, symbol: str, scale: float) -> str:
    """A coefficient and its standard error, both in another unit."""
    one = result.sel(force=symbol)
    return f"{scale * one.coefficient.item():.4f} ± {scale * one.standard_error.item():.4f}"


def driven_model() -> tuple[st.Model, np.ndarray]:
    """A pendulum under a multisine about its resonance, and the times: 30 periods of 40 samples."""
    elapsed = np.arange(1200) * 2.0 * np.pi / W / 40
    lines = np.arange(1, 61) / 30 * W
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, len(lines))
    u = np.cos(np.outer(elapsed, lines) + phases).sum(axis=1) / np.sqrt(len(lines) / 2)
    inputs = {"u": KnownInput(elapsed, u, "smooth")}
    return st.Model(offered(*TRUTH), TRUTH, W, inputs=inputs), elapsed


def simulated(seeds: int) -> None:
    """White noise in a driven pendulum: errors over the bound, and intervals that hold the truth."""
    model, elapsed = driven_model()
    clean = st.simulate(model, elapsed, 0.1, inputs=model.inputs)
    bound = st.validation.cramer_rao_bound(model, elapsed, 0.1, 0.0, NOISE, free=True)
    smallest = np.append(bound.standard_error.values, bound.reference_frequency_standard_error.item())
    rows = []
    for method in (st.methods.Direct(), st.methods.Trajectory()):

        def one(seed: int, method: Any = method) -> dict[str, Any]:
            noise = NOISE * np.random.default_rng(seed).standard_normal(clean.sizes["time"])
            record = clean.assign(angle=clean.angle + noise)
            return estimated(lambda: st.identify(record, model.library, method), TRUTH, W)

        errors, stated, spent = columns(map(one, range(seeds)), "errors", "standard_errors", "seconds")
        pairs = zip(rms(errors) / smallest, covered(errors, stated), strict=True)
        cells = [f"{ratio:.2f} / {share:.0f}" for ratio, share in pairs]
        rows.append([type(method).__name__, *cells, f"{np.mean(spent):.2f}"])
    title = f"RMS error over the Cramér-Rao bound / 95 % intervals that hold (%), {seeds} seeds"
    shown(title, ("method", *TRUTH, "w", "time of one (s)"), rows, WIDTH)


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
    columns_of = {"angle": (angle, {}), "surface": (surface, linear)}
    data = {name: ("time", values, of | {"units": "rad"}) for name, (values, of) in columns_of.items()}
    record = xr.Dataset(data | {"u": ("time", u, smooth)}, {"time": elapsed})
    return record, truth, float(np.mean(np.abs(faster) < 0.02)), float(np.mean(faster > 0.1))


def belt(seeds: int) -> None:
    """`discover` of the friction to a belt, from the push and viscous friction, on records that stick."""
    rows, right = [], 0
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
        rows.append([str(seed), *shares, " ".join(names), *cells, true, f"{seconds:.0f}"])
    title = f"Stick-slip on a belt: the friction to the belt is named first in {right} of {seeds}"
    heads = ("seed", "sticks (%)", "overtakes (%)", "named", "friction", "its error", "true", "time (s)")
    shown(title, heads, rows, WIDTH)


MEASURED = {"silverbox": silverbox, "search": search, "bouc_wen": bouc_wen, "emps": emps, "frame": frame}
FOLDERS = {"search": "silverbox", "frame": "friction_frame"}


def driven(asked: Namespace) -> None:
    for name, table in MEASURED.items():
        if asked.only in name and (DATA / FOLDERS.get(name, name)).is_dir():
            table()
        elif asked.only in name:
            print(f"{name}: left out, {DATA} has no measured records; name their folder in SYSID_TRIB_DATA.")
    for name, made, usual in (("simulated", simulated, 200), ("belt", belt, 10)):
        if asked.only in name:
            made(asked.seeds or usual)
