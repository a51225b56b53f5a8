"""The next run, in sentences, as a table and as plain data."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing.blocks import ALWAYS, Block
from sysid_trib.printing.layout import name_and_unit, text_table
from sysid_trib.printing.plain_data import mapped, same

# Runs that the table has.
MOST_RUNS = 8


def plan_blocks(data: xr.Dataset, stated: xr.Dataset) -> list[Block]:
    """What is said of runs that may be made next; `stated` is the identification that is known."""
    return [
        Block(_sentences(data, stated), ALWAYS),
        Block(table=text_table(_rows(data, stated)[:MOST_RUNS]), layers=ALWAYS),
    ]


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
    if equal := data.sizes["run"] - len(_rows(data, stated)):
        runs = f"{equal} run{'s' if equal > 1 else ''}"
        said.append(f"Left out: {runs} longer than another that tells as much, by the digits shown.")
    return said


def _unit(data: xr.Dataset) -> str:
    return str(data.amplitude.attrs["units"])


def _size(run: xr.Dataset) -> str:
    """The release of a run to three digits, micrometres too without a power of ten."""
    return np.format_float_positional(run.amplitude.item(), 3, fractional=False, trim="-")


def _rows(data: xr.Dataset, stated: xr.Dataset) -> list[dict[str, str]]:
    """What is printed of each run: release, duration, and what it tells."""
    several, rows = len(data.attrs["models"]) > 1, []
    units = {symbol: stated.unit.sel(force=symbol).item() for symbol in data.force.values.tolist()}
    heads = [name_and_unit(f"error of {symbol}", unit) for symbol, unit in units.items()]
    for at in range(data.sizes["run"]):
        run = data.isel(run=at)
        row = {f"release ({_unit(data)})": _size(run), "duration (s)": f"{run.duration.item():.3g}"}
        if several:
            row |= {"probability": f"{run.probability.item():.2f}", "entropy": f"{run.entropy.item():.3f}"}
        errors = (f"{error:.2g}" for error in run.standard_error.values)
        rows.append(row | dict(zip(heads, errors, strict=True)))
    # Of runs that are said to tell as much the shorter one comes first.
    seen = {tuple(row.values())[2:]: row for row in reversed(rows)}
    return [row for row in rows if seen[tuple(row.values())[2:]] is row]


def plan_json(data: xr.Dataset) -> dict[str, Any]:
    """A plan as plain data, all runs."""
    table = same("amplitude", "duration", "samples", "probability", "entropy", "meets")
    of_run = table | {"errors": ("force", "standard_error")}
    runs = [mapped(data.isel(run=at), of_run) for at in range(data.sizes["run"])]
    models = dict(zip(data.attrs["models"], data.attrs["probabilities"], strict=True))
    return {"models": models, "odds": data.attrs["odds"], "runs": runs}
