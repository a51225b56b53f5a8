"""Kinds of oscillators: the forces of each, and known properties of their coefficients."""

import itertools
import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from sysid_trib.errors import LibraryError, UsageError, did_you_mean
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import TEXT, Checks, check_keys, is_number, library_folder, load_library
from sysid_trib.forces.selection import SHIPPED_LIBRARIES, with_shipped

SYSTEMS_FILE = "systems.toml"
# Possible signals of a system.
QUANTITIES = ("angle", "displacement", "rate", "acceleration", "accelerometer")
SYMBOL_LISTS = ("forces", "impossible", "not_negative")
COLUMN_NAMES = "columns"
# Words in the name of a column.
NAME_WORDS = re.compile(r"[^\W\d_]+")
SYSTEM_KEYS: Checks = {
    "name": TEXT,
    "meaning": TEXT,
    "signal": (lambda v: v in QUANTITIES, f"one of {', '.join(QUANTITIES)}"),
    **dict.fromkeys(SYMBOL_LISTS, (lambda v: isinstance(v, list), "a list of symbols")),
    COLUMN_NAMES: (
        lambda v: isinstance(v, list) and all(isinstance(names, str) and names.split() for names in v),
        "a list of names of columns, those of one file with blanks between",
    ),
    "held": (
        lambda v: isinstance(v, dict) and all(map(is_number, v.values())),
        "a table that gives a number to each force",
    ),
}


@dataclass(frozen=True)
class System:
    """A kind of oscillator.

    Attributes
    ----------
    name, meaning : str
        Name of the system, and its description.
    signal : str
        The usually measured quantity.
    forces : tuple of str
        Symbols of the forces that are identified if none are named.
    held : mapping of str to float
        Coefficients of forces that are always present: a pendulum's gravity is 1.
    impossible : tuple of str
        Symbols of forces that are not offered.
    not_negative : tuple of str
        Symbols of forces whose coefficients cannot be negative for physical reasons.
    columns : tuple of tuple of str
        Names of columns by which a file of such a system is recognised, the signal's first.
    """

    name: str
    meaning: str = ""
    signal: str = "angle"
    forces: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    impossible: tuple[str, ...] = ()
    not_negative: tuple[str, ...] = ()
    columns: tuple[tuple[str, ...], ...] = ()

    def known_columns(self, signal: str, columns: Iterable[str]) -> tuple[str, ...]:
        """Return the names of columns by which a file is recognised as one of this system."""
        (first,), others = _first_words([signal]), set(_first_words(columns))
        known = (names for names in self.columns if names[0] == first and others.issuperset(names))
        return next(known, ())

    @property
    def symbols(self) -> tuple[str, ...]:
        """Forces that are identified or fixed."""
        return (*self.forces, *self.held)

    @property
    def swings_under_gravity(self) -> bool:
        """True if gravity is the restoring force, or if the system does not state one."""
        shipped = [force for name in SHIPPED_LIBRARIES for force in load_library(name)]
        held = [force for force in shipped if force.symbol in self.held]
        return not self.name or any(force.matches("sin(x) - x") for force in held)

    @property
    def choices(self) -> ForceLibrary:
        """Forces that can be identified: those of `contact_forces` and its own, without the stiffness."""
        library = with_shipped(load_library(), self.forces)
        stiffness = library.role("x")
        left_out = {*self.impossible, *self.held, *(() if stiffness is None else (stiffness.symbol,))}
        return library.select(symbol for symbol in library.symbols if symbol not in left_out)

    @property
    def usual(self) -> tuple[str, ...]:
        """Forces that are identified if none are named."""
        return tuple(self.forces) or tuple(self.choices.symbols)

    def bounds(self, symbols: Iterable[str]) -> dict[str, tuple[float, float]]:
        """Return the bounds of forces whose coefficients cannot be negative."""
        return {symbol: (0.0, math.inf) for symbol in symbols if symbol in self.not_negative}

    def with_held(self, forces: str | None) -> str | None:
        """Return forces with these symbols, `lambda,zeta`, and those always present; else the usual ones."""
        if forces is None:
            return ",".join(self.symbols) or None
        named = [symbol.strip() for symbol in forces.split(",") if symbol.strip()]
        return ",".join([*named, *(symbol for symbol in self.held if symbol not in named)])


def _first_words(names: Iterable[str]) -> list[str]:
    """Return the first words of column names, in lower case: `phi` for `Phi_rad [rad]`."""
    return [next(iter(NAME_WORDS.findall(name.lower())), "") for name in names]


# An oscillator without known properties.
ANY_SYSTEM = System("", signal="")


