"""Tables of numbers in text, whatever its delimiter, decimal sign, header and comments; and in JSON."""

import csv
import json
import re
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import pandas as pd

from sysid_trib.errors import RecordError
from sysid_trib.records.numbers import DELIMITERS, is_missing, is_number, plain_lines
from sysid_trib.records.units import TIME_UNITS, is_known_unit, plain_unit

FORMATS = "text, CSV or JSON, MATLAB, NumPy, Excel (.xlsx), netCDF, HDF5, Parquet, TDMS"
WIDEST_TABLE = 4096
# Rows in which facts may stand next to the numbers.
MOST_FACTS = 40


def read_text(path: Path) -> tuple[pd.DataFrame, list[str] | None, list[str]]:
    """Rows of numbers of a text file, the names of their columns if it states them, and the lines above.

    Parameters
    ----------
    path : path
        The file.

    Raises
    ------
    RecordError
        Binary content, or no numbers.
    """
    content = path.read_bytes()
    wide = ""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        wide = "utf-16"
    elif content[:MOST_FACTS].count(b"\0") == MOST_FACTS // 2:
        # Without its mark: every second byte of plain letters is zero.
        wide = "utf-16-le" if content[1:2] == b"\0" else "utf-16-be"
    markup = re.match(rb"[\xef\xbb\xbf\s]*<[?!]?(\w+)", content)
    if markup is not None:
        kind = "a web page" if markup[1].lower() in (b"html", b"doctype") else "XML"
        raise RecordError(f"{path.name}: this is {kind}, not a table; export the data as CSV or .xlsx.")
    if not wide and b"\0" in content:
        raise RecordError(
            f"{path.name}: binary content, but none of the formats that can be read ({FORMATS})."
        )
    try:
        text = content.decode(wide or "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = plain_lines(text)
    delimiter, start = _find_block(lines)
    if start is None:
        raise RecordError(f"{path.name}: no rows of numbers were found in it (other formats: {FORMATS}).")
    # The last cell of the first row may be empty.
    width = max(len(_fields(line, delimiter)) for line in lines[start : start + 2])
    check_width(path, width)
    header = _header(lines[:start], delimiter, width)
    commas = any("," in line for line in lines[start : start + 50])
    decimal = "," if commas and delimiter != "," else "."
    if delimiter == "," and header and len(header) == 1:
        delimiter, decimal = None, ","
    # A logger that is started anew writes its head again.
    head = {line.strip() for line in lines[max(0, start - 2) : start]}
    block = [line for line in lines[start:] if line.strip() not in head | {""} and not _is_comment(line)]
    # What a logger writes below the numbers is no row of them.
    usual = _fields(block[0], delimiter)
    while len(block) > 1 and _is_summary(_fields(block[-1], delimiter), usual):
        block.pop()
    frame = pd.read_csv(
        StringIO("\n".join(block)),
        sep=delimiter or r"\s+",
        decimal=decimal,
        header=None,
        skipinitialspace=True,
        low_memory=False,
    )
    # A delimiter at the end of every line makes an empty last column.
    if frame.shape[1] > 1 and frame.iloc[:, -1].isna().all():
        frame = frame.iloc[:, :-1]
    named = header is not None and len(header) >= frame.shape[1]
    return frame, header if named else None, [*lines[:start], *_texts_in(frame)]


def _texts_in(frame: pd.DataFrame) -> list[str]:
    """What columns of texts hold next to the first numbers, as an oscilloscope's facts."""
    texts = frame.head(MOST_FACTS).select_dtypes(exclude="number")
    return [" ".join(str(cell) for cell in row if cell == cell) for row in texts.to_numpy()]


def check_width(path: Path, columns: int) -> None:
    """Refuse a table of far more columns than any record has.

    Raises
    ------
    RecordError
        With how many there are.
    """
    if columns > WIDEST_TABLE:
        raise RecordError(
            f"{path.name}: has {columns:,} columns; a record has a few, and a row for each "
            "sample: turn the table, or cut it."
        )


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%", "//", "!"))


def _is_summary(row: list[str], usual: list[str]) -> bool:
    """True if a row holds a text where the others hold a number."""
    numbers = [is_number(item) for item in usual]
    texts = [not is_missing(item) and not is_number(item) for item in row]
    return not any(map(is_number, row)) or any(a and b for a, b in zip(numbers, texts, strict=False))


def _fields(line: str, delimiter: str | None) -> list[str]:
    # An empty first cell is one.
    line = line.strip(" \r\n") if delimiter == "\t" else line.strip()
    parts = line.split(delimiter)
    if '"' in line and delimiter is not None:
        parts = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), parts)
    fields = [item.strip().strip("\"'").strip() for item in parts]
    return fields[:-1] if len(fields) > 1 and not fields[-1] else fields


def _find_block(lines: list[str]) -> tuple[str | None, int | None]:
    """Delimiter and first line of the numbers: the first line that is numbers alone, or else partly."""
    for enough in (_all_numbers, _some_numbers):
        for start, line in enumerate(lines):
            if not line.strip() or _is_comment(line):
                continue
            for delimiter in DELIMITERS:
                if delimiter is not None and delimiter not in line:
                    continue
                fields = _fields(line, delimiter)
                if enough(fields) and _goes_on(lines[start + 1 : start + 9], delimiter, fields):
                    return delimiter, _first_row(lines, delimiter, start, len(fields))
    return None, None


def _all_numbers(fields: list[str]) -> bool:
    """True if cells are numbers; the first one may be empty."""
    return is_number(fields[-1]) and all(not item or is_number(item) for item in fields)


def _some_numbers(fields: list[str]) -> bool:
    return any(map(is_number, fields))


