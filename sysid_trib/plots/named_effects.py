"""Figures of a discovery: residual, named effects, the missing force, and scores of candidates."""

from collections.abc import Sequence
from textwrap import fill, wrap
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from sysid_trib.arrays import Array
from sysid_trib.plots import style
from sysid_trib.plots.figure import FONT_SIZE, FULL_WIDTH, TALLEST, TWO_COLUMNS, new_figure, shows
from sysid_trib.plots.over_time import draw_in_time, held_out_sentence
from sysid_trib.printing.layout import quantity
from sysid_trib.results.effects import credible_set, or_others, replacing_pairs, steps_taken, strongest
from sysid_trib.results.judged import record_noise, residual_of
from sysid_trib.results.variables import signal_label, signal_symbol, signal_units, small_units

# A cell of fewer samples has no mean; the colours end at this percentile of the cells; a dot marks cells that
# exceed this number of standard errors.
FEWEST_IN_CELL = 5
COLOUR_PERCENT = 98.0
DOT_BEYOND = 3.0
# Competing effects named in a row.
TIED_IN_A_ROW = 2
# Heights in inches: the panels (record, residual before, residual after); models without rows; maps for a
# full page and for a column; a row of a model, and a line of its text.
PANEL_HEIGHTS, LAST_HEIGHT, MAP_HEIGHTS = (1.6, 1.0, 1.4), 0.45, (2.3, 1.8)
MODEL_ROW, LINE = 0.28, 0.26
# Characters of a text per inch.
CHARACTERS = 16


@shows("discover", block="Residual of the start model")
def story(tree: xr.DataTree, run: int = 0, *, width: float = FULL_WIDTH) -> Figure:
    """The record and the motion of each model, with fitted start and sensor's zero.

    Below, the residuals of the start and final model, each on its own scale; the band is plus and minus twice
    the noise. Mean force f that each of them lacks over angle and rate, in θ″ + w²θ = -w²f, for all runs;
    blank where samples are few. Dots mark cells beyond three standard errors of the noise. The last panel
    shows the RMS of the residual over the noise, for the start model and after each effect.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    run : int
        Which of several runs, from 0.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> found = st.discover(st.records.paper_twin(), "lambda,zeta,delta,nu", "epsilon,dahl")
    >>> figure = st.plots.story(found)
    >>> figure.axes[0].get_ylabel()
    'angle (rad)'
    """
    wide = width >= TWO_COLUMNS
    texts = ["", *_texts_of_effects(tree, width)]
    # Each row has space for the text above its line.
    below = np.cumsum([MODEL_ROW + LINE * len(text.splitlines()) for text in texts])
    heights = [*PANEL_HEIGHTS, LAST_HEIGHT + below[-1]]
    heights.insert(3, MAP_HEIGHTS[not wide])
    with mpl.rc_context({"font.size": FONT_SIZE}):
        figure = new_figure(width, sum(heights))
        panels = list(figure.subplot_mosaic("AA;BB;CC;DE;FF", height_ratios=heights).values())
        draw_in_time(panels[:3], tree, run, ["before", "after"])
        for panel in panels[1:3]:
            panel.set_ylabel(f"residual ({small_units(signal_units(tree))[1]})")
        figure.align_ylabels(panels[:3])
        _maps(tree, panels[3:5], wide)
        _explained(panels[5], tree, texts, below)
        titles = (
            "record",
            "residual before: record \N{MINUS SIGN} start model",
            "residual after: record \N{MINUS SIGN} final model",
            "missing force before",
            f"missing force after: dots beyond {DOT_BEYOND:g} errors",
            "effects named" if steps_taken(tree) else "no effect named",
        )
        style.letter(
            panels, [title if wide else title.partition(":")[0] for title in titles], FONT_SIZE + 0.5
        )
        style.footnote(figure, held_out_sentence(tree))
    return figure


def _texts_of_effects(tree: xr.DataTree, width: float) -> list[str]:
    """Return each named effect; in a column, its competing effects are on separate lines."""
    parts = [_in_parts(step, signal_units(tree)) for step in steps_taken(tree)]
    room = int(CHARACTERS * (width - 1.3))
    if width < TWO_COLUMNS:
        return ["\n".join([effect, *wrap(tied, room)]) for _, effect, tied in parts]
    return [fill(f"{name}, {effect}{tied and '; '}{tied}", room) for name, effect, tied in parts]


