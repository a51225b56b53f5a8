"""Clocks in two columns: whole seconds, and their fraction in ms, us or ns."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.records.column import Column
from sysid_trib.records.units import TIME_UNITS, plain_unit


def with_joined_clock(columns: Sequence[Column]) -> tuple[tuple[Column, ...], list[str]]:
    """Return columns with one clock in place of whole seconds and their fraction, and a sentence on it.

    Parameters
    ----------
    columns : sequence of Column
        Columns of one file, in its order.
    """
    for whole, fraction in pairwise(columns):
        seconds = _joined(whole, fraction)
        if seconds is None:
            continue
        name = f"{whole.name} + {fraction.name}"
        kind, instant = whole.first_instant
        cells = seconds
        if kind == "dates":
            # Dates, so that instants of other files can be compared.
            nanoseconds = np.round((seconds - whole.numbers[0]) * 1e9).astype("m8[ns]")
            cells = np.datetime64(instant, "ns") + nanoseconds
        clock = replace(whole, name=name, cells=cells, base="time", stated="s")
        kept = (clock if column is whole else column for column in columns if column is not fraction)
        return tuple(kept), [f"time from {whole.name} and {fraction.name}"]
    return tuple(columns), []


def _joined(whole: Column, fraction: Column) -> Array | None:
    """Return the times (s) of whole seconds and their fraction; None if they are not such a clock."""
    unit = TIME_UNITS.get(plain_unit(fraction.stated or fraction.base.split(" ")[-1]), 1.0)
    seconds_by_name = TIME_UNITS.get(plain_unit(whole.stated or whole.base.split(" ")[-1])) == 1.0
    if not (whole.is_time or seconds_by_name) or unit >= 1.0 or not fraction.is_plain:
        return None
    if whole.cells.size != fraction.cells.size or not (whole.is_plain or whole.is_dated):
        return None
    seconds = whole.numbers
    parts = fraction.cells.astype(float)
    both = np.concatenate((seconds - seconds[:1], parts))
    if not np.all(np.isfinite(both)) or np.any(both != np.round(both)):
        return None
    # Most rows of whole seconds repeat the stamp before.
    repeats = np.mean(np.diff(seconds) == 0.0) > 0.5 if seconds.size > 1 else False
    within = np.all((parts >= 0.0) & (parts * unit < 1.0)) and np.any(np.diff(parts) < 0.0)
    return seconds + parts * unit if repeats and within else None
