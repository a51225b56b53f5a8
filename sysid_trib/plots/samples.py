"""Two samples held against each other."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from sysid_trib.plots.looked import CURVE_LABELS, draw_curve
from sysid_trib.plots.style import BLUE, FULL_WIDTH, GREY, INK, LEGEND, ORANGE, letter, new_figure
from sysid_trib.printing.layout import value_with_error
from sysid_trib.validation.samples import SIDES

SAMPLE_COLOURS = dict(zip(SIDES, (BLUE, ORANGE), strict=True))
# Inch: of the curves, and of a row of the differences.
CURVES_HEIGHT, ROW = 2.4, 0.28
# Differences of more errors stand at the edge.
MOST_ERRORS = 8.0


def difference(tree: xr.DataTree) -> Figure:
    """Damping and frequency of both samples against amplitude, and the difference of each coefficient.

    Parameters
    ----------
    tree : DataTree
        Of `held_against`, which the command `difference` writes.
    """
    count = tree.sizes["force"]
    figure = new_figure(FULL_WIDTH, CURVES_HEIGHT + ROW * (count + 2))
    rows = figure.add_gridspec(2, 1, height_ratios=[CURVES_HEIGHT, ROW * (count + 2)])
    curves = rows[0].subgridspec(1, 2)
    panels = [figure.add_subplot(curves[0, at]) for at in range(2)]
    for ax, name in zip(panels, CURVE_LABELS, strict=True):
        _draw_samples(ax, tree, name)
    panels.append(figure.add_subplot(rows[1]))
    _draw_differences(panels[-1], tree)
    letter(panels)
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
        if name == "frequency":
            ax.legend(**LEGEND, ncols=2)


def _draw_differences(ax: Axes, tree: xr.DataTree) -> None:
    """A row each force: first minus second over the standard error, with the interval of the level."""
    data = tree.to_dataset()
    symbols, z = data.force.values.tolist(), data.z.values
    half = float(norm.isf(0.5 * float(data.attrs["level"]) / len(symbols)))
    edge = min(MOST_ERRORS, float(np.nanmax(np.abs(z), initial=half))) + half
    ax.axvline(0.0, color=GREY, linewidth=0.6)
    for at, symbol in enumerate(symbols):
        row, shown = data.sel(force=symbol), float(np.clip(z[at], -MOST_ERRORS, MOST_ERRORS))
        if not np.isfinite(shown):
            continue
        colour = INK if row.differs.item() else GREY
        ax.errorbar(shown, at, xerr=half, fmt="o", color=colour, markersize=4, linewidth=1.0)
        pair = (value_with_error(row[k].item(), row[f"{k}_standard_error"].item()) for k in SIDES)
        outside = f"  z = {z[at]:+.0f}" if abs(z[at]) > MOST_ERRORS else ""
        ax.annotate(
            " and ".join(pair) + outside,
            (1.01, at),
            xycoords=("axes fraction", "data"),
            va="center",
            color=colour,
            annotation_clip=False,
        )
    ax.set(xlim=(-edge, edge), ylim=(len(symbols) - 0.4, -0.6))
    ax.set_yticks(range(len(symbols)), symbols)
    ax.set_xlabel("first minus second, over its standard error")
