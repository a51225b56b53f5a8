"""What the command line reads: records, libraries, values with errors, settings of a model."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid_trib.errors import UsageError
from sysid_trib.library_files import load_library

if TYPE_CHECKING:
    import xarray as xr

    from sysid_trib.forces import ForceLibrary

PLUS_MINUS = re.compile(r"\s*(?:±|\+/-|\+-)\s*")


def read_decay(
    record: Path | None, options: dict[str, Any], window: str, equilibrium: str
) -> "tuple[xr.Dataset, str]":
    """Free decay of a file, or of the embedded example, and a sentence on what it is."""
    from sysid_trib.example import paper_twin
    from sysid_trib.free_decay import free_decay
    from sysid_trib.records import read_record

    limits = parse_window(window)
    centre = equilibrium if equilibrium == "auto" else parse_number(equilibrium, "--equilibrium")
    if record is None:
        given = [k for k, v in options.items() if v is not None and (k, v) != ("signal", "angle")]
        if given:
            raise UsageError(f"--{given[0].replace('_', '-')} is for a RECORD, and none is given.")
        read = paper_twin()
        told = f"Embedded example: {read.attrs['source']}; {read.attrs['synthetic']}."
    else:
        read = read_record(record, **options)
        told = f"Record: {record}."
    if read.angle.attrs.get("units") != "rad":
        raise UsageError(f"{record}: a position in m must be scaled first (scale_translation in Python).")
    return free_decay(read, window=limits, equilibrium=centre), told


def offered_forces(library: str, forces: str | None, alpha: bool) -> "ForceLibrary":
    """The library's forces that are asked for, the linear elastic one among them where alpha is wanted."""
    whole = load_library(library)
    if forces is None:
        return whole
    symbols = [s.strip() for s in forces.split(",") if s.strip()]
    if not symbols:
        raise UsageError(f"--forces '{forces}' names no force; the library has {', '.join(whole.symbols)}.")
    stiffness = whole.role("x")
    if alpha and stiffness is not None:
        symbols.append(stiffness.symbol)
    return whole.select(symbols)


def parse_window(text: str) -> tuple[float | None, float | None]:
    """`15:75` in s; either side may be empty."""
    sides = text.split(":")
    if len(sides) != 2:
        raise UsageError(f"--window '{text}' must be START:STOP in seconds, such as 15:75, 25: or :60.")
    low, high = (parse_number(side, "--window") if side.strip() else None for side in sides)
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
    if value <= 0 or error < 0:
        raise UsageError(f"{option} '{text}' must be positive.")
    return value, error


def parse_settings(settings: list[str]) -> tuple[dict[str, float], dict[str, float]]:
    """Coefficients and shape parameters from `lambda=1e-3`, `dahl.s=0.02`, also separated by commas."""
    coefficients: dict[str, float] = {}
    shapes: dict[str, float] = {}
    for setting in (part for text in settings for part in text.split(",") if part.strip()):
        name, equals, value = setting.partition("=")
        if not equals or not name.strip():
            raise UsageError(f"--set '{setting}' must be SYMBOL=VALUE, such as lambda=1e-3.")
        (shapes if "." in name else coefficients)[name.strip()] = parse_number(value, f"--set {name.strip()}")
    return coefficients, shapes


def parse_number(text: str, option: str) -> float:
    """A finite number, or a sentence that names the option."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if value != value or value in (float("inf"), float("-inf")):
        raise UsageError(f"{option}: '{text.strip()}' is not a finite number.")
    return value
