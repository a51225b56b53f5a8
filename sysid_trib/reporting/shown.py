"""Results as text, as a command prints them, and as HTML in a notebook."""

import html
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import xarray as xr

from sysid_trib.cycles.signatures import signatures_of
from sysid_trib.errors import UsageError, printable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.physics.consequences import with_consequences
from sysid_trib.printing import Block, Layer, campaign, driven, looked, modes
from sysid_trib.printing.written import blocks_of_layer, write_blocks
from sysid_trib.reporting.contents import PAGES, as_table
from sysid_trib.results.kinds import contents_text, kind_of
from sysid_trib.results.store import counts_of

# Other objects that can be shown: variables by which each is recognised, and its blocks.
OTHERS: dict[frozenset[str], Callable[[xr.Dataset], Iterable[Block]]] = {
    frozenset({"status", "message", "preferred"}): lambda data: campaign.campaign_blocks(
        data, counts_of(data), None
    ),
    frozenset({"damping_ratio", "dissipative_force"}): (
        lambda data: looked.backbone_blocks({"backbone": data}, [])
    ),
    frozenset({"left_open"}): driven.response_blocks,
    frozenset({"drive", "phase"}): modes.mode_response_blocks,
    frozenset({"entropy", "meets"}): driven.plan_blocks,
    frozenset({"first_amplitude", "damping_ratio", "duration"}): modes.modes_blocks,
}
SHOWN = (
    "a result of identify, laws, compare, discover, difference, campaign, look, modes, plan, backbone or "
    "forced_response, or a force library"
)


@dataclass(frozen=True, repr=False)
class Shown:
    """A result as sentences and tables: `str` is the printed output, and a notebook shows it as HTML.

    Attributes
    ----------
    blocks : sequence of Block
        Sentences and tables.
    layer : Layer
        Amount of detail shown.
    """

    blocks: Sequence[Block]
    layer: Layer

    def __str__(self) -> str:
        written = io.StringIO()
        write_blocks(self.blocks, self.layer, file=written)
        return written.getvalue().rstrip("\n")

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Return the HTML that notebooks ask for."""
        parts: list[str] = []
        for block in blocks_of_layer(self.blocks, self.layer):
            parts += [f"<p>{html.escape(printable(sentence))}</p>" for sentence in block.sentences]
            if block.table is not None:
                parts.append(_table_html(as_table(block.caption, block.table)))
        return f"<div>{''.join(parts)}</div>"


def _table_html(table: dict[str, Any]) -> str:
    """Return a table as HTML, with numbers aligned to the right."""

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
    """Return the output of a command for a result, as text and as HTML.

    Parameters
    ----------
    result : Dataset, DataTree or ForceLibrary
        Result of `identify`, `laws`, `compare`, `discover`, `difference`, `campaign`, `look`, `modes`,
        `plan`, `backbone`, `forced_response`, or a force library.
    explain : bool
        True to show all details, as with `--explain`.

    Returns
    -------
    Shown
        Printed by `print`, and shown by a notebook as HTML.

    Raises
    ------
    UsageError
        The object is not such a result.

    Examples
    --------
    >>> import sysid_trib as st
    >>> shown = st.show(st.identify(st.records.paper_twin()))
    >>> print(str(shown).splitlines()[0])
    The model explains the record: the residual is noise.
    """
    return Shown(list(_blocks_of(result)), Layer.EXPLAIN if explain else Layer.DEFAULT)


def _blocks_of(result: xr.Dataset | xr.DataTree | ForceLibrary) -> Iterable[Block]:
    """Return sentences and tables on a result."""
    if isinstance(result, ForceLibrary):
        table = looked.force_table(result, signatures_of(result))
        return [Block([result.title, looked.NORMALISED], table=table)]
    if isinstance(result, xr.Dataset | xr.DataTree):
        tree = result if isinstance(result, xr.DataTree) else xr.DataTree(result)
        if kind := kind_of(tree):
            return PAGES[kind][1](with_consequences(tree))
        if {"decay", "decay_1"} & set(tree.children):
            return looked.look_blocks(tree)
        data = tree.to_dataset()
        for held, blocks_of in OTHERS.items():
            if held <= set(data.data_vars):
                return blocks_of(data)
    raise UsageError(f"show takes {SHOWN}, not {contents_text(result)}.")
