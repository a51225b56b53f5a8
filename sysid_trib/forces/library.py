"""Reading force libraries: TOML in, checked forces out; nothing in a file is ever executed."""

import os
import re
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from sysid_trib import plugins
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.force import Channel, Force, ForceLibrary, Shape
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.notation import LARGEST_CONSTANT, MAX_LENGTH, RESERVED_NAMES, parse, short
from sysid_trib.forces.symmetry import INPUT_KINDS, ORDERS

TEXT_KEYS = ("name", "family", "meaning", "source", "curve")
TABLE_KEYS = ("state", "memory", "start", "shape")
SHORT_WORD = re.compile(r"[A-Za-z]\w{0,39}", re.ASCII)
# Allowed types of each key of a table, and their descriptions.
Checks: TypeAlias = Mapping[str, tuple[Callable[[Any], Any], str]]


def is_number(value: object) -> bool:
    """Return true if a value of a TOML file is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= LARGEST_CONSTANT


def is_line(value: object) -> bool:
    """Return true if a value is a text without control characters, which could affect a terminal."""
    return isinstance(value, str) and " ".join(value.split()).isprintable()


TEXT = (is_line, "a text in quotes, without control characters")
NUMBER = (is_number, "a number up to 1e100")
SHAPE_KEYS: Checks = {**dict.fromkeys(("default", "low", "high"), NUMBER), "meaning": TEXT}
FORCE_KEYS: Checks = {
    "symbol": (
        lambda v: isinstance(v, str) and SHORT_WORD.fullmatch(v),
        "a short word of letters, digits and _",
    ),
    "formula": TEXT,
    **dict.fromkeys(TEXT_KEYS, TEXT),
    "kind": (lambda v: v in ("force", "sensor"), '"force" or "sensor"'),
    "passive": (lambda v: isinstance(v, bool), "true or false"),
    "coefficient": (lambda v: is_number(v) and v, "a number other than 0"),
    "run": (lambda v: is_number(v) and isinstance(v, int) and v > 0, "the number of a run, from 1"),
    "uses": (
        lambda v: isinstance(v, list) and all(isinstance(k, str) and SHORT_WORD.fullmatch(k) for k in v),
        "a list of symbols of forces whose coefficients are in the formula",
    ),
    **dict.fromkeys(TABLE_KEYS, (lambda v: isinstance(v, dict), "a table such as { z = ... }")),
}


def check_keys(table: Any, checks: Checks, needed: tuple[str, ...], where: str) -> None:
    """Raise an error for a table of a TOML file with an unknown key or a wrong value.

    Raises
    ------
    LibraryError
        The message states the key and its permitted values.
    """
    if not isinstance(table, dict):
        raise LibraryError(f"{where} must be a table with {', '.join(needed)}, not {short(repr(table))}.")
    if others := sorted(table.keys() - checks.keys()):
        raise LibraryError(
            f"{where}: unknown key '{short(others[0])}'; known are {', '.join(sorted(checks))}."
        )
    if missing := [key for key in needed if key not in table]:
        raise LibraryError(f"{where} lacks its {' and its '.join(missing)}; add it.")
    for key, value in table.items():
        fits, meaning = checks[key]
        if not fits(value):
            raise LibraryError(f"{where}: {key} must be {meaning}, not {short(repr(value))}.")


# Input that a library need not declare.
USUAL_INPUT = "u"
MAX_BYTES = 1_000_000
# Names in a formula; not the exponent of a number such as 1e-3.
NAMES_IN_FORMULAS = re.compile(r"(?<![\w.])[A-Za-z_]\w*", re.ASCII)
# Largest depth of libraries that include other libraries.
MOST_INCLUDED = 8


def library_folder() -> Path:
    """Return the folder of the package's libraries (wheel, or source tree)."""
    package = Path(__file__).resolve().parents[1]
    return next(p for p in (package / "libraries", package.parent / "libraries") if p.is_dir())


# Other names of libraries: the forces of the paper are the contact forces.
OTHER_NAMES = {"paper": "contact_forces"}


def known_libraries() -> list[str]:
    """Return the names of the libraries of this package and of other installed packages."""
    # The file of systems is in the same folder, but is not a library.
    stems = {path.stem for path in library_folder().glob("*.toml")} - {"systems"}
    return sorted(stems | plugins.installed(plugins.LIBRARY_PLUGINS).keys())


