"""What the command line reads: records, libraries, values with errors, settings of a model."""

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid_trib.commands.options import ConstraintOptions, DecayOptions, ModelOptions
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.library import load_library

if TYPE_CHECKING:
    import xarray as xr

    from sysid_trib.forces.constraints import Constraints
    from sysid_trib.forces.force import ForceLibrary
    from sysid_trib.noise.random_force import RandomForceOption

# No oscillator is outside of this range in rad/s, Hz or s; far beyond it arithmetic overflows.
LEAST, MOST = 1e-9, 1e9
PLUS_MINUS = re.compile(r"\s*(?:±|\+/-|\+-)\s*")
SHIPPED = ("contact_forces", "candidate_effects")
# Options that say how a record is to be read.
COLUMNS = ("time", "angle", "signal", "units", "sampling_rate", "time_units")


def read_decays(
    given: DecayOptions, reference_frequency: float | None = None
) -> "tuple[list[xr.Dataset], list[str]]":
    """Read free decays of the files, or of the embedded example.

    Parameters
    ----------
    given : DecayOptions
        The files, none for the embedded example, and how to read them.
    reference_frequency : float, rad/s, optional
        Refused where the record cannot show it.

    Returns
    -------
    decays : list of xr.Dataset
        The decays.
    sentences : list of str
        What each of them is.
    """
    decays, sentences = zip(*(_read_decay(given, record) for record in given.records or (None,)), strict=True)
    sums = [decay.attrs.get("record_checksum") for decay in decays]
    for at, record in enumerate(given.records):
        # Its noise would count as if it were another's.
        if sums[at] in sums[:at]:
            raise UsageError(f"{record} is given twice; runs of one experiment are different records.")
    for decay in decays:
        _check_reference(reference_frequency, decay)
    return list(decays), list(sentences)


def _read_decay(given: DecayOptions, record: Path | None) -> "tuple[xr.Dataset, str]":
    from sysid_trib.decays.free_decay import free_decay
    from sysid_trib.records.columns import ANGLE_UNITS
    from sysid_trib.records.read import read_record
    from sysid_trib.simulation.example import paper_twin

    limits = parse_window(given.window, "--window")
    centre: float | str = given.equilibrium
    if centre != "auto":
        centre = parse_number(given.equilibrium, "--equilibrium")
    columns = {name: getattr(given, name) for name in COLUMNS}
    if record is None:
        idle = [k for k, v in columns.items() if v is not None and (k, v) != ("signal", "angle")]
        if idle:
            raise UsageError(f"--{idle[0].replace('_', '-')} is for a RECORD, and none is given.")
        read = paper_twin()
        sentence = f"Embedded example: {read.attrs['source']}; {read.attrs['synthetic']}."
    else:
        read = read_record(record, **columns)
        unit = read.attrs["angle_unit_in_file"]
        sentence = f"Record: {record}, {given.signal} in {unit} from column {read.attrs['angle_column']}."
        if not isinstance(centre, str):
            centre *= ANGLE_UNITS.get(unit.removesuffix("/s"), 1.0)
    if read.angle.attrs.get("units") != "rad":
        raise DecayError(f"{record}: a position in m must be scaled first (scale_translation in Python).")
    return free_decay(read, window=limits, equilibrium=centre), sentence


def offered_forces(library: str, forces: str | None, alpha: bool) -> "ForceLibrary":
    """The forces that are asked for, the linear elastic one among them where alpha is wanted.

    What is asked for by name and the library lacks is taken from those that come with the package.
    """
    whole = load_library(library)
    symbols = list(whole.symbols)
    if forces is not None:
        symbols = [s.strip() for s in forces.split(",") if s.strip()]
        shipped = (force for name in SHIPPED for force in load_library(name))
        lacking = [
            force for force in shipped if force.symbol in symbols and force.symbol not in whole.symbols
        ]
        whole = replace(whole, forces=(*whole.forces, *lacking))
    if not symbols:
        raise UsageError(f"--forces '{forces}' names no force; the library has {', '.join(whole.symbols)}.")
    stiffness = whole.role("x")
    if stiffness is not None and alpha:
        symbols.append(stiffness.symbol)
    elif stiffness is not None and set(symbols) == {stiffness.symbol}:
        raise UsageError(
            f"Force '{stiffness.symbol}' cannot be separated from the frequency: give --omega0 or "
            "--reference-frequency, or further forces."
        )
    return whole.select(symbols)


def check_positive(value: float | None, option: str) -> None:
    """Refuse what is not positive, or so large or small that arithmetic would overflow."""
    if value is not None and not LEAST <= value <= MOST:
        raise UsageError(f"{option} '{value:g}' must be a number from {LEAST:g} to {MOST:g}.")


