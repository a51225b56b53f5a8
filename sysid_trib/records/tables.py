"""A file as a table: columns with their names, units and numbers, and further statements of the file."""

import gzip
import hashlib
import os
import re
import sys
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Any, cast
from zipfile import BadZipFile, ZipFile

import numpy as np

from sysid_trib.errors import RecordError, UsageError, did_you_mean, readable
from sysid_trib.records import archives, formats, text, units as lab
from sysid_trib.records.column import Column, is_number
from sysid_trib.records.probe import check_binary
from sysid_trib.records.row_order import in_order
from sysid_trib.records.split_clock import with_joined_clock

STANDARD_INPUT = "-"
# Bytes; larger content is not a record but a decompression bomb.
LARGEST_CONTENT = 2**30
# Largest number of columns that an error lists.
LISTED = 12


@dataclass(frozen=True, eq=False)
class FileTable:
    """Contents of a file.

    Attributes
    ----------
    source : str
        Name of the file, for messages.
    columns : tuple of Column
        Columns in the order of the file.
    notes : tuple of str
        Notes of the file: comment lines, texts and scalars as `name = value`.
    checksum : str
        SHA-256 of the content.
    said : tuple of str
        Sentences on changes of its rows.
    """

    source: str
    columns: tuple[Column, ...]
    notes: tuple[str, ...]
    checksum: str
    said: tuple[str, ...] = ()

    @cached_property
    def rate(self) -> float | None:
        """Sampling rate (Hz) that its notes state, or that follows from a stated duration."""
        rows = max(column.cells.size for column in self.columns)
        return lab.noted_rate(self.notes, rows) or lab.bare_rate(self.notes, rows)

    @cached_property
    def times(self) -> list[Column]:
        """Columns of time: by their headers, else the first one that increases throughout."""
        filled = [column for column in self.columns if not column.is_empty]
        named = [column for column in filled if column.is_time]
        if named or len(filled) == 1:
            return named
        first = [column for column in filled if column.is_plain][:3]
        rising = [column for column in first if column.rises and not column.counts_rows]
        if not rising and filled and filled[0].starts_anew:
            return filled[:1]
        # A row number precedes the time.
        if len(rising) > 1 and len(filled) > 2 and np.median(np.diff(rising[0].cells.astype(float))) == 1:
            rising = rising[1:]
        return self._of_the_name(rising[0]) if rising else []

    def _of_the_name(self, first: Column) -> list[Column]:
        """Return a time column, and later columns of its name: each run side by side has its own."""
        bare = _without_number(first.base)
        if not bare:
            return [first]
        after = self.columns[self.columns.index(first) + 1 :]
        return [first, *(c for c in after if c.rises and _without_number(c.base) == bare)]

    def match(self, wanted: str | int | None) -> Column | None:
        """Return the column with this name, or else this number from 0; None if there is no single one."""
        name = str(wanted)
        for matches in (
            [column for column in self.columns if column.name == wanted],
            [column for column in self.columns if column.base == name.strip().lower()],
            [column for column in self.columns if column.name.startswith((f"{name}[", f"{name}."))],
        ):
            if len(matches) == 1 and isinstance(wanted, str):
                return matches[0]
        if re.fullmatch(r"[0-9]{1,9}", name) and int(name) < len(self.columns):
            return self.columns[int(name)]
        return None

    def find(self, wanted: str | int) -> Column:
        """Return the column with this name, or else with this number from 0.

        Raises
        ------
        UsageError
            There is no such column; the message lists all.
        """
        column = self.match(wanted)
        if column is None:
            names = [*(column.name for column in self.columns), *(column.base for column in self.columns)]
            wrong = f"{self.source}: there is no single column {str(wanted)!r}"
            raise UsageError(f"{wrong}; its columns are {self.listed}.{did_you_mean(str(wanted), names)}")
        return column

    @property
    def listed(self) -> str:
        """Columns with numbers, including those of time."""
        names = [f"{number}: {column.name}" for number, column in enumerate(self.columns)]
        return ", ".join([*names[:LISTED], *["..."] * (len(names) > LISTED)])

    @property
    def no_clock(self) -> str:
        """Message that there are no times, and what to give."""
        over = [column.name for column in self.columns if column.base.startswith("freq")]
        if over:
            why = f"its columns are over {over[0]}, not over time. Give a record over time."
            return f"{self.source}: {why}"
        taken = next((f" but {time.name}, which --angle takes" for time in self.times), "")
        return (
            f"{self.source}: there is no time column{taken}; give the sampling rate (--sampling-rate HZ). "
            f"Its columns are {self.listed}."
        )


def _without_number(base: str) -> str:
    """Remove the number or letter by which a name differs from similar names: `timed 2`, `stamp b`."""
    return re.sub(r"[ _.#]?\d+$|[ _][a-d]$", "", base)


