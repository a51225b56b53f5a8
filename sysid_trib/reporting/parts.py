"""What a page is made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table as PrintedTable


@dataclass(frozen=True)
class Thumbnail:
    """A figure in a cell: a filled path of SVG in a box of 100 by 24, and what it shows in words."""

    path: str
    label: str


@dataclass(frozen=True)
class PageTable:
    """A table; the columns `numbers` are set to the right."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str | Thumbnail]]
    numbers: frozenset[int]


@dataclass(frozen=True)
class Figures:
    """Figures of one caption, which says what a footnote of theirs would say."""

    caption: str
    drawn: Sequence[Figure]


@dataclass(frozen=True)
class Section:
    """A heading and what is below it."""

    title: str
    sentences: Sequence[str] = ()
    tables: Sequence[PageTable] = ()
    figures: Sequence[Figures] = ()


@dataclass(frozen=True)
class Page:
    """A page: title, attributes of the records (their `source`), sentences above all sections, sections.

    Then where it is from: facts as terms and texts, methods with their options, libraries whole by title, and
    the command and the Python that make it again.
    """

    title: str
    records: Sequence[Mapping[Any, Any]]
    summary: Sequence[str]
    sections: Sequence[Section]
    facts: Sequence[tuple[str, str]]
    methods: PageTable | None = None
    texts: Mapping[str, str] = field(default_factory=dict)
    command: str = ""
    python: str = ""


def as_table(title: str, printed: PrintedTable) -> PageTable:
    """The table that a command prints."""
    cells = [[str(cell) for cell in column.cells] for column in printed.columns]
    heads = [str(column.header) for column in printed.columns]
    right = frozenset(at for at, column in enumerate(printed.columns) if column.justify == "right")
    return PageTable(title, heads, list(zip(*cells, strict=True)), right)
