"""Tables of numbers in text, with any delimiter, decimal sign, labels, units, head and comments."""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from io import StringIO
from itertools import chain, combinations, pairwise
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from sysid_trib.errors import RecordError
from sysid_trib.records.column import MINUS, is_missing, is_number
from sysid_trib.records.units import (
    TIME_UNITS,
    is_known_unit,
    is_time,
    names_quantity,
    noted_rate,
    noted_unit,
    plain_unit,
    split_header,
)

FORMATS = "text, CSV or JSON, MATLAB, NumPy, Excel (.xlsx), netCDF, HDF5, Parquet, TDMS"
# Largest number of rows in which settings may be next to the numbers.
MOST_FACTS = 40
DELIMITERS = (";", "\t", "|", ",", None)
# Numbers in other notations: their pattern, a pattern that the text must contain, one that it must not
# contain, and the replaced signs.
_WRITTEN_OTHERWISE = (
    # Digits grouped by narrow blanks or apostrophes; `"5,123"` alone may contain a decimal comma.
    (r"(?<=\d)[\u00a0\u2009\u202f'’](?=\d{3}(?!\d))", "", None, r"\D", ""),
    (r"\"[+-]?\d{1,3}(?:,\d{3})+(?:\.\d+)?\"", r"\"[+-]?\d{1,3}(?:,\d{3})+\.\d+\"", None, ",", ""),
    # `5,123.45`, `5.123,45` and `1 234,5` between semicolons or tabs; between commas they are two numbers.
    (r"(?<![\d.,])[+-]?\d{1,3}(?:,\d{3})+(?=\.\d)", "[;\t]", None, ",", ""),
    (r"(?<![\d.,])[+-]?\d{1,3}(?:\.\d{3})+(?=,\d)", "[;\t]", None, r"\.", ""),
    (r"(?:^|(?<=[;\t\"]))[ ]*[+-]?\d{1,3}(?: \d{3})+(?=[.,;\t\"\r\n]|$)", "[;\t]", None, " ", ""),
    # `+ 0.12` in a separate cell.
    (r"(?:^|(?<=[;\t,\"]))[ ]*[+-] +(?=[\d.])", "[;\t,]", None, " ", ""),
    # `"0,12"` between commas, and Fortran's `1.5D-02`.
    (r"\"[+-]?\d*,\d+(?:[eE][+-]?\d+)?\"", "", r"\"[+-]?\d*\.\d+\"", ",", "."),
    (r"\d\.?[dD][+-]\d\d", "", None, "[dD]", "E"),
)
# `0.010 s`, `-5.2°`, `time:0.12`, `angle = 4.5`: label, number, unit.
_DRESSED = re.compile(
    r"\s*(?:\"?([^\W\d][\w .]*?)\"?\s*[:=]\s*)?\"?([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)"
    r"\s*([^\s\d\"][^\s\"]*)?\"?\s*"
)


class TextTable(NamedTuple):
    """Table of numbers in a text.

    Attributes
    ----------
    frame : DataFrame
        Rows of numbers.
    names : list of str or None
        Names of their columns; None where the text states none.
    notes : list of str
        Lines above.
    said : list of str
        Sentences on rows that were left out.
    """

    frame: pd.DataFrame
    names: list[str] | None
    notes: list[str]
    said: list[str]


def read_text(path: Path) -> TextTable:
    """Return the table of a text file.

    Parameters
    ----------
    path : path
        The file.

    Raises
    ------
    RecordError
        The content is binary, or has no numbers.
    """
    content = path.read_bytes()
    wide = ""
    if content.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        wide = "utf-32"
    elif content.startswith((b"\xff\xfe", b"\xfe\xff")):
        wide = "utf-16"
    elif content[:MOST_FACTS].count(b"\0") == MOST_FACTS // 2:
        # Without a byte order mark: every second byte of plain letters is zero.
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


