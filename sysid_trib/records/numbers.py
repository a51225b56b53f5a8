"""Numbers of a table's cells: missing ones, dates, clock times, and cells dressed up in labels and units."""

import re
from datetime import datetime, time as clock_time
from typing import Any

import numpy as np
import pandas as pd

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError
from sysid_trib.records.signal import LARGEST_NUMBER
from sysid_trib.records.units import LAB_WORDS, TIME_UNITS, is_known_unit, plain_unit

MISSING_TEXTS = frozenset(LAB_WORDS["missing"])
DAY = 86400.0
# The minus sign of Swedish and Norwegian settings.
MINUS = "\u2212"
# What loggers write where they have no value, and how many times as large as any other value it is.
SENTINELS = (-999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, -999.25)
FAR_OUTSIDE = 2.0
_CLOCK_TIME = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:\.\d*)?)(?::(\d+))?(?:\s*([ap])\.?m\.?)?", re.IGNORECASE)
# `time:0.12`, `angle = 4.5`.
_NAMED_NUMBER = re.compile(
    r"\s*\"?([^\W\d][\w .]*?)\"?\s*[:=]\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*"
)
_QUOTED_COMMA = re.compile(r"\"([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)\"")
# Fortran's `1.5D-02`.
_FORTRAN = re.compile(r"(\d\.?)[dD]([+-]\d\d)")
_QUOTED_POINT = re.compile(r"\"[+-]?\d*\.\d+\"")
# `5.123,45` between semicolons or tabs, `"5,123.45"`, and figures parted by narrow blanks or apostrophes.
_POINT_GROUPS = re.compile(r"(?<![\d.,])([+-]?\d{1,3}(?:\.\d{3})+)(?=,\d)")
_QUOTED_GROUPS = re.compile(r"\"([+-]?\d{1,3}(?:,\d{3})+(?:\.\d+)?)\"")
_QUOTED_BOTH = re.compile(r"\"[+-]?\d{1,3}(?:,\d{3})+\.\d+\"")
_COMMA_GROUPS = re.compile(r"(?<![\d.,])([+-]?\d{1,3}(?:,\d{3})+)(?=\.\d)")
_OTHER_GROUPS = re.compile(r"(?<=\d)[\u00a0\u2009\u202f'’](?=\d{3}(?!\d))")
# `1 234,5` between semicolons or tabs.
_BLANK_GROUPS = re.compile(
    r"(?:^|(?<=[;\t\"]))([ ]*[+-]?\d{1,3}(?: \d{3})+)(?=[.,;\t\"\r\n]|$)", re.MULTILINE
)
# `0.010 s`, `-5.2°`.
_NUMBER_WITH_UNIT = re.compile(
    r"\s*\"?([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*([^\s\d\"][^\s\"]*)?\"?\s*"
)
DELIMITERS = (";", "\t", "|", ",", None)


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
    if values.dtype.kind == "M":
        return np.asarray((values - values[0]) / np.timedelta64(1, "ns"), dtype=float) * 1e-9
    if values.dtype.kind == "m":
        return np.asarray(values / np.timedelta64(1, "ns"), dtype=float) * 1e-9
    if values.dtype.kind not in "fiub":
        values = _of_texts(values, name, source)
    values = values.astype(np.float64)
    vast = np.flatnonzero(np.isfinite(values) & (np.abs(np.nan_to_num(values)) > LARGEST_NUMBER))
    if vast.size:
        raise RecordError(
            f"{source}: row {vast[0] + 1} of column {name} holds {values[vast[0]]:g}, too much for an "
            "oscillation or its time; scale it."
        )
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        raise RecordError(
            f"{source}: row {infinite[0] + 1} of column {name} is infinite ({infinite.size} such rows); "
            "cut them out, or keep the part between them."
        )
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
    return np.array([_number(value, name, row, source) for row, value in enumerate(values, 1)])


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


def _number(value: object, name: str, row: int, source: str) -> float:
    if value is None or is_missing(str(value)):
        return float("nan")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        # A whole number of 400 digits is infinite as a text.
        pass
    try:
        return float(str(value).replace(",", ".").replace(MINUS, "-"))
    except ValueError:
        raise RecordError(
            f"{source}: row {row} of column {name} holds {str(value)[:30]!r}, not a number; "
            "correct it or cut it out."
        ) from None


