"""Times of the rows of a file: by a column of times or of counts, a sampling rate, or one in its notes."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.assumed_units import are_whole, check_period, time_factor
from sysid_trib.records.clock import Clock, read_clock
from sysid_trib.records.columns import Chosen, no_clock
from sysid_trib.records.headers import counts_rows, noted_duration, noted_rate, split_header
from sysid_trib.records.numbers import numbers
from sysid_trib.records.reading import Reading
from sysid_trib.records.tables import FileTable

RATE_TOLERANCE = 0.01
# Of its steps so many are those of a counter.
MOSTLY = 0.9
LARGEST_COUNT = 2.0**53
_PACKETS = re.compile(r"\b(packet|paket|paquet|pkt|block|burst|seq|sequence)")


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


def _numbered(table: FileTable, columns: Chosen, samples: int) -> tuple[Index | None, str]:
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


def sample_numbers(table: FileTable, others: Sequence[str | None]) -> tuple[str, Index] | None:
    """The column that counts samples, some of which may be lost, and their numbers from 0; None without one.

    Parameters
    ----------
    table : FileTable
    others : sequence of str or None
        Columns that are something else: times and signal.

    Notes
    -----
    A counter of packets has the same number for each row of one: all packets but the first and the last have
    as many rows. A counter that starts anew at a power of two is counted on.
    """
    for name, values in table.columns.items():
        column = np.asarray(values)
        if name in others or column.dtype.kind not in "fiu" or column.size < 3:
            continue
        if not np.all(np.isfinite(column)) or np.any(column != np.round(column)):
            continue
        if column.min() < 0 or column.max() > LARGEST_COUNT:
            continue
        base = split_header(name)[0]
        steps = _counted_on(column)
        if np.mean(steps == 1) > MOSTLY and np.all(steps >= 1):
            numbers: Index | None = np.append(0, np.cumsum(steps))
        elif (_PACKETS.search(base) or counts_rows(base)) and np.all(steps >= 0) and np.any(steps):
            numbers = _of_packets(steps)
        else:
            continue
        if numbers is not None:
            return name, numbers
    return None


def _counted_on(column: NDArray[np.float64]) -> Index:
    """Steps of a counter that may start anew after all values of so many bits."""
    whole = column.astype(np.int64)
    turn = 1 << int(whole.max()).bit_length()
    steps = np.diff(whole)
    anew = (steps < 0) & (whole[:-1] > 0.9 * turn) & (whole[1:] < 0.1 * turn)
    return np.where(anew, steps + turn, steps)


def _of_packets(steps: Index) -> Index | None:
    """Numbers of samples in packets of the same size; None where sizes differ."""
    begins = np.append(0, np.flatnonzero(steps) + 1)
    sizes = np.diff(begins)
    # The first and the last may be cut.
    size = int(sizes[1:].max(initial=0))
    if len(sizes) < 3 or np.mean(sizes[1:] == size) < MOSTLY or sizes[0] > size:
        return None
    packet = np.append(0, np.cumsum(steps))
    place = np.arange(len(packet)) - np.repeat(begins, np.diff(np.append(begins, len(packet))))
    place[: sizes[0]] += size - sizes[0]
    numbers = packet * size + place
    return np.asarray(numbers - numbers[0])