def asked_model(
    model: ModelOptions, given: ConstraintOptions
) -> "tuple[ForceLibrary, dict[str, float], Constraints, tuple[float, float] | None]":
    """What is to be identified, as the options have it.

    Returns
    -------
    offered : ForceLibrary
        The forces.
    shapes : dict of str to float
        Shape parameters that are held.
    constraints : Constraints
        Checked against the forces.
    contactless : (float, float) or None, rad/s
        Frequency without contact and its error.
    """
    from sysid_trib.forces.constraints import Constraints
    from sysid_trib.forces.to_identify import forces_to_identify

    contactless = parse_value_with_error(model.omega0, "--omega0")
    check_positive(model.reference_frequency, "--reference-frequency")
    if contactless and model.reference_frequency:
        raise UsageError("--omega0 and --reference-frequency each give alpha a meaning: choose one.")
    offered = offered_forces(model.library, model.forces, bool(contactless or model.reference_frequency))
    shapes = held_shapes(given.set_, offered)
    constraints = Constraints.from_texts(given.fix, given.bound, given.tie)
    constraints.check(forces_to_identify(offered, model.reference_frequency, sensors=True))
    return offered, shapes, constraints, contactless


def _check_reference(frequency: float | None, decay: "xr.Dataset") -> None:
    """Refuse a reference frequency that the record cannot show."""
    time = decay.time.values
    slowest = 2.0 * np.pi / (time[-1] - time[0])
    fastest = 0.5 * slowest * (len(time) - 1)
    if frequency is not None and not slowest <= frequency <= fastest:
        raise UsageError(
            f"--reference-frequency '{frequency:g}': this record shows {slowest:.3g} to "
            f"{fastest:.3g} rad/s; mind that it is in rad/s, not Hz."
        )


def parse_window(text: str, option: str) -> tuple[float | None, float | None]:
    """`15:75` in s; either side may be empty."""
    sides = text.split(":")
    if len(sides) != 2:
        raise UsageError(f"{option} '{text}' must be START:STOP in seconds, such as 15:75, 25: or :60.")
    low, high = (parse_number(side, option) if side.strip() else None for side in sides)
    return low, high


def parse_value_with_error(text: str | None, option: str) -> tuple[float, float] | None:
    """`8.87`, `8.87±0.01` or `8.87+-0.01`."""
    if text is None:
        return None
    parts = PLUS_MINUS.split(text.strip())
    if len(parts) > 2:
        raise UsageError(f"{option} '{text}' must be VALUE or VALUE±ERROR.")
    value = parse_number(parts[0], option)
    error = parse_number(parts[1], option) if len(parts) == 2 else 0.0
    check_positive(value, option)
    if not 0.0 <= error <= value:
        raise UsageError(f"{option} '{text}': the error must be positive and below the value.")
    return value, error


def settings(
    texts: list[str], library: "ForceLibrary", *, papers: bool
) -> tuple[dict[str, float], dict[str, float]]:
    """Coefficients and shape parameters from `lambda=1e-3`, `dahl.s=0.02`; the paper's if none is set."""
    from sysid_trib.simulation.example import PAPER_COEFFICIENTS
    from sysid_trib.simulation.model import check_shapes

    values = _assigned(texts, "--set '{}' must be SYMBOL=VALUE, such as lambda=1e-3.")
    for name, value in values.items():
        if abs(value) > MOST:
            raise UsageError(f"--set {name}: {value:g} is larger than {MOST:g}.")
    shapes = {name: value for name, value in values.items() if "." in name}
    coefficients = {name: value for name, value in values.items() if "." not in name}
    check_shapes(shapes, library)
    if not coefficients and (texts or not papers):
        raise UsageError("No force is given a coefficient: add one, such as --set zeta=0.01.")
    return coefficients or PAPER_COEFFICIENTS, shapes


def held_shapes(texts: list[str], library: "ForceLibrary") -> dict[str, float]:
    """Shape parameters of the forces asked for, such as `dahl.s=0.02`."""
    known = list(library.shape_values())
    refusal = f"--set '{{}}': give SHAPE=VALUE; shapes of the forces asked for: {', '.join(known) or 'none'}."
    shapes = _assigned(texts, refusal)
    for name in shapes:
        if name not in known:
            raise UsageError(refusal.format(name))
    return shapes


def _assigned(texts: list[str], refusal: str) -> dict[str, float]:
    """Values by name of `NAME=VALUE,...`; the refusal takes what is no such pair."""
    values: dict[str, float] = {}
    for setting in (part for text in texts for part in text.split(",")):
        name, equals, value = (part.strip() for part in setting.partition("="))
        if not equals or not name:
            raise UsageError(refusal.format(setting))
        values[name] = parse_number(value, f"--set {name}")
    return values


def parse_random_force(text: str) -> "RandomForceOption":
    """`auto`, `off`, or a density in (rad/s^2)^2/Hz."""
    from sysid_trib.noise.random_force import DENSITY_UNITS

    word = text.strip()
    if word in ("auto", "off"):
        return "auto" if word == "auto" else "off"
    try:
        density = float(word)
    except ValueError:
        density = float("nan")
    if not 0.0 <= density <= MOST:
        raise UsageError(
            f"--random-force '{word}' must be auto, off, or a density from 0 to {MOST:g} {DENSITY_UNITS}."
        )
    return density


def parse_number(text: str, option: str) -> float:
    """A finite number, or a sentence that names the option."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if value != value or value in (float("inf"), float("-inf")):
        raise UsageError(f"{option}: '{text.strip()}' is not a finite number.")
    return value
