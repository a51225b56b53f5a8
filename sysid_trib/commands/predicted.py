"""What `sysid-trib simulate`, `plan`, `response` and `discover` do: motions of a model, and what it lacks."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from sysid_trib.commands.asked import asked_model, asked_search, model_of_file
from sysid_trib.commands.destination import deliver, texts_of
from sysid_trib.commands.options import EXAMPLE_FORCES, MOST, Given, assigned, parse_window
from sysid_trib.commands.record_inputs import driving_of, read_decays
from sysid_trib.commands.terminal import keep_next, record_sentences
from sysid_trib.discovery.discover import discover as searched
from sysid_trib.errors import DecayError, Tell, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import with_shipped
from sysid_trib.likelihood.random_force import DENSITY_UNITS
from sysid_trib.printing import driven, next_step
from sysid_trib.printing.discovery import discovery_blocks
from sysid_trib.printing.json_results import discovery_json
from sysid_trib.results.files import kind_of, load, save, write_file
from sysid_trib.simulation.model import Model, check_shapes
from sysid_trib.simulation.simulate import PAPER_COEFFICIENTS, simulate as motion_of
from sysid_trib.validation.identify import identify
from sysid_trib.validation.next_run import plan as best_run
from sysid_trib.validation.steady_response import forced_response


def discover(tell: Tell, given: Given) -> Callable[[], None]:
    """Search what a model lacks."""
    driving = driving_of(given)
    of_example = {} if given.records or given.forces else {"forces": EXAMPLE_FORCES}
    start, offered, options = asked_search(given.but(**of_example), driving)
    tell("reading")
    decays, sources = read_decays(given, driven=True)
    seen, held, said = _held_out(decays, given.holdout)
    tree = searched(seen, start, offered, holdout=held, tell=tell, **options)
    if said:
        tree.attrs["held_out"] = said
    if not driving:
        keep_next(tree, given)
    stretches = tree.attrs["stretches"]
    sentences = [*sources, stretches] if stretches else record_sentences(tree, sources)
    says = partial(discovery_blocks, tree, sentences), partial(discovery_json, tree)
    return deliver(given, tell, says, tree, texts_of(given, tree))


def _held_out(decays: list[xr.Dataset], window: str | None) -> tuple[list[xr.Dataset], list[xr.Dataset], str]:
    """What is learned from, what is kept for prediction: a window of each decay, and its words."""
    if window is None:
        return decays, [], ""
    low, high = parse_window(window, "--holdout")
    seen, held = [], []
    for decay in decays:
        time = decay.time.values
        inside = np.ones(len(time), dtype=bool) if low is None else time >= low
        inside &= True if high is None else time <= high
        here = f"the decay is from {time[0]:.4g} s to {time[-1]:.4g} s"
        if inside.all() or not inside.any():
            part = "all" if inside.any() else "nothing"
            raise DecayError(f"--holdout '{window}' holds out {part}: {here}.")
        if not (inside[0] or inside[-1]):
            raise UsageError(f"--holdout '{window}' must reach to the start or the end: {here}.")
        seen.append(decay.isel(time=np.flatnonzero(~inside)))
        held.append(decay.isel(time=np.flatnonzero(inside)))
    said = f"up to {high:g} s" if low is None else f"from {low:g} s on" if high is None else ""
    said = said or f"{low:g} s to {high:g} s"
    return seen, held, said + (" of each run" if len(decays) > 1 else "")


def plan(tell: Tell, given: Given) -> Callable[[], None]:
    """Say which run tells most, of a result or of records."""
    limits = {
        "amplitude": parse_window(given.amplitude, "--amplitude", "LOW:HIGH, such as 0.05:0.8"),
        "duration": parse_window(given.duration, "--duration"),
    }
    wanted = assigned(given.want, "--want '{}' must be FORCE=ERROR, such as delta=0.0005.")
    tell("reading")
    tree = load(given.records[0]) if [p.suffix for p in given.records] == [".nc"] else None
    # A record may be netCDF too.
    if tree is None or not kind_of(tree):
        of_model = asked_model(given)
        decays, _ = read_decays(given)
        tree = identify(decays, of_model.library, constraints=of_model.constraints.table, tell=tell)
    main = model_of_file(given.records[0] if given.records else Path("the example"), tree)
    data = best_run(tree, **limits, sampling_rate=given.rate, repeats=given.repeats, wanted=wanted, tell=tell)
    says = partial(next_step.plan_blocks, data, main), partial(next_step.plan_json, data)
    return deliver(given, tell, says, xr.DataTree(data), kind="plan")


def response(tell: Tell, given: Given) -> Callable[[], None]:
    """Sweep the frequency of a drive."""
    low, high = parse_window(given.frequencies, "--frequencies")
    if low is None or high is None or not 0.0 < low < high:
        raise UsageError(f"--frequencies '{given.frequencies}' must be LOW:HIGH, both positive: 0.9:1.1.")
    tell("reading")
    answer = model_of_file(given.result, load(given.result))
    tell("response")
    w = answer.asymptotic_frequency.item() * np.linspace(low, high, given.points)
    data = forced_response(answer, given.drive, w, driven_by=given.driven_by, base=given.base)
    says = partial(driven.response_blocks, data), partial(driven.response_json, data)
    texts = {given.csv: partial(driven.response_csv, data)}
    return deliver(given, tell, says, xr.DataTree(data), texts, kind="response")


MAX_SAMPLES, MAX_PERIODS = 20_000_000, 1_000_000


def simulate(tell: Tell, given: Given) -> Callable[[], None]:
    """Simulate a record and write it."""
    named = [text.partition("=")[0].partition(".")[0].strip() for text in given.set_]
    offered = with_shipped(load_library(given.library), named)
    coefficients, shapes = _settings(given.set_, offered, papers=not given.changed(["library"]))
    tell("simulation")
    record = _simulated(Model(offered, coefficients, given.reference_frequency, shapes), given)
    write_record(record, given.output)
    stop = record.stop_time.item()
    ending = f"; it stops at {stop:.4g} s" if stop == stop else ""
    return partial(print, f"{given.output}: {record.sizes['time']} simulated samples{ending}.")


def _settings(
    texts: list[str], library: ForceLibrary, *, papers: bool
) -> tuple[dict[str, float], dict[str, float]]:
    """Coefficients and shape parameters from `lambda=1e-3`, `dahl.s=0.02`; the paper's if none is set."""
    values = assigned(texts, "--set '{}' must be SYMBOL=VALUE, such as lambda=1e-3.")
    for name, value in values.items():
        if abs(value) > MOST:
            raise UsageError(f"--set {name}: {value:g} is larger than {MOST:g}.")
    shapes = {name: value for name, value in values.items() if "." in name}
    coefficients = {name: value for name, value in values.items() if "." not in name}
    check_shapes(shapes, library)
    if not coefficients and (texts or not papers):
        raise UsageError("No force is given a coefficient: add one, such as --set zeta=0.01.")
    return coefficients or PAPER_COEFFICIENTS, shapes


