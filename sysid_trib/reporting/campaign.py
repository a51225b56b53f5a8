"""The page of a campaign: what varies between the records, and every record a row, outliers first."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from sysid_trib import plots
from sysid_trib._version import __version__
from sysid_trib.campaigns.conditions import reported_method
from sysid_trib.campaigns.rows import STATUS
from sysid_trib.campaigns.store import counts_of
from sysid_trib.plots.runs import FAR
from sysid_trib.printing.campaign import AGAINST, campaign_blocks, named_text
from sysid_trib.printing.layout import value_with_error
from sysid_trib.reporting.contents import Part, sections_of
from sysid_trib.reporting.page import rendered, write_page

# Rows of the page; the store has all of them.
MOST_ROWS = 1000
# Of a discovery, whose identifications are models and no methods.
BY_MODEL = {"before": "of the start model", "after": "of the final model"}


def write_campaign(
    store: xr.Dataset,
    compared: xr.Dataset | None,
    conditions: pd.DataFrame | None,
    path: Path,
    command: str = "",
) -> None:
    """Write the page of a campaign.

    Parameters
    ----------
    store : Dataset
        As `campaign` returns it.
    compared : Dataset, optional
        What varies between its records; None of too few.
    conditions : DataFrame, optional
        A row a record.
    path : Path
        The page, HTML.
    command : str
        What made it.

    Raises
    ------
    RecordError
        The page cannot be written.
    """
    figures: dict[str, list[Part]] = {}
    if compared is not None and conditions is not None:
        rows = conditions.iloc[compared["at"].values]
        figures[AGAINST] = [_against(compared, str(name), rows[name].to_numpy()) for name in rows]
    blocks = campaign_blocks(store, counts_of(store), compared)
    summary, sections = sections_of(blocks, figures)
    sections.append(_records(store, compared, conditions))
    facts = [("task", str(store.attrs["task"])), ("version of sysid_trib", __version__)]
    facts += [("methods", ", ".join(store.method.values.tolist()))]
    source = {"source": f"{store.sizes['record']:,} records"}
    page = {"title": "Campaign", "records": [source], "summary": summary, "sections": sections}
    write_page(rendered(page | {"facts": facts, "command": command}), path)


def _against(compared: xr.Dataset, name: str, condition: np.ndarray) -> Part:
    """Every quantity against one condition."""
    caption = (
        f"Coefficients of all records against {name}, with standard errors; orange, by name where they are "
        f"few: more than {FAR:g} standard deviations from what the conditions let expect."
    )
    return {"caption": caption, "drawn": [plots.against_condition(compared, name, condition)]}


def _records(store: xr.Dataset, compared: xr.Dataset | None, conditions: pd.DataFrame | None) -> Part:
    """Every record a row, those that are farthest off first."""
    largest = np.zeros(store.sizes["record"])
    if compared is not None:
        z = np.nan_to_num(np.abs(compared.z.transpose("run", "quantity").values))
        largest[compared["at"].values] = z.max(axis=1)
    order = np.argsort(-largest, kind="stable")[:MOST_ROWS]
    # Of a large store only what is shown is read.
    last = store.sel({"method": reported_method(store)}).isel(record=order).load()
    symbols = [s for s in last.force.values.tolist() if np.isfinite(last.coefficient.sel(force=s)).any()]
    names = [] if conditions is None else list(conditions)
    rows = [
        _row(last.isel(record=place), symbols, largest[at], _conditions_of(conditions, at))
        for place, at in enumerate(order)
    ]
    heads = ["record", "free decay", *names, *symbols, "w_inf (rad/s)", "off by", "verdict"]
    more = store.sizes["record"] - len(order)
    said = [f"{more:,} more records are in the store alone."] if more else []
    by = BY_MODEL.get(last.method.item(), f"by {last.method.item()}")
    title = f"Coefficients {by}; off by: distance from the others in standard deviations"
    table = {"title": title, "heads": heads, "rows": rows, "numbers": range(2 + len(names), len(heads) - 1)}
    return {"title": "Records, those that stand out first", "sentences": said, "tables": [table]}


def _conditions_of(conditions: pd.DataFrame | None, at: int) -> list[str]:
    return [] if conditions is None else [str(value) for value in conditions.iloc[at]]


def _row(record: xr.Dataset, symbols: Sequence[str], off: float, conditions: list[str]) -> list[str | Part]:
    errors = [
        (record.coefficient.sel(force=s).item(), record.standard_error.sel(force=s).item()) for s in symbols
    ]
    errors.append((record.asymptotic_frequency.item(), record.asymptotic_frequency_standard_error.item()))
    cells = [value_with_error(value, error) for value, error in errors]
    status = STATUS[int(record.status)]
    texts = [text for text in (record.verdict.item(), named_text(record)) if text]
    verdict = "; ".join(texts) if status == "done" else f"{status}: {record.message.item()}"
    name = str(record.record.item())
    return [name, _thumbnail(record, name), *conditions, *cells, f"{off:.1f}" if off else "", verdict]


def _thumbnail(record: xr.Dataset, name: str) -> str | Part:
    """The record between its lowest and highest values, about its equilibrium."""
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
