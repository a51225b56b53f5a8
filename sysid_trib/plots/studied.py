"""Figures of a study: errors of methods against noise, sampling rate and the like, above their floor."""

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.plots.style import SERIES, axes, in_latex, line, mark

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACROSS = 3
# Levels below this many times the smallest have no two decades to label.
NARROW = 100.0


def precisions(found: xr.Dataset) -> "Figure":
    """Error of each force by level, one panel a force.

    Parameters
    ----------
    found : see `precision`.
    """
    from matplotlib.figure import Figure

    forces = found.force.values.tolist()
    rows = -(-len(forces) // ACROSS)
    figure = Figure(figsize=(8.0, 2.4 * rows + 0.3), layout="constrained")
    panels = figure.subplots(rows, ACROSS, squeeze=False, sharex=True).ravel()
    for at, panel in enumerate(panels):
        if at >= len(forces):
            panel.remove()
            continue
        precision(found, forces[at], panel)
        panel.get_legend().remove()
        # Panels that stand above none show the levels themselves.
        panel.tick_params(labelbottom=at + ACROSS >= len(forces))
        panel.set_xlabel(panel.get_xlabel() if at + ACROSS >= len(forces) else "")
        panel.set_ylabel("error" if at % ACROSS == 0 else "")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=4, loc="outside upper center", frameon=False, fontsize=8)
    return figure


def precision(found: xr.Dataset, force: str, ax: "Axes | None" = None) -> "Axes":
    """Error of one force by level for each method, and the Cramér-Rao bound, below which no one gets.

    Parameters
    ----------
    found : `error(method, level, force)`, RMS over records or the like, `bound(level, force)`, and the
        coordinate `level` with its `long_name` and `units`.
    force : its symbol.
    """
    ax = axes(ax)
    one = found.sel(force=force)
    level, bound = one.level.values, one.bound.transpose("level").values
    for method, series in zip(one.method.values.tolist(), cycle(SERIES), strict=False):
        ax.plot(level, one.error.sel({"method": method}).values, label=method, **line(series) | mark(series))
    ax.plot(level, bound, color="black", linewidth=1.0, label="Cramér-Rao bound")
    ax.set(xscale="log", yscale="log")
    _ticks(ax, level)
    low = 0.5 * float(np.min(bound))
    ax.fill_between(level, np.full(len(level), low), bound, color="0.9", linewidth=0)
    ax.set_ylim(bottom=low)
    told = one.level.attrs
    ax.set(xlabel=f"{told['long_name']} ({told['units']})", ylabel="error")
    ax.set_title(in_latex(force), loc="left", fontsize=9)
    ax.legend(frameon=False, fontsize=7)
    return ax


def _ticks(ax: "Axes", level: NDArray[np.float64]) -> None:
    """Labels that do not run into each other: levels that are few, else decades; 1 and 3 of the errors."""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, NullLocator

    if level.max() < NARROW * level.min():
        ax.set_xticks(level, [f"{value:g}" for value in level])
        ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    ax.yaxis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.tick_params(labelsize=8)
