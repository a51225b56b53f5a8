"""Numbers of a table's cells: missing ones, dates, and times of the day."""

import re
from datetime import datetime, time as clock_time
from typing import Any

import numpy as np
import pandas as pd

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError
from sysid_trib.records.signal import LARGEST_NUMBER
from sysid_trib.records.units import LAB_WORDS

MISSING_TEXTS = frozenset(LAB_WORDS["missing"])
DAY = 86400.0
# The minus sign of Swedish and Norwegian settings.
MINUS = "\u2212"
# What loggers write where they have no value, and how many times as large as any other value it is.
SENTINELS = (-999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, -999.25)
FAR_OUTSIDE = 2.0
_CLOCK_TIME = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:\.\d*)?)(?::(\d+))?(?:\s*([ap])\.?m\.?)?", re.IGNORECASE)


def numbers(values: Any, name: str, source: str) -> Array:
    """Finite numbers, or nan where a value is missing.

    Parameters
    ----------
    values : array_like
        As the file has them: numbers, texts, dates, or times of the day.
    name, source : str
        Of the column and of the file, for messages.

    Raises
    ------
    RecordError
        A text that is no number, or an infinite value, with its row (from 1, below the header).
    """
    values = np.asarray(values)
    if values.dtype.kind == "O" and all(isinstance(value, datetime) for value in values):
        values = values.astype("datetime64[us]")
    if values.dtype.kind in "mM":
        elapsed = values - values[0] if values.dtype.kind == "M" else values
        return np.asarray(elapsed / np.timedelta64(1, "ns"), dtype=float) * 1e-9
    if values.dtype.kind not in "fiub":
        values = _of_texts(values, name, source)
    values = values.astype(np.float64)
    wrong = np.flatnonzero(np.abs(values) > LARGEST_NUMBER)
    if wrong.size:
        row, count = wrong[0], np.count_nonzero(np.isinf(values))
        vast = f"holds {values[row]:g}, too much for an oscillation or its time; scale it."
        infinite = f"is infinite ({count} such rows); cut them out, or keep the part between them."
        is_infinite = np.isinf(values[row])
        raise RecordError(f"{source}: row {row + 1} of column {name} {infinite if is_infinite else vast}")
    return values


def without_sentinels(values: Array) -> tuple[Array, str]:
    """A signal with nan in place of -999 and its like, and a sentence on them.

    Parameters
    ----------
    values : (row,) array of float
        A sentinel is one of theirs that no other value comes near.
    """
    for sentinel in SENTINELS:
        marked = values == sentinel
        others = np.abs(values[~marked & np.isfinite(values)])
        if marked.any() and others.size and abs(sentinel) > FAR_OUTSIDE * others.max():
            said = f"{np.count_nonzero(marked)} values of {sentinel:g} taken as missing"
            return np.where(marked, np.nan, values), said
    return values, ""


def is_numeric(values: Any) -> bool:
    """True if a column could hold a signal: numbers, most of the first ones."""
    values = np.asarray(values)
    if values.dtype.kind in "fiub":
        return True
    # Rows of a column by which its kind is judged.
    first = values[:1000].tolist()
    return not is_clock_time(values) and sum(map(is_number, first)) * 2 > len(first)


def is_missing(text: str) -> bool:
    """True if a text stands for a missing value: nothing, a usual word, or neither letter nor digit."""
    plain = text.strip().lower()
    return plain in MISSING_TEXTS or not any(map(str.isalnum, plain))


def is_number(value: object) -> bool:
    """True if a text is a number, with a decimal point or comma."""
    try:
        float(str(value).replace(",", ".", 1).replace(MINUS, "-"))
    except ValueError:
        return False
    return True


def is_clock_time(values: Any) -> bool:
    """True if a column holds dates, durations or times of the day, `12:00:01.250`."""
    values = np.asarray(values)
    if values.dtype.kind in "Mm":
        return True
    first = [value for value in values[:5] if value == value and value is not None]
    return bool(first) and all(
        isinstance(value, (datetime, clock_time)) or (isinstance(value, str) and value.count(":") >= 1)
        for value in first
    )


def _of_texts(values: Any, name: str, source: str) -> Array:
    if is_clock_time(values):
        texts = [str(value).strip().replace(",", ".") for value in values]
        seconds = _of_the_day(texts)
        seconds = _of_dates(texts) if seconds is None else seconds
        if seconds is not None:
            return seconds
    found = []
    for row, value in enumerate(values, 1):
        try:
            text = str(value).replace(",", ".").replace(MINUS, "-")
            found.append(np.nan if is_missing(text) else float(text))
        except ValueError:
            raise RecordError(
                f"{source}: row {row} of column {name} holds {str(value)[:30]!r}, not a number; "
                "correct it or cut it out."
            ) from None
    return np.array(found)


def _of_the_day(texts: list[str]) -> Array | None:
    """Seconds of times such as `14:02:33.120`, `02:33.12` (m:s), `2:02:33 PM`, `00:02:33:120`; else None."""
    matches = [_CLOCK_TIME.fullmatch(text) for text in texts]
    if not all(matches):
        return None
    seconds = np.array([_seconds(match) for match in matches if match is not None])
    # A new day starts where the clock goes back by more than half a day.
    return seconds + DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -0.5 * DAY)


def _seconds(match: "re.Match[str]") -> float:
    hours, minutes, seconds, thousandths, half = match.groups()
    hour = int(hours or 0)
    if half:
        hour = hour % 12 + (12 if half.lower().startswith("p") else 0)
    return 3600.0 * hour + 60.0 * int(minutes) + float(seconds) + 1e-3 * int(thousandths or 0)


def _of_dates(texts: list[str]) -> Array | None:
    """Seconds since the first of some dates, `2024-03-01 12:00:01:250` too; None if they are none."""
    texts = [re.sub(r"(:\d\d:\d\d):(?=\d+$)", r"\1.", text) for text in texts]
    for style in ("ISO8601", "mixed"):
        try:
            dates = pd.to_datetime(texts, format=style, utc=True)
        except (ValueError, OverflowError):
            continue
        return np.asarray((dates - dates[0]).total_seconds(), dtype=float)
    return None
