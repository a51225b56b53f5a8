"""Which column of times belongs to a signal, and runs that stand side by side in one table."""

import re

import numpy as np
import pandas as pd

from sysid_trib.records.headers import split_header
from sysid_trib.records.tables import FileTable


def time_of(name: str, times: list[str], table: FileTable) -> str | None:
    """The time column of the same number, `Time_id[2]` of `Y_id[2][0]`; else the next before it."""
    order = list(table.columns)
    fitting = [t for t in times if np.size(table.columns[t]) == np.size(table.columns[name])] or times
    mates = [t for t in fitting if _are_mates(t, name)]
    before = [t for t in fitting if order.index(t) < order.index(name)]
    if mates or not before:
        return next(iter(mates or fitting), None)
    # Of clocks that stand beside each other, the one that stands still least often; else the next one.
    beside = [before[-1]]
    while (at := order.index(beside[0])) and order[at - 1] in before:
        beside.insert(0, order[at - 1])
    return max(reversed(beside), key=lambda clock: pd.unique(table.columns[clock]).size)


def _rest(name: str) -> str:
    """A name without its first word: what it shares with its mate."""
    return re.sub(r"^[^\W\d_]+", "", name.rpartition(".")[2])


def _are_mates(time: str, name: str) -> bool:
    return "[" in time and _rest(name).startswith(_rest(time))


def runs_side_by_side(names: list[str], times: list[str], table: FileTable) -> list[tuple[str, str]]:
    """Time and signal of each run where a table holds the same pair of columns several times."""
    pairs = [(time_of(name, times, table) or "", name) for name in names]
    headers = {split_header(name) for name in names}
    numbered = all(any(sign.isdigit() for sign in name) for name in names[1:])
    grouped = ":" in names[0] or "run" in names[0].lower() or all("#" in name for name in names[1:])
    several = len(pairs) > 1 and len({time for time, _ in pairs}) == len(pairs) == len(times)
    return pairs if several and len(headers) == 1 and numbered and grouped else []


def cells(names: list[str], times: list[str], table: FileTable) -> list[tuple[str, list[str]]]:
    """Times and signals of each run: MATLAB's cells, or `t1 x1 v1 t2 x2 v2`; nothing of other tables.

    Each has as many columns as the others, of the same names but for their numbers or letters, and units.
    """
    groups = [(time, [name for name in names if time_of(name, times, table) == time]) for time in times]
    patterns = {tuple(_without_number(item) for item in (time, *group)) for time, group in groups}
    fit = all(
        np.size(table.columns[name]) == np.size(table.columns[t]) for t, group in groups for name in group
    )
    return groups if len(groups) > 1 and len(patterns) == 1 and fit and groups[0][1] else []


def _without_number(name: str) -> str:
    """What the columns of all runs are called: `x` for `x1 (mm)`, `angle` for `Angle B [rad]`."""
    return re.sub(r"#?\d+|(?<=[ _])[a-d]$", "", split_header(name)[0])
