"""A signal that is computed from columns: `atan2(x - 3.1, -y)`, `0.0115*pot - 5.9`."""

import re
from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.formulas import parse
from sysid_trib.records.headers import split_header
from sysid_trib.records.numbers import is_numeric, numbers
from sysid_trib.records.tables import FileTable

# What makes a text an expression and no name.
EXPRESSION_SIGNS = re.compile(r"[-+*/(]")
ARC_TANGENT = "atan2("


def with_expression(table: FileTable, text: str, source: str) -> FileTable:
    """The table with a further column, of which the expression is the name.

    Parameters
    ----------
    table : FileTable
        Columns go by the names in their headers, without units: `x`, `pot`.
    text : str
        A formula as forces have it; or `atan2(formula, formula)`, an angle in rad.
    source : str
        Name of the file, for messages.

    Raises
    ------
    UsageError
        Not a formula of the columns.
    """
    columns = {split_header(name)[0].replace(" ", "_"): name for name in table.columns}
    usable = {name: column for name, column in columns.items() if name.isidentifier()}
    parts = _arguments(text)
    values = [_evaluated(table, part, usable, source) for part in parts]
    made = np.arctan2(*values) if len(values) == 2 else values[0]
    units = {**table.units, text: "rad"} if len(values) == 2 else table.units
    return replace(table, columns={**table.columns, text: made}, units=units)


def is_expression(text: str | int | None) -> bool:
    """Whether a text could be a formula of columns, where no column has that name."""
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


def _evaluated(table: FileTable, text: str, usable: dict[str, str], source: str) -> Array:
    try:
        formula = parse(text, frozenset(usable), frozenset(), "--angle")
    except LibraryError as error:
        known = ", ".join(usable)
        raise UsageError(f"{source}: {error} Columns that it may hold: {known}.") from None
    held = {name: table.columns[usable[name]] for name in formula.names if name in usable}
    if not held or not all(is_numeric(column) for column in held.values()):
        known = ", ".join(usable)
        raise UsageError(f"{source}: --angle '{text}' holds no column of numbers; it may hold {known}.")
    values = {name: numbers(column, usable[name], source) for name, column in held.items()}
    if len({column.size for column in values.values()}) > 1:
        raise UsageError(f"{source}: the columns of --angle '{text}' are not of one length.")
    with np.errstate(all="ignore"):
        made = np.asarray(formula.evaluate(values), dtype=float)
    return np.where(np.isfinite(made), made, np.nan)