def is_library(name_or_path: str) -> bool:
    """Return true if a text is the name of a library or the path of a library file."""
    path = Path(name_or_path)
    named = name_or_path in OTHER_NAMES or name_or_path in known_libraries()
    return named or path.suffix == ".toml" or os.path.isfile(path)


def load_library(name_or_path: str | Path = "contact_forces") -> ForceLibrary:
    """Load a force library.

    Parameters
    ----------
    name_or_path : str or path
        Name of a library of the package (`contact_forces`, also called `paper`), name of a library that
        another package declares as an entry point `sysid_trib.libraries`, or a TOML file.

    Returns
    -------
    ForceLibrary
        The forces in the order of the file.

    Raises
    ------
    UsageError
        There is no such library or file.
    LibraryError
        The file is not a library of forces. The message states file, force and reason. Nothing in it is
        executed.

    Examples
    --------
    >>> import sysid_trib as st
    >>> library = st.load_library("contact_forces")
    >>> for force in library:
    ...     print(f"{force.symbol:8} {force.formula.text:9} {force.name}")
    lambda   sign(v)   solid friction
    zeta     2*v       viscous friction
    delta    v*abs(v)  quadratic friction
    alpha    x         linear elastic force
    nu       x*abs(x)  quadratic elastic force
    epsilon  x**3      cubic elastic force
    """
    path = Path(name_or_path)
    # A folder with the name of a library does not hide it.
    if path.suffix != ".toml" and not os.path.isfile(path):
        name = OTHER_NAMES.get(str(name_or_path), str(name_or_path))
        path = library_folder() / f"{name}.toml"
        entry = plugins.installed(plugins.LIBRARY_PLUGINS).get(name)
        if entry is not None and not os.path.isfile(path):
            return _of_package(entry)
    if not os.path.isfile(path):
        known = ", ".join(known_libraries())
        raise UsageError(f"There is no library '{name_or_path}'; give a TOML file or one of {known}.")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise LibraryError(f"{path.name}: larger than {MAX_BYTES:,} bytes; a library is a short text.")
        return library_of_text(path.read_text(encoding="utf-8"), path.name)
    # Covers invalid TOML, invalid text, and integers with too many digits.
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, LibraryError):
            raise
        reason = " ".join(str(error).split())
        raise LibraryError(f"{path.name}: not a readable TOML file ({reason}); see libraries/.") from None


def _of_package(entry: EntryPoint) -> ForceLibrary:
    """Return the library declared by another package: a `ForceLibrary`, or the path of its file."""
    given = plugins.loaded(entry)
    if isinstance(given, ForceLibrary):
        return given
    if isinstance(given, str | Path) and Path(given).suffix == ".toml":
        return load_library(given)
    raise LibraryError(
        f"The entry point '{entry.name}' of {plugins.LIBRARY_PLUGINS} has the type {type(given).__name__}; "
        "it must be a ForceLibrary, or the path of a TOML file."
    )


@lru_cache(maxsize=32)
def library_of_text(text: str, source: str) -> ForceLibrary:
    """Return the library of a TOML text as stored in a result, parsed once (see `load_library`)."""
    return parse_library(tomllib.loads(text), source)


def parse_library(data: Mapping[str, Any], source: str) -> ForceLibrary:
    """Build a library from the mapping of a parsed TOML file (see `load_library`)."""
    data = _included(data, source)
    entries = data.get("force")
    if not isinstance(entries, list) or not entries or not all(isinstance(e, dict) for e in entries):
        raise LibraryError(f"{source}: no forces; write at least one [[force]] with symbol and formula.")
    expressions = _expressions(data.get("expressions", {}), source)
    channels = _channels(data.get("inputs", []), expressions, source)
    offered = frozenset(str(entry.get("symbol")) for entry in entries)
    forces = tuple(_force(_expanded(entry, expressions), channels, offered, source) for entry in entries)
    symbols = [force.symbol for force in forces]
    for symbol in symbols:
        if symbols.count(symbol) > 1:
            raise LibraryError(f"{source}: the symbol '{symbol}' belongs to several forces; rename one.")
    title = data.get("title", source)
    check_keys({"title": title}, {"title": TEXT}, ("title",), source)
    return ForceLibrary(" ".join(title.split()), forces, source)