def _explained(ax: Axes, tree: xr.DataTree, texts: Sequence[str], rows: Array) -> None:
    """Draw the RMS residual of the start model and after each named effect, over the noise."""
    steps, units = steps_taken(tree), signal_units(tree)
    # As in the table of the steps: all its models were fitted to the same part of the record.
    first = steps[0].residual_before.item() if steps else residual_of(tree, "before")
    residuals = [first, *(step.residual_after.item() for step in steps)]
    ratios = [residual / record_noise(tree) for residual in residuals]
    note = style.LABEL_OFFSET | {"fontsize": FONT_SIZE, "annotation_clip": False}
    for row, ratio, text in zip(rows, ratios, texts, strict=True):
        look = style.CANDIDATE_MARKS["named" if text else "other candidates"]
        ax.plot([1.0, ratio], [row, row], color=look["color"], linewidth=0.8)
        ax.plot([ratio], [row], **{"linestyle": ""} | look)
        ax.annotate(f"{ratio:.3g}", (ratio, row), (8, 0), **note)
        # Above its line, because a long name may not fit next to a mark.
        words = ax.annotate(text, (1.0, row), (8, 5), **(note | {"va": "bottom"}))
        # A long text would squeeze all panels.
        words.set_in_layout(False)
    ax.axvline(1.0, **style.THRESHOLD)
    ax.set_yticks(rows, ["start model", *(f"+ {step.symbol.item()}" for step in steps)])
    ax.set_ylim(rows[-1] + MODEL_ROW, rows[0] - MODEL_ROW)
    low, high = min(1.0, *ratios) / 1.15, max(2.0, *ratios)
    label = f"RMS residual over the noise{style.short_unit('', units)[1]}"
    ax.set(xlabel=label, xscale="log", xlim=(low, high * (high / low) ** 0.2))
    style.logarithmic_ticks(ax.xaxis, low, high)


def _in_parts(step: xr.Dataset, units: str) -> tuple[str, str, str]:
    """Return the name of an effect, its symbol with its coefficient, and its competing effects."""
    symbol = step.symbol.item()
    pairs = replacing_pairs(step)
    # Their names would be wider than the figure.
    together = [f"one of {len(pairs)} pairs"] if len(pairs) > 1 else [*map(" and ".join, pairs)]
    others = [*(other for other in credible_set(step) if other != symbol), *together]
    tied = f"or {or_others(others, TIED_IN_A_ROW)}" if others else ""
    number = quantity(step, "coefficient", style.short_unit(step.unit.item(), units)[0])
    return step["name"].item(), f"{symbol} = {number}", tied


def _maps(tree: xr.DataTree, panels: list[Axes], wide: bool) -> None:
    """Draw the mean force over angle and rate that start and final model lack, relative to I w^2.

    Both have the same colours, limited by those of the start model, and are blank where samples are few.
    """
    units = signal_units(tree)
    x, (factor, unit) = signal_symbol(units), small_units(units)
    models = [tree[name].to_dataset() for name in ("discrepancy", "discrepancy_after")]
    kept = np.abs(models[0].force.values[models[0].samples.values >= FEWEST_IN_CELL])
    kept = kept[np.isfinite(kept)]
    limit = factor * float(np.percentile(kept, COLOUR_PERCENT)) if kept.size else 1.0
    panels[1].sharex(panels[0])
    panels[1].sharey(panels[0])
    for ax, shown in zip(panels, models, strict=True):
        force = (factor * shown.force).where(shown.samples >= FEWEST_IN_CELL)
        mesh = draw_cells(ax, force, factor * shown.force_standard_error, limit)
        ax.set(xlabel=f"{signal_label(units).split()[0]} ${x}$ ({units})")
        ax.set(ylabel=rf"$\dot{{{x}}}/\omega$ ({units})")
    panels[1].set_ylabel("")
    panels[1].tick_params(labelleft=False)
    place = "right" if wide else "bottom"
    bar = panels[0].figure.colorbar(mesh, ax=panels, extend="both", pad=0.02, location=place)
    bar.set_label(f"missing force over $I\\omega^2$ ({unit})")


def draw_cells(ax: Axes, force: xr.DataArray, error: xr.DataArray, limit: float) -> QuadMesh:
    """Draw a force over angle and rate in colours up to `limit`, with dots above the noise."""
    x, v, values = force.x.values, force.v.values, force.values
    look: dict[str, Any] = {"cmap": "RdBu_r", "norm": TwoSlopeNorm(0.0, -limit, limit), "rasterized": True}
    mesh = ax.pcolormesh(x, v, values.T, shading="nearest", **look)
    at_x, at_v = np.nonzero(np.abs(values) > DOT_BEYOND * error.values)
    ax.plot(x[at_x], v[at_v], ".", color="black", markersize=2.5)
    return mesh


# Candidates in a ranking.
MOST_CANDIDATES = 15
# Scores beyond this multiple of the threshold are drawn on a logarithmic axis.
LOGARITHMIC_BEYOND = 5.0
# If all scores exceed this multiple of the threshold, it is not shown; the axis then extends below them by
# this fraction of their range.
ALL_BEYOND, ROOM_BELOW = 1.5, 0.2
# Panel height without candidates, and height of each candidate, inch.
RANKING_HEIGHT, CANDIDATE_HEIGHT = 0.75, 0.135
# There is always space for this number: the legend at the side needs some.
FEWEST_CANDIDATES = 6


