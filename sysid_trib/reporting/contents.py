"""What a page says of each kind of result: the blocks of the command with --explain, and figures."""

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Any

import xarray as xr
from rich.table import Table

from sysid_trib.plots.declared import figures_of
from sysid_trib.plots.motion_panels import MOST_POINTS
from sysid_trib.printing import Block, Layer, comparison, discovery, driven, identification, sureness
from sysid_trib.results.files import kind_of
from sysid_trib.results.variables import record_groups

# A part of a page as `page.html` reads it.
# A section has a title, sentences, tables, figures.
# Figures have one caption, which says what a footnote of theirs would say, and are drawn by Matplotlib.
# A table has a title, heads, rows, and numbers, its columns that are set to the right.
Part = dict[str, Any]

# After the caption of what is drawn over time.
DECIMATED = (
    "The curves are decimated: each is drawn by {points:,} of {samples:,} samples, the least and the largest "
    "of each stretch, so that none of its peaks is lost."
)
TITLE = "Forces of a free decay"
# By kind of result: the title of its page, and its blocks.
PAGES: dict[str, tuple[str, Callable[[xr.DataTree], list[Block]]]] = {
    "identify": (TITLE, identification.estimate_blocks),
    "cross_check": (f"{TITLE}, by two methods", identification.identification_blocks),
    "driven": ("Forces of a driven record", driven.driven_blocks),
    "compare": (f"{TITLE}, method by method", comparison.comparison_blocks),
    "difference": ("Two samples held against each other", sureness.difference_blocks),
    "discover": ("What a model lacks to explain a free decay", discovery.discovery_blocks),
}


def contents_of(tree: xr.DataTree) -> tuple[str, list[str], list[Part]]:
    """Title of the page of a result, sentences above all sections, and sections."""
    title, blocks_of = PAGES[kind_of(tree)]
    return title, *sections_of(blocks_of(tree), _figures(tree))


def sections_of(
    blocks: Sequence[Block], figures: Mapping[str, Sequence[Part]]
) -> tuple[list[str], list[Part]]:
    """Sentences of the blocks without a title, and the others as sections.

    Parameters
    ----------
    blocks : sequence of Block
        Those of `--explain` are shown.
    figures : mapping of str to sequence of Part
        By the titles of sections.

    Raises
    ------
    ValueError
        A figure is of a section that there is not.
    """
    shown = [block for block in blocks if Layer.EXPLAIN in block.layers]
    summary = [sentence for block in shown if not block.title for sentence in block.sentences]
    if nowhere := figures.keys() - {block.title for block in shown}:
        raise ValueError(f"no section has the figures of {', '.join(map(repr, nowhere))}")
    sections = []
    for title, group in groupby((block for block in shown if block.title), lambda block: block.title):
        parts = list(group)
        section: Part = {
            "sentences": [sentence for block in parts for sentence in block.sentences],
            "tables": [as_table(b.caption or title, b.table) for b in parts if b.table is not None],
            "figures": figures.get(title, ()),
        }
        if any(section.values()):
            sections.append(section | {"title": title})
    return summary, sections


def as_table(title: str, printed: Table) -> Part:
    """The table that a command prints."""
    cells = [[str(cell) for cell in column.cells] for column in printed.columns]
    return {
        "title": title,
        "heads": [str(column.header) for column in printed.columns],
        "rows": list(zip(*cells, strict=True)),
        "numbers": [at for at, column in enumerate(printed.columns) if column.justify == "right"],
    }


def _figures(tree: xr.DataTree) -> dict[str, list[Part]]:
    """The figures of a result by the title of the section that has them."""
    made: dict[str, list[Part]] = {}
    records = record_groups(tree)
    for figure in figures_of(kind_of(tree)):
        for _, run, draw in figure.drawings(tree):
            drawn, caption = draw(), figure.caption(tree)
            attrs, samples = tree[records[run]].attrs, tree[records[run]].sizes["time"]
            source = f" ({attrs['source']})" if attrs.get("source") else ""
            which = f"Run {run + 1}{source}. " if len(records) > 1 and (figure.of_each_run or run) else ""
            further = [drawn.get_supxlabel()]
            if figure.of_each_run and samples > MOST_POINTS:
                further.append(DECIMATED.format(points=MOST_POINTS, samples=samples))
            text = " ".join(filter(None, [f"{which}{caption}", *further]))
            made.setdefault(figure.block, []).append({"caption": text, "drawn": [drawn]})
    return made
