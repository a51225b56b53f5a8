"""Conversion of a source that is not a table with a clock into one."""

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sysid_trib.datasets.registry import PublishedFile, RowOfCells, RowsOfText
from sysid_trib.errors import RecordError


def converted(source: Path, file: PublishedFile) -> bytes:
    """Return the content of a local file, made from its source.

    Raises
    ------
    RecordError
        The source has another form.
    """
    try:
        if file.rows is not None:
            lines = _rows_of_text(source, file.rows)
        elif file.cells is not None:
            lines = _row_of_cells(source, file.cells)
        else:
            return source.read_bytes()
        return "".join(f"{line}\n" for line in lines).encode()
    # A reader of a foreign format may raise any exception for a file of another form.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise RecordError(
            f"{file.path} of the source does not have the expected form ({reason}); report it."
        ) from error


def _rows_of_text(source: Path, rows: RowsOfText) -> Iterable[str]:
    """Return a part of a text table with a clock; numbers keep their text."""
    with source.open(encoding="utf-8", newline="") as opened:
        table = list(csv.reader(opened))
    header = [name.strip() for name in table[0]]
    places = [header.index(column) for column in rows.columns]
    chosen = table[1 + rows.first : 2 + rows.last]
    texts = [",".join(row[place].strip() for place in places) for row in chosen]
    return [rows.header, *(f"{at / rows.rate:.{rows.decimals}f},{text}" for at, text in enumerate(texts))]


def _row_of_cells(source: Path, cells: RowOfCells) -> Iterable[str]:
    """Return time and signal of a row of a MATLAB cell array as a text table."""
    from scipy.io import loadmat

    of_row: Any = loadmat(source)[cells.variable][cells.row]
    time, signal = of_row[0].ravel(), of_row[1].ravel()
    return [cells.header, *(f"{t:.6f},{x:.7g}" for t, x in zip(time, signal, strict=True))]
