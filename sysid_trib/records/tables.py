"""A file as a table: columns with their names, units and numbers, and what else it says."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, UsageError, did_you_mean
from sysid_trib.records import units as lab
from sysid_trib.records.formats import read_lines, reader_of
from sysid_trib.records.numbers import is_clock_time, is_numeric, numbers
from sysid_trib.records.probe import check_binary
from sysid_trib.records.text import check_width

# A clock that is set back this often is none: the rows are in no order.
MOST_SET_BACK = 20
# Columns that a refusal lists.
LISTED = 12


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a file, or one that a formula makes of its columns.

    Attributes
    ----------
    name : str
        As the file has it.
    cells : (row,) array
        Numbers, texts, dates, or times of the day.
    source : str
        Name of the file, for messages.
    base, stated : str
        Name in lower case without its unit, and that unit; nothing where the file states none.
    """

    name: str
    cells: NDArray[Any]
    source: str
    base: str
    stated: str

    @classmethod
    def of_file(cls, name: str, cells: Any, source: str, unit: str = "") -> "Column":
        """A column by its header, and the unit that the file states apart from it."""
        base, in_header = lab.split_header(name)
        # With the capitals that the header has: `mT`, where `split_header` says `mt`.
        at = name.lower().rfind(in_header)
        in_header = name[at : at + len(in_header)] if at >= 0 else in_header
        # In the machine's own order of bytes: not all that follows knows the other one.
        return cls(
            name, cells.astype(cells.dtype.newbyteorder("="), copy=False), source, base, unit or in_header
        )

    @cached_property
    def numbers(self) -> Array:
        """Its numbers (see `numbers`)."""
        return numbers(self.cells, self.name, self.source)

    @property
    def unit(self) -> lab.SignalUnit | None:
        """Unit that the file states of it; None where it states none."""
        return lab.signal_unit(self.stated)

    @property
    def quantity(self) -> str:
        """What is measured in its unit, or what its name usually means; or nothing."""
        return self.unit.quantity if self.unit and self.unit.known else lab.names_quantity(self.base)

    @cached_property
    def is_numeric(self) -> bool:
        """True if it could hold a signal."""
        return is_numeric(self.cells)

    @cached_property
    def is_dated(self) -> bool:
        """True if it holds dates, or times of the day."""
        return is_clock_time(self.cells)

    @property
    def is_plain(self) -> bool:
        """True if the file has it as numbers."""
        return self.cells.dtype.kind in "fiu"

    @property
    def is_empty(self) -> bool:
        """True if it holds nothing, as that of the times where a logger leaves them out."""
        return self.cells.dtype.kind == "f" and not np.isfinite(self.cells).any()

    @cached_property
    def is_time(self) -> bool:
        """True if it is one of times by its header; `t run 2`, `host time (s)` only if it rises."""
        unit = lab.plain_unit(self.stated)
        if lab.is_time(self.base, unit) or self.is_dated:
            return True
        like = re.match(r"(?:time|t|zeit)\b", self.base) is not None
        return self.rises and (unit in lab.TIME_UNITS and self.base.endswith(" time") if unit else like)

    @property
    def counts_rows(self) -> bool:
        """True if its header is that of a number of the row, such as `frame`."""
        return self.base in lab.LAB_WORDS["counter"]

    @cached_property
    def rises(self) -> bool:
        """True if it never falls, and rises at all."""
        if not self.is_plain:
            return False
        steps = np.diff(self.cells[np.isfinite(self.cells)].astype(float))
        return bool(steps.size and np.all(steps >= 0) and np.any(steps > 0))

    @property
    def starts_anew(self) -> bool:
        """True if it rises and starts anew where it began, for each of a few runs."""
        if not self.is_plain or not np.isfinite(self.cells).all():
            return False
        column = self.cells.astype(float)
        back = np.flatnonzero(np.diff(column) <= 0.0) + 1
        # Of the range of times: runs below each other begin as near to each other as this.
        begins = np.abs(column[back] - column[0]) <= 0.01 * np.ptp(column)
        return bool(0 < back.size <= MOST_SET_BACK and begins.all())


