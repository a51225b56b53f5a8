"""A pendulum on a servo: which friction law, how well it predicts runs that were not fitted, and how fast.

python -m benchmarks servo [--only chosen|laws|prediction|halves|free|rigs|named]

The runs are read from ../shared/data/servo_pendulum beside the project, or from the folder in
SYSID_TRIB_DATA. Those of a gain are predicted from the start that was measured, with the goal position, the
gain and the switch of the torque alone; nothing is fitted to them. Runs of the gain 200, which are not there,
may be added to the folder.
"""

import time
from argparse import Namespace
from typing import Any

import numpy as np
import xarray as xr

import sysid_trib as st
from benchmarks import DATA
from sysid_trib.forces import ForceLibrary
from sysid_trib.forces.library import library_of_text
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.inputs import KnownInput
from sysid_trib.results.effects import added_effects, credible_set, steps_taken

FOLDER = DATA / "servo_pendulum"
MOTIONS = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
COLUMNS = {"goal": "goal position", "on": "torque on"}
# Duty ratio by gain and error of position (1/rad), of SOURCE.md of the data.
DUTY_RATIO = 0.00287746
BASE = ("gravity", "tilt", "motor", "back_emf", "lambda", "zeta")
# Friction laws that are held against each other, by the further forces of each. The Stribeck speed is that of
# the library: if it is fitted, the sum of squares has several minima.
LAWS: dict[str, tuple[str, ...]] = {
    "Coulomb and viscous": (),
    "with Stribeck": ("stribeck",),
    "with the load": ("load_friction",),
    "with the load squared": ("load_squared",),
    "with the load squared, Stribeck": ("load_squared", "stribeck"),
    "with the load squared, and the load at low speed": ("load_squared", "load_stribeck"),
    "the same, delay of the sensor": ("load_squared", "load_stribeck", "sensor_delay"),
    "with the load, and more at low speed": (
        *("load_friction", "load_stribeck"),
        *("motor_saturation", "sensor_delay"),
    ),
}
CHOSEN = "with the load, and more at low speed"
NOT_NEGATIVE = dict.fromkeys(("lambda", "zeta", "back_emf"), (0.0, None))


def library_text(duty_ratio: float, seen: str = "x") -> str:
    """The library of a servo in TOML: joints under a control loop that saturates.

    Parameters
    ----------
    duty_ratio : float, 1/rad
        Of the duty ratio to the gain and the error of position.
    seen : str
        Position that the control loop sees, a formula.
    """
    return f"""
title = "A pendulum on a servo"
include = ["joints"]
inputs = {{ goal = "displacement", kp = "", on = "" }}

[expressions]
powered = "on"
torque = "max(-1, min(1, {duty_ratio}*kp*(goal - ({seen}))))"
"""


def library() -> ForceLibrary:
    """The forces of a joint under this law of control."""
    return library_of_text(library_text(DUTY_RATIO), "servo")


def gains() -> list[int]:
    """The gains of which there are runs."""
    return sorted({int(file.name.split("_")[0][2:]) for file in FOLDER.glob("kp*_sin_sin.csv")})


def run_of(gain: int, motion: str) -> xr.Dataset:
    """One run, with its gain as a known constant."""
    record = st.read_record(FOLDER / f"kp{gain}_{motion}.csv", input=COLUMNS, constants={"kp": "kp"})
    # Goals were interpolated from one reading to the next.
    record["goal"].attrs["between"] = "linear"
    return record


def fitted(runs: list[xr.Dataset], law: str) -> tuple[xr.Dataset, float]:
    """The fit of a law to runs, and the processor's time (s)."""
    forces = library().select((*BASE, *LAWS[law]))
    constraints: dict[str, Any] = {s: of for s, of in NOT_NEGATIVE.items() if s in forces.symbols}
    begun = time.process_time()
    method = st.methods.Trajectory(
        random_force="off",
        starts="measured",
        constraints={"gravity": 1.0} | constraints,
    )
    return st.identify(runs, forces, method), time.process_time() - begun


def absolute_error(result: xr.Dataset, runs: list[xr.Dataset]) -> list[float]:
    """Mean absolute error of the open-loop prediction of each run (mrad), its start as measured."""
    predicted = (st.predict(result, run, starts="measured") for run in runs)
    return [1e3 * float(np.abs(record.residual).mean()) for record in predicted]


def servo(asked: Namespace) -> None:
    """Print what is asked for."""
    if not FOLDER.is_dir():
        print(f"No runs in {FOLDER}.")
        return
    for title, part in (
        ("chosen", chosen),
        ("laws", laws),
        ("prediction", prediction),
        ("halves", halves),
        ("free", free),
        ("rigs", rigs),
        ("named", named),
    ):
        if asked.only in title:
            part()


