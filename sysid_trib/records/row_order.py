"""The order of the rows of a table: sorted by a column other than the time, or below a bare head row."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.records.column import MOST_SET_BACK, Column

# Least number of rows that determines the steps of a clock.
FEWEST_ROWS = 12
# A column sorted by its values is a clock if this fraction of its steps deviates by at most this from the
# median.
EVEN_PART = 0.9
EVEN_WITHIN = 0.3
# Largest fraction of repeated stamps.
MOST_DOUBLED = 0.01
# Largest number of columns that are tested.
COLUMNS_LOOKED_AT = 40


def in_order(columns: Sequence[Column]) -> tuple[tuple[Column, ...], list[str]]:
    """Return columns with rows in order of time, without a head row, and sentences on the changes.

    Parameters
    ----------
    columns : sequence of Column
        Columns of one file.
    """
    said: list[str] = []
    columns = tuple(columns)
    if head := _bare_head(columns):
        columns = tuple(_with_rows(column, slice(1, None)) for column in columns)
        said.append(f"the first row ({head}) omitted: it is not a sample")
    time = _time_in_no_order(columns)
    if time is None:
        return columns, said
    rows = np.argsort(time.cells, kind="stable")
    sorted_by = " with equal steps" if _is_even(np.sort(time.cells.astype(float))) else ""
    said.append(f"rows are not in order of time: sorted by column {time.name}{sorted_by}")
    size = time.cells.size
    # Row numbers that were added after sorting belong to the new order too.
    kept = [c.cells.size != size or (c.rises and c.is_plain and _numbers_rows(c)) for c in columns]
    return tuple(c if stays else _with_rows(c, rows) for c, stays in zip(columns, kept, strict=True)), said


def _with_rows(column: Column, rows: slice | Index) -> Column:
    return replace(column, cells=column.cells[rows])


def _bare_head(columns: Sequence[Column]) -> str:
    """Return the first row if it is a head of bare numbers above a uniform clock; or nothing."""
    sizes = {column.cells.size for column in columns}
    if len(columns) < 2 or len(sizes) > 1 or max(sizes) < FEWEST_ROWS:
        return ""
    if not all(column.is_plain for column in columns) or any(column.rises for column in columns):
        return ""
    clocks = [column.cells[1:].astype(float) for column in columns[:3]]
    first = [float(column.cells[0]) for column in columns[:3]]
    apart = [
        _is_even(clock) and not clock[0] - 1.5 * np.median(np.diff(clock)) < number < clock[0]
        for clock, number in zip(clocks, first, strict=True)
    ]
    return ", ".join(f"{column.cells[0]:g}" for column in columns) if any(apart) else ""


def _is_even(stamps: Array) -> bool:
    """Return true if stamps increase in steps that are mostly equal."""
    if stamps.size < FEWEST_ROWS or not np.isfinite(stamps).all():
        return False
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    if not usual > 0.0 or np.any(steps < 0.0) or np.mean(steps == 0.0) > MOST_DOUBLED:
        return False
    return bool(np.mean(np.abs(steps - usual) <= EVEN_WITHIN * usual) >= EVEN_PART)


def _time_in_no_order(columns: Sequence[Column]) -> Column | None:
    """Return the time column by which rows must be sorted; None if they are in order, or nothing shows it.

    Values of a clock are uniformly spaced, in any order. If it has jitter, its name and another sorted column
    show the same.
    """
    plain = [
        column
        for column in columns[:COLUMNS_LOOKED_AT]
        if column.is_plain and column.cells.size >= FEWEST_ROWS and np.isfinite(column.cells).all()
    ]
    # Row numbers, which are in order after any sorting, are not a clock.
    if any(
        c.rises and (c.is_time or _is_even(c.cells.astype(float))) and not _numbers_rows(c) for c in plain
    ):
        return None
    shuffled = [column for column in plain if not column.rises and _is_shuffled(column.cells.astype(float))]
    even = [column for column in shuffled if _is_even(np.sort(column.cells.astype(float)))]
    named = [column for column in shuffled if column.is_time]
    is_sorted = any(_is_monotone(column.cells) for column in plain if column not in shuffled)
    for candidates in (
        [column for column in even if column.is_time],
        [column for column in even if not column.is_time and not named and not _numbers_rows(column)],
        named if is_sorted and not even else [],
    ):
        if candidates:
            return candidates[0]
    return None


def _numbers_rows(column: Column) -> bool:
    """Return true if a column contains the numbers 0, 1, 2, ... of its rows, in any order."""
    ordered = np.sort(column.cells.astype(float))
    return bool(ordered[0] in (0.0, 1.0) and np.all(np.diff(ordered) == 1.0)) and not column.is_time


def _is_shuffled(cells: Array) -> bool:
    """Return true if a column falls more often than a clock that is set back, with few equal values."""
    back = np.count_nonzero(np.diff(cells) < 0.0)
    distinct = np.unique(cells).size
    often = back > min(MOST_SET_BACK, cells.size // 20)
    return bool(often and distinct >= (1.0 - MOST_DOUBLED) * cells.size)


def _is_monotone(cells: Array) -> bool:
    steps = np.diff(cells.astype(float))
    return bool(np.all(steps >= 0.0) or np.all(steps <= 0.0)) and bool(np.any(steps))
