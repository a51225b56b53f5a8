"""The clock behind time stamps: uniform and rounded, jittering, doubled, set back, with rows missing."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import RecordError
from sysid_trib.records import column, half_periods, signal

UNEVEN_PART = 1e-9
# Stamps are decimal numbers: the step of their rounding is a power of ten.
MOST_DIGITS = 9
# Steps of the rounding within which stamps are a line's, cut off or rounded; its slope is known to a little
# less, and less well where the steps differ.
WITHIN = 1.02
WITHIN_UNEQUAL = 1.5
# A row follows at once if it comes within this part of the mean step; in packets most do.
AT_ONCE = 0.5
GIVE_RATE = "give the sampling rate instead, --sampling-rate HZ (sampling_rate= in Python)."


# Origin of a clock, in words.
CLOCKS: dict[column.ClockKind, str] = {
    "dates": "by dates without a time zone",
    "universal": "in universal time (from 1970, or dates with a time zone)",
    "day": "by the time of the day",
    "stamps": "in seconds from an instant of its own",
    "rows": "by its sampling rate from its first row",
}
# s since 1970: stamps of the years 1990 to 2100 count from there.
COUNTED_FROM_1970 = 6.3e8, 4.1e9


class Origin(NamedTuple):
    """The instant that a record calls 0 s.

    Attributes
    ----------
    kind : ClockKind
        By which clock it counts.
    instant : int, ns
        By that clock.
    """

    kind: column.ClockKind
    instant: int = 0

    def later(self, seconds: float) -> "Origin":
        """Return the origin so much later."""
        return Origin(self.kind, self.instant + round(seconds * 1e9))


class Clock(NamedTuple):
    """Times of a record.

    Attributes
    ----------
    time : (sample,) array of float, s
        Rising.
    rows : (sample,) array of int
        Rows of the file that they belong to.
    breaks : tuple of float, s
        Times at which the clock was set back: what comes after is a piece of its own.
    seen : tuple of str
        Observations on the clock.
    counted_from : float, s
        By the stamps, what the record calls 0 s.
    """

    time: Array
    rows: Index
    breaks: tuple[float, ...] = ()
    seen: tuple[str, ...] = ()
    counted_from: float = 0.0


def seconds_between(first: Origin, other: Origin) -> float | None:
    """Return the time (s) from one origin to another; None if no clock is common to both."""
    own = {"rows": "stamps"}
    if own.get(first.kind, first.kind) != own.get(other.kind, other.kind):
        return None
    return (other.instant - first.instant) * 1e-9


def read_clock(
    stamps: Array, factor: float, source: str, values: Array, numbered: Index | None = None
) -> Clock:
    """Return the times from time stamps.

    Parameters
    ----------
    stamps : (row,) array of float
        In the unit of the file; nan where one is missing.
    factor : float
        Factor of that unit, in s.
    source : str
        Name of the file, for messages.
    values : (row,) array of float
        The signal, by which rows prove to be even where stamps are repeated or come in packets.
    numbered : (row,) array of int, optional
        Numbers of the samples, where some are lost; the rows' own otherwise.

    Raises
    ------
    RecordError
        The rows are in no order of time, or too few.
    """
    rows = np.flatnonzero(np.isfinite(stamps))
    given = stamps[rows]
    if given.size < 2:
        raise RecordError(f"{source}: a single sample is not a record.")
    sentences: list[str] = []
    back = np.zeros(0, dtype=np.int64)
    steps = np.diff(given)
    even = None
    if np.ptp(steps) > UNEVEN_PART * steps[0] + 4e-16 * np.abs(given).max():
        even = even_rows(given, rows if numbered is None else numbered[rows], values[rows])
    if even is None:
        kept = np.append(True, steps != 0.0)
        if 2 * np.count_nonzero(kept) < given.size:
            wrong = f"{source}: most time stamps repeat: the clock is coarser than the sampling"
            raise RecordError(f"{wrong}; {GIVE_RATE}")
        if not kept.all():
            repeated = int(np.count_nonzero(~kept))
            sentences.append(f"{repeated} row{'s' * (repeated > 1)} with a repeated time stamp left out")
        rows = rows[kept]
        given, back = _rising(given[kept], source)
    if back.size:
        where = ", ".join(f"{given[b - 1] * factor:.6g} s" for b in back[:3])
        sentences.append(f"the clock is set back after {where}: used as {back.size + 1} pieces")
    # s; of shorter steps numbers lose their digits.
    if factor * float(np.mean(np.abs(np.diff(given)))) < 1e-100:
        apart = f"{factor * (given[1] - given[0]):.3g} s apart: no clock has such steps"
        raise RecordError(f"{source}: samples are {apart}; give their unit, --time-units, or {GIVE_RATE}")
    time, said = even or _without_rounding(given, decimal_step(given))
    time = time * factor
    # s; stamps that started longer ago (epoch seconds) are counted from the first: no digit is lost to them.
    counted_from = float(time[0]) if abs(time[0]) > 1e6 else 0.0
    if counted_from:
        sentences.append(f"counted from the first stamp, {given[0]:.10g}")
        time = time - time[0]
    still = np.flatnonzero(np.diff(time) <= 0.0)
    if still.size:
        # Numbers so much larger than their steps that these are lost in their digits.
        row = int(rows[still[0] + 1]) + 1
        wrong = f"{source}: its times do not rise by as much as their digits show, first in row {row}"
        raise RecordError(f"{wrong}; correct them, or {GIVE_RATE}")
    rate = f"{1.0 / signal.usual_step(np.diff(time)):.6g} Hz {'on average' if 'jitter' in said else 'clock'}"
    breaks = tuple(float(time[b]) for b in back)
    return Clock(time, rows, breaks, (*sentences, f"{rate} ({said})" if said else rate), counted_from)


def are_whole(stamps: Array) -> bool:
    """Return true if stamps are whole numbers, one or more apart."""
    stamps = stamps[np.isfinite(stamps)]
    return bool(stamps.size > 1 and np.all(stamps == np.round(stamps)) and np.median(np.diff(stamps)) >= 1.0)


def check_period(time: Array, values: Array, whole: bool, source: str, remedy: str) -> None:
    """Raise an error that asks for the unit of times if seconds give an implausible period.

    Parameters
    ----------
    time, values : (sample,) array of float
        The signal; times as they stand.
    whole : bool
        Whether the stamps are whole numbers.
    source : str
        Source that the error names.
    remedy : str
        Option to give.

    Raises
    ------
    RecordError
        With the period, and what to give.
    """
    periods = half_periods.dominant_periods(time, values)
    # s; no laboratory has longer periods, or of whole stamps, which often are ms or us, or shorter ones.
    longest = 60.0 if whole else 1000.0
    if periods and not 5e-5 < periods[0] < longest:
        raise RecordError(
            f"{source}: nothing states the unit of its times: the period would be {periods[0]:.3g} s in s, "
            f"{1e-3 * periods[0]:.3g} s in ms, {1e-6 * periods[0]:.3g} s in us; {remedy}"
        )


def _rising(given: Array, source: str) -> tuple[Array, Index]:
    """Return stamps that rise throughout, and where the clock was set back: from there they are shifted."""
    steps = np.diff(given)
    back = np.flatnonzero(steps < 0.0) + 1
    if back.size > min(column.MOST_SET_BACK, given.size // 20):
        row = int(back[0])
        fall = (
            f"{given[row - 1]:.9g} s in row {row} is followed by {given[row]:.9g} s, and so {back.size} times"
        )
        raise RecordError(f"{source}: time must rise, but {fall}; sort the rows, or give the sampling rate.")
    shift = np.zeros(given.size)
    shift[back] = np.median(steps) - steps[back - 1]
    return given + np.cumsum(shift), back


def _without_rounding(given: Array, rounding: float) -> tuple[Array, str]:
    """Return the uniform clock whose rounded stamps these are, also with missing rows; else the stamps."""
    steps = np.diff(given)
    usual = signal.usual_step(steps)
    if usual <= 0.0:
        return given, ""
    counts = np.maximum(1.0, np.round(steps / usual))
    missing = int(np.sum(counts - 1))
    index = np.concatenate(([0.0], np.cumsum(counts)))
    lack = f"{missing} row{'s' * (missing > 1)} missing" if missing else ""
    if np.all(np.abs(steps - usual * counts) <= UNEVEN_PART * usual + 4e-16 * np.abs(given).max()):
        return given, lack
    # A line through all stamps; its steps are counted again by this line.
    for _ in range(3):
        slope, start = np.polyfit(index, given, 1)
        if slope <= 0.0:
            return given, ""
        counts = np.maximum(1.0, np.round(steps / slope))
        index = np.concatenate(([0.0], np.cumsum(counts)))
    # Within the rounding the first stamp is as good a start as any: it is kept.
    line = start + slope * index
    # Within one step of their last digit, whether it was rounded or cut off.
    if np.ptp(given - line) <= WITHIN * rounding + 1e-12 * abs(slope):
        rounded = f"stamps rounded to {rounding:g}"
        return line + (given[0] - line[0]), f"{rounded}; {lack}" if lack else rounded
    worst = float(np.max(np.abs(steps - counts * slope)))
    # Part of a step; less is not worth a word.
    if worst < 1e-4 * slope:
        return given, lack
    jitter = f"stamps jitter by up to {100.0 * worst / slope:.2g} % of a step, and are used as they are"
    return given, jitter


def even_rows(given: Array, rows: Index, values: Array) -> tuple[Array, str] | None:
    """Return the times of rows that are one step apart, and what their stamps are; None if they are not.

    Parameters
    ----------
    given : (row,) array of float
        Stamps.
    rows : (row,) array of int
        Their numbers in the file.
    values : (row,) array of float
        The signal: a clock that stands still for half a period does not show that its rows are even.
    """
    index = (rows - rows[0]).astype(float)
    for step, said in roundings(given):
        # No line is weighted by stamps that are next to zero where others are not.
        # Use the largest stamp: a step of a smaller one is no digit of a clock.
        if np.min(step) < 1e-100 * np.max(np.abs(given)):
            continue
        line = _line(index, given, step)
        allowed = WITHIN if np.ndim(step) == 0 else WITHIN_UNEQUAL
        if np.ptp((given - line) / step) <= allowed and _shows_period(step, line, values):
            return line + (given[0] - line[0]), said
    line = _line(index, given, 1.0)
    if _in_packets(given, line, values):
        return line + (given[0] - line[0]), "stamps of packets: rows within a packet are taken as equidistant"
    return None


def roundings(given: Array) -> Iterator[tuple[float | Array, str]]:
    """Yield possible rounding steps of stamps, coarsest last: decimals, significant digits, float32."""
    step = decimal_step(given)
    if step:
        yield step, f"stamps rounded to {step:g}"
    size = np.abs(np.where(given == 0.0, np.min(np.abs(given[given != 0.0]), initial=1.0), given))
    decade = 10.0 ** np.floor(np.log10(size) + 1e-12)
    # Digits that are counted from the first one that is not zero.
    for digits in range(3, 8):
        unit = decade * 10.0 ** (1 - digits)
        if np.all(np.abs(given / unit - np.round(given / unit)) < 1e-6):
            yield unit, f"stamps of {digits} digits"
            break
    single = given.astype(np.float32)
    if np.all(single == given):
        yield np.spacing(np.abs(single)).astype(float), "stamps in single precision"


def decimal_step(given: Array) -> float:
    """Return the step of the decimal rounding of stamps, 0 if they have more digits than `MOST_DIGITS`."""
    largest = float(np.abs(given).max(initial=1e-300))
    for digits in range(MOST_DIGITS + 1):
        scaled = given * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 4e-16 * largest * 10.0**digits + 1e-9):
            return float(10.0**-digits)
    return 0.0


def _line(index: Array, given: Array, step: float | Array) -> Array:
    """Return the line through stamps; those that are rounded more count less."""
    weights = np.broadcast_to(1.0 / np.asarray(step), given.shape)
    return np.asarray(np.polyval(np.polyfit(index, given, 1, w=weights), index))


def _shows_period(step: float | Array, line: Array, values: Array) -> bool:
    """Return true if a clock with such steps moves within half a period."""
    periods = half_periods.dominant_periods(line, values)
    return bool(periods) and bool(np.max(step) < 0.5 * periods[0])


def _in_packets(given: Array, line: Array, values: Array) -> bool:
    """Return true if rows come in packets, and the signal moves as much between packets as within them."""
    steps = np.diff(given)
    moves = np.abs(np.diff(values))
    at_once = steps < AT_ONCE * (line[1] - line[0])
    if not np.mean(at_once) > 0.5 or np.all(at_once) or np.any(steps < 0.0):
        return False
    # Rows that are lacking add up; those that are late do not.
    # Longest steps by which packets are late, and most by which the long and the short steps differ.
    if np.ptp(given - line) > 1.5 * steps.max() or not _shows_period(steps.max(), line, values):
        return False
    ratio = np.median(steps[~at_once]) / max(float(np.median(steps[at_once])), 1e-300)
    within = np.nanmedian(moves[at_once])
    between = np.nanmedian(moves[~at_once])
    return bool(between < np.sqrt(min(ratio, 100.0)) * within)