def _included(data: Mapping[str, Any], source: str, depth: int = 0) -> dict[str, Any]:
    """Combine a library with the libraries that it includes.

    Its own inputs, expressions and forces replace included ones of the same name.
    """
    names = data.get("include", [])
    if not isinstance(names, list) or not all(isinstance(n, str) and SHORT_WORD.fullmatch(n) for n in names):
        raise LibraryError(f'{source}: include is a list of libraries of the package, ["joints"].')
    if depth > MOST_INCLUDED:
        raise LibraryError(f"{source}: libraries include each other in a circle; leave one include out.")
    joined: dict[str, Any] = {key: value for key, value in data.items() if key != "include"}
    for name in names:
        path = library_folder() / f"{name}.toml"
        if not path.is_file():
            raise LibraryError(f"{source}: there is no library '{name}' of the package to include.")
        other = _included(tomllib.loads(path.read_text(encoding="utf-8")), path.name, depth + 1)
        if isinstance(joined.get("inputs"), list):
            joined["inputs"] = dict.fromkeys(joined["inputs"], "")
        for table in ("inputs", "expressions"):
            if isinstance(joined.setdefault(table, {}), dict):
                joined[table] = {**other.get(table, {}), **joined[table]}
        own = joined.setdefault("force", [])
        if isinstance(own, list):
            taken = [entry.get("symbol") for entry in own if isinstance(entry, dict)]
            joined["force"] = [*own, *(e for e in other["force"] if e.get("symbol") not in taken)]
    return joined


def _expressions(table: object, source: str) -> dict[str, str]:
    """Return the named expressions of a library, with the names of other expressions written out.

    Raises
    ------
    LibraryError
        The table contains something other than texts, or a name reserved for formulas, or names are circular.
    """
    where = f"{source}, [expressions]"
    if not isinstance(table, dict):
        raise LibraryError(f'{where} must be a table of formulas, load = "u - sin(x)".')
    for name, text in table.items():
        if not SHORT_WORD.fullmatch(name) or name in RESERVED_NAMES:
            raise LibraryError(f"{where}: '{short(name)}' cannot name an expression; rename it.")
        if not isinstance(text, str) or not text.strip() or len(text) > MAX_LENGTH:
            raise LibraryError(
                f"{where}: '{name}' must be a formula in quotes of at most {MAX_LENGTH} characters."
            )
    needs = {name: {*NAMES_IN_FORMULAS.findall(text)} & table.keys() for name, text in table.items()}
    whole: dict[str, str] = {}
    try:
        for name in TopologicalSorter(needs).static_order():
            whole[name] = with_expressions(table[name], whole)
            if len(whole[name]) > MAX_LENGTH:
                raise LibraryError(f"{where}: '{name}' is longer than {MAX_LENGTH} characters as a whole.")
    except CycleError as error:
        circle = error.args[1][1:]
        if len(circle) == 1:
            raise LibraryError(f"{where}: '{circle[0]}' contains itself; write it without.") from None
        raise LibraryError(
            f"{where}: {' and '.join(circle)} are circular; write one without the other."
        ) from None
    return whole


def with_expressions(text: str, expressions: Mapping[str, str]) -> str:
    """Return a formula in which each of these names is replaced by its expression."""

    def written(word: re.Match[str]) -> str:
        if word[0] not in expressions:
            return word[0]
        expression = expressions[word[0]]
        return expression if expression.isidentifier() else f"({expression})"

    return NAMES_IN_FORMULAS.sub(written, text)


def _expanded(entry: Mapping[str, Any], expressions: Mapping[str, str]) -> dict[str, Any]:
    """Return an entry with the named expressions written out in its formulas."""

    def expanded(value: Any) -> Any:
        return with_expressions(value, expressions) if isinstance(value, str) else value

    whole = dict(entry)
    for key in ("formula", *(key for key in TABLE_KEYS if key != "shape")):
        value = entry.get(key)
        if isinstance(value, dict):
            whole[key] = {name: expanded(text) for name, text in value.items()}
        elif value is not None:
            whole[key] = expanded(value)
    return whole


def _channels(inputs: object, expressions: Collection[str], source: str) -> dict[str, Channel]:
    """Return the input channels of formulas by name; expressions replace inputs of the same name."""
    kinds = dict.fromkeys(inputs, "") if isinstance(inputs, list) else inputs
    if not isinstance(kinds, dict) or not all(isinstance(k, str) for pair in kinds.items() for k in pair):
        raise LibraryError(f'{source}: inputs are names, ["u", "b"], or a table {{ u = "acceleration" }}.')
    if strange := [kind for kind in kinds.values() if kind not in INPUT_KINDS]:
        known = ", ".join(kind for kind in INPUT_KINDS if kind)
        raise LibraryError(f"{source}: an input is {known}, or any other quantity, '', not '{strange[0]}'.")
    kinds = {name: kind for name, kind in ({USUAL_INPUT: ""} | kinds).items() if name not in expressions}
    every = [Channel(name, n, kind) for name, kind in kinds.items() for n in ORDERS]
    names = [channel.name for channel in every]
    for channel in every:
        fits = SHORT_WORD.fullmatch(channel.input) and channel.name not in RESERVED_NAMES
        if not fits or names.count(channel.name) > 1:
            raise LibraryError(f"{source}: '{channel.input}' cannot name an input; rename it.")
    return {channel.name: channel for channel in every}


