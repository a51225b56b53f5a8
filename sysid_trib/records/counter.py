"""A column that counts samples or packets: how many were lost, which stamps of packets do not say."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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
