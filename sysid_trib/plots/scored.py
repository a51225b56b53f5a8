"""Figures of a discovery: how each candidate scores, and how weak an effect the record would show."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots import style
from sysid_trib.plots.discovery_data import detectability_data, held_out_sentence, rankings_data

# Height of a panel of rankings, and of detectable coefficients: without rows, and of a row, inch.
RANKING_HEIGHT, DETECTABLE_HEIGHT, DETECTABLE_ROW = 3.35, 0.95, 0.155


def ranking(tree: xr.DataTree) -> Figure:
    """The ranking before each step and at the end, side by side.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    """
    drawn = rankings_data(tree)
    across = min(len(drawn), 2)
    figure, panels = style.grid(len(drawn), across, 3.6 * across, RANKING_HEIGHT)
    for data, panel in zip(drawn, panels, strict=True):
        _ranking(panel, data)
    style.letter(panels, [data.title for data in drawn])
    handles = style.legend_marks(style.CANDIDATE_MARKS | {"threshold": style.THRESHOLD})
    figure.legend(handles=handles, ncols=4, loc="outside upper center", frameon=False, fontsize=8)
    style.footnote(figure, held_out_sentence(tree, of_search=True))
    return figure


def _ranking(ax: Axes, data: xr.Dataset) -> None:
    sizes, kinds = data["size"].values.tolist(), data.kind.values.tolist()
    for row, (size, kind) in enumerate(zip(sizes, kinds, strict=True)):
        look = style.CANDIDATE_MARKS[kind]
        if data.low == 0.0 or data.logarithmic:
            # A bar would be as long as it must not be where the axis starts elsewhere.
            ax.plot([data.low, size], [row, row], "-", color=look["color"], linewidth=0.8)
        ax.plot([size], [row], linestyle="", **look)
        # Three digits, and no power of ten as long as there is room without.
        digits = f"{float(f'{size:.3g}'):g}"
        text = ax.annotate(digits, (size, row), (5, 0), fontsize=6, **style.BESIDE_POINT)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4})
    threshold = data.threshold.item()
    if data.low < threshold:
        ax.axvline(threshold, **style.THRESHOLD)
    style.name_rows(ax, data.candidate.values.tolist())
    if data.logarithmic:
        ax.set(xscale="log", xlim=(data.low, data.high * (data.high / data.low) ** 0.2))
        style.logarithmic_ticks(ax.xaxis, data.low, data.high)
    else:
        ax.set_xlim(data.low, data.high + 0.15 * (data.high - data.low))
        ax.grid(axis="y", color="0.93", linewidth=0.5)
        ax.set_axisbelow(True)
    ax.set_xlabel(f"score |z| (threshold {threshold:.3g})", fontsize=8)
    ax.tick_params(labelsize=7, which="both")


def forecast(tree: xr.DataTree, *, width: float = style.FULL_WIDTH) -> Figure:
    """Smallest coefficient of each candidate that the record would show, and effects that were identified.

    As high as there are candidates.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    rows = tree["detectability"].sizes["candidate"]
    figure = style.new_figure(width, DETECTABLE_HEIGHT + DETECTABLE_ROW * rows)
    _detectable(figure.subplots(), detectability_data(tree))
    style.footnote(figure, held_out_sentence(tree, of_search=True))
    return figure


def _detectable(ax: Axes, data: xr.Dataset) -> None:
    sizes = data[["start", "final", "identified"]].to_dataarray().values
    # In the right half a text stands left of its mark.
    half = np.sqrt(np.nanmin(sizes) * np.nanmax(sizes)) if np.isfinite(sizes).any() else np.inf
    for row, (start, final, identified) in enumerate(sizes.T.tolist()):
        if not np.any(np.isfinite([start, final])):
            ax.text(0.01, row, "not testable", transform=ax.get_yaxis_transform(), va="center", fontsize=6)
        elif np.isnan(final) and data.in_final.values[row]:
            side = {"xytext": (-5, 0), "ha": "right"} if start > half else {"xytext": (5, 0)}
            ax.annotate("start model only", (start, row), fontsize=6, **side, **style.BESIDE_POINT)
        ax.plot([start, final], [row, row], "-", color="0.6", linewidth=0.7)
        for value, look in zip((start, final, identified), style.DETECTABLE_MARKS.values(), strict=True):
            if look is not style.DETECTABLE_MARKS["identified"] or np.isfinite(value):
                ax.plot([value], [row], **{"linestyle": ""} | look)
    _families(ax, data.family.values.tolist())
    style.name_rows(ax, data.candidate.values.tolist())
    ax.set_xlabel("coefficient of five standard errors\n(in the candidate's unit)", fontsize=8)
    if np.isfinite(sizes).any():
        ax.set_xscale("log")
    ax.tick_params(axis="y", labelsize=6)
    ax.tick_params(axis="x", labelsize=8)
    ax.grid(axis="x", color="0.9", linewidth=0.5)
    ax.set_axisbelow(True)
    close: dict[str, Any] = {"columnspacing": 0.9, "handletextpad": 0.1}
    ax.legend(handles=style.legend_marks(style.DETECTABLE_MARKS), ncols=3, **(style.LEGEND | close))


def _families(ax: Axes, families: list[str]) -> None:
    """A band behind every second family, and its name at the right."""
    for at, family in enumerate(dict.fromkeys(families)):
        rows = [row for row, name in enumerate(families) if name == family]
        if at % 2 == 0:
            ax.axhspan(rows[0] - 0.5, rows[-1] + 0.5, color="0.96", zorder=0)
        look: dict[str, Any] = {"color": "0.3", "fontsize": 7, "va": "center"}
        middle = 0.5 * (rows[0] + rows[-1])
        ax.text(1.01, middle, family or "other", transform=ax.get_yaxis_transform(), **look)
