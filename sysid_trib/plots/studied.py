"""Figures of a study: errors of methods against noise, sampling rate and the like, above their floor."""

from itertools import cycle

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from sysid_trib.plots.style import SERIES, grid, in_latex, line, mark

STUDY_COLUMNS = 3
# Levels below this many times the smallest have no two decades to label.
FEW_DECADES = 100.0


def precision(study: xr.Dataset) -> Figure:
    """Error of each force by level for each method, and the Cramér-Rao bound, below which no one gets.

    Parameters
    ----------
    study : xr.Dataset
        `error(method, level, force)`, RMS over records or the like, `bound(level, force)`, and the
        coordinate `level` with its `long_name` and `units`.
    """
    forces = study.force.values.tolist()
    figure, panels = grid(len(forces), STUDY_COLUMNS, 8.0, 2.4, sharing="x")
    for at, (force, panel) in enumerate(zip(forces, panels, strict=True)):
        _errors(study, force, panel)
        # Panels that stand above none show the levels themselves.
        lowest = at + STUDY_COLUMNS >= len(forces)
        panel.tick_params(labelbottom=lowest)
        panel.set_xlabel(panel.get_xlabel() if lowest else "")
        panel.set_ylabel("error" if at % STUDY_COLUMNS == 0 else "")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, ncols=4, loc="outside upper center", frameon=False, fontsize=8)
    return figure


def _errors(study: xr.Dataset, force: str, ax: Axes) -> None:
    of_force = study.sel(force=force)
    level, bound = of_force.level.values, of_force.bound.transpose("level").values
    for method, series in zip(of_force.method.values.tolist(), cycle(SERIES), strict=False):
        error = of_force.error.sel({"method": method}).values
        ax.plot(level, error, label=method, **line(series) | mark(series))
    ax.plot(level, bound, color="black", linewidth=1.0, label="Cramér-Rao bound")
    ax.set(xscale="log", yscale="log")
    _ticks(ax, level)
    low = 0.5 * float(np.min(bound))
    ax.fill_between(level, np.full(len(level), low), bound, color="0.9", linewidth=0)
    ax.set_ylim(bottom=low)
    label = "{long_name} ({units})".format_map(of_force.level.attrs)
    ax.set(xlabel=label, ylabel="error")
    ax.set_title(in_latex(force), loc="left", fontsize=9)


def _ticks(ax: Axes, level: NDArray[np.float64]) -> None:
    """Labels that do not run into each other: levels that are few, else decades; 1 and 3 of the errors."""
    if level.max() < FEW_DECADES * level.min():
        ax.set_xticks(level, [f"{value:g}" for value in level])
        ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    ax.yaxis.set_major_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.tick_params(labelsize=8)
