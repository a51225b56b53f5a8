"""What a page says of each kind of result: the blocks of the command with --explain, and figures."""

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import xarray as xr
from matplotlib.figure import Figure
from rich.table import Table as PrintedTable

from sysid_trib import plots
from sysid_trib.plots.at_a_glance import drawn_overview
from sysid_trib.plots.motion_panels import MOST_POINTS
from sysid_trib.plots.overview_data import held_out_sentence, overview_data
from sysid_trib.printing.blocks import Block, Layer
from sysid_trib.printing.comparison import comparison_blocks
from sysid_trib.printing.discovery import discovery_blocks
from sysid_trib.printing.driven import driven_blocks
from sysid_trib.printing.identification import estimate_blocks, identification_blocks
from sysid_trib.printing.sureness import difference_blocks
from sysid_trib.results.files import is_of_driven, kind_of
from sysid_trib.results.variables import group_names, record_groups


@dataclass(frozen=True)
class Thumbnail:
    """A figure in a cell: a filled path of SVG in a box of 100 by 24, and what it shows in words."""

    path: str
    label: str


@dataclass(frozen=True)
class PageTable:
    """A table; the columns `numbers` are set to the right."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str | Thumbnail]]
    numbers: frozenset[int]


@dataclass(frozen=True)
class Figures:
    """Figures of one caption, which says what a footnote of theirs would say."""

    caption: str
    drawn: Sequence[Figure]


@dataclass(frozen=True)
class Section:
    """A heading and what is below it."""

    title: str
    sentences: Sequence[str] = ()
    tables: Sequence[PageTable] = ()
    figures: Sequence[Figures] = ()


@dataclass(frozen=True)
class Page:
    """A page: title, attributes of the records (their `source`), sentences above all sections, sections.

    Then where it is from: facts as terms and texts, methods with their options, libraries whole by title, and
    the command and the Python that make it again.
    """

    title: str
    records: Sequence[Mapping[Any, Any]]
    summary: Sequence[str]
    sections: Sequence[Section]
    facts: Sequence[tuple[str, str]]
    methods: PageTable | None = None
    texts: Mapping[str, str] = field(default_factory=dict)
    command: str = ""
    python: str = ""


def as_table(title: str, printed: PrintedTable) -> PageTable:
    """The table that a command prints."""
    cells = [[str(cell) for cell in column.cells] for column in printed.columns]
    heads = [str(column.header) for column in printed.columns]
    right = frozenset(at for at, column in enumerate(printed.columns) if column.justify == "right")
    return PageTable(title, heads, list(zip(*cells, strict=True)), right)


CAPTIONS = tomllib.loads(Path(__file__).with_name("captions.toml").read_text(encoding="utf-8"))
TITLE = "Forces of a free decay"
# By kind of result: the title of its page, and its blocks.
PAGES: dict[str, tuple[str, Callable[[xr.DataTree], list[Block]]]] = {
    "identify": (TITLE, estimate_blocks),
    "cross_check": (f"{TITLE}, by two methods", identification_blocks),
    "driven": ("Forces of a driven record", driven_blocks),
    "compare": (f"{TITLE}, method by method", comparison_blocks),
    "difference": ("Two samples held against each other", difference_blocks),
    "discover": ("What a model lacks to explain a free decay", discovery_blocks),
}


def contents_of(tree: xr.DataTree) -> tuple[str, list[str], list[Section]]:
    """Title of the page of a result, sentences above all sections, and sections."""
    title, blocks_of = PAGES[kind_of(tree)]
    return title, *sections_of(blocks_of(tree), lambda name: FIGURES[name](tree))


def sections_of(
    blocks: Sequence[Block], figures: Callable[[str], list[Figures]]
) -> tuple[list[str], list[Section]]:
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
    titled = [block for block in shown if block.title]
    sections = []
    for title, group in groupby(titled, lambda block: block.title):
        parts = list(group)
        sentences = [sentence for block in parts for sentence in block.sentences]
        tables = [as_table(b.caption or title, b.table) for b in parts if b.table is not None]
        drawn = [made for block in parts if block.figures for made in figures(block.figures)]
        if sentences or tables or drawn:
            sections.append(Section(title, sentences, tables, drawn))
    return summary, sections


def _glance(tree: xr.DataTree) -> list[Figures]:
    """The overview of each run; that of a driven one in a discovery has no envelope."""
    if kind_of(tree) == "discover" and is_of_driven(tree):
        return _driven(tree)
    figures = []
    for run in range(len(record_groups(tree))):
        data = overview_data(tree, run)
        caption = CAPTIONS["glance_backbone"] * (data.backbone is not None)
        caption += CAPTIONS["glance_discovery" if data.of_discovery else "glance"]
        figures.append(_over_time(tree, run, caption, drawn_overview(data)))
    return figures


def _stochastic(tree: xr.DataTree) -> list[Figures]:
    """Innovations, random force and predictions of each run whose motion settles."""
    count = len(record_groups(tree))
    names = zip(*(group_names(name, count) for name in ("innovations", "prediction_bands")), strict=True)
    made = []
    for run, (followed, bands) in enumerate(names):
        if followed in tree.children:
            caption = f"{_of_run(tree, run)}{CAPTIONS['random_force']}"
            made.append(Figures(caption, [plots.innovations(*_groups(tree, followed, bands))]))
    return made


def _motions(tree: xr.DataTree) -> list[Figures]:
    """Each record with the residuals of the models before and after, and the force map."""
    runs = range(len(record_groups(tree)))
    return [_over_time(tree, run, CAPTIONS["motions_apart"], plots.story(tree, run)) for run in runs]


def _over_time(tree: xr.DataTree, run: int, caption: str, figure: Figure) -> Figures:
    """A figure of one run, decimated where it is long, with what was held out."""
    caption = f"{_of_run(tree, run)}{caption}{_held_out(tree)}"
    samples = tree[record_groups(tree)[run]].sizes["time"]
    decimated = CAPTIONS["decimated"].format(points=MOST_POINTS, samples=samples)
    return Figures(f"{caption}{decimated * (samples > MOST_POINTS)}", [figure])


def _held_out(tree: xr.DataTree, *, of_search: bool = False) -> str:
    """What a discovery held out, after a caption."""
    return f" {held_out_sentence(tree, of_search=of_search)}".rstrip()


def _of_run(tree: xr.DataTree, run: int) -> str:
    groups = record_groups(tree)
    source = tree[groups[run]].attrs.get("source", "")
    return f"Run {run + 1}{f' ({source})' if source else ''}. " if len(groups) > 1 else ""


def _of_discovery(caption: str, draw: Callable[[xr.DataTree], Figure], tree: xr.DataTree) -> list[Figures]:
    """A figure of the search of a discovery."""
    return [Figures(CAPTIONS[caption] + _held_out(tree, of_search=True), [draw(tree)])]


def _groups(tree: xr.DataTree, *names: str) -> list[xr.Dataset]:
    """The groups of these names that a result has."""
    return [tree[name].to_dataset() for name in names if name in tree.children]


def _profiles(tree: xr.DataTree) -> list[Figures]:
    """Profiles and contours."""
    names = [name for name in ("profile", "contour") if name in tree.children]
    return [Figures(" ".join(CAPTIONS[name] for name in names), [plots.profile(*_groups(tree, *names))])]


def _driven(tree: xr.DataTree) -> list[Figures]:
    """Inputs, motion and residuals of each run."""
    runs = range(len(record_groups(tree)))
    return [_over_time(tree, run, CAPTIONS["driven"], plots.overview(tree, run)) for run in runs]


# By the names in blocks.
FIGURES: dict[str, Callable[[xr.DataTree], list[Figures]]] = {
    "glance": _glance,
    "driven": _driven,
    "random_force": _stochastic,
    "by_method": lambda tree: [Figures(CAPTIONS["by_method"], [plots.comparison(tree)])],
    "difference": lambda tree: [Figures(CAPTIONS["difference"], [plots.difference(tree)])],
    "profile": _profiles,
    "sensitivity": lambda tree: [
        Figures(CAPTIONS["sensitivity"], [plots.sensitivity(*_groups(tree, "sensitivity"))])
    ],
    "gap": _motions,
    "scores": partial(_of_discovery, "scores", plots.ranking),
}
