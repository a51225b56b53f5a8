"""A column of a file: its name, unit and numbers, also from texts, dates and times of the day."""

import re
from dataclasses import dataclass
from datetime import datetime, time as clock_time
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pandas as pd

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError
from sysid_trib.records import units as lab
from sysid_trib.records.signal import LARGEST_NUMBER
from sysid_trib.records.unit_tables import LAB_WORDS

# Clock from which a column counts (see `clock.CLOCKS`).
ClockKind = Literal["dates", "universal", "day", "stamps", "rows"]
# If the clock is set back more often than this, the rows are not in order of time.
MOST_SET_BACK = 20
MISSING_TEXTS = frozenset(LAB_WORDS["missing"])
DAY = 86400.0
# Minus sign in Swedish and Norwegian settings.
MINUS = "\u2212"
# `Z`, `+01:00` or `UTC` after a date.
_ZONE = re.compile(r"\d\s*(?:Z|UTC|GMT|[+-]\d\d:?\d\d)$", re.IGNORECASE)
_CLOCK_TIME = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:\.\d*)?)(?::(\d+))?(?:\s*([ap])\.?m\.?)?", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a file, or one computed by a formula from its columns.

    Attributes
    ----------
    name : str
        Name as in the file.
    cells : (row,) array
        Numbers, texts, dates, or times of the day.
    source : str
        Name of the file, for messages.
    base, stated : str
        Name in lower case without its unit, and the unit; empty if the file states none.
    """

    name: str
    cells: Any
    source: str
    base: str
    stated: str

    @classmethod
    def of_file(cls, name: str, cells: Any, source: str, unit: str = "") -> "Column":
        """Return a column from its header and a unit that the file states separately."""
        base, in_header = lab.split_header(name)
        # Keep the capitals of the header: `mT`, although `split_header` returns `mt`.
        at = name.lower().rfind(in_header)
        in_header = name[at : at + len(in_header)] if at >= 0 else in_header
        # Convert to the native byte order, because some later functions accept no other.
        cells = cells.astype(cells.dtype.newbyteorder("="), copy=False)
        return cls(name, cells, source, base, unit or in_header)

    @cached_property
    def numbers(self) -> Array:
        """Finite numbers, with dates and clock times in s; nan for missing values.

        Raises
        ------
        RecordError
            A text is not a number, or a value is infinite; the message states its row (from 1, below the
            header).
        """
        values = self.cells
        if self.holds_instants:
            values = self._instants
        if values.dtype.kind in "mM":
            elapsed = values - values[0] if values.dtype.kind == "M" else values
            return np.asarray(elapsed / np.timedelta64(1, "ns"), dtype=float) * 1e-9
        if values.dtype.kind not in "fiub":
            values = self._of_texts()
        values = values.astype(np.float64)
        wrong = np.flatnonzero(np.abs(values) > LARGEST_NUMBER)
        if wrong.size:
            row = wrong[0]
            infinite = np.isinf(values)
            said = f"contains {values[row]:g}, too much for an oscillation or its time; scale it."
            if infinite[row]:
                count = np.count_nonzero(infinite)
                said = f"is infinite ({count} such rows); cut them out, or keep the part between them."
            raise RecordError(f"{self.source}: row {row + 1} of column {self.name} {said}")
        return values

    @cached_property
    def holds_instants(self) -> bool:
        """True if its cells are dates of Python, pandas or NumPy."""
        instants = self.cells.dtype.kind == "O" and all(isinstance(value, datetime) for value in self.cells)
        return self.cells.dtype.kind == "M" or (instants and self.cells.size > 0)

    @cached_property
    def _instants(self) -> Any:
        """Dates; those with a time zone in UTC."""
        if self.cells.dtype.kind == "M":
            return self.cells
        return pd.to_datetime(pd.Index(self.cells), utc=True).tz_localize(None).to_numpy()

    @cached_property
    def first_instant(self) -> tuple[ClockKind, int]:
        """Clock from which its numbers count (see `clock.CLOCKS`), and its first instant (ns)."""
        if not self.is_dated or self.cells.dtype.kind == "m":
            return "stamps", 0
        if self.holds_instants:
            zoned = self.cells.dtype.kind == "O" and self.cells[0].tzinfo is not None
            first = pd.Timestamp(self._instants[0]).as_unit("ns").value
            return "universal" if zoned else "dates", int(first)
        texts = [str(value).strip().replace(",", ".") for value in self.cells]
        if _of_the_day(texts) is not None:
            return "day", 0
        dates = _as_dates(texts[:1])
        if dates is None:
            return "stamps", 0
        return "universal" if _ZONE.search(texts[0]) else "dates", int(dates.as_unit("ns")[0].value)

    def _of_texts(self) -> Array:
        if self.is_dated:
            texts = [str(value).strip().replace(",", ".") for value in self.cells]
            seconds = _of_the_day(texts)
            seconds = _of_dates(texts) if seconds is None else seconds
            if seconds is not None:
                return seconds
        values = []
        for row, value in enumerate(self.cells, 1):
            try:
                text = str(value).replace(",", ".").replace(MINUS, "-")
                values.append(np.nan if is_missing(text) else float(text))
            except ValueError:
                wrong = f"{self.source}: row {row} of column {self.name} contains {str(value)[:30]!r}"
                raise RecordError(f"{wrong}, not a number; correct it or cut it out.") from None
        return np.array(values)

    @cached_property
    def signal(self) -> tuple[Array, str]:
        """Its numbers with nan in place of sentinels such as -999, and a sentence on them.

        A sentinel is one of the usual values, if no other value comes near it.
        """
        # Values that loggers write for missing data: at least twice as large as any other value.
        for sentinel in (-999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, -999.25):
            marked = self.numbers == sentinel
            others = np.abs(self.numbers[~marked & np.isfinite(self.numbers)])
            if marked.any() and others.size and abs(sentinel) > 2.0 * others.max():
                said = f"{np.count_nonzero(marked)} values of {sentinel:g} taken as missing"
                return np.where(marked, np.nan, self.numbers), said
        return self.numbers, ""

    @property
    def values(self) -> Array:
        """Its numbers as a signal."""
        return self.signal[0]

    @cached_property
    def amplitude(self) -> float:
        """Largest deviation to either side, apart from a few samples."""
        return 0.5 * float(np.ptp(np.nanpercentile(self.values, [0.5, 99.5])))

    @property
    def unit_text(self) -> str:
        """Name of the unit that the file states; empty without one."""
        return self.unit.text if self.unit else ""

    @property
    def unit(self) -> lab.SignalUnit | None:
        """Unit that the file states; None without one."""
        return lab.signal_unit(self.stated)

    @property
    def quantity(self) -> str:
        """Measured quantity from its unit, or else from the usual meaning of its name; may be empty."""
        return self.unit.quantity if self.unit and self.unit.known else lab.names_quantity(self.base)

    @cached_property
    def is_numeric(self) -> bool:
        """True if it could contain a signal: most of its first cells are numbers."""
        # Number of first rows that determine the kind of a column.
        first = self.cells[:1000].tolist()
        plain = self.is_plain or self.cells.dtype.kind == "b"
        return plain or (not self.is_dated and sum(map(is_number, first)) * 2 > len(first))

    @cached_property
    def is_dated(self) -> bool:
        """True if it contains dates, durations or times of the day, such as `12:00:01.250`."""
        first = [value for value in self.cells[:5] if value == value and value is not None]
        dated = [isinstance(v, (datetime, clock_time)) or (isinstance(v, str) and ":" in v) for v in first]
        return self.cells.dtype.kind in "Mm" or (bool(dated) and all(dated))

    @property
    def is_level(self) -> bool:
        """True if it contains levels in dB, by its unit or its name."""
        return lab.is_level(self.stated) or (not self.stated and lab.is_level(self.base))

    @property
    def is_plain(self) -> bool:
        """True if the file stores it as numbers."""
        return self.cells.dtype.kind in "fiu"

    @property
    def is_empty(self) -> bool:
        """True if it is empty, as a time column that a logger does not fill."""
        return self.cells.dtype.kind == "f" and not np.isfinite(self.cells).any()

    @cached_property
    def is_time(self) -> bool:
        """True if its header is that of a time; a name such as `t run 2` counts only if the column rises."""
        unit = lab.plain_unit(self.stated)
        if lab.is_time(self.base, unit) or self.is_dated:
            return True
        like = re.match(r"(?:time|t|zeit)\b", self.base) is not None
        # A time column of a group, such as `plate t`.
        of_group = self.base.endswith((" time", " t", " zeit"))
        return self.rises and (unit in lab.TIME_UNITS and of_group if unit else like or of_group)

    @property
    def counts_rows(self) -> bool:
        """True if its header is that of a row number, such as `frame`."""
        return self.base in LAB_WORDS["counter"] or self.stated in LAB_WORDS["counted"]

    @cached_property
    def rises(self) -> bool:
        """True if it never decreases, and increases somewhere."""
        if not self.is_plain:
            return False
        steps = np.diff(self.cells[np.isfinite(self.cells)].astype(float))
        return bool(steps.size and np.all(steps >= 0) and np.any(steps > 0))

    @property
    def starts_anew(self) -> bool:
        """True if it rises and returns to its start a few times, once for each run."""
        if not self.is_plain or not np.isfinite(self.cells).all():
            return False
        column = self.cells.astype(float)
        back = np.flatnonzero(np.diff(column) <= 0.0) + 1
        # Runs below each other start within this fraction of the range of times.
        begins = np.abs(column[back] - column[0]) <= 0.01 * np.ptp(column)
        return bool(0 < back.size <= MOST_SET_BACK and begins.all())


def is_missing(text: str) -> bool:
    """Return true if a text is a missing value: empty, a usual word, or without letters and digits."""
    plain = text.strip().lower()
    return plain in MISSING_TEXTS or not any(map(str.isalnum, plain))


def is_number(value: object) -> bool:
    """Return true if a text is a number, with a decimal point or comma."""
    try:
        float(str(value).replace(",", ".", 1).replace(MINUS, "-"))
    except ValueError:
        return False
    return True


def _of_the_day(texts: list[str]) -> Array | None:
    """Return seconds of times, `14:02:33.120`, `02:33.12` (m:s), `2:02:33 PM`, `00:02:33:120`, or None.

    Behind a third colon are thousandths; of two digits in every row hundredths, or frames.
    """
    matches = [_CLOCK_TIME.fullmatch(text) for text in texts]
    if not all(matches):
        return None
    parts = _parts_of_a_second([match[4] for match in matches if match and match[4]])
    seconds = np.array([_seconds(match, parts) for match in matches if match])
    # A new day starts where the clock jumps back by more than half a day.
    return seconds + DAY * np.cumsum(np.diff(seconds, prepend=seconds[0]) < -0.5 * DAY)


def _parts_of_a_second(texts: list[str]) -> int:
    """Return the number of parts behind a third colon that make a second."""
    if {len(text) for text in texts} != {2}:
        return 1000
    count = 1 + max(map(int, texts))
    # Frames of video, if every one is there.
    return count if count in (24, 25, 30, 50, 60) and len({*texts}) == count else 100


def _seconds(match: "re.Match[str]", parts: int) -> float:
    hours, minutes, seconds, last, half = match.groups()
    hour = int(hours or 0)
    if half:
        hour = hour % 12 + (12 if half.lower().startswith("p") else 0)
    return 3600.0 * hour + 60.0 * int(minutes) + float(seconds) + int(last or 0) / parts


def _of_dates(texts: list[str]) -> Array | None:
    """Return seconds since the first of some dates, also `2024-03-01 12:00:01:250`; None if they are none."""
    dates = _as_dates(texts)
    return None if dates is None else np.asarray((dates - dates[0]).total_seconds(), dtype=float)


def _as_dates(texts: list[str]) -> pd.DatetimeIndex | None:
    """Parse dates in UTC; dates without a time zone are read as UTC. Return None if they are no dates."""
    texts = [re.sub(r"(:\d\d:\d\d):(?=\d+$)", r"\1.", text) for text in texts]
    for style in ("ISO8601", "mixed"):
        try:
            return pd.to_datetime(texts, format=style, utc=True)
        except (ValueError, OverflowError):
            continue
    return None
