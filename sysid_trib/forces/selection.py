"""Selection of forces: those of a method, the default ones, and those of a system."""

import itertools
import math
import os
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from sysid_trib.errors import DecayError, LibraryError, UsageError, did_you_mean
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import TEXT, Checks, check_keys, is_number, library_folder, load_library

# The forces that systems name, by library.
EFFECTS, INPUTS, HYSTERESIS = "candidate_effects", "inputs", "hysteresis"
SHIPPED_LIBRARIES = ("contact_forces", EFFECTS, INPUTS, HYSTERESIS, "water")
SYSTEMS_FILE = "systems.toml"
# Possible signals of a system.
QUANTITIES = ("angle", "displacement", "rate", "acceleration", "accelerometer")
SYMBOL_LISTS = ("forces", "impossible", "not_negative")
COLUMN_NAMES = "columns"
# Words of the name of a column.
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


def forces_to_identify(
    library: ForceLibrary, reference_frequency: float | None, *, sensors: bool = False
) -> ForceLibrary:
    """Return forces to identify: without a given frequency the one of formula `x` is the frequency itself.

    Parameters
    ----------
    library : ForceLibrary
        All forces offered.
    reference_frequency : float or None, rad/s
        None where it is fitted.
    sensors : bool
        Whether the method knows terms of the sensor.

    Returns
    -------
    ForceLibrary

    Raises
    ------
    DecayError
        None remains, or there is a sensor term that the method does not know.
    """
    if not sensors:
        refuse_sensors(library)
    stiffness = library.role("x")
    if reference_frequency is None and stiffness is not None:
        library = library.select(s for s in library.symbols if s != stiffness.symbol)
    if all(force.kind == "sensor" for force in library):
        raise DecayError(
            "No force is left to identify, only the frequency; offer at least one force (--forces)."
        )
    return library


def with_shipped(library: ForceLibrary, symbols: Collection[str]) -> ForceLibrary:
    """Add forces that are named and that another library of the package has."""
    wanted = set(symbols) - set(library.symbols)
    shipped = (force for name in SHIPPED_LIBRARIES if wanted for force in load_library(name))
    lacking = {force.symbol: force for force in shipped if force.symbol in wanted}
    return replace(library, forces=(*library, *lacking.values())) if lacking else library


def is_free_to_move(library: ForceLibrary, fixed: Mapping[str, float]) -> bool:
    """Return true if the body has no restoring force.

    Parameters
    ----------
    library : ForceLibrary
    fixed : mapping of str to float
        Coefficients that are held.
    """
    restoring = library.role("-x")
    others = (force for force in library if force is not restoring)
    held = restoring is not None and fixed.get(restoring.symbol) == 1.0
    return held and not any("x" in formula.names for force in others for formula in force.formulas)


def refuse_sensors(library: ForceLibrary) -> None:
    """Raise an error for sensor terms in a method that does not support them.

    Raises
    ------
    DecayError
        A sensor term is in the library.
    """
    sensors = [force.symbol for force in library if force.kind == "sensor"]
    if sensors:
        wrong = f"'{sensors[0]}' is a sensor term: it changes what is measured, not the motion"
        raise DecayError(f"{wrong}; Direct and Trajectory identify it, leave it out for others (--forces).")


def needed_forces(library: ForceLibrary, formulas: Sequence[str], method: str) -> ForceLibrary:
    """Return the library's forces of these formulas, for a method by its label.

    Raises
    ------
    DecayError
        One is missing, so that the method does not apply; or there is a sensor term.
    """
    refuse_sensors(library)
    forces = {formula: library.role(formula) for formula in formulas}
    if missing := [formula for formula, force in forces.items() if force is None]:
        raise DecayError(f"{method} needs a force of formula {missing[0]}, and the library has none.")
    return library.select(force.symbol for force in forces.values() if force is not None)


def viscous_model(library: ForceLibrary, inputs: Collection[str] = ()) -> ForceLibrary:
    """Return the model that a search starts from: viscous friction alone, and the first force of each input.

    Raises
    ------
    UsageError
        The library has none.
    """
    viscous = [library[symbol] for symbol in library.damping_factors]
    if not viscous:
        wrong = f"Library '{library.title}' has no viscous friction to start from"
        raise UsageError(
            f"{wrong}; name the forces of the start model (--forces {','.join(library.symbols[:2])})."
        )
    return replace(library, forces=(*first_of_inputs(inputs), viscous[0]))


def first_of_inputs(inputs: Collection[str]) -> list[Force]:
    """Return the first force of each input in the library of inputs: `gain` of `u`."""
    driving = {force.inputs: force for force in reversed([*load_library(INPUTS)]) if force.inputs}
    return [force for held, force in driving.items() if set(held) <= set(inputs)]


def with_inputs_acting(library: ForceLibrary, inputs: Collection[str]) -> ForceLibrary:
    """Return the library with the first force of each input that none of its forces holds."""
    idle = [name for name in inputs if name not in library.inputs]
    further = [force for force in first_of_inputs(idle) if force.symbol not in library.symbols]
    return replace(library, forces=(*further, *library)) if further else library


def further_forces(library: ForceLibrary, start: ForceLibrary, inputs: Collection[str] = ()) -> ForceLibrary:
    """Return the candidates for a model: other forces of its library and inputs, and the usual effects."""
    effects = load_library(EFFECTS)
    of_inputs = [force for force in load_library(INPUTS) if set(force.inputs) & set(inputs)]
    # More shapes are more than a search can tell, and of a decay these too.
    of_inputs += [force for force in load_library(HYSTERESIS) if inputs and len(force.shape) < 3]
    others = [force for force in (*library, *of_inputs) if force.symbol not in start.symbols]
    taken = [force.symbol for force in (*start, *others)]
    # A user's own force of a symbol precedes the usual effect of the same symbol.
    others += [force for force in effects if force.symbol not in taken]
    return replace(effects, forces=tuple(others))