def load_system(name_or_path: str | None) -> System:
    """Return a system by its name, or the first system of a TOML file.

    Parameters
    ----------
    name_or_path : str or None
        One of `libraries/systems.toml`, such as `pendulum`, or a file of the same format; `ANY_SYSTEM` if
        omitted.

    Returns
    -------
    System

    Raises
    ------
    UsageError
        There is no such system or file.
    LibraryError
        The file does not have this format, or it names a force that no library has.

    Examples
    --------
    >>> import sysid_trib as st
    >>> spring = st.forces.load_system("spring")
    >>> spring.signal, spring.forces
    ('displacement', ('lambda', 'zeta', 'delta', 'epsilon'))
    >>> spring.choices.symbols
    ('lambda', 'zeta', 'delta', 'nu', 'epsilon')
    """
    if name_or_path is None:
        return ANY_SYSTEM
    path = Path(name_or_path)
    if path.suffix == ".toml":
        if not os.path.isfile(path):
            raise UsageError(f"{path}: there is no such file.")
        return next(iter(_systems(path).values()))
    known = load_systems()
    if name_or_path not in known:
        offered = f"{', '.join(known)}.{did_you_mean(name_or_path, known)}"
        raise UsageError(f"There is no system '{name_or_path}'; give a TOML file or one of {offered}")
    return known[name_or_path]


class SystemModel(NamedTuple):
    """The forces of a system and their known coefficients: `library, constraints = system(...)`.

    Attributes
    ----------
    library : ForceLibrary
        Forces that are identified or fixed.
    constraints : mapping of str to float or (float, float)
        Fixed coefficients, and bounds, in the form for `identify` and `compare`.
    """

    library: ForceLibrary
    constraints: dict[str, float | tuple[float | None, float | None]]

    @property
    def held(self) -> dict[str, float]:
        """Fixed coefficients, in the form for `discover`: a search does not bound coefficients."""
        return {symbol: value for symbol, value in self.constraints.items() if isinstance(value, float)}


def system(
    name_or_path: str | Path, forces: Iterable[str] | None = None, library: ForceLibrary | None = None
) -> SystemModel:
    """Return the forces of a system and their known coefficients, as with `--system`.

    Parameters
    ----------
    name_or_path : str or path
        One of `libraries/systems.toml`, such as `pendulum`, or a file of the same format.
    forces : iterable of str, optional
        Symbols that replace the usually identified forces; fixed forces of the system are added.
    library : ForceLibrary, optional
        Library searched first for the forces; by default `contact_forces`. Other forces come from the
        libraries of the package.

    Returns
    -------
    SystemModel
        The pair `library, constraints`: the forces, and their fixed values and bounds by symbol, in the form
        for `identify` and `compare`.

    Raises
    ------
    UsageError
        There is no such system, or a force is in no library.
    LibraryError
        The file does not have this format.

    Examples
    --------
    >>> import sysid_trib as st
    >>> pendulum = st.system("pendulum")
    >>> pendulum.library.symbols
    ('lambda', 'zeta', 'delta', 'gravity')
    >>> dict(pendulum.constraints)
    {'lambda': (0.0, inf), 'zeta': (0.0, inf), 'delta': (0.0, inf), 'gravity': 1.0}
    """
    moving = load_system(str(name_or_path))
    offered = load_library() if library is None else library
    symbols = [*(moving.forces if forces is None else forces), *moving.held] or [*offered.symbols]
    model = with_shipped(offered, symbols).select(symbols)
    held = {symbol: float(value) for symbol, value in moving.held.items()}
    return SystemModel(model, {**moving.bounds(model.symbols), **held})


def load_systems() -> dict[str, System]:
    """Return the systems that come with the package, by their names.

    Returns
    -------
    dict of str to System
        Each has `name`, `meaning`, `forces`, the usually identified ones, and `held`, the known coefficients.

    Examples
    --------
    >>> import sysid_trib as st
    >>> st.forces.load_systems()["pendulum"].held
    {'gravity': 1.0}
    """
    return _systems(library_folder() / SYSTEMS_FILE)


def shipped_systems() -> list[System]:
    """Return the systems that come with the package."""
    return [*load_systems().values()]


def _systems(path: Path) -> dict[str, System]:
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("system", [])
    # Covers invalid TOML, invalid text, and integers with too many digits.
    except (OSError, ValueError, RecursionError) as error:
        raise LibraryError(f"{path.name}: not a TOML file: {' '.join(str(error).split())}.") from None
    if not isinstance(tables, list) or not tables:
        raise LibraryError(f"{path.name}: there is no [[system]] in it; see libraries/{SYSTEMS_FILE}.")
    return {system.name: system for system in (_checked(table, path.name) for table in tables)}


def _checked(table: Any, source: str) -> System:
    check_keys(table, SYSTEM_KEYS, ("name",), f"{source}: a [[system]]")
    lists = {key: tuple(table[key]) for key in SYMBOL_LISTS if key in table}
    known = [force.symbol for name in SHIPPED_LIBRARIES for force in load_library(name)]
    for name in [*itertools.chain(*lists.values()), *table.get("held", {})]:
        if name not in known:
            nearest = did_you_mean(str(name), known)
            where = f"{source}: system '{table['name']}'"
            raise LibraryError(f"{where} names a force '{name}' of no library.{nearest}")
    columns = tuple(tuple(names.split()) for names in table.get(COLUMN_NAMES, []))
    return System(**{**table, **lists, COLUMN_NAMES: columns})
