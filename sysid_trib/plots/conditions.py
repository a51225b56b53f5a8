"""Numbers against conditions: coefficients of many runs, and errors of methods in a study."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, NullLocator
from numpy.typing import ArrayLike, NDArray

from sysid_trib.plots.style import (
    FULL_WIDTH,
    INK,
    LABEL_OFFSET,
    ORANGE,
    SERIES,
    grid,
    in_latex,
    line,
    mark,
    unit_label,
)

ACROSS = 2
# Beyond these runs bars hide the marks.
MANY_RUNS = 300
# Runs that stand out are drawn in another colour: standard deviations.
FAR = 4.0
# So many of them are named.
MOST_NAMES_DRAWN = 8


def against_condition(
    compared: xr.Dataset, name: str, condition: ArrayLike, *, width: float = FULL_WIDTH
) -> Figure:
    """Each quantity of all runs against a condition, with standard errors; outliers in another colour.

    Parameters
    ----------
    compared : Dataset
        Of `between_runs`.
    name : str
        Of the condition.
    condition : (run,) array_like
        Its value in each run, numbers or texts.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    quantities = compared.quantity.values.tolist()
    figure, panels = grid(len(quantities), ACROSS, width, 2.2)
    for quantity, panel in zip(quantities, panels, strict=True):
        _of_quantity(panel, compared, quantity, name, condition)
    return figure


def _of_quantity(ax: Axes, compared: xr.Dataset, quantity: str, name: str, condition: ArrayLike) -> None:
    """One quantity of all runs, with standard errors; outliers in another colour."""
    of_quantity = compared.sel(quantity=quantity)
    at, ticks = places(np.asarray(condition))
    far = np.abs(of_quantity.z.values) > FAR
    few = len(at) <= MANY_RUNS
    for chosen, color in ((~far, INK), (far, ORANGE)):
        value, error = of_quantity.value.values[chosen], of_quantity.standard_error.values[chosen]
        bars = {"yerr": error, "elinewidth": 0.8} if few else {}
        ax.errorbar(at[chosen], value, fmt="o", markersize=3 if few else 1.5, color=color, **bars)
    if np.count_nonzero(far) <= MOST_NAMES_DRAWN:
        _name_runs(ax, of_quantity.isel(run=far), at[far])
    if ticks:
        ax.set_xticks(range(len(ticks)), ticks)
    unit = str(of_quantity.unit.item()).removeprefix("1") if "unit" in of_quantity.coords else ""
    ax.set(xlabel=name, ylabel=f"{quantity} ({unit_label(unit)})" if unit else quantity)


def _name_runs(ax: Axes, named: xr.Dataset, at: np.ndarray) -> None:
    """The name of each run beside its mark, towards the middle, where there is room."""
    middle = np.mean(ax.get_xlim())
    for x, value, name in zip(at, named.value.values, named.run.values, strict=True):
        side, end = (5, "left") if x < middle else (-5, "right")
        ax.annotate(str(name), (x, value), (side, 0), ha=end, fontsize=6, **LABEL_OFFSET)


def places(condition: np.ndarray) -> tuple[np.ndarray, Sequence[str]]:
    """Where the runs stand on the axis of a condition, and the labels of texts."""
    if condition.dtype.kind in "fiu":
        return condition.astype(float), ()
    labels, numbers = np.unique(condition.astype(str), return_inverse=True)
    at = numbers.astype(float)
    for group in range(len(labels)):
        # Runs of a group side by side about its label, so that none hides another.
        count = np.count_nonzero(numbers == group)
        at[numbers == group] += (np.arange(count) + 0.5) / (2.0 * count) - 0.25
    return at, labels.tolist()


STUDY_COLUMNS = 3
# Levels below this many times the smallest have no two decades to label.
FEW_DECADES = 100.0


def precision(study: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """Error of each force by level for each method, and the Cramér-Rao bound, below which no one gets.

    Parameters
    ----------
    study : xr.Dataset
        `error(method, level, force)`, RMS over records or the like, `bound(level, force)`, and the
        coordinate `level` with its `long_name` and `units`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    forces = study.force.values.tolist()
    figure, panels = grid(len(forces), STUDY_COLUMNS, 8.0, 2.4, sharing="x")
    for at, (force, panel) in enumerate(zip(forces, panels, strict=True)):
        _errors(study, force, panel)
        # Panels that stand above none show the levels themselves.
        lowest = at + STUDY_COLUMNS >= len(forces)
        panel.tick_params(labelbottom=lowest)
        panel.set_xlabel(panel.get_xlabel() if lowest else "", fontsize=8)
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