def read_table(path: Path) -> FileTable:
    """Read every column of a file, of the content of a .gz or, for the path `-`, of standard input.

    Parameters
    ----------
    path : path
        The file; its content decides how it is read.

    Raises
    ------
    UsageError
        There is no such file.
    RecordError
        The file is empty, binary, truncated, too large, or contains no table; the message names it.
    """
    with _opened(path) as file:
        source = readable(path.name if str(path) != STANDARD_INPUT else file.name)
        cells, units, notes, sentences = _contents(file)
        arrays = {name: np.asarray(values) for name, values in cells.items()}
        longest = max((array.shape[0] for array in arrays.values() if array.ndim), default=0)
        text.check_width(file, len(cells), longest)
        kept = [(name, values) for name, values in arrays.items() if not _is_nested(values)]
        columns = tuple(Column.of_file(*named, source, units.get(named[0], "")) for named in kept)
        if not any(column.cells.size for column in columns):
            raise RecordError(f"{file.name}: there are no numbers in it.")
        columns, of_clock = with_joined_clock(columns)
        columns, said = in_order(columns)
        checksum = hashlib.sha256(file.read_bytes()).hexdigest()
        said = [*sentences, *of_clock, *said, *_without_numbers(columns)]
        return FileTable(source, columns, tuple(notes), checksum, tuple(said))


def _without_numbers(columns: Sequence[Column]) -> list[str]:
    """Return a sentence on the columns that have a name but no number, if there are some."""
    # Names that the reader gave, `#3`, and numbers, are those of columns that the file does not name.
    names = [
        column.name
        for place, column in enumerate(columns)
        if column.is_empty
        and not column.name.startswith("#")
        and (column.name == str(place) or not is_number(column.name))
    ]
    if not names:
        return []
    said = (
        f"column {names[0]} contains" if len(names) == 1 else f"columns {', '.join(names[:LISTED])} contain"
    )
    return [f"{said} no number, left out"]


def _contents(path: Path) -> formats.Contents:
    try:
        reader = formats.reader_of(path)
        if reader is not formats.read_lines:
            check_binary(path, reader.__name__)
        return reader(path)
    except (RecordError, UsageError):
        raise
    except ImportError as error:
        package = f"the package {error.name}" if error.name else "a further package"
        raise RecordError(
            f"{path.name}: to read this format {package} is needed: pip install pyarrow npTDMS."
        ) from error
    # Readers of foreign formats may raise any exception for a damaged file.
    except Exception as error:
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise RecordError(f"{path.name}: cannot be read, it seems damaged or cut off ({reason}).") from error


def _is_nested(values: Any) -> bool:
    """Return true if the cells of a column are lists, which netCDF and Parquet allow."""
    return values.dtype.kind == "O" and any(isinstance(cell, np.ndarray | list | dict) for cell in values)


def check_is_file(path: Path) -> None:
    """Raise an error for a path that cannot be read, or whose reading would never end.

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
        raise RecordError(f"{path}: this is a pipe or a device; save what it gives as a file first.")
    if not os.access(path, os.R_OK):
        raise RecordError(f"{path}: you may not read this file; change its permissions.")


@contextmanager
def _opened(path: Path) -> Iterator[Path]:
    """Yield the file; for `-` the standard input, for a .gz or .zip its content, each as a temporary copy.

    Raises
    ------
    RecordError
        The file is damaged, its content is too large or holds several files, or the disk is full.
    """
    with ExitStack() as stack:
        packed = _unpacked(path, stack)
        if packed is None:
            yield path
            return
        name, source = packed
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            copy = Path(folder) / (Path(name).name.strip(".") or "content")
            with copy.open("wb") as target:
                for part in _parts(source, name):
                    target.write(part)
        except OSError as error:
            why = error.strerror or error
            wrong = f"{name}: no copy of it can be written to the temporary folder ({why})"
            raise RecordError(f"{wrong}; make space there, or set TMPDIR.") from None
        yield copy


def _parts(source: IO[bytes], name: str) -> Iterator[bytes]:
    """Yield the content of a packed file in parts."""
    size = 0
    while True:
        try:
            part = source.read(2**20)
        except (OSError, EOFError, ValueError, NotImplementedError, zlib.error, BadZipFile) as error:
            raise RecordError(f"{name}: cannot be unpacked, it seems damaged ({error}).") from None
        if not part:
            return
        size += len(part)
        if size > LARGEST_CONTENT:
            raise RecordError(f"{name}: contains more than {LARGEST_CONTENT:,} bytes: no record does.")
        yield part


def _unpacked(path: Path, stack: ExitStack) -> tuple[str, IO[bytes]] | None:
    """Return the name and content of what is not a plain file: standard input, .gz, .zip; else None."""
    if str(path) == STANDARD_INPUT:
        return "standard input", sys.stdin.buffer
    check_is_file(path)
    with path.open("rb") as file:
        start = file.read(2)
    if start == b"\x1f\x8b":
        return path.name.removesuffix(".gz"), cast(IO[bytes], stack.enter_context(gzip.open(path)))
    member = archives.single_file(path) if start == b"PK" else None
    if member is None:
        return None
    archive = stack.enter_context(ZipFile(path))
    return readable(member.filename), stack.enter_context(archive.open(member))
