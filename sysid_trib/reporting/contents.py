"""Contents of a page for each kind of result: blocks of the command with --explain, and figures."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from rich.table import Table

from sysid_trib import plots
from sysid_trib._version import __version__
from sysid_trib.physics.consequences import with_consequences
from sysid_trib.plots.compared import FAR
from sysid_trib.plots.figure import figures_of
from sysid_trib.printing import (
    Block,
    Layer,
    campaign,
    comparison,
    discovery,
    driven,
    identification,
    laws,
    layout,
)
from sysid_trib.records.drawn import MOST_POINTS
from sysid_trib.results.judged import SEARCH_OUTCOME
from sysid_trib.results.kinds import kind_of
from sysid_trib.results.store import PREFERRED, Status, counts_of, of_model, reported_model
from sysid_trib.results.variables import record_groups

# A part of a page in the form for `page.html`. A section has a title, sentences, tables and figures. Figures
# have one caption, which includes the text of their footnotes, and are drawn by Matplotlib. A table has a
# title, column heads, rows, and the numbers of the columns that are aligned to the right.
Part = dict[str, Any]

# Appended to the caption of figures over time.
DECIMATED = (
    "The curves are decimated: each is drawn by {points:,} of {samples:,} samples, the least and the largest "
    "of each stretch, so that none of its peaks is lost."
)
TITLE = "Forces of a free decay"
# Title of the page and its blocks, for each kind of result.
PAGES: dict[str, tuple[str, Callable[[xr.DataTree], Iterable[Block]]]] = {
    "identify": (TITLE, identification.estimate_blocks),
    "cross_check": (f"{TITLE}, by two methods", identification.identification_blocks),
    "laws": ("Friction and restoring force of a free decay, as curves", laws.laws_blocks),
    "driven": ("Forces of a driven record", driven.driven_blocks),
    "compare": (f"{TITLE}, method by method", comparison.comparison_blocks),
    "difference": ("Two samples held against each other", campaign.difference_blocks),
    "discover": ("Missing forces of a free decay", discovery.discovery_blocks),
}


def contents_of(tree: xr.DataTree) -> tuple[str, list[str], list[Part]]:
    """Return the title of a result's page, the sentences above all sections, and the sections."""
    tree = with_consequences(tree)
    title, blocks_of = PAGES[kind_of(tree)]
    return title, *sections_of(blocks_of(tree), _figures(tree))


