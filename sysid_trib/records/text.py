"""Tables of numbers in text, whatever its delimiter, decimal sign, labels, units, head and comments."""

import csv
import re
from io import StringIO
from itertools import chain, pairwise
from pathlib import Path

import pandas as pd

from sysid_trib.errors import RecordError
from sysid_trib.records.column import MINUS, is_missing, is_number
from sysid_trib.records.units import TIME_UNITS, is_known_unit, plain_unit

FORMATS = "text, CSV or JSON, MATLAB, NumPy, Excel (.xlsx), netCDF, HDF5, Parquet, TDMS"
# Rows in which facts may stand next to the numbers.
MOST_FACTS = 40
DELIMITERS = (";", "\t", "|", ",", None)
# Numbers that are written otherwise: what they look like, what the text must hold besides, or must not, and
# the signs in them with what stands for these.
_WRITTEN_OTHERWISE = (
    # Figures parted by narrow blanks or apostrophes; `"5,123"` alone may be a decimal comma.
    (r"(?<=\d)[\u00a0\u2009\u202f'’](?=\d{3}(?!\d))", "", None, r"\D", ""),
    (r"\"[+-]?\d{1,3}(?:,\d{3})+(?:\.\d+)?\"", r"\"[+-]?\d{1,3}(?:,\d{3})+\.\d+\"", None, ",", ""),
    # `5,123.45`, `5.123,45` and `1 234,5` between semicolons or tabs; between commas they are two numbers.
    (r"(?<![\d.,])[+-]?\d{1,3}(?:,\d{3})+(?=\.\d)", "[;\t]", None, ",", ""),
    (r"(?<![\d.,])[+-]?\d{1,3}(?:\.\d{3})+(?=,\d)", "[;\t]", None, r"\.", ""),
    (r"(?:^|(?<=[;\t\"]))[ ]*[+-]?\d{1,3}(?: \d{3})+(?=[.,;\t\"\r\n]|$)", "[;\t]", None, " ", ""),
    # `"0,12"` between commas, and Fortran's `1.5D-02`.
    (r"\"[+-]?\d*,\d+(?:[eE][+-]?\d+)?\"", "", r"\"[+-]?\d*\.\d+\"", ",", "."),
    (r"\d\.?[dD][+-]\d\d", "", None, "[dD]", "E"),
)
# `0.010 s`, `-5.2°`, `time:0.12`, `angle = 4.5`: label, number, unit.
_DRESSED = re.compile(
    r"\s*(?:\"?([^\W\d][\w .]*?)\"?\s*[:=]\s*)?\"?([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)"
    r"\s*([^\s\d\"][^\s\"]*)?\"?\s*"
)


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
        raise RecordError(f"{path.name}: binary content of no format that can be read ({FORMATS}).")
    try:
        return table_in(content.decode(wide or "utf-8-sig"), path)
    except UnicodeDecodeError:
        return table_in(content.decode("latin-1"), path)


def table_in(text: str, path: Path) -> tuple[pd.DataFrame, list[str] | None, list[str]]:
    """Rows of numbers in a text, the names of their columns, and the lines above (see `read_text`)."""
    lines = _without_labels(_plain_numbers(text).splitlines())
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
    rows, sign = StringIO("\n".join(block)), delimiter or r"\s+"
    frame = pd.read_csv(rows, sep=sign, decimal=decimal, header=None, skipinitialspace=True, low_memory=False)
    # A delimiter at the end of every line makes an empty last column.
    if frame.shape[1] > 1 and frame.iloc[:, -1].isna().all():
        frame = frame.iloc[:, :-1]
    named = header is not None and len(header) >= frame.shape[1]
    # What columns of texts hold next to the first numbers, as an oscilloscope's facts.
    texts = frame.head(MOST_FACTS).select_dtypes(exclude="number").to_numpy()
    facts = [" ".join(str(cell) for cell in row if cell == cell) for row in texts]
    return frame, header if named else None, [*lines[:start], *facts]


def check_width(path: Path, columns: int) -> None:
    """Refuse a table of far more columns than any record has.

    Raises
    ------
    RecordError
        With how many there are.
    """
    # The widest table that is looked at.
    if columns > 4096:
        raise RecordError(
            f"{path.name}: has {columns:,} columns, where a record has a few: turn the table, or cut it."
        )


def _plain_numbers(text: str) -> str:
    """Text with plain numbers in place of those that are parted in groups, quoted, or of Fortran."""
    text = text.replace(MINUS, "-")
    for pattern, needed, unless, sign, plain in _WRITTEN_OTHERWISE:
        if re.search(needed, text) and not (unless and re.search(unless, text)):
            text = _rewritten(text, pattern, sign, plain)
    return text


def _rewritten(text: str, pattern: str, sign: str, plain: str) -> str:
    return re.sub(pattern, lambda match: re.sub(sign, plain, match[0].strip('"')), text, flags=re.MULTILINE)


def _without_labels(lines: list[str]) -> list[str]:
    """Lines with bare numbers where each row has the same labels or units: the head has them instead."""
    # By a line in the middle: a logger may greet and say farewell.
    middle = lines[len(lines) // 2] if lines else ""
    for delimiter in DELIMITERS:
        labels, _, units = _dressed(middle, delimiter) or ((), (), ())
        if not any(labels) and not any(units):
            continue
        rows = [_dressed(line, delimiter) for line in lines]
        alike = [row is not None and (row[0], row[2]) == (labels, units) for row in rows]
        start, sign = alike.index(True), delimiter or "\t"
        above = lines[start - 1].split(delimiter) if start else []
        named = not any(labels) and len(above) == len(units)
        names = above if named else labels
        head = [f"{name.strip()} ({unit})" if unit else name for name, unit in zip(names, units, strict=True)]
        plain = [
            sign.join(row[1]) if row and is_so else line
            for line, row, is_so in zip(lines, rows, alike, strict=True)
        ]
        return [*plain[: start - named], sign.join(head), *plain[start:]]
    return lines


def _dressed(line: str, delimiter: str | None) -> tuple[tuple[str, ...], ...] | None:
    """Labels, numbers and units of the cells of a line; None if a cell is anything else.

    Either each cell has a label of its own, or none has one.
    """
    cells = [_DRESSED.fullmatch(cell) for cell in line.strip(" \t,{}[]").split(delimiter)]
    if not cells or None in cells:
        return None
    labels, numbers, units = zip(*(cell.groups(default="") for cell in cells if cell), strict=True)
    known = all(plain_unit(unit) in TIME_UNITS or is_known_unit(unit) for unit in units if unit)
    of_their_own = not any(labels) or len({*labels} - {""}) == len(labels)
    return (labels, numbers, units) if known and of_their_own else None


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
    for whole in (True, False):
        rows = ((at, line) for at, line in enumerate(lines) if line.strip() and not _is_comment(line))
        for (start, line), (_, below) in pairwise(chain(rows, [(0, "")])):
            for delimiter in DELIMITERS:
                if delimiter is not None and delimiter not in line:
                    continue
                fields = _fields(line, delimiter)
                # Cells may be empty, but for the last one.
                numbers = is_number(fields[-1]) and all(is_number(item) for item in fields if item)
                goes_on = not below or len(_fields(below, delimiter)) == len(fields)
                # A lone number above the header is no row.
                single = len(fields) == 1 and any(sign in below for sign in ",;\t")
                if (numbers if whole else any(map(is_number, fields))) and goes_on and not single:
                    return delimiter, _first_row(lines, delimiter, start, len(fields))
    return None, None


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
    if not header:
        return None
    last, above = header[0], header[1] if len(header) > 1 else []
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