def _simulated(model: Model, motion: Given) -> xr.Dataset:
    """What `simulate` returns, with the noise in `angle`; numbers from which no record comes are refused."""
    duration, sampling_rate, noise = motion.duration, motion.sampling_rate, motion.noise
    samples = round(duration * sampling_rate)
    if not 2 <= samples <= MAX_SAMPLES:
        raise UsageError(
            f"{duration:g} s at {sampling_rate:g} Hz must be 2 to {MAX_SAMPLES:,} samples; "
            "change --duration or --sampling-rate."
        )
    if duration * model.reference_frequency > 2.0 * np.pi * MAX_PERIODS:
        raise UsageError(
            f"{duration:g} s at {model.reference_frequency:g} rad/s are more than {MAX_PERIODS:,} periods; "
            "shorten --duration, or lower --reference-frequency."
        )
    if motion.seed < 0:
        raise UsageError(f"--seed '{motion.seed}' must be a whole number, 0 or more.")
    time = np.arange(samples) / sampling_rate
    density, seed = motion.random_force, motion.seed
    record = motion_of(model, time, motion.angle0, motion.rate0, random_force=density, seed=seed)
    record["angle"] = record.angle + noise * np.random.default_rng(seed).standard_normal(samples)
    record.angle.attrs = {"units": "rad", "long_name": "angle"}
    disturbed = f", random force {density:g} {DENSITY_UNITS}" if density else ""
    source = f"simulated by sysid_trib, noise {noise:g} rad{disturbed}, seed {seed}"
    return record.assign_attrs(source=source, synthetic="yes")


def write_record(record: xr.Dataset, target: Path) -> None:
    """Write a record as CSV (`time (s)`, `angle (rad)`) or netCDF, by the file's ending."""
    if target.suffix.lower() == ".csv":
        table = record.angle.to_dataframe()[["angle"]].rename(columns={"angle": "angle (rad)"})
        write_file(target, table.to_csv(index_label="time (s)").encode())
    else:
        save(record, target)
