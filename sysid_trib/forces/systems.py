"""Systems of laboratories as data: what is measured, which forces are there, which cannot be."""

import math
import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from sysid_trib.errors import LibraryError, UsageError, did_you_mean
from sysid_trib.forces.formulas import LARGEST_CONSTANT
from sysid_trib.forces.library import library_folder, load_library

# The forces that systems name, by library.
SHIPPED_LIBRARIES = ("contact_forces", "candidate_effects", "inputs")
SYSTEMS_FILE = "systems.toml"
# What a system's signal can be.
QUANTITIES = ("angle", "displacement", "rate", "acceleration", "accelerometer")


@dataclass(frozen=True)
class System:
    """A kind of oscillator.

    Attributes
    ----------
    name, meaning : str
        Its name, and what it is.
    signal : str
        The quantity that is usually measured.
    forces : tuple of str
        Symbols of the forces that are identified where none is named.
    held : mapping of str to float
        Coefficients of forces that are always there: a pendulum's gravity is 1.
    impossible : tuple of str
        Symbols that are not offered.
    not_negative : tuple of str
        Symbols of forces whose coefficient physics does not let be negative.
    """

    name: str
    meaning: str = ""
    signal: str = "angle"
    forces: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    impossible: tuple[str, ...] = ()
    not_negative: tuple[str, ...] = ()

    @property
    def symbols(self) -> tuple[str, ...]:
        """Forces that are identified or held."""
        return (*self.forces, *self.held)

    def bounds(self, symbols: Iterable[str]) -> dict[str, tuple[float, float]]:
        """Bounds of those of these forces whose coefficient physics does not let be negative."""
        return {symbol: (0.0, math.inf) for symbol in symbols if symbol in self.not_negative}

    def with_held(self, forces: str | None) -> str | None:
        """Forces by their symbols, `lambda,zeta`, and those that are always there; else its usual ones."""
        if forces is None:
            return ",".join(self.symbols) or None
        named = [symbol.strip() for symbol in forces.split(",") if symbol.strip()]
        return ",".join([*named, *(symbol for symbol in self.held if symbol not in named)])


# An oscillator of which nothing is known.
ANY_SYSTEM = System("", signal="")


def load_system(name_or_path: str | None) -> System:
    """A system by its name, or the first of a TOML file.

    Parameters
    ----------
    name_or_path : str or None
        One of `libraries/systems.toml`, such as `pendulum`, or a file of the same format; without a name
        `ANY_SYSTEM`.

    Returns
    -------
    System

    Raises
    ------
    UsageError
        No such system or file.
    LibraryError
        A file that is not of this format, or names a force that no library has.
    """
    if name_or_path is None:
        return ANY_SYSTEM
    path = Path(name_or_path)
    if path.suffix == ".toml":
        if not os.path.isfile(path):
            raise UsageError(f"{path}: there is no such file.")
        return next(iter(_systems(path).values()))
    known = _systems(library_folder() / SYSTEMS_FILE)
    if name_or_path not in known:
        nearest = did_you_mean(name_or_path, known)
        raise UsageError(
            f"There is no system '{name_or_path}'; give a TOML file or one of {', '.join(known)}.{nearest}"
        )
    return known[name_or_path]


def _systems(path: Path) -> dict[str, System]:
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("system", [])
    # TOML, text and integers of too many digits alike.
    except (OSError, ValueError, RecursionError) as error:
        raise LibraryError(f"{path.name}: not a TOML file: {' '.join(str(error).split())}.") from None
    if not isinstance(tables, list) or not tables:
        raise LibraryError(f"{path.name}: there is no [[system]] in it; see libraries/{SYSTEMS_FILE}.")
    return {system.name: system for system in (_checked(table, path.name) for table in tables)}


def _checked(table: Any, source: str) -> System:
    keys = {part.name for part in fields(System)}
    if not isinstance(table, dict) or not isinstance(table.get("name"), str) or not set(table) <= keys:
        raise LibraryError(
            f"{source}: a [[system]] has a name, and of {', '.join(sorted(keys))} what it needs."
        )
    where, held = f"{source}: system '{table['name']}'", table.get("held", {})
    words = {key: table.get(key, "") for key in ("name", "meaning", "signal")}
    lists = {key: table[key] for key in ("forces", "impossible", "not_negative") if key in table}
    if not all(isinstance(word, str) for word in words.values()):
        raise LibraryError(f"{where}: name, meaning and signal are texts in quotes.")
    if not all(isinstance(names, list) for names in lists.values()) or not isinstance(held, dict):
        raise LibraryError(f"{where}: {', '.join(lists)} are lists of symbols, held is a table.")
    if "signal" in table and table["signal"] not in QUANTITIES:
        raise LibraryError(f"{where}: signal must be one of {', '.join(QUANTITIES)}.")
    names = [*(name for names in lists.values() for name in names), *held]
    known = [force.symbol for name in SHIPPED_LIBRARIES for force in load_library(name)]
    for name in names:
        if name not in known:
            nearest = did_you_mean(str(name), known)
            raise LibraryError(f"{where} names a force '{name}' of no library.{nearest}")
    numbers = [v for v in held.values() if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(numbers) < len(held) or not all(abs(value) <= LARGEST_CONSTANT for value in numbers):
        raise LibraryError(f"{where}: 'held' gives a number to each force.")
    return System(**{**table, **{key: tuple(value) for key, value in lists.items()}})
