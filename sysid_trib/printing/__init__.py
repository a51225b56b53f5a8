"""Results in words, tables and plain data: lists of blocks, which the terminal prints and the page shows."""

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
    """Part of a result; without sentences and a table the terminal prints nothing of it.

    Attributes
    ----------
    sentences : sequence of str
        A line each.
    layers : Layer
        The layers that show it.
    title : str
        The heading of its section, which `--explain` and the page have, there with the figures that are
        declared of it (`plots.figure`); the page has blocks without one at its top.
    table : Table, optional
        Below the sentences.
    caption : str
        A line above the table.
    """

    sentences: Sequence[str] = ()
    layers: Layer = USUALLY
    title: str = ""
    table: "Table | None" = None
    caption: str = ""