def offered_forces(
    model: ForceLibrary, candidates: ForceLibrary, inputs: Collection[str]
) -> tuple[ForceLibrary, list[str]]:
    """Return the candidates that the model does not have, of these inputs, and the symbols of the others."""
    kept, left_out = list[Force](), list[str]()
    for force in candidates:
        same = any(_same(force, other) for other in model) or not set(force.inputs) <= set(inputs)
        if same or any(force.symbol == other.symbol for other in (*model, *kept)):
            left_out.append(force.symbol)
        else:
            kept.append(force)
    return replace(candidates, forces=tuple(kept)), left_out


def _same(force: Force, other: Force) -> bool:
    """Return true if two forces are the same function."""
    if force.kind != other.kind:
        return False
    if force.memoryless and not force.shape and force.kind == "force" and not force.channels:
        return other.matches(force.formula.text)
    texts = [
        (f.formula.text, *(p.text for table in (f.state, f.memory) for p in table.values()))
        for f in (force, other)
    ]
    return texts[0] == texts[1]


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
    columns : tuple of tuple of str
        Names of columns by which a file is known as one of such a system, that of the signal first.
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
        """Forces that are identified or held."""
        return (*self.forces, *self.held)

    @property
    def swings_under_gravity(self) -> bool:
        """True if gravity is the restoring force, or if the system does not state it."""
        shipped = [force for name in SHIPPED_LIBRARIES for force in load_library(name)]
        held = [force for force in shipped if force.symbol in self.held]
        return not self.name or any(force.matches("sin(x) - x") for force in held)

    def bounds(self, symbols: Iterable[str]) -> dict[str, tuple[float, float]]:
        """Return the bounds of forces whose coefficients cannot be negative."""
        return {symbol: (0.0, math.inf) for symbol in symbols if symbol in self.not_negative}

    def with_held(self, forces: str | None) -> str | None:
        """Return forces by symbols, `lambda,zeta`, and those that are always there; else the usual ones."""
        if forces is None:
            return ",".join(self.symbols) or None
        named = [symbol.strip() for symbol in forces.split(",") if symbol.strip()]
        return ",".join([*named, *(symbol for symbol in self.held if symbol not in named)])


def _first_words(names: Iterable[str]) -> list[str]:
    """Return the first words of names of columns, in small letters: `Phi` of `Phi_rad [rad]`."""
    return [next(iter(NAME_WORDS.findall(name.lower())), "") for name in names]


# An oscillator without known properties.
ANY_SYSTEM = System("", signal="")


def load_system(name_or_path: str | None) -> System:
    """Return a system by its name, or the first of a TOML file.

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
        The forces that are identified or held.
    constraints : mapping of str to float or (float, float)
        Coefficients that are held, and bounds, as `identify` and `compare` take them.
    """

    library: ForceLibrary
    constraints: dict[str, float | tuple[float | None, float | None]]

    @property
    def held(self) -> dict[str, float]:
        """The coefficients that are held, as `discover` takes them: a search bounds none."""
        return {symbol: value for symbol, value in self.constraints.items() if isinstance(value, float)}


def system(
    name_or_path: str | Path, forces: Iterable[str] | None = None, library: ForceLibrary | None = None
) -> SystemModel:
    """Return the forces of a system and their known coefficients, as `--system` takes them.

    Parameters
    ----------
    name_or_path : str or path
        One of `libraries/systems.toml`, such as `pendulum`, or a file of the same format.
    forces : iterable of str, optional
        Symbols in the place of the forces that are usually identified; what the system holds is added.
    library : ForceLibrary, optional
        Where forces are sought first; by default `contact_forces`. Others come from the libraries of the
        package.

    Returns
    -------
    SystemModel

    Raises
    ------
    UsageError
        No such system, or a force that no library has.
    LibraryError
        A file that is not of this format.
    """
    moving = load_system(str(name_or_path))
    offered = load_library() if library is None else library
    symbols = [*(moving.forces if forces is None else forces), *moving.held] or [*offered.symbols]
    model = with_shipped(offered, symbols).select(symbols)
    held = {symbol: float(value) for symbol, value in moving.held.items()}
    return SystemModel(model, {**moving.bounds(model.symbols), **held})


def known_coefficients(library: ForceLibrary) -> dict[str, float]:
    """Return the coefficients that a user's library states, by symbol; they are held.

    The known coefficients of the package's libraries are free if their force is named: the record then tests
    them.
    """
    shipped = {f"{name}.toml": name for name in SHIPPED_LIBRARIES}
    sources = library.source.split(" + ")
    if all(source in shipped for source in sources):
        return {}
    # For a sum of libraries.
    free = {force for source in sources if source in shipped for force in load_library(shipped[source])}
    stated = (force for force in library if force.coefficient is not None and force not in free)
    return {force.symbol: force.coefficient for force in stated if force.coefficient is not None}


def load_systems() -> dict[str, System]:
    """Return the systems that come with the package, by their names."""
    return _systems(library_folder() / SYSTEMS_FILE)


def shipped_systems() -> list[System]:
    """Return the systems that come with the package."""
    return [*load_systems().values()]


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
