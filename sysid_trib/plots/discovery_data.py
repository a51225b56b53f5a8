"""A discovery as numbers to draw, the same on paper and on a page."""

import json

import numpy as np
import xarray as xr

from sysid_trib.plots.style import CANDIDATE_MARKS
from sysid_trib.results.discoveries import credible_set, strongest
from sysid_trib.results.files import kind_of
from sysid_trib.results.variables import signal_units, small_units

LAST_THIRD = "the last third"
# Candidates in a ranking.
MOST_CANDIDATES = 15
# A score beyond so many thresholds asks for a logarithmic axis.
LOGARITHMIC_BEYOND = 5.0
# Scores that are all beyond so many thresholds are shown without it, with so much of their range below them.
ALL_BEYOND, ROOM_BELOW = 1.5, 0.2
# A cell of fewer samples has no mean; colours end where so many percent of the cells lie within; a dot marks
# cells of more standard errors.
FEWEST_IN_CELL = 5
COLOUR_PERCENT = 98.0
DOT_BEYOND = 3.0


def held_out_sentence(tree: xr.DataTree, *, of_search: bool = False) -> str:
    """What of the records is held out of a figure; empty where nothing is.

    Parameters
    ----------
    tree : xr.DataTree
        Result of a command.
    of_search : bool
        Whether the figure is of the search itself, which never sees what is held out; models may be fitted to
        the whole records in the end.
    """
    if kind_of(tree) != "discover":
        return ""
    held = str(tree.attrs["held_out"])
    held += " of the record" * (held == LAST_THIRD)
    if json.loads(tree.attrs["options"])["refit"] and held.startswith(LAST_THIRD):
        return f"Held out of the search, and of these numbers: {held}." if of_search else ""
    return f"Held out, and not in this figure: {held}."


def missing_force(tree: xr.DataTree, *, after: bool) -> tuple[xr.DataArray, xr.DataArray, float]:
    """Mean force over angle and rate that a model lacks, relative to I w^2.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    after : bool
        Of the final model, else of the start model.

    Returns
    -------
    tuple
        The force and its standard error, in small units, nan where samples are few; and the force at which
        the colours of both models end.
    """
    first, last = (tree[name].to_dataset() for name in ("discrepancy", "discrepancy_after"))
    kept = np.abs(first.force.values[first.samples.values >= FEWEST_IN_CELL])
    kept = kept[np.isfinite(kept)]
    factor, _ = small_units(signal_units(tree))
    limit = factor * float(np.percentile(kept, COLOUR_PERCENT)) if kept.size else 1.0
    shown = last if after else first
    force = (factor * shown.force).where(shown.samples >= FEWEST_IN_CELL)
    return force, factor * shown.standard_error, limit


def ranking_data(tree: xr.DataTree, selection_step: int) -> xr.Dataset:
    """The candidates of the highest scores at a selection step; those named or competing always.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    selection_step : int
        0 before the first step, 1 before the second, ..., -1 at the end.

    Returns
    -------
    xr.Dataset
        Columns of `ranking` at the step for the candidates shown, the highest score first, with
        `size(candidate)`, which is |z|, and `kind(candidate)`, a key of `CANDIDATE_MARKS`; `threshold`, the
        |z| beyond which a candidate is named. Attributes: `title`, when the step was; `logarithmic`, whether
        scores ask for a logarithmic axis; `low`, the least that the axis shows (not zero, nor the threshold,
        where all scores are far beyond it), and `high`, the largest |z| or the threshold.
    """
    scores = tree["ranking"].to_dataset().isel(selection_step=selection_step)
    named, competing = _named(tree, selection_step)
    chosen = strongest(scores.expand_dims("selection_step"), MOST_CANDIDATES)
    tested = scores.candidate.values[np.isfinite(scores.z.values)]
    chosen += [s for s in (*named, *competing) if s in tested and s not in chosen]
    kinds = list(CANDIDATE_MARKS)
    kind = [kinds[0] if s in named else kinds[1] if s in competing else kinds[2] for s in chosen]
    shown = scores.sel(candidate=chosen)
    size, threshold = np.abs(shown.z.values), scores.threshold.item()
    columns = {"size": size, "kind": np.array(kind, dtype=str)}
    shown = shown.assign({name: ("candidate", column) for name, column in columns.items()})
    title, high, low = _title(tree, selection_step), max([threshold, *size]), 0.0
    logarithmic = bool(high > LOGARITHMIC_BEYOND * threshold)
    if size.size and size.min() > ALL_BEYOND * threshold:
        # An axis from zero, or a logarithm, would hide in what the candidates differ.
        logarithmic, low = False, float(size.min() - ROOM_BELOW * max(np.ptp(size), 0.05 * high))
    elif logarithmic:
        # Scores in their hundreds and a threshold of four need a logarithm, else it hides the differences.
        low = min([0.5 * threshold, *(0.7 * size)])
    return shown.assign_attrs(title=title, logarithmic=logarithmic, low=low, high=high)


def rankings_data(tree: xr.DataTree) -> list[xr.Dataset]:
    """The ranking at the selection steps at which an effect of the final model was chosen, and at the end.

    That at the end is left out if every candidate is in the model.
    """
    chosen = tree["steps"].selection_step.values.tolist() if tree["steps"].attrs["count"] else []
    rankings = [ranking_data(tree, step) for step in (*sorted(set(chosen)), -1)]
    return rankings if rankings[-1].sizes["candidate"] or len(rankings) == 1 else rankings[:-1]


def _title(tree: xr.DataTree, selection_step: int) -> str:
    if selection_step in (-1, tree["ranking"].sizes["selection_step"] - 1):
        return "at the end"
    steps = tree["steps"].to_dataset().get("selection_step", xr.DataArray([])).values
    added = " and ".join(str(at + 1) for at in np.flatnonzero(steps == selection_step))
    return f"before step {added}" if added else f"selection step {selection_step + 1}"


def _named(tree: xr.DataTree, selection_step: int) -> tuple[list[str], list[str]]:
    """The effects that were chosen at a selection step, and those that compete with them."""
    if not tree["steps"].attrs["count"]:
        return [], []
    steps = tree["steps"].to_dataset()
    sets = [
        list(credible_set(steps.isel(step=at)))
        for at in np.flatnonzero(steps.selection_step.values == selection_step)
    ]
    named = [credible[0] for credible in sets]
    return named, [symbol for credible in sets for symbol in credible[1:] if symbol not in named]
