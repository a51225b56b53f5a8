"""Rows that were sampled evenly though their stamps do not say so: coarse, of few digits, or of packets."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array
from sysid_trib.decays.half_periods import dominant_periods

# Stamps are decimal numbers: the step of their rounding is a power of ten.
MOST_DIGITS = 9
# Digits that are counted from the first one that is not zero.
SIGNIFICANT_DIGITS = range(3, 8)
# Steps of the rounding within which stamps are a line's, cut off or rounded; its slope is known to a little
# less, and less well where the steps differ.
WITHIN, WITHIN_UNEQUAL = 1.02, 1.5
# Of the largest stamp; a step of a smaller one is no digit of a clock.
SMALLEST_STEP = 1e-100
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
        if np.min(step) < SMALLEST_STEP * np.max(np.abs(given)):
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
    """Whether a clock with such steps moves within half a period; without a signal, within two rows."""
    if values is None:
        return bool(np.max(step) < 2.0 * np.median(np.diff(line)))
    good = np.isfinite(values)
    periods = dominant_periods(line[good], values[good]) if np.count_nonzero(good) > 1 else []
    return bool(periods) and bool(np.max(step) < 0.5 * periods[0])


def _in_packets(given: Array, line: Array, values: Array) -> bool:
    """Whether rows come at once, then late, and the signal moves as far between packets as within them."""
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
