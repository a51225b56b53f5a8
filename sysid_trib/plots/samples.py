"""Two samples held against each other."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from sysid_trib.plots.looked import CURVE_LABELS, draw_curve
from sysid_trib.plots.style import (
    BLUE,
    FULL_WIDTH,
    GREY,
    INK,
    ORANGE,
    TWO_COLUMNS,
    in_latex,
    letter,
    new_figure,
)
from sysid_trib.printing.layout import value_with_error
from sysid_trib.validation.samples import SIDES

SAMPLE_COLOURS = dict(zip(SIDES, (BLUE, ORANGE), strict=True))
# Inch: of the curves, and of a row of the differences.
CURVES_HEIGHT, ROW = 2.4, 0.28
# Differences of more errors stand at the edge.
MOST_ERRORS = 8.0


def difference(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """Damping and frequency of both samples against amplitude, and the difference of each coefficient.

    Parameters
    ----------
    tree : DataTree
        Of `held_against`, which the command `difference` writes.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    count = tree.sizes["force"]
    wide = width >= TWO_COLUMNS
    heights = [CURVES_HEIGHT * (2 - wide), ROW * (1.0 if wide else 1.5) * (count + 2)]
    figure = new_figure(width, sum(heights))
    rows = figure.add_gridspec(2, 1, height_ratios=heights)
    curves = rows[0].subgridspec(*((1, 2) if wide else (2, 1)))
    panels = [figure.add_subplot(curves[at]) for at in range(2)]
    for ax, name in zip(panels, CURVE_LABELS, strict=True):
        _draw_samples(ax, tree, name)
    panels.append(figure.add_subplot(rows[1]))
    _draw_differences(panels[-1], tree, wide)
    letter(panels)
    lines, labels = panels[0].get_legend_handles_labels()
    figure.legend(lines, labels, ncols=2 if wide else 1, loc="outside upper right", frameon=False, fontsize=8)
    return figure


def _draw_samples(ax: Axes, tree: xr.DataTree, name: str) -> None:
    """One curve of the backbone of every run, in the colour of its sample."""
    limits = []
    for side, colour in SAMPLE_COLOURS.items():
        groups = [k for k in tree.children if k.startswith(f"backbone_{side}")]
        for at, group in enumerate(groups):
            label = f"{side} sample, 95 %" if at == 0 else None
            draw_curve(ax, tree[group].to_dataset(), name, colour=colour, label=label)
            limits.append((*ax.get_ylim(), *ax.get_xlim()))
    if limits:
        low, high, left, right = np.array(limits).T
        ax.set(ylim=(low.min(), high.max()), xlim=(left.min(), right.max()))


def _draw_differences(ax: Axes, tree: xr.DataTree, wide: bool) -> None:
    """A row each force: first minus second over the standard error, with the interval of the level."""
    data = tree.to_dataset()
    symbols, z = data.force.values.tolist(), data.z.values
    half = float(norm.isf(0.5 * float(data.attrs["level"]) / len(symbols)))
    edge = min(MOST_ERRORS, float(np.nanmax(np.abs(z), initial=half))) + 1.1 * half
    ax.axvline(0.0, color=GREY, linewidth=0.6)
    for at, symbol in enumerate(symbols):
        row, shown = data.sel(force=symbol), float(np.clip(z[at], -MOST_ERRORS, MOST_ERRORS))
        if not np.isfinite(shown):
            continue
        colour = INK if row.differs.item() else GREY
        ax.errorbar(shown, at, xerr=half, fmt="o", color=colour, markersize=4, linewidth=1.0)
        pair = (value_with_error(row[k].item(), row[f"{k}_standard_error"].item()) for k in SIDES)
        outside = f"  z = {z[at]:+.0f}" if abs(z[at]) > MOST_ERRORS else ""
        # Beside the row, or in a column above it.
        place, side = ((1.01, at), "center") if wide else ((0.02, at - 0.16), "bottom")
        text = " and ".join(pair) + outside
        ax.annotate(
            text,
            place,
            xycoords=("axes fraction", "data"),
            va=side,
            color=colour,
            fontsize=8 if wide else 6.5,
            annotation_clip=False,
        )
    ax.set(xlim=(-edge, edge), ylim=(len(symbols) - 0.4, -0.6))
    ax.set_yticks(range(len(symbols)), [in_latex(symbol) for symbol in symbols])
    ax.set_xlabel("first minus second, over its standard error", fontsize=8)