@dataclass(frozen=True, eq=False)
class FileTable:
    """What a file holds.

    Attributes
    ----------
    source : str
        Its name, for messages.
    columns : tuple of Column
        In the order of the file.
    notes : tuple of str
        What else it says: comment lines, texts and scalars as `name = value`.
    """

    source: str
    columns: tuple[Column, ...]
    notes: tuple[str, ...] = ()

    @cached_property
    def rate(self) -> float | None:
        """Sampling rate (Hz) that its notes state, or that its rows have over a duration they state."""
        return lab.noted_rate(self.notes, max(column.cells.size for column in self.columns))

    @cached_property
    def times(self) -> list[Column]:
        """Columns of time: by their headers, else the first one that rises throughout."""
        filled = [column for column in self.columns if not column.is_empty]
        named = [column for column in filled if column.is_time]
        if named or len(filled) == 1:
            return named
        first = [column for column in filled if column.is_plain][:3]
        rising = [column for column in first if column.rises and not column.counts_rows]
        if not rising and filled and filled[0].starts_anew:
            return filled[:1]
        # A number of the row stands before the time.
        if len(rising) > 1 and len(filled) > 2 and np.median(np.diff(rising[0].cells.astype(float))) == 1:
            return rising[1:2]
        return rising[:1]

    def match(self, wanted: str | int | None) -> Column | None:
        """The column of that name, or else of that number from 0; None if there is no single one."""
        text = str(wanted)
        for matches in (
            [column for column in self.columns if column.name == wanted],
            [column for column in self.columns if column.base == text.strip().lower()],
            [column for column in self.columns if column.name.startswith((f"{text}[", f"{text}."))],
        ):
            if len(matches) == 1 and isinstance(wanted, str):
                return matches[0]
        if re.fullmatch(r"[0-9]{1,9}", text) and int(text) < len(self.columns):
            return self.columns[int(text)]
        return None

    def find(self, wanted: str | int) -> Column:
        """The column of that name, or else of that number from 0.

        Raises
        ------
        UsageError
            There is none; all are listed.
        """
        found = self.match(wanted)
        if found is None:
            names = [*(column.name for column in self.columns), *(column.base for column in self.columns)]
            raise UsageError(
                f"{self.source}: there is no single column {str(wanted)!r}; its columns are {self.listed}."
                f"{did_you_mean(str(wanted), names)}"
            )
        return found

    @property
    def listed(self) -> str:
        """Its columns with their numbers, the time's among them."""
        names = [f"{number}: {column.name}" for number, column in enumerate(self.columns)]
        return ", ".join([*names[:LISTED], *["..."] * (len(names) > LISTED)])

    @property
    def no_clock(self) -> str:
        """Why there are no times, and what to give."""
        over = [column.name for column in self.columns if column.base.startswith("freq")]
        if over:
            why = f"its columns are over {over[0]}, not over time: it is a response; a record is needed."
            return f"{self.source}: {why}"
        taken = next((f" but {time.name}, which --angle takes" for time in self.times), "")
        return (
            f"{self.source}: there is no time column{taken}; give the sampling rate (--sampling-rate HZ). "
            f"Its columns are {self.listed}."
        )


def read_table(path: Path, source: str) -> FileTable:
    """Read every column of a file.

    Parameters
    ----------
    path : path
        The file; its content decides how it is read.
    source : str
        Its name, for messages.

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        The file is empty, binary, truncated or holds no table; the message names it.
    """
    check_is_file(path)
    try:
        reader = reader_of(path)
        if reader is not read_lines:
            check_binary(path, reader.__name__)
        cells, units, notes = reader(path)
    except (RecordError, UsageError):
        raise
    except ImportError as error:
        package = f"the package {error.name}" if error.name else "a further package"
        raise RecordError(
            f"{path.name}: to read this format {package} is needed; install it with "
            "pip install pyarrow npTDMS."
        ) from error
    except PermissionError:
        raise RecordError(f"{path}: you may not read this file; change its permissions.") from None
    # Readers of foreign formats meet a damaged file with any exception at all.
    except Exception as error:
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise RecordError(f"{path.name}: cannot be read, it seems damaged or cut off ({reason}).") from error
    check_width(path, len(cells))
    arrays = {name: np.asarray(values) for name, values in cells.items()}
    columns = tuple(
        Column.of_file(name, values, source, units.get(name, ""))
        for name, values in arrays.items()
        if not _is_nested(values)
    )
    if not any(column.cells.size for column in columns):
        raise RecordError(f"{path.name}: there are no numbers in it.")
    return FileTable(source, columns, tuple(notes))


def _is_nested(values: NDArray[Any]) -> bool:
    """True if the cells of a column are lists, as netCDF and Parquet can have them."""
    return values.dtype.kind == "O" and any(isinstance(cell, np.ndarray | list | dict) for cell in values)


def check_is_file(path: Path) -> None:
    """Refuse what cannot be read, or what would be waited for without end.

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        It is a folder, a pipe or a device.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        raise UsageError(f"{path}: there is no such file.") from None
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror}); name another file.") from None
    if path.is_dir():
        raise RecordError(f"{path}: this is a directory; name a file in it.")
    if not path.is_file():
        raise RecordError(
            f"{path}: this is a pipe or a device, not a file; save what it gives as a file first."
        )
