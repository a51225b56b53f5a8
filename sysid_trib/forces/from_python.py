"""Force libraries made in Python: from formulas, forces, other libraries and their names."""

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path

from sysid_trib.errors import UsageError, did_you_mean
from sysid_trib.forces.force import Force, ForceLibrary, ForceTable, LibraryLike
from sysid_trib.forces.library import is_library, known_libraries, load_library, parse_library
from sysid_trib.forces.selection import SHIPPED_LIBRARIES
from sysid_trib.forces.systems import SystemModel

# Name of a library made in Python, used in messages.
MADE_IN_PYTHON = "library(...)"


def library(
    *parts: LibraryLike, title: str = "", inputs: Iterable[str] = (), **formulas: ForceTable
) -> ForceLibrary:
    """Make a force library from formulas, forces, and other libraries.

    Parameters
    ----------
    *parts : ForceLibrary, Force, str, path, or mapping
        Libraries or their names (`contact_forces`), library files, forces or their symbols (`zeta`), or
        formulas by symbol: `{"lambda": "sign(v)"}`, because `lambda` is a keyword of Python.
    title : str, optional
        Title of the library; by default the symbols of its forces.
    inputs : iterable of str, optional
        Names of the known inputs that the formulas contain; `u` need not be named.
    **formulas : str, Force or mapping
        A formula by the symbol of its force, `zeta="2*v"`; or a table as in a library file,
        `mine={"formula": "z", "state": {"z": "v - z"}}`; or a `Force`, which gets this symbol.

    Returns
    -------
    ForceLibrary
        The forces in the order given.

    Raises
    ------
    UsageError
        There is no such library or force, two different forces have the same symbol, or there is no force.
    LibraryError
        A formula cannot be read. Nothing is executed.

    Examples
    --------
    >>> import sysid_trib as st
    >>> mine = st.library({"lambda": "sign(v)"}, zeta="2*v", quintic="x**5")
    >>> mine["quintic"].character
    'conservative'
    >>> (st.load_library("contact_forces") + mine).symbols
    ('lambda', 'zeta', 'delta', 'alpha', 'nu', 'epsilon', 'quintic')
    """
    channels = list(inputs)
    taken = [_part(part, channels) for part in parts]
    made = [*itertools.chain.from_iterable(taken), *_forces(formulas, channels)]
    if not made:
        raise UsageError('A library contains at least one force, such as st.library(zeta="2*v").')
    whole = ForceLibrary("", (), "")
    sources = list(dict.fromkeys(part.source for part in taken if part.source))
    if formulas or not sources:
        sources.append(MADE_IN_PYTHON)
    for force in made:
        whole = whole + force
    given = title or ", ".join(part.title for part in taken if len(taken) == 1 and not formulas)
    return ForceLibrary(given or ", ".join(whole.symbols), whole.forces, " + ".join(dict.fromkeys(sources)))


def as_library(given: LibraryLike, function: str) -> ForceLibrary:
    """Return the force library that an argument specifies.

    Parameters
    ----------
    given : LibraryLike
        A library, its name or file, forces, symbols, or formulas by symbol.
    function : str
        Name of the function with this argument, for the message.

    Returns
    -------
    ForceLibrary
        The given library itself, or one with the given forces in their order.

    Raises
    ------
    UsageError
        The argument does not specify a library.
    LibraryError
        A file or formula cannot be read.

    Examples
    --------
    >>> import sysid_trib as st
    >>> st.forces.as_library("zeta,delta", "my_function").symbols
    ('zeta', 'delta')
    >>> st.forces.as_library({"lambda": "sign(v)"}, "my_function").symbols
    ('lambda',)
    """
    if isinstance(given, ForceLibrary):
        return given
    if isinstance(given, SystemModel):
        raise UsageError(
            f"{function}: st.system returns a library and constraints; write library, constraints = "
            f"st.system(...), and then {function}(..., library, constraints=constraints)."
        )
    if isinstance(given, str | Path | Force | Mapping):
        return library(given)
    if isinstance(given, list | tuple) and all(
        isinstance(part, str | Force | ForceLibrary) for part in given
    ):
        return library(*given)
    raise UsageError(
        f"{function} needs a force library: st.load_library('contact_forces'), its name, or "
        f"st.library(zeta='2*v'); not {_kind(given)}."
    )


def _kind(given: object) -> str:
    """Describe the type of an object given in place of a library, in a few words."""
    return (
        f"the class {given.__name__}"
        if isinstance(given, type)
        else f"an object of type {type(given).__name__}"
    )


def _part(given: LibraryLike, channels: list[str]) -> ForceLibrary:
    """Return one part of a library as a library."""
    if isinstance(given, ForceLibrary):
        return given
    if isinstance(given, Force):
        return ForceLibrary(given.name, (given,), "")
    if isinstance(given, Path):
        return load_library(given)
    if isinstance(given, str):
        return _named(given)
    if isinstance(given, Mapping):
        return ForceLibrary("", tuple(_forces(given, channels)), MADE_IN_PYTHON)
    raise UsageError(
        f"A library consists of formulas, forces and libraries, not of {_kind(given)}; write "
        "st.library(zeta='2*v')."
    )


def _named(text: str) -> ForceLibrary:
    """Return the library of a name or file, or the package's forces of these symbols (`lambda,zeta`)."""
    if is_library(text):
        return load_library(text)
    shipped = {
        f.symbol: f for name in reversed(SHIPPED_LIBRARIES) for f in reversed(load_library(name).forces)
    }
    symbols = [symbol.strip() for symbol in text.split(",") if symbol.strip()]
    not_shipped = [symbol for symbol in symbols if symbol not in shipped]
    if not_shipped or not symbols:
        known = known_libraries()
        nearest = did_you_mean(not_shipped[0] if not_shipped else text, [*known, *shipped])
        raise UsageError(
            f"There is no library or force '{not_shipped[0] if not_shipped else text}'; give a TOML file, "
            f"one of the libraries {', '.join(known)}, or the symbol of a force.{nearest}"
        )
    return ForceLibrary(
        ", ".join(symbols), tuple(shipped[symbol] for symbol in symbols), "contact_forces.toml"
    )


def _forces(formulas: Mapping[str, ForceTable], channels: Iterable[str]) -> list[Force]:
    """Return the forces of formulas given by symbol."""
    return [_force(str(symbol), given, list(channels)) for symbol, given in formulas.items()]


def _force(symbol: str, given: ForceTable, channels: list[str]) -> Force:
    """Return the force of one formula or table, checked in the same way as the forces of a file."""
    if isinstance(given, Force):
        return given.renamed(symbol)
    if callable(given):
        raise UsageError(
            f"The force '{symbol}' is a Python function; write its formula as a text in x, v and t, such as "
            f"{symbol}='x**5'."
        )
    table = {"formula": given} if not isinstance(given, Mapping) else dict(given)
    data = {"title": MADE_IN_PYTHON, "inputs": channels, "force": [{"symbol": symbol, **table}]}
    (force,) = parse_library(data, MADE_IN_PYTHON)
    return force
