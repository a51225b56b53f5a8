"""Methods side by side, one panel per force; and many runs against their conditions."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.plots import style
from sysid_trib.plots.figure import FULL_WIDTH, TWO_COLUMNS, shows
from sysid_trib.plots.style import INK, ORANGE
from sysid_trib.results.judged import column_power, comparison_of
from sysid_trib.results.models import library_of

# Marks of the families stated by methods (see `MethodScope`).
OTHER_FAMILY = "other"
FAMILY_MARKS: dict[str, dict[str, Any]] = {
    "trajectory": {"color": style.GREEN, "marker": "D"},
    "direct": {"color": style.BLUE, "marker": "s"},
    "averaging": {"color": style.ORANGE, "marker": "o"},
    OTHER_FAMILY: {"color": style.INK, "marker": "^"},
}
FAMILY_LABELS = {OTHER_FAMILY: "decrements and others"}
ASYMPTOTIC = "asymptotic_frequency"
PREDICTION = ("train_over_noise", "holdout_over_noise")
# Marks of the last panel.
OF_THE_RMS: dict[str, dict[str, Any]] = {
    "RMS: fitted": {"color": style.GREY, "marker": "o", "markerfacecolor": "white"},
    "RMS: held out": {"color": style.GREY, "marker": "o"},
}
# A method whose distance from the best exceeds this multiple of the usual distance is an arrow at the edge.
ARROW_BEYOND = 5.0


def shown_methods(tree: xr.DataTree) -> xr.Dataset:
    """Return the group `comparison` of a result of `compare`, for the methods that have any result."""
    table = comparison_of(tree)
    # A method that failed must not set the scale.
    table = table.isel(model=np.flatnonzero((table.failure == "") | (table.model == table.attrs["best"])))
    results = [table[name].notnull() for name in ("coefficient", ASYMPTOTIC, *PREDICTION)]
    there = [column.any("force") if "force" in column.dims else column for column in results]
    return table.isel(model=np.flatnonzero(np.any(there, axis=0)))


def _marks(table: xr.Dataset) -> tuple[list[style.Style], dict[str, style.Style]]:
    """Return the mark of each method, open except for the first of its family; and marks by family."""
    marks: list[style.Style] = []
    before: set[str] = set()
    for stated in table.family.values.tolist():
        family = stated if stated in FAMILY_MARKS else OTHER_FAMILY
        face = {"markerfacecolor": "white"} if family in before - {OTHER_FAMILY} else {}
        marks.append(FAMILY_MARKS[family] | face)
        before.add(family)
    return marks, {FAMILY_LABELS.get(k, k): mark for k, mark in FAMILY_MARKS.items() if k in before}


def _limits(value: Array, error: Array, best: int) -> tuple[float, float]:
    """Return the limits of an axis that contain most methods; an outlier must not squeeze the others."""
    known = np.isfinite(value[best])
    centre = float(value[best] if known else np.nanmedian(value))
    distance = np.abs(value - centre) + error
    usual = max(float(np.nanmedian(distance)), 3.0 * float(error[best]) if known else 0.0)
    inside = distance <= ARROW_BEYOND * usual
    low = min(float((value - error)[inside].min(initial=np.inf)), centre - usual)
    high = max(float((value + error)[inside].max(initial=-np.inf)), centre + usual)
    spare = max(0.08 * (high - low), 1e-9 * abs(centre), 1e-300)
    return low - spare, high + spare


@shows("compare", block="Coefficients by method")
def comparison(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """Each quantity by method with its standard error; the band is that of the method of best prediction.

    An arrow is a value outside of the axis. Open marks are variants of the method above. Green: trajectory,
    blue: direct, orange: averaging, dark: decrements and others. A method that does not apply has no row. The
    last panel shows the RMS of record minus simulated model over the noise, for the part used for
    identification (open) and the held-out part (full); 1 is the noise alone.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `compare`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> compared = st.compare(st.records.paper_twin(), methods=["averaging", "direct"])
    >>> figure = st.plots.comparison(compared)
    >>> len(figure.axes), figure.axes[-1].get_xlabel()
    (7, 'RMS over noise')
    """
    table = shown_methods(tree)
    marks, legend = _marks(table)
    names = [*table.force.values.tolist(), ASYMPTOTIC]
    wide = width >= TWO_COLUMNS
    across = min((3, 4), key=lambda columns: -(len(names) + 1) % columns) if wide else 3
    height = 0.7 + 0.14 * len(marks)
    figure, panels = style.grid(len(names) + 1, across if wide else 2 * across, width, height, sharing="y")
    for name, panel in zip(names, panels, strict=False):
        holding = (node.ds for node in tree.children.values() if name in node.ds.get("force", ()))
        symbol = r"\omega_\infty"
        if name != ASYMPTOTIC:
            symbol = library_of(next(holding), whole=True)[name].latex_symbol
        _coefficients(panel, table, name, marks, symbol)
    _prediction(panels[-1], table, marks)
    style.letter(panels, fontsize=8)
    for at, panel in enumerate(panels):
        # Names are written once in a row of panels, because these have the same names.
        panel.tick_params(labelleft=at % across == 0)
    style.legend_above(figure, style.legend_marks(legend | OF_THE_RMS), 6 if wide else 2, 7)
    return figure


def _coefficients(ax: Axes, table: xr.Dataset, name: str, marks: Sequence[style.Style], symbol: str) -> None:
    """Draw a coefficient or the `asymptotic_frequency` by method, over a power of ten in its label."""
    power, unit, columns = 0, "rad/s", (table[ASYMPTOTIC], table[f"{ASYMPTOTIC}_standard_error"])
    if name != ASYMPTOTIC:
        column = table.sel(force=name)
        power, unit = column_power(column), column.unit.item()
        columns = column.coefficient, column.standard_error
    values, errors = (column.values / 10.0**power for column in columns)
    best = table.model.values.tolist().index(table.attrs["best"])
    low, high = _limits(values, errors, best)
    if np.isfinite(values[best]):
        ax.axvspan(values[best] - errors[best], values[best] + errors[best], color="0.88", zorder=0)
    bars: dict[str, Any] = {"fmt": "", "linestyle": "", "markersize": 4, "linewidth": 0.9, "capsize": 1.5}
    for row, (value, error, mark) in enumerate(zip(values, errors, marks, strict=True)):
        style.interval(ax, row, value, error, (low, high), markeredgewidth=0.9, **bars | dict(mark))
    # A power of ten is in the label, not in the ticks.
    scale = [f"$10^{{{power}}}$"] * bool(power) + [style.unit_label(unit)] * (unit != "1")
    ax.set(xlabel=f"${symbol}$ ({' '.join(scale) or '1'})", xlim=(low, high))
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.locator_params(axis="x", nbins=3)
    _with_methods(ax, table)
    # Labels of a precisely known coefficient are long; in a larger font they would overlap.
    ax.tick_params(axis="x", labelsize=6)


def _prediction(ax: Axes, table: xr.Dataset, marks: Sequence[style.Style]) -> None:
    for row, mark in enumerate(marks):
        pair = [float(table[name].values[row]) for name in PREDICTION]
        full = {"color": mark["color"], "marker": mark["marker"], "markersize": 4, "linestyle": ""}
        ax.plot(pair, [row, row], "-", color=mark["color"], linewidth=0.7)
        ax.plot(pair[:1], [row], markerfacecolor="white", **full)
        ax.plot(pair[1:], [row], **full)
    ax.axvline(1.0, color="0.6", linewidth=0.7, linestyle=":")
    ax.set(xlabel="RMS over noise", xscale="log")
    style.logarithmic_ticks(ax.xaxis, *ax.get_xlim())
    _with_methods(ax, table)


def _with_methods(ax: Axes, table: xr.Dataset) -> None:
    """Draw methods as rows, the first at the top."""
    style.name_rows(ax, table.model.values.tolist())
    ax.tick_params(labelsize=7, which="both")
    ax.xaxis.label.set_fontsize(8)
    style.row_lines(ax)


# Above this number of runs, error bars hide the marks.
MANY_RUNS = 300
# Runs beyond this number of standard deviations have another colour.
FAR = 4.0
# Largest number of these runs that are labelled with their names.
MOST_NAMES_DRAWN = 8


def against_condition(
    compared: xr.Dataset, name: str, condition: ArrayLike, *, width: float = FULL_WIDTH
) -> Figure:
    """Draw each quantity of all runs against a condition, with standard errors; outliers in another colour.

    Parameters
    ----------
    compared : Dataset
        Result of `between_runs`.
    name : str
        Name of the condition.
    condition : (run,) array_like
        Value of the condition in each run, numbers or texts.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> import xarray as xr
    >>> load, error = [1, 1, 2, 2, 3, 3], np.full((6, 1), 0.1)
    >>> value = [[1.0], [1.1], [2.0], [2.2], [3.1], [3.0]]
    >>> data = {"value": (("run", "quantity"), value), "standard_error": (("run", "quantity"), error)}
    >>> compared = st.campaigns.between_runs(xr.Dataset(data, {"quantity": ["lambda"]}), {"load": load})
    >>> figure = st.plots.against_condition(compared, "load", load)
    >>> figure.axes[0].get_xlabel()
    'load'
    """
    quantities = compared.quantity.values.tolist()
    figure, panels = style.grid(len(quantities), 2, width, 2.2)
    for quantity, panel in zip(quantities, panels, strict=True):
        _of_quantity(panel, compared, quantity, name, condition)
    return figure


def _of_quantity(ax: Axes, compared: xr.Dataset, quantity: str, name: str, condition: ArrayLike) -> None:
    """Draw one quantity of all runs with standard errors; outliers in another colour."""
    of_quantity = compared.sel(quantity=quantity)
    at, ticks = places(np.asarray(condition))
    far = np.abs(of_quantity.z.values) > FAR
    few = len(at) <= MANY_RUNS
    for chosen, color in ((~far, INK), (far, ORANGE)):
        value, error = of_quantity.value.values[chosen], of_quantity.standard_error.values[chosen]
        bars = {"yerr": error, "elinewidth": 0.8} if few else {}
        ax.errorbar(at[chosen], value, fmt="o", markersize=3 if few else 1.5, color=color, **bars)
    named, middle = of_quantity.isel(run=far), np.mean(ax.get_xlim())
    for x, value, run in zip(at[far], named.value.values, named.run.values, strict=True):
        # Place the name next to its mark, towards the middle, where there is space.
        if np.count_nonzero(far) <= MOST_NAMES_DRAWN:
            side, end = (5, "left") if x < middle else (-5, "right")
            ax.annotate(str(run), (x, value), (side, 0), ha=end, fontsize=6, **style.LABEL_OFFSET)
    if ticks:
        ax.set_xticks(range(len(ticks)), ticks)
    unit = str(of_quantity.unit.item()).removeprefix("1") if "unit" in of_quantity.coords else ""
    ax.set(xlabel=name, ylabel=f"{quantity} ({style.unit_label(unit)})" if unit else quantity)


def places(condition: np.ndarray) -> tuple[np.ndarray, Sequence[str]]:
    """Return the positions of runs on the axis of a condition, and the labels of texts."""
    if condition.dtype.kind in "fiu":
        return condition.astype(float), ()
    labels, numbers = np.unique(condition.astype(str), return_inverse=True)
    # Runs of a group are side by side around its label, so that no run hides another.
    groups = pd.Series(numbers).groupby(numbers)
    at = numbers + (groups.cumcount() + 0.5) / (2.0 * groups.transform("size")) - 0.25
    return at.to_numpy(), labels.tolist()