def plain_lines(text: str) -> list[str]:
    """Lines with numbers in place of labelled ones, their labels as a header, and decimal points in quotes.

    Parameters
    ----------
    text : str
        Of a file.
    """
    text = _without_groups(text.replace(MINUS, "-"))
    if _QUOTED_COMMA.search(text) and not _QUOTED_POINT.search(text):
        text = _QUOTED_COMMA.sub(r"\1.\2", text)
    if _FORTRAN.search(text):
        text = _FORTRAN.sub(r"\1E\2", text)
    lines = text.splitlines()
    # By a line in the middle: a logger may greet and say farewell.
    middle = lines[len(lines) // 2] if lines else ""
    for delimiter in DELIMITERS:
        labels = _labels(middle, delimiter)
        if labels is not None:
            rows = [_numbers(line, delimiter, labels) for line in lines]
            start = next(at for at, row in enumerate(rows) if row is not None)
            plain = [line if row is None else row for line, row in zip(lines, rows, strict=True)]
            return [*plain[:start], "\t".join(labels), *plain[start:]]
    return _without_units(lines, middle)


def _without_groups(text: str) -> str:
    """Text whose numbers are not parted in groups of three digits."""
    text = _OTHER_GROUPS.sub("", text)
    # `"5,123"` alone may be a decimal comma.
    if _QUOTED_BOTH.search(text):
        text = _QUOTED_GROUPS.sub(lambda match: match[1].replace(",", ""), text)
    # Between commas `0.123,45` is two numbers.
    if ";" in text or "\t" in text:
        text = _COMMA_GROUPS.sub(lambda match: match[1].replace(",", ""), text)
        text = _POINT_GROUPS.sub(lambda match: match[1].replace(".", ""), text)
        text = _BLANK_GROUPS.sub(lambda match: match[1].replace(" ", ""), text)
    return text


def _without_units(lines: list[str], middle: str) -> list[str]:
    """Lines whose cells have their units in the head instead, where each row has the same."""
    for delimiter in DELIMITERS[:-1]:
        if delimiter not in middle:
            continue
        units = _units(middle, delimiter)
        if units is None or not any(units):
            continue
        rows = [_bare(line, delimiter, units) for line in lines]
        start = next(at for at, row in enumerate(rows) if row is not None)
        head = lines[start - 1].split(delimiter) if start else []
        names = head if len(head) == len(units) else [""] * len(units)
        named = delimiter.join(
            f"{name.strip()} ({unit})" if unit else name for name, unit in zip(names, units, strict=True)
        )
        plain = [line if row is None else row for line, row in zip(lines, rows, strict=True)]
        return [*plain[: start - 1 if any(names) else start], named, *plain[start:]]
    return lines


def _units(line: str, delimiter: str) -> list[str] | None:
    """Known units behind the numbers of a line; None if a cell is anything else."""
    matches = [_NUMBER_WITH_UNIT.fullmatch(cell) for cell in line.split(delimiter)]
    if not all(matches):
        return None
    units = [match[2] or "" for match in matches if match is not None]
    known = [plain_unit(unit) in TIME_UNITS or is_known_unit(unit) for unit in units if unit]
    return units if all(known) else None


def _bare(line: str, delimiter: str, units: list[str]) -> str | None:
    """The numbers of a line with these units; else None."""
    cells = [_NUMBER_WITH_UNIT.fullmatch(cell) for cell in line.split(delimiter)]
    if not all(cells) or [cell[2] or "" for cell in cells if cell is not None] != units:
        return None
    return delimiter.join(cell[1] for cell in cells if cell is not None)


def _labels(line: str, delimiter: str | None) -> list[str] | None:
    """Labels of a line in which each cell has one."""
    matches = _named_numbers(line, delimiter)
    labels = [match[1] for match in matches if match is not None]
    return labels if labels and len(labels) == len(matches) == len(set(labels)) else None


def _named_numbers(line: str, delimiter: str | None) -> "list[re.Match[str] | None]":
    """Cells of a line, of JSON or not, as label and number."""
    return [_NAMED_NUMBER.fullmatch(item) for item in line.strip(" \t,{}[]").split(delimiter)]


def _numbers(line: str, delimiter: str | None, labels: list[str]) -> str | None:
    """The numbers of a line with these labels; else None."""
    if _labels(line, delimiter) != labels:
        return None
    matches = _named_numbers(line, delimiter)
    return "\t".join(match[2] for match in matches if match is not None)
