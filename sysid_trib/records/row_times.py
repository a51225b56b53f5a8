"""Times of the rows of a file: by its time column, a sampling rate that is given, or one in its notes."""

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.assumed_units import are_whole, check_period, time_factor
from sysid_trib.records.clock import Clock, read_clock
from sysid_trib.records.columns import Chosen, no_clock
from sysid_trib.records.even_rows import sample_numbers
from sysid_trib.records.headers import noted_duration, noted_rate
from sysid_trib.records.numbers import numbers
from sysid_trib.records.reading import Reading
from sysid_trib.records.tables import FileTable

RATE_TOLERANCE = 0.01


def row_times(
    table: FileTable, columns: Chosen, how: Reading, values: Array, source: str
) -> tuple[Clock, str, list[str]]:
    """Times of the rows of a signal.

    Parameters
    ----------
    table : FileTable
    columns : Chosen
        Which column is the time, if any.
    how : Reading
    values : (row,) array of float
        The signal.
    source : str
        Of whom sentences speak.

    Returns
    -------
    clock : Clock
        Times in s, and the rows that they belong to.
    unit : str
        Of the times in the file.
    said : list of str
        What is to be said of it.

    Raises
    ------
    RecordError
        There is no time, or another number of them.
    UsageError
        Time stamps contradict the sampling rate that is given.
    """
    noted = stated_rate(table)
    if columns.time is None or (how.sampling_rate is not None and _idle(table, columns.time, values.size)):
        rate = how.sampling_rate or noted
        if rate is None:
            raise RecordError(no_clock(table, source))
        said = [] if how.sampling_rate else [f"sampling rate of {rate:g} Hz from its notes"]
        rows, (numbered, gaps) = np.arange(values.size), _numbered(table, columns, values.size)
        said += [gaps] if gaps else []
        return Clock((rows if numbered is None else numbered) / rate, rows, (), (f"{rate:g} Hz",)), "s", said
    stamps = numbers(table.columns[columns.time], columns.time, source)
    if stamps.size != values.size:
        raise RecordError(
            f"{source}: {stamps.size} times but {values.size} angles; choose columns that belong together."
        )
    unit, factor, why = time_factor(table, columns.time, how.time_units, source)
    if how.sampling_rate is not None:
        rows = np.flatnonzero(np.isfinite(stamps))
        counted = max(float(np.ptp(stamps[rows])) * factor, 1e-300)
        # A coarse clock's last stamp lasts for as many samples as the others do.
        distinct = np.unique(stamps[rows]).size
        rate = (rows.size - rows.size / max(1, distinct)) / counted
        if distinct > 1 and abs(how.sampling_rate / rate - 1.0) > RATE_TOLERANCE + 1.0 / rows.size:
            raise UsageError(
                f"{source}: the time stamps of column {columns.time} say {rate:.6g} Hz, but --sampling-rate "
                f"says {how.sampling_rate:g} Hz (sampling_rate= in Python); leave the option out, or give "
                "the unit of the stamps, --time-units."
            )
        clock = Clock(rows / how.sampling_rate, rows, (), (f"{how.sampling_rate:g} Hz as given",))
        return clock, unit or "s", []
    numbered, gaps = _numbered(table, columns, values.size)
    clock = read_clock(stamps, factor, source, values, numbered)
    why = "; ".join(text for text in (why, gaps) if text)
    if unit is None:
        check_period(clock.time, values[clock.rows], are_whole(stamps), source)
    return clock, unit or "s", [why] if why else []


def _numbered(table: FileTable, columns: Chosen, samples: int) -> tuple[NDArray[np.int64] | None, str]:
    """Numbers of the samples where a column counts them and some are lost, and a sentence on these."""
    counter = sample_numbers(table, (columns.time, columns.signal))
    if counter is None or counter[1].size != samples or counter[1][-1] == samples - 1:
        return None, ""
    name, counted = counter
    return counted, f"{counted[-1] + 1 - samples} samples lost, by column {name}"


def stated_rate(table: FileTable) -> float | None:
    """Sampling rate (Hz) that the notes of a file state, or that its rows have over a duration they state."""
    rate, duration = noted_rate(table.notes), noted_duration(table.notes)
    if rate is not None or duration is None:
        return rate
    rows = max(np.size(column) for column in table.columns.values())
    # The last sample may be at the end.
    return (rows - 1) / duration if (rows - 1) % duration == 0.0 else rows / duration


def _idle(table: FileTable, name: str, samples: int) -> bool:
    """True if a time column cannot contradict a sampling rate: it is of another length, or does not move."""
    stamps = np.asarray(table.columns[name])
    return stamps.size != samples or stamps.dtype.kind not in "fiu" or bool(np.ptp(stamps) == 0)
