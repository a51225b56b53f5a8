"""The clock behind time stamps: rounded, with jitter, repeated, set back, or with missing rows."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import RecordError
from sysid_trib.records import column, half_periods, signal

UNEVEN_PART = 1e-9
# Stamps are decimal numbers: the step of their rounding is a power of ten.
MOST_DIGITS = 9
# Number of rounding steps within which stamps lie on a line, truncated or rounded, with an uncertain slope;
# and the same for unequal steps.
WITHIN = 1.02
WITHIN_UNEQUAL = 1.5
# A row of a packet follows within this fraction of the mean step; in packets most rows do.
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
# s since 1970, for stamps of the years 1990 to 2100.
COUNTED_FROM_1970 = 6.3e8, 4.1e9


class Origin(NamedTuple):
    """The instant that a record calls 0 s.

    Attributes
    ----------
    kind : ClockKind
        Clock from which the origin is counted.
    instant : int, ns
        Time of the origin by this clock.
    """

    kind: column.ClockKind
    instant: int = 0

    def later(self, seconds: float) -> "Origin":
        """Return the origin moved by some seconds."""
        return Origin(self.kind, self.instant + round(seconds * 1e9))


class Clock(NamedTuple):
    """Times of a record.

    Attributes
    ----------
    time : (sample,) array of float, s
        Increasing times.
    rows : (sample,) array of int
        Row of the file for each time.
    breaks : tuple of float, s
        Times at which the clock was set back: a separate piece starts after each.
    seen : tuple of str
        Observations on the clock.
    counted_from : float, s
        Time by the stamps that is 0 s in the record.
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
        Stamps in the unit of the file; nan for missing ones.
    factor : float
        Factor of that unit, in s.
    source : str
        Name of the file, for messages.
    values : (row,) array of float
        The signal, which shows that rows are equidistant although stamps are repeated or come in packets.
    numbered : (row,) array of int, optional
        Numbers of the samples, if some are lost; by default those of the rows.

    Raises
    ------
    RecordError
        The rows are not in order of time, or there are too few.
    """
    rows = np.flatnonzero(np.isfinite(stamps))
    given = stamps[rows]
    if given.size < 2:
        raise RecordError(f"{source}: a single sample is not a record.")
    given, sentences = _without_overflow(given)
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
    # s; shorter steps lose their digits.
    if factor * float(np.mean(np.abs(np.diff(given)))) < 1e-100:
        apart = f"{factor * (given[1] - given[0]):.3g} s apart: no clock has such steps"
        raise RecordError(f"{source}: samples are {apart}; give their unit, --time-units, or {GIVE_RATE}")
    time, said = even or _without_rounding(given, decimal_step(given))
    time = time * factor
    # s; if stamps start later than this (such as epoch seconds), count from the first one: no digit is lost.
    counted_from = float(time[0]) if abs(time[0]) > 1e6 else 0.0
    if counted_from:
        sentences.append(f"counted from the first stamp, {given[0]:.10g}")
        time = time - time[0]
    still = np.flatnonzero(np.diff(time) <= 0.0)
    if still.size:
        # The numbers are so much larger than their steps that the steps are lost in rounding.
        row = int(rows[still[0] + 1]) + 1
        wrong = f"{source}: its times do not rise by as much as their digits show, first in row {row}"
        raise RecordError(f"{wrong}; correct them, or {GIVE_RATE}")
    rate = f"{1.0 / signal.usual_step(np.diff(time)):.6g} Hz {'on average' if 'jitter' in said else 'clock'}"
    breaks = tuple(float(time[b]) for b in back)
    return Clock(time, rows, breaks, (*sentences, f"{rate} ({said})" if said else rate), counted_from)


def _without_overflow(given: Array) -> tuple[Array, list[str]]:
    """Return stamps of a counter that starts anew at the end of its range as one clock, and a sentence."""
    steps = np.diff(given)
    back = np.flatnonzero(steps < 0.0)
    if not back.size or np.any(given < 0.0) or np.any(given != np.round(given)):
        return given, []
    usual = float(np.median(steps))
    for bits in (16, 24, 32):
        turn = 2.0**bits
        lasts = turn + steps[back]
        # A counter starts anew within a few steps of its end.
        if given.max() < turn and np.all((lasts > 0.0) & (lasts <= 10.0 * usual)):
            times = "once" if back.size == 1 else f"{back.size} times"
            said = (
                f"the clock starts anew {times} after {turn:.0f}, as a counter of {bits} bits: put together"
            )
            starts = np.zeros(given.size)
            starts[back + 1] = turn
            return given + np.cumsum(starts), [said]
    return given, []


def are_whole(stamps: Array) -> bool:
    """Return true if stamps are whole numbers, one or more apart."""
    stamps = stamps[np.isfinite(stamps)]
    return bool(stamps.size > 1 and np.all(stamps == np.round(stamps)) and np.median(np.diff(stamps)) >= 1.0)


def check_period(time: Array, values: Array, whole: bool, source: str, remedy: str) -> None:
    """Raise an error that asks for the unit of times if seconds would give an implausible period.

    Parameters
    ----------
    time, values : (sample,) array of float
        The signal, and its times as they are.
    whole : bool
        Whether the stamps are whole numbers.
    source : str
        Source, for the error.
    remedy : str
        Option to give.

    Raises
    ------
    RecordError
        The period is implausible; the message states it and the option to give.
    """
    periods = half_periods.dominant_periods(time, values)
    # s; no laboratory has longer or shorter periods. For whole stamps, which often are ms or us, the limit is
    # lower.
    longest = 60.0 if whole else 1000.0
    if periods and not 5e-5 < periods[0] < longest:
        raise RecordError(
            f"{source}: nothing states the unit of its times: the period would be {periods[0]:.3g} s in s, "
            f"{1e-3 * periods[0]:.3g} s in ms, {1e-6 * periods[0]:.3g} s in us; {remedy}"
        )


def _rising(given: Array, source: str) -> tuple[Array, Index]:
    """Return stamps that increase throughout, shifted where the clock was set back, and these rows."""
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
    """Return the uniform clock whose rounded stamps these are, even with missing rows; else the stamps."""
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
    # Fit a line through all stamps; then count its steps again along this line.
    for _ in range(3):
        slope, start = np.polyfit(index, given, 1)
        if slope <= 0.0:
            return given, ""
        counts = np.maximum(1.0, np.round(steps / slope))
        index = np.concatenate(([0.0], np.cumsum(counts)))
    # Within the rounding, the first stamp is a valid start: keep it.
    line = start + slope * index
    # Accept deviations within one step of the last digit, whether it was rounded or truncated.
    if np.ptp(given - line) <= WITHIN * rounding + 1e-12 * abs(slope):
        rounded = f"stamps rounded to {rounding:g}"
        return line + (given[0] - line[0]), f"{rounded}; {lack}" if lack else rounded
    worst = float(np.max(np.abs(steps - counts * slope)))
    # Relative to a step; a smaller jitter is not mentioned.
    if worst < 1e-4 * slope:
        return given, lack
    jitter = f"stamps jitter by up to {100.0 * worst / slope:.2g} % of a step, and are used as they are"
    return given, jitter


def even_rows(given: Array, rows: Index, values: Array) -> tuple[Array, str] | None:
    """Return the times of equidistant rows, and a description of their stamps; None if they are not.

    Parameters
    ----------
    given : (row,) array of float
        Time stamps.
    rows : (row,) array of int
        Numbers of the rows in the file.
    values : (row,) array of float
        The signal. If the clock stands still for half a period, it does not show that rows are equidistant.
    """
    index = (rows - rows[0]).astype(float)
    for step, said in roundings(given):
        # Weights need stamps of comparable size. Compare with the largest stamp: smaller steps are below its
        # digits.
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
    """Yield possible rounding steps of stamps, the coarsest last: decimals, significant digits, float32."""
    step = decimal_step(given)
    if step:
        yield step, f"stamps rounded to {step:g}"
    size = np.abs(np.where(given == 0.0, np.min(np.abs(given[given != 0.0]), initial=1.0), given))
    decade = 10.0 ** np.floor(np.log10(size) + 1e-12)
    # Significant digits, counted from the first nonzero digit.
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
    """Return the line through stamps; more strongly rounded stamps have less weight."""
    weights = np.broadcast_to(1.0 / np.asarray(step), given.shape)
    return np.asarray(np.polyval(np.polyfit(index, given, 1, w=weights), index))


def _shows_period(step: float | Array, line: Array, values: Array) -> bool:
    """Return true if a clock with such steps advances within half a period."""
    periods = half_periods.dominant_periods(line, values)
    return bool(periods) and bool(np.max(step) < 0.5 * periods[0])


def _in_packets(given: Array, line: Array, values: Array) -> bool:
    """Return true if rows come in packets and the signal changes as much between packets as within them."""
    steps = np.diff(given)
    moves = np.abs(np.diff(values))
    at_once = steps < AT_ONCE * (line[1] - line[0])
    if not np.mean(at_once) > 0.5 or np.all(at_once) or np.any(steps < 0.0):
        return False
    # Missing rows accumulate, late ones do not: limit the deviation from the line, in longest steps; and
    # compare the signal's changes between and within packets.
    if np.ptp(given - line) > 1.5 * steps.max() or not _shows_period(steps.max(), line, values):
        return False
    ratio = np.median(steps[~at_once]) / max(float(np.median(steps[at_once])), 1e-300)
    within = np.nanmedian(moves[at_once])
    between = np.nanmedian(moves[~at_once])
    return bool(between < np.sqrt(min(ratio, 100.0)) * within)
