"""The records of a command: files or the embedded example, their decays, and files of other kinds."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.campaigns.conditions import read_conditions
from sysid_trib.commands.app import (
    command_after,
    parse_number,
    parse_value_with_error,
    parse_window,
    texts_by_name,
)
from sysid_trib.commands.asked import driving_of
from sysid_trib.commands.options import ForcesOptions, ModelOptions, RecordOptions
from sysid_trib.errors import DecayError, RecordError, SysidTribError, UsageError
from sysid_trib.forces.library import load_library
from sysid_trib.forces.systems import load_system
from sysid_trib.records import modes
from sysid_trib.records.driven_parts import driven_parts
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.no_decay import NoDecayError
from sysid_trib.records.one_mode import one_mode
from sysid_trib.records.read import read_records, reading_text
from sysid_trib.records.reading import Reading
from sysid_trib.records.sensors import read_sensors
from sysid_trib.records.smoothing import swing_frequency
from sysid_trib.records.units import signal_unit
from sysid_trib.results.files import load
from sysid_trib.simulation.measured_motion import MEASURED
from sysid_trib.simulation.simulate import paper_twin

PROGRAM = "sysid-trib"


class RunsOfFile(NamedTuple):
    """The runs in a file, and a sentence that describes them; `file` is None for the embedded example."""

    file: Path | None
    runs: list[xr.Dataset]
    sentence: str


def what_else(path: Path) -> str:
    """Describe a file of this package that is not a record, and how to show it; otherwise empty.

    Parameters
    ----------
    path : path
        A file, or folder, that could not be read as a record.
    """
    name, page = path.name, f"{path.stem}.html"
    if path.is_dir():
        # Files in either version of Zarr.
        store = any((path / file).is_file() for file in ("zarr.json", ".zgroup"))
        said = f"{name}: this is the store of a campaign, no record; its page {page} shows it."
        return said if store else ""
    if not path.is_file():
        return ""
    start = b""
    with suppress(OSError), path.open("rb") as file:
        start = file.read(1024).lstrip().lower()
    if start.startswith((b"<!doctype html", b"<html")):
        return f"{name}: this is a page of HTML, no record; a browser shows it."
    if start.startswith(b"{") and _is_printed(path):
        return (
            f"{name}: this is the output of a command with --json, no record; -o RESULT.nc saves a "
            f"result for {PROGRAM} report."
        )
    if path.suffix.lower() in (".nc", ".nc4", ".cdf") and (maker := _maker_of(path)):
        return f"{name}: this is a result of {maker}, no record; {PROGRAM} report {name} -o {page} shows it."
    return ""


def _is_printed(path: Path) -> bool:
    """Return true if a file is the JSON output of a command."""
    # Size in bytes; the JSON output of a command is far smaller.
    if path.stat().st_size > 2**24:
        return False
    try:
        data = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return False
    return str(data.get("next")).startswith(f"{PROGRAM} ") or {"records", "without_result"} <= data.keys()


def _maker_of(path: Path) -> str:
    """Return the command or method that wrote a result; empty if the file is not a result."""
    try:
        tree = load(path)
    except SysidTribError:
        return ""
    methods = [node.attrs.get("method") for node in tree.subtree if "sysid_trib_version" in node.attrs]
    words = str(tree.attrs.get("command", "")).split()
    return (words[1] if len(words) > 1 else str(methods[0])) if methods else ""


# Options for reading a record.
READING = ("time", "angle", "signal", "units", "sampling_rate", "time_units", "length", "distance")
OMEGA0, REFERENCE = "--omega0", "--reference-frequency"
# Largest ratio of frequencies. Hz and rad/s differ by more; w_inf and omega0 differ by less, even if the
# contact is 24 times as stiff as the oscillator.
MOST_RATIO = 5.0
# Advice if the frequency given by an option differs much from that of the record.
INSTEAD = {
    OMEGA0: "correct it, or leave it out and compute alpha = (w_inf / omega0)^2 - 1 from w_inf of the result",
    REFERENCE: "correct it, or leave it out: w is then fitted",
}


def read_decays(
    given: RecordOptions,
    *,
    as_it_is: bool = False,
    driven: bool = False,
    warm_up: float | None = None,
) -> tuple[list[xr.Dataset], list[str]]:
    """Read free decays of the files, or of the embedded example.

    Parameters
    ----------
    given : RecordOptions
        The files and how to read them; without files, the embedded example. Frequencies of a model are
        refused if they are impossible for the records.
    as_it_is : bool
        As in `free_decays`; also true if the forces of the model are given.
    driven : bool
        True if inputs are used.
    warm_up : float, s, optional
        Beginning of a record whose rest is predicted: the rest does not change it.

    Returns
    -------
    decays : list of xr.Dataset
        The decays; several decays of one file are separate runs.
    sentences : list of str
        Descriptions of the decays.
    """
    named = isinstance(given, ForcesOptions) and bool(given.forces)
    sources = read_sources(given, driven=driven)
    decays, sentences, sums = list[xr.Dataset](), list[str](), list[str]()
    for source in sources:
        record, runs, _ = source
        checksum = str(runs[0].attrs.get("record_checksum"))
        # The noise of a record given twice would count as independent.
        if checksum in sums:
            raise UsageError(f"{record} is given twice; runs of one experiment are different records.")
        sums.append(checksum)
        chosen, sentence = decays_within(given, source, as_it_is=as_it_is or named, warm_up=warm_up)
        decays += chosen
        sentences += [sentence] * len(chosen)
    if len({str(decay.angle.attrs.get("units")) for decay in decays}) > 1:
        raise UsageError(
            "The records have different units; give runs of one experiment in one unit (--units)."
        )
    _check_frequencies(decays, given)
    return decays, sentences


def read_sources(given: RecordOptions, *, driven: bool = False) -> list[RunsOfFile]:
    """Read the runs of each file without cuts, and describe them."""
    if given.constant and not driven:
        raise UsageError(
            "--constant is for records of identify, laws, discover, compare and difference; leave it out of "
            "this command."
        )
    if given.input_ is not None and not driven:
        raise UsageError(
            "--input is for driven records (identify, laws, discover, compare); this command takes free "
            "decays."
        )
    constants = constants_of_records(given)
    return [_read(given, record, of) for record, of in zip(given.records or (None,), constants, strict=True)]


def decays_within(
    given: RecordOptions, source: RunsOfFile, *, as_it_is: bool = False, warm_up: float | None = None
) -> tuple[list[xr.Dataset], str]:
    """Return the decays of a file, or the requested one, and their description."""
    record, runs, sentence = source
    those = [decay for run in runs for decay in _decays(given, run, as_it_is=as_it_is, warm_up=warm_up)]
    count = "1 decay" if len(those) == 1 else f"{len(those)} decays"
    if given.decay is not None and given.decay > len(those):
        raise UsageError(
            f"--decay {given.decay}: {record or 'the example'} contains {count}; give 1 to {len(those)}."
        )
    chosen = those if given.decay is None else [those[given.decay - 1]]
    taken = ", one of them taken" if len(chosen) == 1 else ""
    return chosen, sentence + (f" {count}{taken}." if len(those) > 1 else "")


def calibration_of(given: RecordOptions) -> tuple[float, float]:
    """Return the scale of the signal and its standard error."""
    return parse_value_with_error(given.scale, "--scale") or (1.0, 0.0)


def constants_of_records(given: RecordOptions) -> list[dict[str, str | float]]:
    """Return the known constants of each record by name.

    `--constant` is `kp=100`, `kp=100,400`, `kp=COLUMN` or `kp=TABLE.csv:kp`.

    Raises
    ------
    UsageError
        The number of values differs from the number of records, or a table has no row for a record.
    """
    form = "of the form kp=100, kp=COLUMN or kp=TABLE.csv:COLUMN"
    texts = texts_by_name(given.constant, "--constant", form)
    records = [str(record) for record in given.records or ()]
    of_each: list[dict[str, str | float]] = [{} for _ in records or (None,)]
    for name, text in texts.items():
        values = _constants(name, text, records)
        if len(values) not in (1, len(records)):
            raise UsageError(
                f"--constant '{name}={text}' contains {len(values)} values for {len(records)} records; give "
                "one, or one a record."
            )
        for at, of in enumerate(of_each):
            of[name] = values[at if len(values) > 1 else 0]
    return of_each


def _constants(name: str, text: str, records: Sequence[str]) -> list[str | float]:
    """Return the values of a constant, or the name of a column, for each record."""
    file, colon, column = text.rpartition(":")
    if colon and file:
        table = read_conditions(Path(file), records)
        if column not in table:
            raise UsageError(
                f"{Path(file).name}: no column '{column}' for the constant {name}; there are "
                f"{', '.join(map(str, table))}."
            )
        return [parse_number(str(value), f"--constant {name}") for value in table[column]]
    parts = [part.strip() for part in text.split(",")]
    with suppress(ValueError):
        return [float(part) for part in parts]
    return [text]


def _read(given: RecordOptions, record: Path | None, constants: Mapping[str, str | float]) -> RunsOfFile:
    """Return the runs of a file or of the embedded example, and their description."""
    how = {name: getattr(given, name) for name in READING}
    factor = calibration_of(given)[0]
    if record is None:
        if idle := given.changed([*READING, "input_", "constant", "mode", "band"]):
            raise UsageError(f"{idle[0]} is for a RECORD, and none is given.")
        example = paper_twin()
        source = f"Embedded example: {example.attrs['source']}; {example.attrs['synthetic']}."
        return RunsOfFile(record, [_multiplied(example, factor)], source)
    try:
        system = load_system(given.system)
        how |= {"usual": system.signal, "gravity": system.swings_under_gravity}
        if band_or_mode(given):
            runs = [_mode_of(given, record)]
        else:
            inputs = driving_of(given)
            asked = Reading(**how, inputs=inputs, between=given.between, constants=constants)
            runs = read_records(record, asked)
    except SysidTribError:
        if said := what_else(record):
            raise RecordError(said) from None
        raise
    facts = [reading_text(runs)]
    facts += [f"multiplied by {given.scale}"] * (given.scale != "1")
    if said := _several_modes(given, runs[0]):
        facts.append(
            f"several modes ring in it, {said}: the others act as noise, and --mode takes one of them"
        )
    sentence = f"Record: {record}, {'; '.join(facts)}."
    return RunsOfFile(record, [_multiplied(run, factor) for run in runs], sentence)


def _several_modes(given: RecordOptions, run: xr.Dataset) -> str:
    """List the modes in a run of accelerometers; empty if there is one mode, or if one was selected."""
    if band_or_mode(given) or given.input_ is not None or int(run.attrs.get("integrations", 0)) != 2:
        return ""
    measured = run[str(run.attrs["measured"])]
    frequencies = modes.modes(run.time.values, measured.values)
    return modes.listed(frequencies) if len(frequencies) > 1 else ""


def band_or_mode(given: RecordOptions) -> bool:
    """Return true if one mode of a record is requested, by number or by a frequency band."""
    if given.mode is not None and given.band is not None:
        raise UsageError("--mode and --band both name a mode; give one.")
    wanted = given.mode is not None or given.band is not None
    if wanted and given.input_ is not None:
        raise UsageError("--mode and --band are for free decays; leave out --input.")
    return wanted


def sensors_of(given: RecordOptions, record: Path) -> xr.Dataset:
    """Read the sensors of a file."""
    how = Reading(**{name: getattr(given, name) for name in READING})
    return read_sensors(record, how, window=parse_window(given.window, "--window"))


def _mode_of(given: RecordOptions, record: Path) -> xr.Dataset:
    """Return the record of the requested mode."""
    sensors = sensors_of(given, record)
    if given.band is None:
        return one_mode(sensors, given.mode)
    return one_mode(sensors, band=parse_window(given.band, "--band", "LOW:HIGH in Hz, such as 70:90"))


def _multiplied(record: xr.Dataset, factor: float) -> xr.Dataset:
    """Return a record with its signal multiplied by a factor."""
    names = [name for name in ("angle", MEASURED) if name in record and factor != 1.0]
    return record.assign({name: record[name].copy(data=factor * record[name].values) for name in names})


def _decays(
    given: RecordOptions, record: xr.Dataset, *, as_it_is: bool = False, warm_up: float | None = None
) -> list[xr.Dataset]:
    limits = parse_window(given.window, "--window")
    if given.input_ is not None or given.constant:
        known_until = np.inf
        if warm_up is not None:
            first = record.time.values[0].item()
            known_until = warm_up + (first if limits[0] is None else max(first, limits[0]))
        return driven_parts(record, limits, keep_outliers=given.keep_outliers, known_until=known_until)
    centre: float | str = given.equilibrium
    if centre != "auto":
        unit = signal_unit(str(record.attrs.get("angle_unit_in_file", "rad")))
        centre = parse_number(given.equilibrium, "--equilibrium") * (unit.factor if unit else 1.0)
        centre *= calibration_of(given)[0]
    how = {"keep_outliers": given.keep_outliers, "as_it_is": as_it_is}
    try:
        return free_decays(record, window=limits, equilibrium=centre, **how)
    except NoDecayError as error:
        if not error.reason.uncut:
            raise
        refusal = error
    reason = replace(refusal.reason, uncut=_as_it_is(given, record, limits, centre))
    raise NoDecayError(refusal.source, reason)


def _as_it_is(
    given: RecordOptions, record: xr.Dataset, limits: tuple[float | None, float | None], centre: float | str
) -> str:
    """Describe how to use a record without cuts if it is not a decay; empty if it is too short."""
    try:
        for decay in free_decays(record, window=limits, equilibrium=centre, as_it_is=True):
            envelope(decay)
    except DecayError:
        return ""
    viscous = next(iter(load_library().damping_factors))
    if isinstance(given, ForcesOptions):
        return f"name the forces that act, such as --forces {viscous}, to use it uncut"
    # This command lacks the option, so another command is suggested.
    return f"use it uncut with {command_after('identify', {'forces': viscous}, given)}"


def _check_frequencies(decays: Sequence[xr.Dataset], given: RecordOptions) -> None:
    """Raise an error for a frequency that is the record's own in Hz, or differs by a factor above five."""
    given_ones = dict[str, float]()
    if isinstance(given, ForcesOptions) and given.reference_frequency is not None:
        given_ones[REFERENCE] = given.reference_frequency
    contactless = parse_value_with_error(given.omega0, OMEGA0) if isinstance(given, ModelOptions) else None
    if contactless is not None:
        given_ones[OMEGA0] = contactless[0]
    for decay in decays if given_ones else ():
        swing = np.nan
        # If there are too few half periods the methods raise their own error.
        with suppress(DecayError):
            swing = swing_frequency(decay)
        for flag, frequency in given_ones.items():
            in_hertz, said = swing / (2.0 * np.pi), ""
            # A frequency within 30 % of the record's frequency in Hz is assumed to be in Hz.
            if abs(frequency / in_hertz - 1.0) < 0.3:
                said = f"which is {in_hertz:.4g} Hz; give it in rad/s"
            elif frequency > MOST_RATIO * swing:
                said = f"less than a fifth of that; {INSTEAD[flag]}"
            elif frequency < swing / MOST_RATIO:
                said = f"more than five times that; {INSTEAD[flag]}"
            if said:
                raise UsageError(f"{flag} '{frequency:g}': the record swings at {swing:.4g} rad/s, {said}.")
