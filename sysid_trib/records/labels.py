"""Text whose cells are dressed up: labels before each number, commas of decimals within quotes."""

import re

# `time:0.12`, `angle = 4.5`.
_NAMED_NUMBER = re.compile(
    r"\s*\"?([^\W\d][\w .]*?)\"?\s*[:=]\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*"
)
_QUOTED_COMMA = re.compile(r"\"([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)\"")
# Fortran's `1.5D-02`.
_FORTRAN = re.compile(r"(\d\.?)[dD]([+-]\d\d)")
_QUOTED_POINT = re.compile(r"\"[+-]?\d*\.\d+\"")
DELIMITERS = (";", "\t", "|", ",", None)


def plain_lines(text: str) -> list[str]:
    """Lines with numbers in place of labelled ones, their labels as a header, and decimal points in quotes.

    Parameters
    ----------
    text : str
        Of a file.
    """
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
    return lines


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
