"""What to do after a result: the next command, and why; the next run, in words and as plain data."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing import ALWAYS, Block, comparison, layout
from sysid_trib.results.effects import candidates_of, credible_set, determines
from sysid_trib.results.files import identifications_of, kind_of
from sysid_trib.results.schema import library_of, shape_values_of
from sysid_trib.results.variables import record_groups
from sysid_trib.validation.findings import (
    LARGE,
    LAST_THIRD,
    fewer_forces,
    held_out_excess,
    second_of,
    verdict_of,
)

# A file that the user is to measure first.
SECOND_RECORD = "SECOND_RECORD.csv"
# Runs that the table has.
MOST_RUNS = 8
# More effects than were asked for, where candidates still stand out.
MORE_EFFECTS = 2


# A command, what it is for in a few words, and options that replace those of the command that has run: a
# switch has an empty value, what is left out has None; `records` is one more.
NextStep = tuple[str, str, Mapping[str, str | None]]


def next_step(tree: xr.DataTree) -> NextStep:
    """The command that follows from a result of `cross_check`, `compare` or `discover`."""
    after = {"discover": _after_discovery, "compare": _after_comparison}
    return after.get(kind_of(tree), _after_identification)(tree)


def _after_identification(tree: xr.DataTree) -> NextStep:
    if verdict_of(tree) == "undetermined":
        return _after_nothing(second_of(tree))
    if not verdict_of(tree).startswith("explained"):
        return _search(tree, "names what is missing")
    if fewer := fewer_forces(tree):
        return "identify", "the fewest forces that suffice", {"forces": ",".join(fewer[0])}
    return "compare", "every method, and how it predicts a part that is held out", {}


def _after_nothing(result: xr.Dataset) -> NextStep:
    """After a record that decides none of its forces: with fewer of them."""
    viscous = [*library_of(result, whole=True).damping_factors][:1]
    if viscous and result.force.values.tolist() != viscous:
        options = {"forces": viscous[0], "window": None}
        return "identify", "fewer forces, and all of the record", options
    reason = f"{SECOND_RECORD}: a longer motion, from a larger amplitude"
    return "identify", reason, {"records": SECOND_RECORD, "window": None}


def _after_comparison(tree: xr.DataTree) -> NextStep:
    table = tree["comparison"].to_dataset()
    reason = "tests further effects" if comparison.ratio_of_best(table) <= LARGE else "names what is missing"
    return _search(tree, reason)


def _search(tree: xr.DataTree, reason: str) -> NextStep:
    """What is missing beside the forces that were given; terms of the sensor are candidates alone."""
    # Methods for two forces hold no others.
    library = library_of(max(identifications_of(tree).values(), key=lambda result: result.sizes["force"]))
    forces = [force.symbol for force in library if force.kind != "sensor"]
    return "discover", reason, {"forces": ",".join(forces)} if len(forces) < len(library) else {}


def _after_discovery(tree: xr.DataTree) -> NextStep:
    if tree.attrs.get("out_of_time"):
        return "discover", "the same to its end", {"time_limit": None}
    if tied := _tied(tree):
        reason = f"{SECOND_RECORD}: the measurement that separates {' and '.join(tied[:2])}, see above"
        return "discover", reason, {"records": SECOND_RECORD}
    after = tree["after"].to_dataset()
    if tree.attrs["verdict"] == "unknown effect":
        outstanding = bool(tree["ranking"].significant.isel(selection_step=-1).any())
        most = tree.attrs["max_effects"]
        if outstanding and tree["steps"].attrs["count"] >= most:
            return "discover", "adds further effects", {"max_effects": str(most + MORE_EFFECTS)}
        return "discover", "story shows the force that no candidate names", {"plot": "figures"}
    if not determines(after):
        return _after_nothing(after)
    if held_out_excess(tree) and tree.attrs["held_out"].startswith(LAST_THIRD):
        return "discover", "fits the same forces to the whole record", {"refit": ""}
    forces = ",".join(after.force.values.tolist())
    shapes = ",".join(f"{name}={value:.6g}" for name, value in shape_values_of(after).items())
    options = {"forces": forces} | ({"set": shapes} if shapes else {})
    return "identify", "two methods, held against each other", options


def _tied(tree: xr.DataTree) -> list[str]:
    """An effect and those that it cannot be separated from; nothing where every name is certain.

    Nothing for a record that is no file, beside which another could be given.
    """
    if not all(tree[group].attrs.get("record_checksum") for group in record_groups(tree)):
        return []
    offered = candidates_of(tree).symbols
    for at in range(tree["steps"].attrs["count"]):
        credible = list(credible_set(tree["steps"].to_dataset().isel(step=at)))
        if len(credible) > 1:
            return [symbol for symbol in credible if symbol in offered]
    return []


def plan_blocks(data: xr.Dataset, stated: xr.Dataset) -> list[Block]:
    """What is said of runs that may be made next; `stated` is the identification that is known."""
    return [
        Block(_sentences(data, stated), ALWAYS),
        Block(table=layout.text_table(_rows(data, stated)[:MOST_RUNS]), layers=ALWAYS),
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
    heads = [layout.name_and_unit(f"error of {symbol}", unit) for symbol, unit in units.items()]
    for run in layout.by_label(data, "run").values():
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
    runs = layout.per_label(data, "run", layout.KEYS["plan"])
    models = dict(zip(data.attrs["models"], data.attrs["probabilities"], strict=True))
    return {"models": models, "odds": data.attrs["odds"], "runs": list(runs.values())}