def _goes_on(lines: list[str], delimiter: str | None, fields: list[str]) -> bool:
    """True if the next row has as many fields: a lone number above the header is no row."""
    rows = [line for line in lines if line.strip() and not _is_comment(line)]
    if not rows:
        return True
    if len(fields) == 1:
        return not any(sign in rows[0] for sign in ",;\t")
    return len(_fields(rows[0], delimiter)) == len(fields)


def _first_row(lines: list[str], delimiter: str | None, start: int, width: int) -> int:
    """Go back over rows that are numbers by half, or where others are: bad data or facts, not a header."""
    usual = [at for at, item in enumerate(_fields(lines[start], delimiter)) if is_number(item)]
    while start > 0 and not _is_comment(lines[start - 1]):
        fields = _fields(lines[start - 1], delimiter)
        if len(fields) < width:
            # The last cell may be empty.
            fields = lines[start - 1].split(delimiter)
        if len(fields) != width:
            break
        numeric = [is_number(item) for item in fields]
        if 2 * sum(numeric) < width and not (len(usual) > 1 and all(numeric[at] for at in usual)):
            break
        start -= 1
    return start


def _header(before: list[str], delimiter: str | None, width: int) -> list[str] | None:
    """Names from the lines above the numbers, a line of units below them included."""
    header: list[list[str]] = []
    # A line of dashes below the names is none of them.
    for line in reversed([line for line in before if any(map(str.isalnum, line)) or "°" in line][-2:]):
        text = line.lstrip("#%/! \t") if _is_comment(line) else line
        separator = "," if delimiter is None and "," in text else delimiter
        fields = _fields(text, separator)
        if delimiter is None and len(fields) != width:
            # `Time (s)   Angle (deg)`; `time.angle`
            apart = (re.split(r"\s{2,}|\t", text.strip()), text.strip().split("."))
            fields = next((split for split in apart if len(split) == width), fields)
        # A last column of comments may be empty throughout.
        wider = not header and delimiter is not None and len(fields) > width
        if len(fields) != width and not wider and not (len(fields) == 1 and delimiter == ","):
            break
        # Letters of a column's name.
        header.append([field[:1000] for field in fields])
    return header_names(header[::-1])


def header_names(rows: list[list[str]]) -> list[str] | None:
    """Names of columns from the last rows above the numbers, two at most; the last may hold units alone.

    Parameters
    ----------
    rows : list of list of str
        In the order of the file.
    """
    if not rows:
        return None
    last, above = rows[-1], rows[-2] if len(rows) > 1 else []
    bracketed = any(last) and all(re.fullmatch(r"[\[(].*[\])]|", item) for item in last)
    named = len(above) == len(last) and not any(map(is_number, above)) and bool(above and above[-1])
    if named and (bracketed or _are_units(last, known=False)):
        units = [item if bracketed or not item else f"({item})" for item in last]
        return [f"{name} {unit}".strip() for unit, name in zip(units, above, strict=True)]
    if _are_units(last):
        return [f"{'time' if plain_unit(item) in TIME_UNITS else 'signal'} ({item})" for item in last]
    return last


def _are_units(items: list[str], known: bool = True) -> bool:
    """True if a line holds units alone, one of them that of time; all of them known, or another one."""
    # Sketches call their columns so.
    if {"millis", "micros"} & {item.lower() for item in items}:
        return False
    times = [item for item in items if plain_unit(item) in TIME_UNITS]
    others = [is_known_unit(item) for item in items if item and item not in times]
    enough = all if known else any
    return bool(times) and len(items) > 1 and enough(others)


def json_content(path: Path) -> Any:
    """What a file of JSON holds, an object a line or not; None of any other one."""
    content = path.read_bytes().removeprefix(b"\xef\xbb\xbf").strip()
    if not content.startswith((b"{", b"[")) or not content.endswith((b"}", b"]")):
        return None
    try:
        return json.loads(content)
    except RecursionError:
        return None
    except ValueError:
        lines = content.splitlines()
    try:
        # Where the first line is whole, the others are rows too.
        return [json.loads(line) for line in lines if line.strip()] if len(lines) > 1 else None
    except (ValueError, RecursionError):
        return None


def json_columns(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Columns by name, as `run.theta`.

    Parameters
    ----------
    value : dict, list or scalar
        Of `json.loads`.
    name : str
        Of the group that holds it.
    """
    if isinstance(value, dict):
        table = _split_table(value)
        if table is None and value and all(key.isdigit() for key in value):
            table = list(value.values())
        if table is not None:
            yield from json_columns(table, name)
            return
        for key, item in value.items():
            yield from json_columns(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        frame = pd.json_normalize(value)
        for column in frame.columns:
            yield (f"{name}.{column}" if name else str(column)), frame[column].to_numpy()
    elif isinstance(value, list) and value and all(isinstance(item, list) for item in value):
        # Rows, or a few columns.
        frame = pd.DataFrame(value)
        for at, column in (frame if len(frame) >= frame.shape[1] else frame.T).items():
            yield f"{name or 'data'}[{at}]", column.to_numpy()
    elif isinstance(value, list) and value:
        yield name or "data", pd.Series(value).to_numpy()


def _split_table(value: dict[str, Any]) -> list[dict[str, Any]] | None:
    """Rows of `{"columns": [names], "data": [rows]}`, as pandas writes them."""
    names, rows = value.get("columns"), value.get("data")
    if not isinstance(names, list) or not isinstance(rows, list):
        return None
    if not all(isinstance(row, list) and len(row) == len(names) for row in rows):
        return None
    return [dict(zip(map(str, names), row, strict=True)) for row in rows]
