"""A printed result in layers: what the default, `--quiet` and `--explain` show of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import TYPE_CHECKING, Union

if TYPE_CHECKING:
    from rich.table import Table


class Layer(Flag):
    """How much of a result is printed."""

    QUIET = auto()
    DEFAULT = auto()
    EXPLAIN = auto()


ALWAYS = Layer.QUIET | Layer.DEFAULT | Layer.EXPLAIN
USUALLY = Layer.DEFAULT | Layer.EXPLAIN


@dataclass(frozen=True)
class Block:
    """Part of a printed result.

    Attributes
    ----------
    content : Table or sequence of str
        A table, or sentences of a line each; without any the block is not printed.
    layers : Layer
        The layers that show it.
    title : str
        A line above it, or nothing.
    """

    content: Union["Table", Sequence[str]]
    layers: Layer = USUALLY
    title: str = ""
