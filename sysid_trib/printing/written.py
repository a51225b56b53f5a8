"""Blocks as text: output of a command on the terminal or in any other file."""

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
    """Write a table without truncation, by default on the terminal."""
    from rich.console import Console

    # With markup, a bracket in the name of a force would be read as a command.
    # Only standard output may be a terminal. In a notebook rich would otherwise display each table by itself,
    # and add the codes of a terminal to the text.
    console = Console(
        file=file,
        highlight=False,
        markup=False,
        emoji=False,
        force_terminal=None if file is None else False,
        force_jupyter=False,
    )
    # A result must be complete on every output: a terminal may fold words but not numbers, a pipe neither.
    if not console.is_terminal:
        # Width of the table without truncation.
        console.width = console.measure(table, options=console.options.update(width=2000)).maximum
    console.print(table, crop=False)


def write_blocks(
    blocks: Iterable[Block],
    layer: Layer = Layer.DEFAULT,
    ends: Iterable[str] = (),
    file: TextIO | None = None,
) -> None:
    """Write the blocks of a layer, separated by empty lines; `--explain` has headings.

    Parameters
    ----------
    blocks : iterable of Block
        All blocks of a result.
    layer : Layer
        Layer that is shown.
    ends : iterable of str
        Lines below the blocks.
    file : file of text, optional
        Output file, by default the terminal.
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