def table_in(text: str, path: Path) -> TextTable:
    """Return the table in a text (see `read_text`)."""
    lines = _without_labels(_plain_numbers(text).splitlines())
    delimiter, start = _find_block(lines)
    if start is None:
        raise RecordError(f"{path.name}: no rows of numbers were found in it (other formats: {FORMATS}).")
    # The last cell of the first row may be empty.
    width = max(len(_fields(line, delimiter)) for line in lines[start : start + 2])
    header = _header(lines[:start], delimiter, width)
    commas = any("," in line for line in lines[start : start + 50])
    decimal = "," if commas and delimiter != "," else "."
    if delimiter == "," and header and len(header) == 1:
        delimiter = None
        decimal = ","
    block, said = _rows_below(lines, start, delimiter)
    check_width(path, width, len(block))
    frame = _as_frame(block, delimiter, decimal, path, len(header or ()))
    # A delimiter at the end of every line makes an empty last column.
    unnamed = len(header or ()) < frame.shape[1]
    if frame.shape[1] > 1 and unnamed and frame.iloc[:, -1].isna().all():
        frame = frame.iloc[:, :-1]
    named = header is not None and len(header) >= frame.shape[1]
    # Texts next to the first numbers, such as the settings of an oscilloscope.
    texts = frame.head(MOST_FACTS).select_dtypes(exclude="number").to_numpy()
    facts = [" ".join(str(cell) for cell in row if cell == cell) for row in texts]
    notes = [*lines[:start], *_facts_below_names(lines[:start], delimiter), *facts]
    return TextTable(frame, header if named else None, notes, said)


def _facts_below_names(lines: list[str], delimiter: str | None) -> list[str]:
    """Return `name = value` for each number or unit above the table that stands below a name."""
    facts: list[str] = []
    for names, values in pairwise(_fields(line, delimiter) for line in lines[-HEAD_LINES:]):
        if len(names) == len(values) > 1:
            pairs = [pair for pair in zip(names, values, strict=True) if not is_number(pair[0])]
            facts += [
                f"{name} = {value}" for name, value in pairs if is_number(value) or is_known_unit(value)
            ]
    return facts


def _rows_below(
    lines: list[str], start: int, delimiter: str | None
) -> tuple[list[tuple[int, str]], list[str]]:
    """Return the rows of numbers with their line numbers from 1, and a sentence on other rows."""
    # A restarted logger writes its head again, with other dates.
    head = {line.strip() for line in lines[max(0, start - 2) : start]} | {""}
    keys = {_fields(line, delimiter)[0] for line in lines[:start] if line.strip() and not _is_comment(line)}
    keys = {_numberless(key) for key in keys if not is_number(key) and not is_missing(key)}
    block = [
        (number, line)
        for number, line in enumerate(lines[start:], start + 1)
        if line.strip() not in head and not _is_comment(line)
    ]
    if keys:
        block = block[:1] + [row for row in block[1:] if not _begins_with(row[1], keys, delimiter)]
    # Texts below the numbers are not data.
    usual = _fields(block[0][1], delimiter)
    while len(block) > 1 and _is_summary(_fields(block[-1][1], delimiter), usual):
        block.pop()
    remarks = [(number, line) for number, line in block if _is_remark(line, delimiter, usual)]
    if not remarks:
        return block, []
    number, line = remarks[0]
    count = f"{len(remarks)} rows" if len(remarks) > 1 else "1 row"
    said = f"{count} of text left out, such as line {number}: {line.strip()[:40]!r}"
    return [row for row in block if row not in remarks], [said]


def _is_remark(line: str, delimiter: str | None, usual: list[str]) -> bool:
    """Return true if a line is a text without numbers, while the other lines have several numbers."""
    first = next(iter(line.split(delimiter, 1)), "").strip(" \t\"'")
    if is_number(first) or is_missing(first) or sum(map(is_number, usual)) < 2:
        return False
    cells = [cell for cell in _fields(line, delimiter) if cell]
    return len(cells) < len(usual) and not any(is_number(cell) or is_missing(cell) for cell in cells)


def _numberless(text: str) -> str:
    """Return a text with one sign in place of each number next to words, so that `Run 2` equals `Run 1`."""
    return re.sub(r"\d+", "0", text) if any(map(str.isalpha, text)) else text


def _begins_with(line: str, keys: set[str], delimiter: str | None) -> bool:
    """Return true if the first cell of a line is one of these texts, up to the numbers in it."""
    first = next(iter(line.strip().split(delimiter, 1)), "")
    return not is_number(first) and _numberless(first.strip(" \t\"'")) in keys


def _as_frame(
    block: list[tuple[int, str]], delimiter: str | None, decimal: str, path: Path, names: int
) -> pd.DataFrame:
    """Return the rows of text as a table.

    Raises
    ------
    RecordError
        A row has more cells than the others; the message states its line in the file.
    """

    def table(lines: Sequence[str]) -> pd.DataFrame:
        rows = StringIO("\n".join(lines))
        sign = delimiter or r"\s+"
        return pd.read_csv(
            rows, sep=sign, decimal=decimal, header=None, skipinitialspace=True, low_memory=False
        )

    try:
        return table([line for _, line in block])
    except pd.errors.ParserError:
        # Some rows have more cells than the first one: ignore empty cells at their ends.
        cells = [(number, _filled(line, delimiter)) for number, line in block]
        width = max(names, Counter(len(row) for _, row in cells).most_common(1)[0][0])
        for number, row in cells:
            if len(row) > width:
                wrong = f"line {number} has {len(row)} cells ({', '.join(row)[:60]}), the others have {width}"
                raise RecordError(f"{path.name}: {wrong}; correct it, or cut it out.") from None
        sign = delimiter or " "
        return table([sign.join(_quoted(row + [""] * (width - len(row)), sign)) for _, row in cells])


