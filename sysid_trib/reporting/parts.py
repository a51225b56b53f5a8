"""What a page is made of."""

from collections.abc import Sequence
from dataclasses import dataclass

from bokeh import plotting
from matplotlib.figure import Figure
from rich.table import Table as PrintedTable


@dataclass(frozen=True)
class PageTable:
    """A table; the columns `numbers` are set to the right."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: frozenset[int]


@dataclass(frozen=True)
class Panel:
    """An interactive figure, as wide as the page or half of it."""

    figure: plotting.figure
    wide: bool = True


@dataclass(frozen=True)
class Figures:
    """Interactive figures with a caption, and what stands in their place on paper."""

    caption: str
    panels: Sequence[Panel]
    on_paper: Sequence[Figure]


@dataclass(frozen=True)
class Section:
    """A heading and what is below it."""

    title: str
    sentences: Sequence[str] = ()
    tables: Sequence[PageTable] = ()
    figures: Sequence[Figures] = ()


def as_table(title: str, printed: PrintedTable) -> PageTable:
    """The table that a command prints."""
    cells = [[str(cell) for cell in column.cells] for column in printed.columns]
    heads = [str(column.header) for column in printed.columns]
    right = frozenset(at for at, column in enumerate(printed.columns) if column.justify == "right")
    return PageTable(title, heads, list(zip(*cells, strict=True)), right)