def sections_of(
    blocks: Iterable[Block], figures: Mapping[str, Sequence[Part]]
) -> tuple[list[str], list[Part]]:
    """Return the sentences of the blocks without a title, and the others as sections.

    Parameters
    ----------
    blocks : iterable of Block
        Blocks; those of `--explain` are included.
    figures : mapping of str to sequence of Part
        Figures by the titles of their sections.

    Raises
    ------
    ValueError
        A figure belongs to a section that does not exist.
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
    """Return the table that a command prints."""
    cells = [[str(cell) for cell in column.cells] for column in printed.columns]
    return {
        "title": title,
        "heads": [str(column.header) for column in printed.columns],
        "rows": list(zip(*cells, strict=True)),
        "numbers": [at for at, column in enumerate(printed.columns) if column.justify == "right"],
    }


def _figures(tree: xr.DataTree) -> dict[str, list[Part]]:
    """Return the figures of a result by the title of their section."""
    made: dict[str, list[Part]] = {}
    records = record_groups(tree)
    for figure in figures_of(kind_of(tree)):
        for _, run, draw in figure.drawings(tree):
            drawn, caption = draw(), figure.caption(tree)
            attrs, samples = tree[records[run]].attrs, tree[records[run]].sizes["time"]
            source = f" ({attrs['source']})" if attrs.get("source") else ""
            which = f"Run {run + 1}{source}. " if len(records) > 1 and (figure.of_each_run or run) else ""
            texts = [f"{which}{caption}", drawn.get_supxlabel()]
            if figure.of_each_run and samples > MOST_POINTS:
                texts.append(DECIMATED.format(points=MOST_POINTS, samples=samples))
            part = {"caption": " ".join(filter(None, texts)), "drawn": [drawn]}
            made.setdefault(figure.block, []).append(part)
    return made


# Largest number of rows on the page; the store has all rows.
MOST_ROWS = 1000
# Labels that are not names of methods.
BY_MODEL = {
    "before": "of the start model",
    "after": "of the final model",
    PREFERRED: "by the preferred method of each record",
}


def campaign_contents(
    store: xr.Dataset, compared: xr.Dataset | None, conditions: pd.DataFrame | None, command: str = ""
) -> Part:
    """Return the page of a campaign: the variation between records, and a row for each, outliers first.

    Parameters
    ----------
    store : Dataset
        Result of `campaign`.
    compared : Dataset, optional
        Variation between its records; None if there are too few.
    conditions : DataFrame, optional
        One row per record.
    command : str
        Command that made the store.
    """
    figures: dict[str, list[Part]] = {}
    if compared is not None and conditions is not None:
        rows = conditions.iloc[compared["at"].values]
        figures[campaign.AGAINST] = [_against(compared, str(name), rows[name].to_numpy()) for name in rows]
    summary, sections = sections_of(campaign.campaign_blocks(store, counts_of(store), compared), figures)
    facts = {"task": str(store.attrs["task"]), "version of sysid_trib": __version__}
    return {
        "title": "Campaign",
        "records": [{"source": f"{store.sizes['record']:,} records"}],
        "summary": summary,
        "sections": [*sections, _records(store, compared, conditions)],
        "facts": [*facts.items(), ("methods", ", ".join(store.model.values.tolist()))],
        "command": command,
    }


def _against(compared: xr.Dataset, name: str, condition: np.ndarray) -> Part:
    """Return a section with all quantities against one condition."""
    caption = (
        f"Coefficients of all records against {name}, with standard errors; orange, by name where they are "
        f"few: more than {FAR:g} standard deviations from what the conditions let expect."
    )
    return {"caption": caption, "drawn": [plots.against_condition(compared, name, condition)]}


def _records(store: xr.Dataset, compared: xr.Dataset | None, conditions: pd.DataFrame | None) -> Part:
    """Return a table with one row per record, in the order of decreasing deviation."""
    known = pd.DataFrame(index=range(store.sizes["record"])) if conditions is None else conditions
    largest = np.zeros(store.sizes["record"])
    if compared is not None:
        z = np.nan_to_num(np.abs(compared.z.transpose("run", "quantity").values))
        largest[compared["at"].values] = z.max(axis=1)
    order = np.argsort(-largest, kind="stable")[:MOST_ROWS]
    # Only the displayed part of a large store is read.
    shown = store.isel(record=order)
    reported = reported_model(store)
    last = of_model(shown, reported).load()
    verdicts = of_model(shown, PREFERRED).verdict.load()
    symbols = [s for s in last.force.values.tolist() if np.isfinite(last.coefficient.sel(force=s)).any()]
    rows = [
        _row(
            last.isel(record=place),
            verdicts[place].item(),
            symbols,
            largest[at],
            [*map(str, known.iloc[at])],
        )
        for place, at in enumerate(order)
    ]
    heads = [
        "record",
        "free decay",
        *known,
        *symbols,
        "w_inf (rad/s)",
        "off by",
        "residual / noise",
        "verdict",
    ]
    more = store.sizes["record"] - len(order)
    said = [f"{more:,} more records are in the store alone."] if more else []
    by = BY_MODEL.get(reported, f"by {reported}")
    title = (
        f"Coefficients and residual {by}; off by: distance from the others in standard deviations; verdict: "
        "that on the preferred model"
    )
    numbers = range(2 + len(known.columns), len(heads) - 1)
    table = {"title": title, "heads": heads, "rows": rows, "numbers": numbers}
    return {"title": "Records, outliers first", "sentences": said, "tables": [table]}


def _row(
    record: xr.Dataset, verdict: str, symbols: Sequence[str], off: float, conditions: list[str]
) -> list[str | Part]:
    """Return the cells of a record.

    Parameters
    ----------
    record : Dataset
        Its row, of the reported model.
    verdict : str
        That on its preferred model.
    symbols : sequence of str
        Forces with a column.
    off : float
        Distance from the other records in standard deviations.
    conditions : list of str
    """
    cells = [layout.quantity(record.sel(force=symbol), "coefficient") for symbol in symbols]
    cells.append(layout.quantity(record, "asymptotic_frequency"))
    ratio = record.residual_over_noise.item()
    cells += [f"{off:.1f}" if off else "", f"{ratio:.3g}" if np.isfinite(ratio) else "-"]
    status = Status(int(record.status)).name.lower()
    if status == "done":
        said = "; ".join(filter(None, (verdict, _search_text(record), campaign.named_text(record))))
    else:
        said = f"{status}: {record.message.item()}"
    name = str(record.record.item())
    return [name, _thumbnail(record, name), *conditions, *cells, said]


def _search_text(record: xr.Dataset) -> str:
    """Return the outcome of the search of a record, and whether it ended early; empty of other tasks."""
    if SEARCH_OUTCOME not in record:
        return ""
    early = "" if record.converged.item() else " (ended before the search had converged)"
    return f"search: {record[SEARCH_OUTCOME].item()}{early}"


def _thumbnail(record: xr.Dataset, name: str) -> str | Part:
    """Return the record between its lowest and highest values, relative to its equilibrium."""
    low, high = record.outline.transpose("edge", "part").values
    known = np.flatnonzero(np.isfinite(low))
    reach = float(np.max(np.abs([low[known], high[known]]), initial=0.0))
    if not reach:
        return "-"
    across = 100.0 * (known + 0.5) / len(low)
    down = [12.0 - 11.5 * edge[known] / reach for edge in (high, low)]
    points = [*zip(across, down[0], strict=True), *zip(across[::-1], down[1][::-1], strict=True)]
    path = "M" + "L".join(f"{x:.1f},{y:.2f}" for x, y in points) + "Z"
    return {"path": path, "label": f"{name}, up to {reach:.3g} {record.signal_units.item()}"}
