"""Commands `plan` and `response`: predictions of runs."""

from collections.abc import Callable
from dataclasses import fields
from functools import partial

import numpy as np
import xarray as xr

from sysid_trib.commands.app import numbers_by_name, parse_window
from sysid_trib.commands.asked import asked_model, model_of_file
from sysid_trib.commands.options import ModeOptions, PlanOptions, RecordOptions, ResponseOptions
from sysid_trib.commands.record_inputs import read_decays, sensors_of
from sysid_trib.commands.terminal import deliver
from sysid_trib.cycles.backbone import backbone
from sysid_trib.errors import RecordError, SysidTribError, Tell, UsageError
from sysid_trib.printing import driven, layout
from sysid_trib.printing.modes import mode_response_blocks
from sysid_trib.questions.modal_response import response_of_mode, usual_frequencies
from sysid_trib.questions.next_run import plan as best_run
from sysid_trib.questions.steady_response import forced_response
from sysid_trib.records.mode_list import modes
from sysid_trib.results.files import load
from sysid_trib.results.kinds import kind_of
from sysid_trib.validation.identify import identify


def plan(tell: Tell, given: PlanOptions) -> Callable[[], None]:
    """Rank the next runs by their information, for a result or for records."""
    limits = {
        "amplitude": parse_window(given.amplitude, "--amplitude", "LOW:HIGH, such as 0.05:0.8"),
        "duration": parse_window(given.duration, "--duration"),
    }
    wanted = numbers_by_name(given.want, "--want", "FORCE=ERROR, such as delta=0.0005")
    tell("reading")
    tree = load(given.records[0]) if [p.suffix for p in given.records] == [".nc"] else None
    # A record may also be a netCDF file.
    if tree is None or not kind_of(tree):
        of_model = asked_model(given)
        decays, _ = read_decays(given)
        tree = identify(decays, of_model.library, constraints=of_model.constraints, tell=tell)
    data = best_run(tree, **limits, sampling_rate=given.rate, repeats=given.repeats, wanted=wanted, tell=tell)
    says = partial(driven.plan_blocks, data), partial(driven.plan_json, data)
    return deliver(given, tell, says, xr.DataTree(data), kind="plan")


def response(tell: Tell, given: ResponseOptions) -> Callable[[], None]:
    """Sweep the frequency of a drive."""
    low, high = parse_window(given.frequencies, "--frequencies")
    if low is None or high is None or not 0.0 < low < high:
        raise UsageError(f"--frequencies '{given.frequencies}' must be LOW:HIGH, both positive: 0.9:1.1.")
    if given.mode is not None or given.band is not None:
        return _response_of_mode(tell, given, (low, high))
    tell("reading")
    answer = model_of_file(given.result, _result(given))
    tell("response")
    w = answer.asymptotic_frequency.item() * np.linspace(low, high, given.points)
    data = forced_response(answer, given.drive, w, driven_by=given.driven_by, base=given.base)
    says = partial(driven.response_blocks, data), partial(layout.mapped, data, "response")
    texts = {given.csv: partial(driven.response_csv, data)}
    return deliver(given, tell, says, xr.DataTree(data), texts, kind="response")


def _result(given: ResponseOptions) -> xr.DataTree:
    """Load a result; if the file is a record of modes, say which option takes it."""
    try:
        return load(given.result)
    except RecordError as error:
        if said := _modes_in(given):
            raise UsageError(f"{given.result}: this is a record, no result; {said}.") from error
        raise


def _modes_in(given: ResponseOptions) -> str:
    """Describe the modes in a file, and the option that selects one; empty if it is not such a record."""
    try:
        listed = modes(sensors_of(_as_record(given), given.result))
    except SysidTribError:
        return ""
    named = ", ".join(f"{number}: {value:.4g} Hz" for number, value in listed.frequency.to_series().items())
    largest = 1 + int(np.argmax(listed.first_amplitude.max("sensor").values))
    return f"give the mode whose response is wanted ({named}), such as --mode {largest}"


def _as_record(given: ResponseOptions) -> RecordOptions:
    reading = {option.name: getattr(given, option.name) for option in fields(ModeOptions)}
    return RecordOptions(records=[given.result], **reading)


def _response_of_mode(tell: Tell, given: ResponseOptions, limits: tuple[float, float]) -> Callable[[], None]:
    """Sweep the frequency of a force on one mode of a decay."""
    tell("reading")
    decays, sources = read_decays(_as_record(given))
    if len(decays) > 1:
        raise UsageError(
            f"{given.result} contains {len(decays)} decays of this mode; choose one by --window."
        )
    tell("frequency and damping against amplitude")
    curves = backbone(decays[0])
    tell("response")
    w = usual_frequencies(curves, given.points)
    if given.changed(["frequencies"]):
        w = curves.smallest_amplitude_frequency.item() * np.linspace(*limits, given.points)
    data = response_of_mode(curves, given.drive, w, modal_mass=given.modal_mass)
    says = partial(mode_response_blocks, data, sources), partial(layout.mapped, data, "mode_response")
    texts = {given.csv: partial(driven.response_csv, data)}
    return deliver(given, tell, says, xr.DataTree(data), texts, kind="response of a mode")
