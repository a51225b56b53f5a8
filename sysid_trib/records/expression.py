"""A signal that is computed from columns: `atan2(x - 3.1, -y)`, `0.0115*pot - 5.9`."""

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import TypeAlias

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.formulas import Formula, parse
from sysid_trib.records.headers import split_header, unit_of_column
from sysid_trib.records.numbers import is_numeric, numbers
from sysid_trib.records.tables import FileTable
from sysid_trib.records.units import METRES, RADIANS, signal_unit

# What makes a text an expression and no name.
EXPRESSION_SIGNS = re.compile(r"[-+*/(]")
ARC_TANGENT = "atan2("
# How near to the factor between two units a factor is that stands for it.
CONVERTED = 2e-3
# A unit and its power.
Dimension: TypeAlias = tuple[str, float]
NUMBER: Dimension = ("", 0.0)


def with_expression(table: FileTable, text: str, units: str | None, source: str) -> FileTable:
    """The table with a further column, of which the expression is the name.

    Parameters
    ----------
    table : FileTable
        Columns go by the names in their headers, without units, in any case of letters: `x`, `pot`.
    text : str
        A formula as forces have it; or `atan2(formula, formula)`, an angle in rad.
    units : str or None
        Unit of the result, if the user says it; else it is that of the columns, carried through the formula.
    source : str
        Name of the file, for messages.

    Raises
    ------
    UsageError
        Not a formula of the columns, a name that two of them have, or a unit that does not follow.
    """
    signal, parts, held = evaluated(table, text, "--angle", source)
    stated = {name: unit_of_column(table, column) for name, column in held.items()}
    # The usual name of a unit, so that deg and degrees are one.
    follows = _unit(parts, {name: unit.text if unit else "" for name, unit in stated.items()})
    unit = _agreed(follows, units)
    if unit is None:
        columns = ", ".join(held.values())
        raise UsageError(
            f"{source}: the unit of --angle '{text}' does not follow from that of its columns ({columns}), "
            "whose numbers it takes as they are; say it with --units (units= in Python)."
        )
    base = next(iter(held)) if len(held) == 1 else ""
    return replace(
        table,
        columns={**table.columns, text: np.where(np.isfinite(signal), signal, np.nan)},
        made={**table.made, text: (base, unit)},
    )


def evaluated(
    table: FileTable, text: str, flag: str, source: str
) -> tuple[Array, list[Formula], dict[str, str]]:
    """A formula of columns: its values (row,), its parts, and the columns that it holds by their names.

    Raises
    ------
    UsageError
        Not a formula of the columns, or a name that two of them have.
    """
    names: dict[str, list[str]] = {}
    for column in table.columns:
        name = split_header(column)[0].replace(" ", "_")
        if name.isidentifier():
            names.setdefault(name, []).append(column)
    parts = [_parsed(part, names, source) for part in _arguments(text.lower())]
    used = {name for part in parts for name in part.names & names.keys()}
    held = {name: _single(table, text, name, names[name], source) for name in sorted(used)}
    if not held:
        known = ", ".join(names)
        raise UsageError(f"{source}: {flag} '{text}' holds no column of numbers; it may hold {known}.")
    values = {name: numbers(table.columns[column], column, source) for name, column in held.items()}
    sizes = {column.size for column in values.values()}
    if len(sizes) > 1:
        raise UsageError(f"{source}: the columns of {flag} '{text}' are not of one length.")
    with np.errstate(all="ignore"):
        made = [np.broadcast_to(part.evaluate(values), tuple(sizes)) for part in parts]
        signal = np.arctan2(*made) if len(made) == 2 else made[0].astype(float)
    return signal, parts, held


def is_expression(text: str | int | None) -> bool:
    """True if a text could be a formula of columns, where no column has that name."""
    return isinstance(text, str) and EXPRESSION_SIGNS.search(text) is not None


def _arguments(text: str) -> list[str]:
    """The two arguments of an arc tangent of two, or the text itself."""
    plain = text.strip()
    if not (plain.startswith(ARC_TANGENT) and plain.endswith(")")):
        return [plain]
    inside, depth = plain[len(ARC_TANGENT) : -1], 0
    for at, letter in enumerate(inside):
        depth += (letter == "(") - (letter == ")")
        if letter == "," and depth == 0:
            return [inside[:at], inside[at + 1 :]]
    return [plain]