def _force(
    entry: Mapping[str, Any], channels: Mapping[str, Channel], symbols: Collection[str], source: str
) -> Force:
    symbol = entry.get("symbol")
    where = f"{source}, force {symbol!r}"
    check_keys(entry, FORCE_KEYS, ("symbol", "formula"), where)
    tables = {k: entry.get(k, {}) for k in TABLE_KEYS}
    _check_names(tables, where)
    if entry.get("kind") == "sensor" and (tables["state"] or tables["memory"]):
        raise LibraryError(f"{where}: a sensor has no states or memory; declare it as a force or drop them.")
    exponents = frozenset(tables["shape"])
    internal = exponents | frozenset(tables["state"]) | frozenset(tables["memory"])

    def formulas(table: Mapping[str, object], names: frozenset[str]) -> dict[str, Formula]:
        return {k: parse(text, frozenset("xvt") | names, exponents, where) for k, text in table.items()}

    # Coefficients in the formula: of forces of the library, or of forces that it names.
    own = internal | frozenset(channels) | RESERVED_NAMES | {str(symbol)}
    usable = frozenset([*symbols, *entry.get("uses", [])]) - own
    if entry.get("kind") == "sensor":
        usable = frozenset()
    words = {k: " ".join(entry.get(k, "").split()) for k in TEXT_KEYS}
    plain = {k: entry[k] for k in ("symbol", "kind", "passive", "run") if k in entry}
    known = {"coefficient": float(entry["coefficient"])} if "coefficient" in entry else {}
    allowed = internal | frozenset(channels)
    force = Force(
        formula=formulas({"h": entry["formula"]}, allowed | usable)["h"],
        state=formulas(tables["state"], allowed),
        memory=formulas(tables["memory"], allowed),
        start=formulas(tables["start"], exponents),
        shape={k: _shape(v, f"{where}, shape '{k}'") for k, v in tables["shape"].items()},
        **(words | plain | known | {"name": words["name"] or symbol}),
    )
    held = {name for f in force.formulas for name in f.names} - internal
    force = replace(
        force,
        channels=tuple(channel for name, channel in channels.items() if name in held),
        uses=tuple(sorted(force.formula.names & usable)),
    )
    _check_finite(force, where)
    return force


def _check_names(tables: Mapping[str, Mapping[str, Any]], where: str) -> None:
    names = [*tables["state"], *tables["memory"], *tables["shape"]]
    for name in names:
        if name in RESERVED_NAMES or not name.isidentifier() or names.count(name) > 1:
            raise LibraryError(
                f"{where}: '{name}' cannot name a state, memory or shape parameter; rename it."
            )
    strange = sorted(set(tables["start"]) - set(tables["state"]) - set(tables["memory"]))
    if strange:
        raise LibraryError(f"{where}: start value for '{strange[0]}', which is neither a state nor a memory.")


def _shape(table: Any, where: str) -> Shape:
    check_keys(table, SHAPE_KEYS, ("default", "low", "high"), where)
    default, low, high = (float(table[k]) for k in ("default", "low", "high"))
    if not low <= default <= high or low == high:
        raise LibraryError(f"{where}: default {default:g} must lie between low {low:g} and high {high:g}.")
    return Shape(default, low, high, table.get("meaning", ""))


def _check_finite(force: Force, where: str) -> None:
    """Raise an error for formulas that are not finite and real for a swing of a pendulum (below 1.2 rad)."""
    for formula in (*force.formulas, *force.start.values()):
        with np.errstate(all="ignore"):
            values = np.asarray(formula.evaluate(force.test_points))
        if not np.all(np.isfinite(values)) or np.max(np.abs(values)) > 1e9:
            raise LibraryError(
                f"{where}: '{formula.text}' is not a finite number at all angles and speeds up to 1.2 rad "
                "and states of either sign; check for overflow, division by zero, roots of negative numbers."
            )
