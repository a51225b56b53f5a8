"""Columns that drive a motion: names and units show that they are inputs, not signals."""

import re
from collections.abc import Iterable

import numpy as np

from sysid_trib.errors import SysidTribError
from sysid_trib.records.column import Column
from sysid_trib.records.unit_tables import LAB_WORDS

_WORDS = LAB_WORDS["drives"]


def is_named_as_drive(column: Column) -> bool:
    """Return true if the name or unit of a column is that of an input: a torque, a voltage, a command."""
    if is_wanted(column):
        return True
    tokens = _tokens(column)
    if tokens & {*_WORDS["no_drive"]}:
        return False
    return bool(tokens & {*_WORDS["names"]}) or column.stated in _WORDS["units"]


def is_wanted(column: Column) -> bool:
    """Return true if a column is the wanted motion, such as a goal position, which is not a force."""
    return bool(_tokens(column) & {*_WORDS["wanted"]})


def _tokens(column: Column) -> set[str]:
    """Return the words of a name in lower case: `pwm`, `duty` for `PWM duty`; `u` for `data.u[0]`, `u1`."""
    last = re.sub(r"\[\d+\]", "", column.base).rpartition(".")[2]
    return {*re.findall(r"[^\W\d_]+", last)}


def moves(column: Column) -> bool:
    """Return true if a column contains changing numbers and is not a clock or counter."""
    try:
        values = column.values
    except SysidTribError:
        return False
    finite = values[np.isfinite(values)]
    return finite.size > 2 and bool(np.ptp(finite) > 1e-12 * np.max(np.abs(finite))) and not column.rises


def drives_among(columns: Iterable[Column], signal: Column) -> list[Column]:
    """Return the columns that may drive a signal, with its length: forces before wanted motions."""
    driving = [
        column
        for column in columns
        if column is not signal
        and column.cells.size == signal.cells.size
        and column.is_numeric
        and is_named_as_drive(column)
        and moves(column)
    ]
    return sorted(driving, key=is_wanted)
