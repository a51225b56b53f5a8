"""Rows that were sampled evenly though their stamps do not say so, and columns that count samples."""

import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array
from sysid_trib.records.half_periods import dominant_periods
from sysid_trib.records.headers import counts_rows, split_header
from sysid_trib.records.tables import FileTable

# Of its steps so many are those of a counter.
MOSTLY = 0.9
LARGEST_COUNT = 2.0**53
_PACKETS = re.compile(r"\b(packet|paket|paquet|pkt|block|burst|seq|sequence)")


def sample_numbers(table: FileTable, others: Sequence[str | None]) -> tuple[str, NDArray[np.int64]] | None:
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
            numbers: NDArray[np.int64] | None = np.append(0, np.cumsum(steps))
        elif (_PACKETS.search(base) or counts_rows(base)) and np.all(steps >= 0) and np.any(steps):
            numbers = _of_packets(steps)
        else:
            continue
        if numbers is not None:
            return name, numbers
    return None


def _counted_on(column: NDArray[np.float64]) -> NDArray[np.int64]:
    """Steps of a counter that may start anew after all values of so many bits."""
    whole = column.astype(np.int64)
    turn = 1 << int(whole.max()).bit_length()
    steps = np.diff(whole)
    anew = (steps < 0) & (whole[:-1] > 0.9 * turn) & (whole[1:] < 0.1 * turn)
    return np.where(anew, steps + turn, steps)


def _of_packets(steps: NDArray[np.int64]) -> NDArray[np.int64] | None:
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


# Stamps are decimal numbers: the step of their rounding is a power of ten.
MOST_DIGITS = 9
# Digits that are counted from the first one that is not zero.
SIGNIFICANT_DIGITS = range(3, 8)
# Steps of the rounding within which stamps are a line's, cut off or rounded; its slope is known to a little
# less, and less well where the steps differ.
WITHIN, WITHIN_UNEQUAL = 1.02, 1.5
# A row follows at once if it comes within this part of the mean step; in packets most do.
AT_ONCE = 0.5
# Longest steps by which packets are late, and most by which the long and the short steps differ.
LATE, LARGEST_RATIO = 1.5, 100.0


def even_rows(given: Array, rows: "NDArray[np.int64]", values: Array | None) -> tuple[Array, str] | None:
    """Times of rows that are one step apart, and what their stamps are; None if they are not.

    Parameters
    ----------
    given : (row,) array of float
        Stamps.
    rows : (row,) array of int
        Their numbers in the file.
    values : (row,) array of float, optional
        The signal: a clock that stands still for half a period does not show that its rows are even.
    """
    index = (rows - rows[0]).astype(float)
    for step, said in roundings(given):
        # Of stamps next to zero beside others no line is weighted.
        # Of the largest stamp; a step of a smaller one is no digit of a clock.
        if np.min(step) < 1e-100 * np.max(np.abs(given)):
            continue
        line = _line(index, given, step)
        allowed = WITHIN if np.ndim(step) == 0 else WITHIN_UNEQUAL
        if np.ptp((given - line) / step) <= allowed and _shows_period(step, line, values):
            return line + (given[0] - line[0]), said
    line = _line(index, given, 1.0)
    if values is not None and _in_packets(given, line, values):
        return line + (given[0] - line[0]), "stamps of packets: their rows are taken as even"
    return None


def roundings(given: Array) -> Iterator[tuple[float | Array, str]]:
    """Steps to which stamps may be rounded, coarsest last: of decimals, of significant digits, of float32."""
    step = decimal_step(given)
    if step:
        yield step, f"stamps rounded to {step:g}"
    size = np.abs(np.where(given == 0.0, np.min(np.abs(given[given != 0.0]), initial=1.0), given))
    decade = 10.0 ** np.floor(np.log10(size) + 1e-12)
    for digits in SIGNIFICANT_DIGITS:
        unit = decade * 10.0 ** (1 - digits)
        if np.all(np.abs(given / unit - np.round(given / unit)) < 1e-6):
            yield unit, f"stamps of {digits} digits"
            break
    single = given.astype(np.float32)
    if np.all(single == given):
        yield np.spacing(np.abs(single)).astype(float), "stamps in single precision"


def decimal_step(given: Array) -> float:
    """Step of the decimal rounding of stamps, 0 if they have more digits than `MOST_DIGITS`."""
    largest = float(np.abs(given).max(initial=1e-300))
    for digits in range(MOST_DIGITS + 1):
        scaled = given * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 4e-16 * largest * 10.0**digits + 1e-9):
            return float(10.0**-digits)
    return 0.0


def _line(index: Array, given: Array, step: float | Array) -> Array:
    """The line through stamps; those that are rounded more count less."""
    weights = np.broadcast_to(1.0 / np.asarray(step), given.shape)
    return np.asarray(np.polyval(np.polyfit(index, given, 1, w=weights), index))


def _shows_period(step: float | Array, line: Array, values: Array | None) -> bool:
    """True if a clock with such steps moves within half a period; without a signal, within two rows."""
    if values is None:
        return bool(np.max(step) < 2.0 * np.median(np.diff(line)))
    good = np.isfinite(values)
    periods = dominant_periods(line[good], values[good]) if np.count_nonzero(good) > 1 else []
    return bool(periods) and bool(np.max(step) < 0.5 * periods[0])


def _in_packets(given: Array, line: Array, values: Array) -> bool:
    """True if rows come at once, then late, and the signal moves as far between packets as within them."""
    steps, moves = np.diff(given), np.abs(np.diff(values))
    at_once = steps < AT_ONCE * (line[1] - line[0])
    if not np.mean(at_once) > 0.5 or np.all(at_once) or np.any(steps < 0.0):
        return False
    # Rows that are lacking add up; those that are late do not.
    if np.ptp(given - line) > LATE * steps.max() or not _shows_period(steps.max(), line, values):
        return False
    ratio = np.median(steps[~at_once]) / max(float(np.median(steps[at_once])), 1e-300)
    within, between = np.nanmedian(moves[at_once]), np.nanmedian(moves[~at_once])
    return bool(between < np.sqrt(min(ratio, LARGEST_RATIO)) * within)