@shows("discover", block="Models and candidates")
def ranking(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """Candidates by score, before each step that named an effect and, unless all are named, at the end.

    Orange diamond: the named effect; blue squares: effects that compete with it; open: others. The dashed
    line is the threshold, corrected for the number of candidates.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> found = st.discover(st.records.paper_twin(), "lambda,zeta,delta,nu", "epsilon,dahl")
    >>> figure = st.plots.ranking(found)
    >>> [ax.get_title(loc="left") for ax in figure.axes]
    ['(a) before step 1', '(b) at the end']
    """
    # Selection step at which each effect was chosen: 0 before the first.
    chosen = [step.selection_step.item() for step in steps_taken(tree)]
    steps = sorted(set(chosen))
    if not steps or _scores(tree, -1, MOST_CANDIDATES).sizes["candidate"]:
        steps.append(-1)
    rows = -(-len(steps) // (2 if width >= TWO_COLUMNS else 1))
    room = int((TALLEST - 0.3 - rows * RANKING_HEIGHT) / (rows * CANDIDATE_HEIGHT))
    drawn = [_scores(tree, step, min(room, MOST_CANDIDATES)) for step in steps]
    most = max(FEWEST_CANDIDATES, *(data.sizes["candidate"] for data in drawn))
    figure, panels = style.grid(len(drawn), 2, width, RANKING_HEIGHT + CANDIDATE_HEIGHT * most)
    for data, panel in zip(drawn, panels, strict=True):
        _ranking(panel, data)
    before = (" and ".join(str(at + 1) for at, when in enumerate(chosen) if when == step) for step in steps)
    last = (-1, tree["ranking"].sizes["selection_step"] - 1)
    pairs = zip(steps, before, strict=True)
    style.letter(panels, ["at the end" if step in last else f"before step {n}" for step, n in pairs])
    handles = style.legend_marks(style.CANDIDATE_MARKS | {"threshold": style.THRESHOLD})
    style.legend_above(figure, handles, 4 if width >= TWO_COLUMNS else 2, 8)
    style.footnote(figure, held_out_sentence(tree, of_search=True))
    return figure


def _scores(tree: xr.DataTree, selection_step: int, most: int) -> xr.Dataset:
    """Return the candidates of the highest scores at a selection step, and all named or competing ones.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    selection_step : int
        0 before the first step, 1 before the second, ..., -1 at the end.
    most : int
        Number of candidates in addition to the named and competing ones.

    Returns
    -------
    xr.Dataset
        Columns of `ranking` at the step for the drawn candidates, the highest score first, with
        `kind(candidate)`, a key of `CANDIDATE_MARKS`; `threshold`, the |z| above which a candidate is named.
    """
    scores = tree["ranking"].to_dataset().isel(selection_step=selection_step)
    here = [step for step in steps_taken(tree) if step.selection_step == selection_step]
    sets = [list(credible_set(step)) for step in here]
    named = [credible[0] for credible in sets]
    competing = [symbol for credible in sets for symbol in credible[1:] if symbol not in named]
    chosen = strongest(scores.expand_dims("selection_step"), most)
    tested = scores.candidate.values[np.isfinite(scores.z.values)]
    chosen += [s for s in (*named, *competing) if s in tested and s not in chosen]
    kinds = list(style.CANDIDATE_MARKS)
    kind = [kinds[0] if s in named else kinds[1] if s in competing else kinds[2] for s in chosen]
    return scores.sel(candidate=chosen).assign(kind=("candidate", np.array(kind, dtype=str)))


def _ranking(ax: Axes, data: xr.Dataset) -> None:
    sizes, threshold = np.abs(data.z.values), data.threshold.item()
    high, low = max([threshold, *sizes]), 0.0
    logarithmic = high > LOGARITHMIC_BEYOND * threshold
    if sizes.size and sizes.min() > ALL_BEYOND * threshold:
        # A linear axis from zero, or a logarithmic one, would hide the differences of the candidates.
        logarithmic, low = False, float(sizes.min() - ROOM_BELOW * max(np.ptp(sizes), 0.05 * high))
    elif logarithmic:
        # Scores of several hundred and a threshold of four need a logarithmic axis to show the differences.
        low = min([0.5 * threshold, *(0.7 * sizes)])
    for row, (size, kind) in enumerate(zip(sizes.tolist(), data.kind.values.tolist(), strict=True)):
        look = style.CANDIDATE_MARKS[kind]
        if low == 0.0 or logarithmic:
            # The length of a bar would be misleading if the axis does not start at zero.
            ax.plot([low, size], [row, row], "-", color=look["color"], linewidth=0.8)
        ax.plot([size], [row], linestyle="", **look)
        # Three digits, and no power of ten if there is space without it.
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
