"""Text and tables on standard output."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
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


def printable(text: str) -> str:
    """One line without control characters: a file's column names may hold any."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))
