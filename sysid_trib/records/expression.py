"""A signal that is computed from columns: `atan2(x - 3.1, -y)`, `0.0115*pot - 5.9`."""

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.formulas import Formula, parse
from sysid_trib.records.column import Column
from sysid_trib.records.tables import FileTable
from sysid_trib.records.units import METRES, RADIANS, signal_unit

ARC_TANGENT = "atan2("
# How near to the factor between two units a factor is that stands for it.
CONVERTED = 2e-3
# A unit and its power.
Dimension: TypeAlias = tuple[str, float]
NUMBER: Dimension = ("", 0.0)


def with_expression(table: FileTable, text: str, units: str | None) -> FileTable:
    """The table with a further column, of which the expression is the name.

    Parameters
    ----------
    table : FileTable
        Columns go by the names in their headers, without units, in any case of letters: `x`, `pot`.
    text : str
        A formula as forces have it; or `atan2(formula, formula)`, an angle in rad.
    units : str or None
        Unit of the result, if the user says it; else it is that of the columns, carried through the formula.

    Raises
    ------
    UsageError
        Not a formula of the columns, a name that two of them have, or a unit that does not follow.
    """
    signal, parts, held = evaluated(table, text, "--angle")
    # The usual name of a unit, so that deg and degrees are one.
    follows = _unit(parts, {name: column.unit.text if column.unit else "" for name, column in held.items()})
    unit = _agreed(follows, units)
    if unit is None:
        columns = ", ".join(column.name for column in held.values())
        raise UsageError(
            f"{table.source}: the unit of --angle '{text}' does not follow from that of its columns "
            f"({columns}), whose numbers it takes as they are; say it with --units (units= in Python)."
        )
    base = next(iter(held)) if len(held) == 1 else ""
    made = Column(text, np.where(np.isfinite(signal), signal, np.nan), table.source, base, unit)
    return replace(table, columns=(*table.columns, made))


def evaluated(table: FileTable, text: str, flag: str) -> tuple[Array, list[Formula], dict[str, Column]]:
    """A formula of columns: its values (row,), its parts, and the columns that it holds by their names.

    Raises
    ------
    UsageError
        Not a formula of the columns, or a name that two of them have.
    """
    names: dict[str, list[Column]] = {}
    for column in table.columns:
        name = column.base.replace(" ", "_")
        if name.isidentifier():
            names.setdefault(name, []).append(column)
    parts = [_parsed(part, names, table.source) for part in _arguments(text.lower())]
    used = {name for part in parts for name in part.names & names.keys()}
    held = {name: _single(names[name], name, text) for name in sorted(used)}
    if not held:
        known = f"{flag} '{text}' holds no column of numbers; it may hold {', '.join(names)}."
        raise UsageError(f"{table.source}: {known}")
    values = {name: column.numbers for name, column in held.items()}
    sizes = {column.size for column in values.values()}
    if len(sizes) > 1:
        raise UsageError(f"{table.source}: the columns of {flag} '{text}' are not of one length.")
    with np.errstate(all="ignore"):
        made = [np.broadcast_to(part.evaluate(values), tuple(sizes)) for part in parts]
        signal = np.arctan2(*made) if len(made) == 2 else made[0].astype(float)
    return signal, parts, held


def is_expression(table: FileTable, wanted: str | int | None) -> bool:
    """True if a text could be a formula of columns, and no column has that name."""
    # What makes a text an expression and no name.
    signs = isinstance(wanted, str) and re.search(r"[-+*/(]", wanted) is not None
    return signs and table.match(wanted) is None


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


def _parsed(text: str, names: Mapping[str, Sequence[Column]], source: str) -> Formula:
    try:
        return parse(text, frozenset(names), frozenset(), "--angle")
    except LibraryError as error:
        raise UsageError(f"{source}: {error} Columns that it may hold: {', '.join(names)}.") from None


def _single(columns: Sequence[Column], name: str, text: str) -> Column:
    """The column of numbers that alone has a name."""
    if len(columns) > 1:
        raise UsageError(
            f"{columns[0].source}: there is no single column '{name}' for --angle '{text}': "
            f"{', '.join(column.name for column in columns)}; rename one in the file."
        )
    if not columns[0].is_numeric:
        holds = f"column '{columns[0].name}' of --angle '{text}' holds no numbers."
        raise UsageError(f"{columns[0].source}: {holds}")
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
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() | float() as exponent)):
            base = _dimension(left, units)
            return base and (base[0], base[1] * float(exponent))
        case ast.BinOp(left=left, op=op, right=right):
            name, args = type(op).__name__, [left, right]
        case ast.Call(func=ast.Name(id=name), args=args):
            pass
        case _:
            return None
    dimensions = [_dimension(arg, units) for arg in args]
    known = [dimension for dimension in dimensions if dimension is not None]
    if len(known) < len(dimensions) or name == "Pow":
        return None
    if name in ("Mult", "Div"):
        return _product(known[0], known[1], -1.0 if name == "Div" else 1.0)
    if name in ("Add", "Sub", "abs", "min", "max"):
        # A number that is added to a column is in its unit.
        others = {*known} - {NUMBER}
        return None if len(others) > 1 else next(iter(others), NUMBER)
    if name == "sqrt":
        return known[0][0], 0.5 * known[0][1]
    return NUMBER if known[0] == NUMBER or name == "sign" else None


def _product(first: Dimension, second: Dimension, sign: float) -> Dimension | None:
    if second == NUMBER:
        return first
    if first != NUMBER and first[0] != second[0]:
        return None
    power = first[1] + sign * second[1]
    return (second[0], power) if power else NUMBER
