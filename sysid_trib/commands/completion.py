"""Values that a shell offers for an option: fixed words, and names of libraries, systems, forces and methods.

Modules that compute are imported when a name is asked for.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any

import typer

from sysid_trib.errors import SysidTribError

# Values that begin with the written text; the context holds the options before it.
Completer = Callable[[typer.Context, str], list[str]]


def completer_of(option: str, row: Mapping[str, Any]) -> Completer | None:
    """Return the function that completes the values of an option, or None if no value is known.

    Parameters
    ----------
    option : str
        Name of the option.
    row : mapping
        Its row in `commands.toml`. Its placeholder has the fixed words in small letters: `auto|off|VALUE`.
    """
    words = [word for word in row.get("value", "").split("|") if word.islower() and not word.startswith(".")]
    names = COMPLETERS.get(option)
    if names is None and not words:
        return None

    def complete(context: typer.Context, incomplete: str) -> list[str]:
        known = names(context, incomplete) if names is not None else []
        return [*_beginning_with(incomplete, words), *known]

    return complete


def _beginning_with(incomplete: str, names: Iterable[str]) -> list[str]:
    """Return the names that begin with a text."""
    return [name for name in names if name.startswith(incomplete)]


def _lists(incomplete: str, names: Iterable[str]) -> list[str]:
    """Return the lists `A,B,...` in which a name takes the place of the last, incomplete one."""
    before, comma, last = incomplete.rpartition(",")
    listed = before.split(",")
    return [f"{before}{comma}{name}" for name in _beginning_with(last, names) if name not in listed]


def _libraries(context: typer.Context, incomplete: str) -> list[str]:
    """Return names of libraries."""
    from sysid_trib.forces.library import known_libraries

    return _beginning_with(incomplete, known_libraries())


def _systems(context: typer.Context, incomplete: str) -> list[str]:
    """Return names of systems."""
    from sysid_trib.forces.systems import load_systems

    return _beginning_with(incomplete, load_systems())


def _forces(context: typer.Context, incomplete: str) -> list[str]:
    """Return lists of forces of the given library; none if it cannot be read."""
    from sysid_trib.forces.library import load_library

    with suppress(SysidTribError):
        library = load_library(context.params.get("library") or "contact_forces")
        return _lists(incomplete, library.symbols)
    return []


def _methods(context: typer.Context, incomplete: str) -> list[str]:
    """Return lists of methods; a shell would separate a label of several words."""
    from sysid_trib.validation.compare import every_method

    return _lists(incomplete, (label for label in every_method() if label.isalpha()))


COMPLETERS: dict[str, Completer] = {
    "library": _libraries,
    "candidates": _libraries,
    "system": _systems,
    "forces": _forces,
    "profile": _forces,
    "own": _forces,
    "methods": _methods,
}
