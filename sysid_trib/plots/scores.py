"""Scores of candidates before each step of a search and at its end."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots import style
from sysid_trib.plots.motion_panels import held_out_sentence
from sysid_trib.plots.style import FULL_WIDTH, TWO_COLUMNS
from sysid_trib.results.effects import credible_set, strongest

# Candidates in a ranking.
MOST_CANDIDATES = 15
# A score beyond so many thresholds asks for a logarithmic axis.
LOGARITHMIC_BEYOND = 5.0
# Scores that are all beyond so many thresholds are shown without it, with so much of their range below them.
ALL_BEYOND, ROOM_BELOW = 1.5, 0.2
# Height of a panel, inch: without candidates, and of a candidate.
RANKING_HEIGHT, CANDIDATE_HEIGHT = 0.75, 0.135
# For which there is always room: the legend beside takes some.
FEWEST_CANDIDATES = 6


def ranking(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """The ranking before each step at which an effect of the final model was chosen and at the end.

    That at the end is left out if every candidate is in the model.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    steps = sorted(set(_chosen_at(tree)))
    if not steps or _scores(tree, -1, MOST_CANDIDATES).sizes["candidate"]:
        steps.append(-1)
    rows = -(-len(steps) // (2 if width >= TWO_COLUMNS else 1))
    room = int((style.TALLEST - 0.3 - rows * RANKING_HEIGHT) / (rows * CANDIDATE_HEIGHT))
    drawn = [_scores(tree, step, min(room, MOST_CANDIDATES)) for step in steps]
    most = max(FEWEST_CANDIDATES, *(data.sizes["candidate"] for data in drawn))
    figure, panels = style.grid(len(drawn), 2, width, RANKING_HEIGHT + CANDIDATE_HEIGHT * most)
    for data, panel in zip(drawn, panels, strict=True):
        _ranking(panel, data)
    style.letter(panels, [_title(tree, step) for step in steps])
    handles = style.legend_marks(style.CANDIDATE_MARKS | {"threshold": style.THRESHOLD})
    style.legend_above(figure, handles, 4 if width >= TWO_COLUMNS else 2, 8)
    style.footnote(figure, held_out_sentence(tree, of_search=True))
    return figure


def _chosen_at(tree: xr.DataTree) -> list[int]:
    """The selection step at which each effect was chosen: 0 before the first."""
    return tree["steps"].selection_step.values.tolist() if tree["steps"].attrs["count"] else []


def _scores(tree: xr.DataTree, selection_step: int, most: int) -> xr.Dataset:
    """The candidates of the highest scores at a selection step; those named or competing always.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    selection_step : int
        0 before the first step, 1 before the second, ..., -1 at the end.
    most : int
        Candidates beside those named and competing.

    Returns
    -------
    xr.Dataset
        Columns of `ranking` at the step for the candidates shown, the highest score first, with
        `kind(candidate)`, a key of `CANDIDATE_MARKS`; `threshold`, the |z| beyond which a candidate is named.
    """
    scores = tree["ranking"].to_dataset().isel(selection_step=selection_step)
    steps = tree["steps"].to_dataset()
    chosen_here = np.flatnonzero(np.array(_chosen_at(tree)) == selection_step)
    sets = [list(credible_set(steps.isel(step=at))) for at in chosen_here]
    named = [credible[0] for credible in sets]
    competing = [symbol for credible in sets for symbol in credible[1:] if symbol not in named]
    chosen = strongest(scores.expand_dims("selection_step"), most)
    tested = scores.candidate.values[np.isfinite(scores.z.values)]
    chosen += [s for s in (*named, *competing) if s in tested and s not in chosen]
    kinds = list(style.CANDIDATE_MARKS)
    kind = [kinds[0] if s in named else kinds[1] if s in competing else kinds[2] for s in chosen]
    return scores.sel(candidate=chosen).assign(kind=("candidate", np.array(kind, dtype=str)))


def _title(tree: xr.DataTree, selection_step: int) -> str:
    if selection_step in (-1, tree["ranking"].sizes["selection_step"] - 1):
        return "at the end"
    steps = tree["steps"].to_dataset().get("selection_step", xr.DataArray([])).values
    added = " and ".join(str(at + 1) for at in np.flatnonzero(steps == selection_step))
    return f"before step {added}" if added else f"selection step {selection_step + 1}"


def _ranking(ax: Axes, data: xr.Dataset) -> None:
    sizes, threshold = np.abs(data.z.values), data.threshold.item()
    high, low = max([threshold, *sizes]), 0.0
    logarithmic = high > LOGARITHMIC_BEYOND * threshold
    if sizes.size and sizes.min() > ALL_BEYOND * threshold:
        # An axis from zero, or a logarithm, would hide in what the candidates differ.
        logarithmic, low = False, float(sizes.min() - ROOM_BELOW * max(np.ptp(sizes), 0.05 * high))
    elif logarithmic:
        # Scores in their hundreds and a threshold of four need a logarithm, else it hides the differences.
        low = min([0.5 * threshold, *(0.7 * sizes)])
    for row, (size, kind) in enumerate(zip(sizes.tolist(), data.kind.values.tolist(), strict=True)):
        look = style.CANDIDATE_MARKS[kind]
        if low == 0.0 or logarithmic:
            # A bar would be as long as it must not be where the axis starts elsewhere.
            ax.plot([low, size], [row, row], "-", color=look["color"], linewidth=0.8)
        ax.plot([size], [row], linestyle="", **look)
        # Three digits, and no power of ten as long as there is room without.
        digits = f"{float(f'{size:.3g}'):g}"
        text = ax.annotate(digits, (size, row), (5, 0), fontsize=6, **style.LABEL_OFFSET)
        text.set_bbox(style.WHITE)
    if low < threshold:
        ax.axvline(threshold, **style.THRESHOLD)
    style.name_rows(ax, data.candidate.values.tolist())
    if logarithmic:
        ax.set(xscale="log", xlim=(low, high * (high / low) ** 0.2))
        style.logarithmic_ticks(ax.xaxis, low, high)
    else:
        ax.set_xlim(low, high + 0.15 * (high - low))
        style.row_lines(ax)
    ax.set_xlabel(f"score |z| (threshold {threshold:.3g})", fontsize=8)
    ax.tick_params(labelsize=7, which="both")