def runs_of(which: list[int]) -> list[xr.Dataset]:
    """All runs of some gains."""
    return [run_of(gain, motion) for gain in which for motion in MOTIONS]


def laws() -> None:
    """Each law fitted to all runs: what it leaves, and how long it takes."""
    runs = runs_of(gains())
    print(f"{'law, fitted to ' + str(len(runs)) + ' runs':52s} {'MAE (mrad)':>10s} {'processor (s)':>14s}")
    for law in LAWS:
        print_law(law, runs)


def chosen() -> None:
    """The law that predicts best, fitted to all runs."""
    print_law(CHOSEN, runs_of(gains()))


def print_law(law: str, runs: list[xr.Dataset]) -> None:
    """A law fitted to runs, in a line, and its coefficients."""
    result, seconds = fitted(runs, law)
    print(f"{law:52s} {np.mean(absolute_error(result, runs)):10.1f} {seconds:14.0f}", flush=True)
    print_coefficients(result)


def print_coefficients(result: xr.Dataset) -> None:
    """Coefficients with their standard errors, a line each."""
    for symbol in result.force.values.tolist():
        row = result.sel(force=symbol)
        print(f"    {symbol:16s} {row.coefficient.item():9.4f} ± {row.standard_error.item():.4f}")
    print(f"    w (rad/s)        {result.reference_frequency.item():9.4f}")


def prediction(
    laws_tried: tuple[str, ...] = ("Coulomb and viscous", "with the load squared", CHOSEN),
) -> None:
    """Each gain predicted by the runs of the others, by three laws."""
    print("mean absolute error (mrad) of the four runs of a gain that is kept back")
    for law in laws_tried:
        for gain in gains():
            result, _ = fitted(runs_of([other for other in gains() if other != gain]), law)
            error = np.mean(absolute_error(result, runs_of([gain])))
            print(f"{law:52s} {gain:5d} {error:10.1f}", flush=True)


# Runs of one half, of twelve in the order of motions and then gains: each has a gain or two of every motion.
HALVES = ((0, 2, 4, 6, 8, 10), (0, 1, 5, 6, 7, 11), (2, 4, 5, 6, 9, 11))


def halves() -> None:
    """Fits of disjoint halves of the runs: difference of each parameter over its error."""
    runs = [run_of(gain, motion) for motion in MOTIONS for gain in gains()]
    sizes = []
    for half in HALVES:
        others = [at for at in range(len(runs)) if at not in half]
        both = [fitted([runs[at] for at in part], CHOSEN)[0] for part in (half, others)]
        values, errors = (
            np.array([of[name].values for of in both]) for name in ("coefficient", "standard_error")
        )
        known = (errors > 0.0).all(axis=0)
        z = (values[0] - values[1])[known] / np.hypot(*errors)[known]
        names = both[0].force.values[known].tolist()
        sizes.append(float(np.sqrt(np.mean(z**2))))
        each = ", ".join(f"{name} {value:+.1f}" for name, value in zip(names, z, strict=True))
        print(f"halves of the runs, difference over its error: {each}; RMS {sizes[-1]:.2f}", flush=True)
    print(f"    RMS of {len(HALVES)} divisions {np.sqrt(np.mean(np.square(sizes))):.2f}", flush=True)


# Simulated rigs: the common part of their laws, and what each has besides.
RIG = {"gravity": 1.0, "motor": 1.5, "back_emf": 0.6, "lambda": 0.02, "zeta": 0.06}
RIG_LAWS: dict[str, dict[str, float]] = {
    "Coulomb and viscous": {},
    "with Stribeck": {"stribeck": 0.03},
    "with the load": {"load_friction": 0.2},
    "with the load, and Stribeck": {"load_friction": 0.2, "stribeck": 0.03},
    "directional": {"motor_friction": 0.2, "weight_friction": 0.08},
}
RIG_FREQUENCY, RIG_NOISE, RIG_SEEDS = 8.4, 5e-4, (1, 2, 3)


def rig_goals(time: np.ndarray) -> dict[str, np.ndarray]:
    """Return the goal motions of the measured runs, by their names, rad."""
    rises = np.clip(time / 3.0, 0.0, 1.0)
    return {
        "sin_sin": 0.5 * np.pi * np.sin(time) + 0.5 * np.sin(5.0 * time) * np.sin(2.0 * time),
        "sin_time_square": np.sin(time**2),
        "up_and_down": 0.5 * np.pi * (rises - 0.2 * np.clip((time - 3.0) / 3.0, 0.0, 1.0)),
        "lift_and_drop": -0.5 * np.pi * np.clip(time / 2.0, 0.0, 1.0),
    }


