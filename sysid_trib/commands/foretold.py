"""What `sysid-trib discover`, `plan` and `response` do: what a model lacks, and what it foretells."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from sysid_trib.commands.asked import asked_model, asked_search, model_of_file
from sysid_trib.commands.checks import assigned, parse_window
from sysid_trib.commands.destination import deliver, figures_of_runs, texts_of
from sysid_trib.commands.options import (
    EXAMPLE_FORCES,
    DecayOptions,
    Destination,
    Files,
    ModelOptions,
    SearchOptions,
    Shown,
    StartOptions,
)
from sysid_trib.commands.own_options import PlanOptions, SweepOptions
from sysid_trib.commands.record_inputs import driving_of, read_decays
from sysid_trib.commands.terminal import keep_next, record_sentences
from sysid_trib.discovery.discover import discover as searched
from sysid_trib.errors import DecayError, Tell, UsageError
from sysid_trib.printing import driven, next_step
from sysid_trib.printing.discovery import discovery_blocks
from sysid_trib.printing.json_results import discovery_json
from sysid_trib.results.files import kind_of, load
from sysid_trib.validation.identify import identify
from sysid_trib.validation.next_run import plan as best_run
from sysid_trib.validation.steady_response import forced_response


def discover(
    tell: Tell, given: DecayOptions, model: StartOptions, asked: SearchOptions, into: Destination
) -> Callable[[], None]:
    """Search what a model lacks."""
    forces = EXAMPLE_FORCES if model.forces is None and not given.records else model.forces
    driving = driving_of(given)
    start, offered, options = asked_search(model, forces, asked, given.system, driving)
    tell("reading")
    decays, sources = read_decays(given, model, driven=True)
    seen, held, said = _held_out(decays, model.holdout)
    tree = searched(seen, start, offered, holdout=held, tell=tell, **options)
    if said:
        tree.attrs["held_out"] = said
    if not driving:
        keep_next(tree, given, model, asked)
    stretches = tree.attrs["stretches"]
    sentences = [*sources, stretches] if stretches else record_sentences(tree, sources)
    figures = figures_of_runs(tree, "overview") | figures_of_runs(tree, "story")
    figures["ranking"] = ("ranking", tree)
    says = partial(discovery_blocks, tree, sentences), partial(discovery_json, tree)
    return deliver(into, tell, says, figures, tree, texts_of(into, tree))


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


def plan(
    tell: Tell, given: DecayOptions, model: ModelOptions, asked: PlanOptions, shown: Shown
) -> Callable[[], None]:
    """Say which run tells most, of a result or of records."""
    limits = {
        "amplitude": parse_window(asked.amplitude, "--amplitude", "LOW:HIGH, such as 0.05:0.8"),
        "duration": parse_window(asked.duration, "--duration"),
    }
    wanted = assigned(asked.want, "--want '{}' must be FORCE=ERROR, such as delta=0.0005.")
    tell("reading")
    tree = load(given.records[0]) if [p.suffix for p in given.records] == [".nc"] else None
    # A record may be netCDF too.
    if tree is None or not kind_of(tree):
        of_model = asked_model(model, given.system)
        decays, _ = read_decays(given, model)
        tree = identify(decays, of_model.library, constraints=of_model.constraints.table, tell=tell)
    main = model_of_file(given.records[0] if given.records else Path("the example"), tree)
    data = best_run(tree, **limits, sampling_rate=asked.rate, repeats=asked.repeats, wanted=wanted, tell=tell)
    says = partial(next_step.plan_blocks, data, main), partial(next_step.plan_json, data)
    return deliver(shown, tell, says, {"plan": ("plan", data)})


def response(tell: Tell, sweep: SweepOptions, files: Files, result: Path) -> Callable[[], None]:
    """Sweep the frequency of a drive."""
    low, high = parse_window(sweep.frequencies, "--frequencies")
    if low is None or high is None or not 0.0 < low < high:
        raise UsageError(f"--frequencies '{sweep.frequencies}' must be LOW:HIGH, both positive: 0.9:1.1.")
    tell("reading")
    answer = model_of_file(result, load(result))
    tell("response")
    w = answer.asymptotic_frequency.item() * np.linspace(low, high, sweep.points)
    data = forced_response(answer, sweep.drive, w, driven_by=sweep.driven_by, base=sweep.base)
    says = partial(driven.response_blocks, data), partial(driven.response_json, data)
    texts = {files.csv: partial(driven.response_csv, data)}
    return deliver(files, tell, says, {"response": ("response", data)}, xr.DataTree(data), texts)
