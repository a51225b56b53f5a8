"""Results as text, as a command prints them, and as HTML in a notebook."""

import html
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import xarray as xr

from sysid_trib.campaigns.rows import counts_of
from sysid_trib.errors import UsageError, printable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.physics.consequences import with_consequences
from sysid_trib.printing import Block, Layer, campaign, driven, looked
from sysid_trib.printing.written import blocks_of_layer, write_blocks
from sysid_trib.reporting.contents import PAGES, as_table
from sysid_trib.results.kinds import kind_of

# Datasets other than results that can be shown: variables by which they are recognised.
CAMPAIGN, BACKBONE, RESPONSE = {"status", "message"}, {"damping_ratio", "dissipative_force"}, {"left_open"}


@dataclass(frozen=True, repr=False)
class Shown:
    """A result in words and tables: `str` is what the command prints, and a notebook shows it as HTML.

    Attributes
    ----------
    blocks : sequence of Block
        Sentences and tables.
    layer : Layer
        How much of them is shown.
    """

    blocks: Sequence[Block]
    layer: Layer

    def __str__(self) -> str:
        written = io.StringIO()
        write_blocks(self.blocks, self.layer, file=written)
        return written.getvalue().rstrip("\n")

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Return it as HTML, which notebooks ask for."""
        parts: list[str] = []
        for block in blocks_of_layer(self.blocks, self.layer):
            parts += [f"<p>{html.escape(printable(sentence))}</p>" for sentence in block.sentences]
            if block.table is not None:
                parts.append(_table_html(as_table(block.caption, block.table)))
        return f"<div>{''.join(parts)}</div>"


def _table_html(table: dict[str, Any]) -> str:
    """Return a table as HTML, numbers to the right."""

    def row(cells: Iterable[str], tag: str) -> str:
        aligned = ("right" if at in table["numbers"] else "left" for at in range(len(table["heads"])))
        columns = zip(cells, aligned, strict=True)
        return "".join(
            f'<{tag} style="text-align:{side}">{html.escape(cell)}</{tag}>' for cell, side in columns
        )

    caption = f"<caption>{html.escape(table['title'])}</caption>" if table["title"] else ""
    rows = "".join(f"<tr>{row(cells, 'td')}</tr>" for cells in table["rows"])
    return f"<table>{caption}<thead><tr>{row(table['heads'], 'th')}</tr></thead><tbody>{rows}</tbody></table>"


def show(result: xr.Dataset | xr.DataTree | ForceLibrary, *, explain: bool = False) -> Shown:
    """Return what the command prints of a result, as text and as HTML.

    Parameters
    ----------
    result : Dataset, DataTree or ForceLibrary
        Of `identify`, `laws`, `compare`, `discover`, `difference`, `campaign`, `backbone`,
        `forced_response`, or a force library.
    explain : bool
        Whether all is said, as by `--explain`.

    Returns
    -------
    Shown
        `print` prints it, a notebook shows it as HTML.

    Raises
    ------
    UsageError
        No such result.
    """
    return Shown(list(_blocks_of(result)), Layer.EXPLAIN if explain else Layer.DEFAULT)


def _blocks_of(result: xr.Dataset | xr.DataTree | ForceLibrary) -> Iterable[Block]:
    """Return sentences and tables on a result."""
    if isinstance(result, ForceLibrary):
        return [Block([result.title, looked.NORMALISED], table=looked.force_table(result))]
    if not isinstance(result, xr.Dataset | xr.DataTree):
        raise UsageError(
            f"show takes a result of identify, laws, compare, discover or difference, not an object of type "
            f"{type(result).__name__}."
        )
    tree = result if isinstance(result, xr.DataTree) else xr.DataTree(result)
    if kind := kind_of(tree):
        return PAGES[kind][1](with_consequences(tree))
    data = tree.to_dataset()
    held = {str(name) for name in data.data_vars}
    if held >= CAMPAIGN:
        return campaign.campaign_blocks(data, counts_of(data), None)
    if held >= BACKBONE:
        return looked.backbone_blocks({"backbone": data}, [])
    if held >= RESPONSE:
        return driven.response_blocks(data)
    names = ", ".join([*map(str, tree.children), *sorted(held)][:6]) or "nothing"
    raise UsageError(
        f"show takes a result of identify, laws, compare, discover or difference; this one contains {names}."
    )