def rig_runs(law: dict[str, float], seed: int, step: float = 0.02) -> list[xr.Dataset]:
    """Return twelve simulated runs of 6 s with a law, with the measured gains and motions."""
    random, time = np.random.default_rng(seed), np.arange(0.0, 6.0, step)
    truth, forces = RIG | law, library()
    model = st.Model(forces.select([*truth]), truth, RIG_FREQUENCY)
    runs = []
    for gain in (100.0, 400.0, 800.0):
        for motion, goal in rig_goals(time).items():
            on = np.where((motion == "lift_and_drop") & (time > 2.0), 0.0, 1.0)
            given = {"goal": (goal, "linear"), "kp": (np.full_like(time, gain), "held"), "on": (on, "held")}
            inputs = {name: KnownInput(time, *of) for name, of in given.items()}
            moved = st.simulate(model, time, 0.0, inputs=inputs)
            noise = RIG_NOISE * random.standard_normal(len(time))
            runs.append(moved.assign(angle=moved.angle + noise))
    return runs


def found_by(runs: list[xr.Dataset]) -> tuple[xr.DataTree, float]:
    """Return what `discover` adds to Coulomb and viscous friction, and the processor's time (s)."""
    forces = library()
    begun = time.process_time()
    start = forces.select([symbol for symbol in BASE if symbol != "tilt"])
    return st.discover(runs, start, forces, constraints={"gravity": 1.0}), time.process_time() - begun


def rigs() -> None:
    """Print how often `discover` names exactly the law of a simulated rig."""
    for name, law in RIG_LAWS.items():
        answers, seconds = list[str](), list[float]()
        for seed in RIG_SEEDS:
            tree, taken = found_by(rig_runs(law, seed))
            answers.append(", ".join(sorted(added_effects(tree))) or "nothing")
            seconds.append(taken)
        right = answers.count(", ".join(sorted(law)) or "nothing")
        others = "; ".join(sorted({*answers}))
        print(f"{name:30s} {right} of {len(RIG_SEEDS)}, {np.mean(seconds):.0f} s: {others}", flush=True)


def named() -> None:
    """Print what `discover` names on all measured runs and without a gain, and the error of that gain."""
    for kept_back in (None, *gains()):
        tree, seconds = found_by(runs_of([gain for gain in gains() if gain != kept_back]))
        which = "all runs" if kept_back is None else f"without the gain {kept_back}"
        effects = ", ".join(added_effects(tree)) or "nothing"
        print(f"{which}: {effects} ({tree.attrs['search_outcome']}), {seconds:.0f} s", flush=True)
        for step in steps_taken(tree):
            likely = ", ".join(f"{symbol} {part:.2f}" for symbol, part in credible_set(step).items())
            size = f"{step.coefficient.item():.3f} ± {step.standard_error.item():.3f}"
            print(f"    {step.symbol.item()} {size}, p {step.p_value.item():.1g}; in its place: {likely}")
        if kept_back is not None:
            models = (tree[name].to_dataset() for name in ("before", "after"))
            errors = [np.mean(absolute_error(of, runs_of([kept_back]))) for of in models]
            print(f"    mean absolute error of the gain {kept_back}: {errors[0]:.1f} to {errors[1]:.1f} mrad")


def free() -> None:
    """Each swing with the torque off predicted by the others; its start alone is fitted to it."""
    files = sorted(FOLDER.glob("free_swing_kp*.csv"))
    records = [st.read_record(file, angle="position (rad)") for file in files]
    # One of them has two half periods.
    swings = [free_decays(record, as_it_is=True)[0] for record in records]
    joint = st.load_library("joints")
    method = st.methods.Trajectory(random_force="off", constraints={"gravity": 1.0})
    for law in (("lambda", "zeta"), ("lambda", "zeta", "weight_friction")):
        errors = []
        for at, swing in enumerate(swings):
            others = [other for place, other in enumerate(swings) if place != at]
            result = st.identify(others, joint.select(("gravity", *law)), method)
            errors.append(1e3 * float(np.abs(st.predict(result, swing).residual).mean()))
        each = ", ".join(f"{error:.1f}" for error in errors)
        print(f"free swings, {', '.join(law):40s} MAE (mrad) {each}; mean {np.mean(errors):.1f}", flush=True)
