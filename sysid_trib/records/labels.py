"""Text whose cells are dressed up: labels or units with each number, quoted commas, groups of digits."""

import re

from sysid_trib.records.numbers import MINUS
from sysid_trib.records.units import TIME_UNITS, is_known_unit, plain_unit

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