def _parsed(text: str, names: Mapping[str, Sequence[str]], source: str) -> Formula:
    try:
        return parse(text, frozenset(names), frozenset(), "--angle")
    except LibraryError as error:
        raise UsageError(f"{source}: {error} Columns that it may hold: {', '.join(names)}.") from None


def _single(table: FileTable, text: str, name: str, columns: Sequence[str], source: str) -> str:
    """The column of numbers that alone has a name."""
    if len(columns) > 1:
        raise UsageError(
            f"{source}: there is no single column '{name}' for --angle '{text}': {', '.join(columns)}; "
            "rename one in the file."
        )
    if not is_numeric(table.columns[columns[0]]):
        raise UsageError(f"{source}: column '{columns[0]}' of --angle '{text}' holds no numbers.")
    return columns[0]


def _unit(parts: Sequence[Formula], units: Mapping[str, str]) -> str | None:
    """The unit of a formula, or of an arc tangent; empty where no column has one, None where none follows."""
    if not any(units.values()):
        return "rad" if len(parts) == 2 else ""
    dimensions = [_dimension(part.tree, units) for part in parts]
    if len(dimensions) == 2:
        return "rad" if dimensions[0] is not None and dimensions[0] == dimensions[1] else None
    if dimensions[0] is None or dimensions[0][1] not in (0.0, 1.0):
        return None
    unit, power = dimensions[0]
    return "" if not power else None if _converts(parts[0], unit, units) else unit


def _agreed(follows: str | None, given: str | None) -> str | None:
    """The unit that follows, or the one given where none does, or one of another quantity."""
    of_columns, asked = signal_unit(follows or ""), signal_unit(given or "")
    if asked is None or (of_columns is not None and of_columns.quantity == asked.quantity):
        return follows
    return given


def _converts(formula: Formula, unit: str, names: Iterable[str]) -> bool:
    """True if the factor of a formula is that from its unit to another one, as `a*pi/180` has."""
    of_unit = signal_unit(unit)
    table = RADIANS if of_unit and of_unit.position == "rad" else METRES
    if of_unit is None or (table is METRES and of_unit.position not in METRES):
        return False
    size = of_unit.factor * (METRES[of_unit.position] if table is METRES else 1.0)
    with np.errstate(all="ignore"):
        ends = [float(formula.evaluate(dict.fromkeys(names, at))) for at in (0.0, 1.0)]
    factor = abs(ends[1] - ends[0])
    others = (size / other for other in table.values())
    return abs(factor - 1.0) > CONVERTED and any(abs(factor / other - 1.0) < CONVERTED for other in others)


def _dimension(tree: ast.AST, units: Mapping[str, str]) -> Dimension | None:
    """Unit of a formula and its power, with the power 0 of a number; None of what has none."""
    match tree:
        case ast.Constant() | ast.Name(id="pi"):
            return NUMBER
        case ast.Name(id=name):
            return units[name], 1.0
        case ast.UnaryOp(operand=operand):
            return _dimension(operand, units)
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=exponent)):
            base = _dimension(left, units)
            return (
                (base[0], base[1] * float(exponent)) if base and isinstance(exponent, int | float) else None
            )
        case ast.BinOp(left=left, op=op, right=right):
            first, second = _dimension(left, units), _dimension(right, units)
            if first is None or second is None:
                return None
            if isinstance(op, ast.Add | ast.Sub):
                return _sum(first, second)
            return _product(first, second, -1.0 if isinstance(op, ast.Div) else 1.0)
        case ast.Call(func=ast.Name(id=name), args=args):
            dimensions = [_dimension(arg, units) for arg in args]
            if None in dimensions:
                return None
            if name in ("abs", "min", "max"):
                return reduce(lambda a, b: a and b and _sum(a, b), dimensions)
            if name == "sqrt" and dimensions[0] is not None:
                return dimensions[0][0], 0.5 * dimensions[0][1]
            return NUMBER if dimensions[0] == NUMBER or name == "sign" else None
    return None


def _sum(first: Dimension, second: Dimension) -> Dimension | None:
    """The unit of a sum; a number added to a column is in its unit."""
    if NUMBER in (first, second):
        return second if first == NUMBER else first
    return first if first == second else None


def _product(first: Dimension, second: Dimension, sign: float) -> Dimension | None:
    if second == NUMBER:
        return first
    if first != NUMBER and first[0] != second[0]:
        return None
    power = first[1] + sign * second[1]
    return (second[0], power) if power else NUMBER
