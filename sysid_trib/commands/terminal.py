"""Text and tables on standard output."""

import shlex
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from rich.table import Table

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


def print_records(tree: "xr.DataTree", told: list[str]) -> None:
    """What each record is, and what was cut of it."""
    from sysid_trib.records.runs import record_groups

    for sentence, group in zip(told, record_groups(tree), strict=True):
        print(printable(sentence))
        print(tree[group].attrs.get("free_decay", ""))


def print_written(*places: "Path | None") -> None:
    """The files and folders that were written."""
    for place in places:
        if place is not None:
            print(f"Written: {place}")


def printable(text: str) -> str:
    """One line without control characters: a file's column names may hold any."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def command_line() -> str:
    """The command that runs, as it can be given again."""
    return shlex.join(["sysid-trib", *sys.argv[1:]])
