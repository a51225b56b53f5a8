"""Numbers with errors, and tables for a terminal."""

from math import floor, log10
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rich.table import Table


def value_with_error(value: float, error: float) -> str:
    """`0.0097 ± 0.0002`: two digits of the error, the value to the same place, one power of ten for both."""
    if not (np.isfinite(value) and np.isfinite(error)):
        return (
            f"{value:.5g} ± {'?' if not np.isfinite(error) else f'{error:.2g}'}"
            if np.isfinite(value)
            else "-"
        )
    if error <= 0.0:
        return f"{value:.6g}"
    size = max(abs(value), error)
    power = floor(log10(size))
    power = power if power < -3 or power > 4 else 0
    digits = max(0, 1 - floor(log10(error)) + power)
    text = f"{value / 10.0**power:.{digits}f} ± {error / 10.0**power:.{digits}f}"
    return text if power == 0 else f"({text})e{power:+03d}"


def p_value_text(p_value: float, equals: str = "= ") -> str:
    """A p-value as a sentence takes it, or without `equals` a table."""
    if not np.isfinite(p_value):
        return "-"
    return f"{equals}{p_value:.2g}" if p_value > 1e-300 else "< 1e-300"


def number(value: float) -> float | int | None:
    """A number that JSON can hold."""
    return value if np.isfinite(value) else None


def text_table(
    heads: list[str], rows: list[list[str]], *, whole: tuple[int, ...] = (), numbers: tuple[int, ...] = ()
) -> "Table":
    """A table whose words a narrow terminal may fold, but not the columns `whole` nor the `numbers`."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for at, head in enumerate(heads):
        longest = max(len(row[at]) for row in rows)
        table.add_column(
            head,
            justify="right" if at in numbers else "left",
            min_width=longest if at in (*whole, *numbers) else min(longest, 12),
            overflow="fold",
        )
    for row in rows:
        table.add_row(*row)
    return table
