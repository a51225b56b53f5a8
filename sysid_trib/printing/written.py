"""Blocks as text: what a command prints, on the terminal or into any other file."""

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, TextIO

from sysid_trib.errors import printable
from sysid_trib.printing import Block, Layer

if TYPE_CHECKING:
    from rich.table import Table


def blocks_of_layer(blocks: Iterable[Block], layer: Layer) -> list[Block]:
    """Return the blocks that a layer shows."""
    return [block for block in blocks if layer in block.layers and (block.sentences or block.table)]


def write_table(table: "Table", file: TextIO | None = None) -> None:
    """Write a table whole, by default on the terminal."""
    from rich.console import Console

    # Markup would take a bracket in the name of a force for a command.
    console = Console(file=file, highlight=False, markup=False, emoji=False)
    # A result must be complete on every output: a terminal may fold words but not numbers, a pipe nothing.
    if not console.is_terminal:
        # Columns of a table that is not cut short.
        console.width = console.measure(table, options=console.options.update(width=2000)).maximum
    console.print(table, crop=False)


def write_blocks(
    blocks: Iterable[Block],
    layer: Layer = Layer.DEFAULT,
    ends: Iterable[str] = (),
    file: TextIO | None = None,
) -> None:
    """Write the blocks of a layer, with an empty line between two; `--explain` has headings.

    Parameters
    ----------
    blocks : iterable of Block
        All of a result.
    layer : Layer
        Which of them are shown.
    ends : iterable of str
        Lines below them.
    file : file of text, optional
        Where they are written, by default the terminal.
    """
    target = sys.stdout if file is None else file
    section = ""
    for at, block in enumerate(blocks_of_layer(blocks, layer)):
        if at:
            print(file=target)
        if block.title not in ("", section) and layer is Layer.EXPLAIN:
            print(block.title, file=target)
        section = block.title
        for sentence in block.sentences:
            print(printable(sentence), file=target)
        if block.table is not None:
            if block.caption:
                print(block.caption, file=target)
            write_table(block.table, file)
    for sentence in ends:
        print(sentence, file=target)