def _filled(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a row up to the last one that is not empty."""
    cells = line.strip(" \r\n").split(delimiter)
    if '"' in line and delimiter is not None:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), cells)
    while cells and not cells[-1].strip():
        cells.pop()
    return cells


def _quoted(cells: list[str], delimiter: str) -> list[str]:
    return [f'"{cell}"' if delimiter in cell else cell for cell in cells]


def check_width(path: Path, columns: int, rows: int) -> None:
    """Raise an error for a table with far more columns than any record has, or one on its side.

    Raises
    ------
    RecordError
        There are too many columns; the message states their number.
    """
    # A wider table is refused.
    if columns > 4096:
        raise RecordError(
            f"{path.name}: has {columns:,} columns, where a record has a few: turn the table, or cut it."
        )
    # A table with few rows, and many times as many columns, lies on its side.
    if rows <= 12 and columns >= 8 * max(rows, 8):
        raise RecordError(
            f"{path.name}: has {columns:,} columns and {rows} row{'s' * (rows != 1)}: time must run down the "
            "rows; turn the table (transpose it), so that each signal is a column."
        )


def _plain_numbers(text: str) -> str:
    """Return text with plain numbers in place of grouped, quoted, or Fortran numbers."""
    # Spreadsheets keep `="0.12"` from being changed.
    text = re.sub(r'="([^"\n]*)"', r"\1", text.replace(MINUS, "-"))
    for pattern, needed, unless, sign, plain in _WRITTEN_OTHERWISE:
        if re.search(needed, text) and not (unless and re.search(unless, text)):
            text = _rewritten(text, pattern, sign, plain)
    return text


def _rewritten(text: str, pattern: str, sign: str, plain: str) -> str:
    return re.sub(pattern, lambda match: re.sub(sign, plain, match[0].strip('"')), text, flags=re.MULTILINE)


def _without_labels(lines: list[str]) -> list[str]:
    """Return lines with bare numbers if each row has the same labels or units, which go to the head."""
    # Use a line in the middle: a logger may write a greeting and a farewell.
    middle = lines[len(lines) // 2] if lines else ""
    for delimiter in DELIMITERS:
        labels, _, units = _dressed(middle, delimiter) or ((), (), ())
        if not any(labels) and not any(units):
            continue
        rows = [_dressed(line, delimiter) for line in lines]
        alike = [row is not None and (row[0], row[2]) == (labels, units) for row in rows]
        start = alike.index(True)
        sign = delimiter or "\t"
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
    """Return labels, numbers and units of the cells of a line; None if a cell is anything else.

    Either each cell has its own label, or none has one.
    """
    cells = [_DRESSED.fullmatch(cell) for cell in line.strip(" \t,{}[]").split(delimiter)]
    if not cells or None in cells:
        return None
    labels, numbers, units = zip(*(cell.groups(default="") for cell in cells if cell), strict=True)
    known = all(plain_unit(unit) in (*TIME_UNITS, "%") or is_known_unit(unit) for unit in units if unit)
    of_their_own = not any(labels) or len({*labels} - {""}) == len(labels)
    return (labels, numbers, units) if known and of_their_own else None


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%", "//", "!"))


def _is_summary(row: list[str], usual: list[str]) -> bool:
    """Return true if a row contains a text where the others contain a number."""
    numbers = [is_number(item) for item in usual]
    texts = [not is_missing(item) and not is_number(item) for item in row]
    return not any(map(is_number, row)) or any(a and b for a, b in zip(numbers, texts, strict=False))


def _fields(line: str, delimiter: str | None) -> list[str]:
    # Keep an empty first cell.
    line = line.strip(" \r\n") if delimiter == "\t" else line.strip()
    parts = line.split(delimiter)
    if '"' in line and delimiter is not None:
        parts = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), parts)
    fields = [item.strip().strip("\"'").strip() for item in parts]
    return fields[:-1] if len(fields) > 1 and not fields[-1] else fields


def _find_block(lines: list[str]) -> tuple[str | None, int | None]:
    """Return the delimiter and the first line of the numbers: all cells are numbers, or else some."""
    for whole in (True, False):
        rows = ((at, line) for at, line in enumerate(lines) if line.strip() and not _is_comment(line))
        for (start, line), (_, below) in pairwise(chain(rows, [(0, "")])):
            for delimiter in DELIMITERS:
                if delimiter is not None and delimiter not in line:
                    continue
                fields = _fields(line, delimiter)
                # Cells may be empty, except the last one.
                numbers = is_number(fields[-1]) and all(is_number(item) for item in fields if item)
                # The last cells of a row may be empty.
                cells = line.rstrip("\r\n").count(delimiter) if delimiter else 0
                goes_on = not below or len(_fields(below, delimiter)) == len(fields)
                goes_on = goes_on or (whole and cells > 0 and below.count(delimiter or "") == cells)
                # A line such as `data:` below a setting.
                goes_on = goes_on and not below.rstrip().endswith(":")
                # A single number above the header is not a row.
                single = len(fields) == 1 and any(sign in below for sign in ",;\t")
                # Settings above a head are not rows.
                partly = any(map(is_number, fields)) and (
                    not below or any(map(is_number, _fields(below, delimiter)))
                )
                if (numbers if whole else partly) and goes_on and not single:
                    return delimiter, _first_row(lines, delimiter, start, len(fields))
    return None, None


def _first_row(lines: list[str], delimiter: str | None, start: int, width: int) -> int:
    """Go back over rows of which half are numbers, or that have numbers elsewhere: these are no header."""
    usual = [at for at, item in enumerate(_fields(lines[start], delimiter)) if is_number(item)]
    while start > 0 and not _is_comment(lines[start - 1]):
        fields = _fields(lines[start - 1], delimiter)
        if len(fields) < width:
            # The last cell may be empty.
            fields = lines[start - 1].split(delimiter)
        if len(fields) != width:
            break
        numeric = [is_number(item) for item in fields]
        # `sample_rate,1000` is a setting.
        if not all(numeric) and noted_rate([lines[start - 1]], 1) is not None:
            break
        # A row of names may hold a number where the others hold none, `Sequence,VOLT,0.0,1e-3`.
        if usual and not any(numeric[at] for at in usual) and any(fields[at] for at in usual):
            break
        if 2 * sum(numeric) < width and not (len(usual) > 1 and all(numeric[at] for at in usual)):
            break
        start -= 1
    return start


# Most lines above the numbers that may name columns: names, units, quantities, and groups.
HEAD_LINES = 6


def _header(before: list[str], delimiter: str | None, width: int) -> list[str] | None:
    """Return names from the lines above the numbers, with the lines of units and groups next to them."""
    # Ignore a line of dashes below the names.
    lines = [line for line in before if any(map(str.isalnum, line)) or "°" in line][-HEAD_LINES:][::-1]
    lines = [line.lstrip("#%/! \t") if _is_comment(line) else line for line in lines]
    if not lines or _states_a_fact(lines[0], width):
        return None
    rows: list[list[str]] = []
    for line in lines:
        row = _names_in(line, delimiter, width, nearest=not rows)
        if row is None:
            break
        # Largest number of letters in a column's name.
        rows.append([cell[:1000] for cell in row])
    if not rows:
        return None
    at, units = _names_and_units(rows)
    if at is None:
        return [f"{'time' if plain_unit(item) in TIME_UNITS else 'signal'} ({item})" for item in rows[0]]
    names = _with_groups(rows[at], lines[at + 1 :], delimiter)
    return [_with_unit(name, unit) for name, unit in zip(names, units or [""] * len(names), strict=True)]


def _states_a_fact(line: str, width: int) -> bool:
    """Return true if a line above a single column states a number, `sample_rate: 1000`, not a name."""
    stated = re.search(r"[:=,;\t]\s*[-+]?[\d.]", line) is not None
    return width == 1 and bool(stated or noted_rate([line], 1) is not None or noted_unit([line]))


def _names_in(line: str, delimiter: str | None, width: int, *, nearest: bool) -> list[str] | None:
    """Return the cells of a line above the numbers, one per column; None if the number differs."""
    separator = "," if delimiter is None and "," in line else delimiter
    fields = _fields(line, separator)
    if len(fields) != width and (delimiter is None or len(fields) == 1):
        # `Time (s)   Angle (deg)`; `time.angle`; the delimiter of names may differ from that of numbers.
        apart = [re.split(r"\s{2,}|\t", line.strip())]
        apart += [line.strip().split(".")] if delimiter is None else []
        apart += [_fields(line, other) for other in DELIMITERS if other not in (None, delimiter, separator)]
        # A sentence has blanks, too.
        words = line.split()
        apart += [words] if any(is_time(*split_header(word)) for word in words) else []
        fields = next(
            (cells for cells in apart if len(cells) == width and not any(map(is_number, cells))), fields
        )
    # A last column of comments may be empty throughout.
    wider = nearest and delimiter is not None and len(fields) > width
    one_name = delimiter == "," and len(fields) == 1 and any(map(str.isalpha, fields[0]))
    return fields if len(fields) == width or wider or one_name else None


def _names_and_units(rows: list[list[str]]) -> tuple[int | None, list[str] | None]:
    """Return the row that names the columns, nearest first, and the row of their units, or None."""
    last = rows[0]
    above = rows[1] if len(rows) > 1 else []
    bracketed = any(last) and all(re.fullmatch(r"[\[(].*[\])]|", item) for item in last)
    if _are_names(above, last) and (bracketed or _are_units_of(last, above)):
        return 1, last
    # The quantity, or the sensor, may be named below the units.
    if len(rows) > 2 and _are_names(rows[2], above) and _are_units_of(above, rows[2]):
        return 2, above
    if _are_names(last, above) and _are_units_of(above, last, known=True):
        return 0, above
    return (None, None) if _are_units(last) else (0, None)


def _are_names(row: list[str], others: list[str]) -> bool:
    """Return true if a row could name the columns of another row."""
    return bool(row) and len(row) == len(others) and not any(map(is_number, row)) and bool(row[-1])


def _are_units_of(row: list[str], names: list[str], known: bool = False) -> bool:
    """Return true if a row contains units of named columns: the time's, or others with it."""
    of_time = any(
        plain_unit(item.strip("[]() ")) in TIME_UNITS and is_time(*split_header(name))
        for item, name in zip(row, names, strict=True)
        if item != name
    )
    items = [item.strip("[]() ") for item in row]
    filled = [item for item in items if item]
    # `mm` below each of several names; `raw` and `counts` may be names themselves.
    known_all = bool(filled) and all(is_known_unit(item) for item in filled)
    known_all = known_all and not all(names_quantity(item.lower()) for item in filled)
    return (of_time and not any(map(is_number, row))) or known_all or _are_units(items, known)


# Largest number of letters of an unknown unit.
LONGEST_UNIT = 8


def _with_unit(name: str, said: str) -> str:
    """Return a name with the unit or quantity below it."""
    plain = said.strip().removeprefix("(").removesuffix(")") if said.count("(") == 1 else said.strip()
    plain = plain.strip("[] ")
    if is_missing(plain) or plain.lower() == "none" or split_header(name)[1]:
        return name
    unit = plain_unit(plain)
    words = " " in plain or len(plain) > LONGEST_UNIT or bool(names_quantity(plain.lower()))
    if unit in TIME_UNITS or is_known_unit(unit) or not words:
        return f"{name} ({plain})".strip()
    return f"{name} {plain}"


def _with_groups(names: list[str], above: list[str], delimiter: str | None) -> list[str]:
    """Return repeated names with the name of their group in front, which a line above states once."""
    repeated = [bool(name) and names.count(name) > 1 for name in names]
    if not any(repeated) or delimiter is None:
        return names
    groups = [_filled_forward(line, delimiter, len(names)) for line in above]
    for count in (1, 2):
        for chosen in combinations([group for group in groups if group], count):
            words = [
                " ".join(dict.fromkeys(filter(None, cells[::-1]))) for cells in zip(*chosen, strict=True)
            ]
            full = [
                f"{word} {name}".strip() if again else name
                for name, word, again in zip(names, words, repeated, strict=True)
            ]
            if len({*full}) == len(full):
                return full
    return names


def _filled_forward(line: str, delimiter: str, width: int) -> list[str]:
    """Return the cells of a line, with each empty one filled from the left; nothing if there are too many."""
    cells = [cell.strip().strip("\"'").strip() for cell in line.strip("\r\n").split(delimiter)]
    if len(cells) > width:
        cells = cells[:width] if not any(cells[width:]) else []
    repeated_cells: list[str] = []
    for cell in cells:
        repeated_cells.append(cell or (repeated_cells[-1] if repeated_cells else ""))
    return repeated_cells + [repeated_cells[-1]] * (width - len(repeated_cells)) if repeated_cells else []


def _are_units(items: list[str], known: bool = True) -> bool:
    """Return true if a line contains only units, one of time; all are known, except one."""
    # Arduino sketches name their columns like this.
    if {"millis", "micros"} & {item.lower() for item in items}:
        return False
    times = [item for item in items if plain_unit(item) in TIME_UNITS]
    others = [is_known_unit(item) for item in items if item and item not in times]
    enough = all if known else any
    return bool(times) and len(items) > 1 and enough(others)
