"""The next run, in sentences, as a table and as plain data."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing.blocks import ALWAYS, Block
from sysid_trib.printing.layout import by_label, number, same, text_table

# Runs that the table has.
MOST_RUNS = 8


def plan_blocks(data: xr.Dataset, stated: xr.Dataset) -> list[Block]:
    """What is said of runs that may be made next; `stated` is the identification that is known."""
    return [Block(_sentences(data, stated), ALWAYS), Block(table=_table(data, stated), layers=ALWAYS)]


def _sentences(data: xr.Dataset, stated: xr.Dataset) -> list[str]:
    """The best run, and what it is expected to tell."""
    best, unit, repeats = data.isel(run=0), _unit(data), int(data.attrs["repeats"])
    run = f"Release at {_size(best)} {unit} and record {best.duration.item():.3g} s"
    run += f", {repeats} times" if repeats > 1 else ""
    models, wanted = data.attrs["models"], {k: float(v) for k, v in data.attrs["wanted"].items()}
    said = []
    if len(models) > 1:
        said.append(
            f"{run}: of {', '.join(models[:-1])} and {models[-1]} the right one will have odds of "
            f"{data.attrs['odds']:g} to 1 against each other with probability {best.probability.item():.2f}."
        )
    if wanted or len(models) == 1:
        symbols = [*wanted] or data.force.values.tolist()
        parts = [
            f"{symbol} ± {best.standard_error.sel(force=symbol).item():.2g} "
            f"({stated.standard_error.sel(force=symbol).item():.2g} now)"
            for symbol in symbols
        ]
        said.append(f"{run}: {', '.join(parts)}, by all records together.")
    if wanted and not best.meets.item():
        asked = ", ".join(f"{symbol} ± {limit:g}" for symbol, limit in wanted.items())
        said.append(f"No run within the limits reaches {asked}; widen them, or repeat the run.")
    rows = _rows(data)
    if equal := len(rows) - len(_distinct(rows)):
        runs = f"{equal} run{'s' if equal > 1 else ''}"
        said.append(f"Left out: {runs} longer than another that tells as much, by the digits shown.")
    return said


def _unit(data: xr.Dataset) -> str:
    return str(data.amplitude.attrs["units"])


def _size(run: xr.Dataset) -> str:
    """The release of a run to three digits, micrometres too without a power of ten."""
    return np.format_float_positional(run.amplitude.item(), 3, fractional=False, trim="-")


def _rows(data: xr.Dataset) -> list[list[str]]:
    """What is printed of each run: release, duration, and what it tells."""
    several, rows = len(data.attrs["models"]) > 1, []
    for at in range(data.sizes["run"]):
        row = data.isel(run=at)
        by_names = [f"{row.probability.item():.2f}", f"{row.entropy.item():.3f}"] if several else []
        errors = [f"{error:.2g}" for error in row.standard_error.values]
        rows.append([_size(row), f"{row.duration.item():.3g}", *by_names, *errors])
    return rows


def _distinct(rows: list[list[str]]) -> list[list[str]]:
    """The runs of which none before them, which is the shorter one, is said to tell as much."""
    seen = {tuple(row[2:]): row for row in reversed(rows)}
    return [row for row in rows if seen[tuple(row[2:])] is row]


def _table(data: xr.Dataset, stated: xr.Dataset) -> Any:
    """The best runs, a row each."""
    several = len(data.attrs["models"]) > 1
    heads = [f"release ({_unit(data)})", "duration (s)", *(["probability", "entropy"] if several else [])]
    for symbol in data.force.values.tolist():
        unit = stated.unit.sel(force=symbol).item()
        heads.append(f"error of {symbol}{'' if unit == '1' else f' ({unit})'}")
    return text_table(heads, _distinct(_rows(data))[:MOST_RUNS], numbers=tuple(range(len(heads))))


def plan_json(data: xr.Dataset) -> dict[str, Any]:
    """A plan as plain data, all runs."""
    names = same("amplitude", "duration", "samples", "probability", "entropy", "meets")
    runs = []
    for at in range(data.sizes["run"]):
        row = data.isel(run=at)
        errors = {s: number(of.standard_error.item()) for s, of in by_label(row, "force").items()}
        runs.append({name: number(np.asarray(row[name]).tolist()) for name in names} | {"errors": errors})
    models = dict(zip(data.attrs["models"], data.attrs["probabilities"], strict=True))
    return {"models": models, "odds": data.attrs["odds"], "runs": runs}
