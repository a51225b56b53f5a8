"""Results as sentences, tables and plain data: lists of blocks that terminal and page show."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table


class Layer(Flag):
    """Amount of a result that is shown; the page shows what `--explain` prints."""

    QUIET = auto()
    DEFAULT = auto()
    EXPLAIN = auto()


ALWAYS = Layer.QUIET | Layer.DEFAULT | Layer.EXPLAIN
USUALLY = Layer.DEFAULT | Layer.EXPLAIN


@dataclass(frozen=True)
class Block:
    """Part of a result; a block without sentences and a table is not printed.

    Attributes
    ----------
    sentences : sequence of str
        One per line.
    layers : Layer
        Layers that show the block.
    title : str
        Heading of its section, shown by `--explain` and by the page, which also has the figures declared for
        this title (`plots.figure`); blocks without a title are at the top of the page.
    table : Table, optional
        Shown below the sentences.
    caption : str
        Line above the table.
    """

    sentences: Sequence[str] = ()
    layers: Layer = USUALLY
    title: str = ""
    table: "Table | None" = None
    caption: str = ""
