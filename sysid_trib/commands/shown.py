"""Commands without a fit: `look`, `backbone`, `report`, `export`, `forces` and `simulate`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from sysid_trib.commands.app import command_after, numbers_by_name
from sysid_trib.commands.asked import model_of_file
from sysid_trib.commands.next_step import fitting_options, pointed_options
from sysid_trib.commands.options import (
    MOST,
    BackboneOptions,
    ExportOptions,
    LibraryOptions,
    LookOptions,
    ReportOptions,
    SimulateOptions,
)
from sysid_trib.commands.record_inputs import (
    band_or_mode,
    decays_within,
    read_decays,
    read_sources,
    sensors_of,
)
from sysid_trib.commands.terminal import check_output, deliver, print_table, print_written
from sysid_trib.cycles.backbone import backbone as curves_of
from sysid_trib.cycles.look import look as facts
from sysid_trib.cycles.signatures import signatures_of
from sysid_trib.errors import DecayError, RecordError, SysidTribError, Tell, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import with_shipped
from sysid_trib.printing import code, exported, looked, parameters
from sysid_trib.printing.modes import modes_blocks, modes_json
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.mode_list import modes as modes_of
from sysid_trib.records.modes import modes as mode_frequencies
from sysid_trib.records.sensors import ClippedError
from sysid_trib.results.files import load, save, write_file
from sysid_trib.results.random_force import DENSITY_UNITS
from sysid_trib.results.variables import group_names
from sysid_trib.simulation.model import Model, check_shapes
from sysid_trib.simulation.simulate import PAPER_COEFFICIENTS, simulate as motion_of
from sysid_trib.validation import drive


def backbone(tell: Tell, given: BackboneOptions) -> Callable[[], None]:
    """Print the curves of each decay."""
    tell("reading")
    decays, sources = read_decays(given)
    names = group_names("backbone", len(decays))
    tell("frequency and damping against amplitude")
    curves = {name: curves_of(decay) for name, decay in zip(names, decays, strict=True)}
    says = partial(looked.backbone_blocks, curves, sources), partial(looked.backbone_json, curves)
    texts = {given.csv: partial(looked.backbone_csv, curves)}
    return deliver(given, tell, says, xr.DataTree.from_dict(curves), texts, kind="backbone")


def look(tell: Tell, given: LookOptions) -> Callable[[], None]:
    """Show the contents of files."""
    tell("reading")
    if given.input_ is not None:
        return _look_at_driven(tell, given)
    if (listed := _listed_modes(given)) is not None:
        return _look_at_modes(tell, given, listed)
    sources = read_sources(given)
    records = [run for _, runs, _ in sources for run in runs]
    sentences = [sentence for _, runs, sentence in sources for _ in runs]
    with_drive = _with_its_drive(given, records)
    try:
        decays = [decay for source in sources for decay in decays_within(given, source)[0]]
        tree = facts(records, decays)
    except DecayError as error:
        if with_drive is not None:
            return _look_at_driven(tell, with_drive)
        # The sentences on the reading of the files help to find the cause.
        return partial(_refuse, [] if given.as_json else sentences, error)
    if with_drive is not None and _is_driven_within(with_drive, decays):
        return _look_at_driven(tell, with_drive)
    asked = pointed_options(tree, given.system)
    command = command_after("identify", asked, given)
    says = partial(looked.look_blocks, tree, sentences, command), partial(looked.look_json, tree, command)
    return deliver(given, tell, says, tree, kind="look")


def _listed_modes(given: LookOptions) -> xr.Dataset | None:
    """Return the modes in a record of accelerometers; None for any other file, or for a single mode."""
    if len(given.records) != 1 or band_or_mode(given) or given.decay is not None:
        return None
    try:
        sensors = sensors_of(given, given.records[0])
        if int(sensors.attrs["integrations"]) != 2:
            return None
        time = sensors.time.values
        if all(len(mode_frequencies(time, signal)) < 2 for signal in sensors.signal.values):
            return None
        return modes_of(sensors)
    except ClippedError as error:
        if error.quantity == "acceleration":
            raise
        return None
    except SysidTribError:
        # The usual reading of the file reports its error.
        return None


def _look_at_modes(tell: Tell, given: LookOptions, listed: xr.Dataset) -> Callable[[], None]:
    """Show the modes in a record, and the command that selects one of them."""
    tell("modes")
    names = ", ".join(str(name) for name in listed.sensor.values)
    attrs = listed.attrs
    facts_of = [f"{attrs['quantity']} in {attrs['angle_unit_in_file']} from {names}", str(attrs["reading"])]
    sentence = f"Record: {given.records[0]}, {'; '.join(filter(None, facts_of))}."
    number = 1 + int(np.argmax(listed.first_amplitude.max("sensor").values))
    command = command_after("backbone", {"mode": str(number)}, given)
    says = partial(modes_blocks, listed, [sentence], command), partial(modes_json, listed, command)
    return deliver(given, tell, says, xr.DataTree(listed), kind="modes")


def _with_its_drive(given: LookOptions, records: list[xr.Dataset]) -> LookOptions | None:
    """Return the options with the columns of signal and drive; None if no column is a drive."""
    acting = list(records[0].attrs.get("drives", ()))
    if not acting or len(records) > 1:
        return None
    angle = given.angle or str(records[0].attrs["angle_column"])
    return given.but(angle=angle, input_=acting[0])


# A drive that changes within a decay by less than this fraction of its range is switched off there.
STILL = 0.02
# From this correlation with the signal, a force is the reaction of a spring, measured together with it.
REACTION = 0.9


def _is_driven_within(given: LookOptions, decays: list[xr.Dataset]) -> bool:
    """Return true if a drive acts within the parts used as decays."""
    try:
        (_, (record, *_), _), *_ = read_sources(given, driven=True)
    except SysidTribError:
        return False
    (known,) = inputs_of(record).values()
    whole = float(np.ptp(known.values))
    for decay in decays:
        time = decay.time.values - float(record.time.values[0])
        values = known.of(time)
        alike = abs(float(np.corrcoef(values, decay.angle.values)[0, 1])) if np.ptp(values) > 0.0 else 0.0
        if np.ptp(values) > STILL * whole and alike < REACTION:
            return True
    return False


def _look_at_driven(tell: Tell, given: LookOptions) -> Callable[[], None]:
    """Show the contents of driven records, and the forces that fit them."""
    sources = read_sources(given, driven=True)
    runs = [run for source in sources for run in decays_within(given, source)[0]]
    sentences = [sentence for _, of_file, sentence in sources for _ in of_file]
    if not given.changed(["between"]):
        given = given.but(between=drive.common_between(runs[0]))
    tell("which forces fit")
    models = drive.fitting_models(runs)
    command = command_after("identify", fitting_options(models, given.system), given)
    tree = xr.DataTree.from_dict(dict(zip(group_names("record", len(runs)), runs, strict=True)))
    says = (
        partial(looked.driven_look_blocks, tree, sentences, models, command),
        partial(looked.driven_look_json, tree, models, command),
    )
    return deliver(given, tell, says, tree, kind="driven look")


def _refuse(sentences: list[str], error: DecayError) -> None:
    """Print the sentences on the reading of the files, without duplicates, and raise the error."""
    for sentence in dict.fromkeys(sentences):
        print(sentence)
    raise error


def report(tell: Tell, given: ReportOptions) -> Callable[[], None]:
    """Write the page of a result."""
    from sysid_trib.reporting.page import page, write_page

    tell("reading")
    tree = load(given.result)
    tell("page")
    try:
        text = page(tree)
    except (RecordError, UsageError) as error:
        raise RecordError(f"{given.result}: {error}") from None
    write_page(text, given.output)
    return partial(print_written, given.output)


def export(tell: Tell, given: ExportOptions) -> Callable[[], None]:
    """Write the equation of a result as a program, or its parameters with their covariance."""
    result, language, output = given.result, given.language, given.output
    ending = {"simulink": ".m", "toml": ".toml", "json": ".json"}.get(language, ".py")
    check_output(output, ending, reads=[result])
    model = model_of_file(result, load(result))
    if language in code.PARAMETER_LANGUAGES:
        text = parameters.parameters_text(model, language)
    else:
        text = code.model_code(model, language)
    if output is None:
        return partial(print, text, end="")
    write_file(output, text.encode())
    return partial(print_written, output)


def forces(tell: Tell, given: LibraryOptions) -> Callable[[], None]:
    """Print the forces of a library."""
    offered = load_library(given.library)
    table = looked.force_table(offered, signatures_of(offered))
    if given.latex is not None:
        write_file(given.latex, exported.forces_latex(offered).encode())

    def say() -> None:
        print(f"{offered.title}\n{looked.NORMALISED}\n")
        print_table(table)
        print_written(given.latex)

    return say


MAX_SAMPLES, MAX_PERIODS = 20_000_000, 1_000_000


def simulate(tell: Tell, given: SimulateOptions) -> Callable[[], None]:
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
    """Parse coefficients and shape parameters, `lambda=1e-3`, `dahl.s=0.02`; the paper's if none is set."""
    values = numbers_by_name(texts, "--set", "SYMBOL=VALUE, such as lambda=1e-3")
    for name, value in values.items():
        if abs(value) > MOST:
            raise UsageError(f"--set {name}: {value:g} is larger than {MOST:g}.")
    shapes = {name: value for name, value in values.items() if "." in name}
    coefficients = {name: value for name, value in values.items() if "." not in name}
    check_shapes(shapes, library)
    if not coefficients and (texts or not papers):
        raise UsageError("No force has a coefficient: add one, such as --set zeta=0.01.")
    return coefficients or PAPER_COEFFICIENTS, shapes


def _simulated(model: Model, motion: SimulateOptions) -> xr.Dataset:
    """Return the result of `simulate`, with noise in `angle`; raise an error for impossible numbers."""
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
    """Write a record as CSV (`time (s)`, `angle (rad)`) or netCDF, according to the extension of the file."""
    if target.suffix.lower() == ".csv":
        table = record.angle.to_dataframe()[["angle"]].rename(columns={"angle": "angle (rad)"})
        write_file(target, table.to_csv(index_label="time (s)").encode())
    else:
        save(record, target)
