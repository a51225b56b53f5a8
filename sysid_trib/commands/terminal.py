"""Text, tables and progress on the terminal."""

import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from rich.table import Table

    from sysid_trib.printing.layers import Block, Layer

# Columns of a table that is not cut short.
WIDEST = 2000


def print_table(table: "Table") -> None:
    """Print a table whole."""
    from rich.console import Console

    # Markup would take a bracket in the name of a force for a command.
    console = Console(highlight=False, markup=False, emoji=False)
    # A result must be whole wherever it goes: a terminal may fold words but not numbers, a pipe nothing.
    if not console.is_terminal:
        console.width = console.measure(table, options=console.options.update(width=WIDEST)).maximum
    console.print(table, crop=False)


def print_blocks(blocks: "Iterable[Block]", layer: "Layer") -> None:
    """Print the blocks of a layer, with an empty line between two."""
    shown = [block for block in blocks if block.content and layer in block.layers]
    for at, block in enumerate(shown):
        if at:
            print()
        if block.title:
            print(block.title)
        if isinstance(block.content, Sequence):
            for sentence in block.content:
                indent = len(sentence) - len(sentence.lstrip())
                print(" " * indent + printable(sentence))
        else:
            print_table(block.content)


def record_sentences(tree: "xr.DataTree", sentences: Sequence[str]) -> list[str]:
    """The sentence on each record, and what was cut of it."""
    from sysid_trib.results.per_run import record_groups

    pairs = zip(sentences, record_groups(tree), strict=True)
    return [text for sentence, group in pairs for text in (sentence, tree[group].attrs.get("free_decay", ""))]


def print_written(*places: "Path | None") -> None:
    """Print the files and folders that were written."""
    for place in places:
        if place is not None:
            print(f"Written: {place}")


@contextmanager
def progress(steps: int | None = None) -> "Iterator[Callable[[str], None]]":
    """What is under way, on stderr, gone when all is done; nothing where no terminal is.

    Parameters
    ----------
    steps : int, optional
        How often the caller will report; without it there is no bar, which would lie.

    Yields
    ------
    callable
        Takes the name of what begins.
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, markup=False)
    if not console.is_terminal:
        # A Progress that is disabled ends with an empty line in older releases.
        yield lambda text: None
        return
    spinner = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    columns = Progress.get_default_columns() if steps else spinner
    with Progress(*columns, console=console, transient=True) as shown:
        task, done = shown.add_task("", total=steps), count()
        yield lambda text: shown.update(task, completed=next(done), description=text)


def printable(text: str) -> str:
    """One line without control characters: a file's column names may hold any."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def command_line() -> str:
    """The command that runs, as it can be given again."""
    return shlex.join(["sysid-trib", *sys.argv[1:]])
