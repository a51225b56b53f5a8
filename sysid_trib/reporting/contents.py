"""What a page says of each kind of result: the blocks of the command with --explain, and figures."""

import tomllib
from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import xarray as xr
from matplotlib.figure import Figure
from rich.table import Table

from sysid_trib import plots
from sysid_trib.plots.motion_panels import MOST_POINTS, held_out_sentence
from sysid_trib.printing import Block, Layer, comparison, discovery, driven, identification, sureness
from sysid_trib.results.files import is_of_driven, kind_of
from sysid_trib.results.variables import group_names, record_groups

# A part of a page as `page.html` reads it.
# A section has a title, sentences, tables, figures.
# Figures have one caption, which says what a footnote of theirs would say, and are drawn by Matplotlib.
# A table has a title, heads, rows, and numbers, its columns that are set to the right.
Part = dict[str, Any]

CAPTIONS = tomllib.loads(Path(__file__).with_name("captions.toml").read_text(encoding="utf-8"))
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
    return title, *sections_of(blocks_of(tree), lambda name: FIGURES[name](tree))


def sections_of(
    blocks: Sequence[Block], figures: Callable[[str], list[Part]]
) -> tuple[list[str], list[Part]]:
    """Sentences of the blocks without a title, and the others as sections.

    Parameters
    ----------
    blocks : sequence of Block
        Those of `--explain` are shown.
    figures : callable
        Draws figures by their name in a block.
    """
    shown = [block for block in blocks if Layer.EXPLAIN in block.layers]
    summary = [sentence for block in shown if not block.title for sentence in block.sentences]
    sections = []
    for title, group in groupby((block for block in shown if block.title), lambda block: block.title):
        parts = list(group)
        section: Part = {
            "sentences": [sentence for block in parts for sentence in block.sentences],
            "tables": [as_table(b.caption or title, b.table) for b in parts if b.table is not None],
            "figures": [made for block in parts if block.figures for made in figures(block.figures)],
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


def _glance(tree: xr.DataTree) -> list[Part]:
    """The overview of each run; that of a driven one in a discovery has no envelope."""
    if kind_of(tree) == "discover" and is_of_driven(tree):
        return FIGURES["driven"](tree)
    figures = []
    for run in range(len(record_groups(tree))):
        curves = group_names("lack_of_fit", len(record_groups(tree)))[run]
        caption = CAPTIONS["glance_backbone"] * (curves in tree.children)
        caption += CAPTIONS["glance_discovery" if kind_of(tree) == "discover" else "glance"]
        figures.append(_over_time(tree, run, caption, plots.overview(tree, run)))
    return figures


def _stochastic(tree: xr.DataTree) -> list[Part]:
    """Innovations, random force and predictions of each run whose motion settles."""
    count = len(record_groups(tree))
    names = zip(*(group_names(name, count) for name in ("innovations", "prediction_bands")), strict=True)
    return [
        _figure(f"{_of_run(tree, run)}{CAPTIONS['random_force']}", plots.innovations(*_groups(tree, *pair)))
        for run, pair in enumerate(names)
        if pair[0] in tree.children
    ]


def _figure(caption: str, drawn: Figure) -> Part:
    return {"caption": caption, "drawn": [drawn]}


def _of_runs(name: str, draw: Callable[[xr.DataTree, int], Figure]) -> Callable[[xr.DataTree], list[Part]]:
    """A figure of each run."""
    return lambda tree: [
        _over_time(tree, run, CAPTIONS[name], draw(tree, run)) for run in range(len(record_groups(tree)))
    ]


def _over_time(tree: xr.DataTree, run: int, caption: str, figure: Figure) -> Part:
    """A figure of one run, decimated where it is long, with what was held out."""
    samples = tree[record_groups(tree)[run]].sizes["time"]
    decimated = CAPTIONS["decimated"].format(points=MOST_POINTS, samples=samples) * (samples > MOST_POINTS)
    return _figure(f"{_of_run(tree, run)}{caption}{_held_out(tree)}{decimated}", figure)


def _held_out(tree: xr.DataTree, *, of_search: bool = False) -> str:
    """What a discovery held out, after a caption."""
    return f" {held_out_sentence(tree, of_search=of_search)}".rstrip()


def _of_run(tree: xr.DataTree, run: int) -> str:
    groups = record_groups(tree)
    source = tree[groups[run]].attrs.get("source", "")
    return f"Run {run + 1}{f' ({source})' if source else ''}. " if len(groups) > 1 else ""


def _groups(tree: xr.DataTree, *names: str) -> list[xr.Dataset]:
    """The groups of these names that a result has."""
    return [tree[name].to_dataset() for name in names if name in tree.children]


def _profiles(tree: xr.DataTree) -> list[Part]:
    """Profiles and contours."""
    names = [name for name in ("profile", "contour") if name in tree.children]
    caption = " ".join(CAPTIONS[name] for name in names)
    return [_figure(caption, plots.profile(*_groups(tree, *names)))]


# By the names in blocks.
FIGURES: dict[str, Callable[[xr.DataTree], list[Part]]] = {
    "glance": _glance,
    "driven": _of_runs("driven", plots.overview),
    "gap": _of_runs("motions_apart", plots.story),
    "random_force": _stochastic,
    "by_method": lambda tree: [_figure(CAPTIONS["by_method"], plots.comparison(tree))],
    "difference": lambda tree: [_figure(CAPTIONS["difference"], plots.difference(tree))],
    "profile": _profiles,
    "sensitivity": lambda tree: [
        _figure(CAPTIONS["sensitivity"], plots.sensitivity(tree["sensitivity"].to_dataset()))
    ],
    "scores": lambda tree: [
        _figure(CAPTIONS["scores"] + _held_out(tree, of_search=True), plots.ranking(tree))
    ],
}
