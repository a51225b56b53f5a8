"""Figure of methods side by side: one panel a force, and how well each method predicts."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.arrays import Array
from sysid_trib.plots.style import (
    BLUE,
    FULL_WIDTH,
    GREEN,
    GREY,
    INK,
    ORANGE,
    TWO_COLUMNS,
    Style,
    grid,
    legend_marks,
    letter,
    logarithmic_ticks,
    name_rows,
    unit_label,
)
from sysid_trib.results.schema import library_of
from sysid_trib.validation.comparison_table import column_power

# Marks of the families that methods state (see `MethodScope`).
OTHER_FAMILY = "other"
FAMILY_MARKS: dict[str, dict[str, Any]] = {
    "trajectory": {"color": GREEN, "marker": "D"},
    "direct": {"color": BLUE, "marker": "s"},
    "averaging": {"color": ORANGE, "marker": "o"},
    OTHER_FAMILY: {"color": INK, "marker": "^"},
}
FAMILY_LABELS = {OTHER_FAMILY: "decrements and others"}
ASYMPTOTIC = "asymptotic_frequency"
PREDICTION = ("train_over_noise", "holdout_over_noise")
# Marks of the last panel.
OF_THE_RMS: dict[str, dict[str, Any]] = {
    "RMS: fitted": {"color": GREY, "marker": "o", "markerfacecolor": "white"},
    "RMS: held out": {"color": GREY, "marker": "o"},
}
# A method farther from the best than this many times the usual distance is an arrow at the edge.
ARROW_BEYOND = 5.0


def shown_methods(tree: xr.DataTree) -> xr.Dataset:
    """The group `comparison` of a result of `compare`, of the methods that have any result."""
    table = tree["comparison"].to_dataset()
    # A method that failed must not set a scale.
    table = table.isel(method=np.flatnonzero((table.failure == "") | (table.method == table.attrs["best"])))
    results = [table[name].notnull() for name in ("coefficient", ASYMPTOTIC, *PREDICTION)]
    there = [column.any("force") if "force" in column.dims else column for column in results]
    return table.isel(method=np.flatnonzero(np.any(there, axis=0)))


def _marks(table: xr.Dataset) -> tuple[list[Style], dict[str, Style]]:
    """Mark of each method, that of its family, open for all but the first of it; and marks by family."""
    marks: list[Style] = []
    before: set[str] = set()
    for stated in table.family.values.tolist():
        family = stated if stated in FAMILY_MARKS else OTHER_FAMILY
        face = {"markerfacecolor": "white"} if family in before - {OTHER_FAMILY} else {}
        marks.append(FAMILY_MARKS[family] | face)
        before.add(family)
    return marks, {FAMILY_LABELS.get(k, k): style for k, style in FAMILY_MARKS.items() if k in before}


def compared_quantity(table: xr.Dataset, name: str) -> xr.Dataset:
    """A coefficient or the `asymptotic_frequency` by method, as an axis shows it.

    Parameters
    ----------
    table : xr.Dataset
        Of `shown_methods`.
    name : str
        Symbol of a force, or `asymptotic_frequency`.

    Returns
    -------
    xr.Dataset
        `value(method)` and `error(method)` over ten to the attribute `power`, and `side(method)`: -1 or 1
        for a value beyond the axis, else 0. Attributes: `power`, `unit`, the ends `low` and `high` of the
        axis, and the band of the method that predicts best, `band_low` and `band_high` (nan without one).
    """
    if name == ASYMPTOTIC:
        power, unit = 0, "rad/s"
        columns = table[ASYMPTOTIC], table[f"{ASYMPTOTIC}_standard_error"]
    else:
        column = table.sel(force=name)
        power, unit = column_power(column), column.unit.item()
        columns = column.coefficient, column.standard_error
    value, error = (column.values / 10.0**power for column in columns)
    at = table.method.values.tolist().index(table.attrs["best"])
    low, high = _limits(value, error, at)
    side = np.where(value > high, 1, np.where(value < low, -1, 0))
    shown = {name: ("method", c) for name, c in (("value", value), ("error", error), ("side", side))}
    band = {"band_low": value[at] - error[at], "band_high": value[at] + error[at]}
    attrs = {"power": power, "unit": unit, "low": low, "high": high} | band
    return xr.Dataset(shown, {"method": table.method.values}, attrs)


def _limits(value: Array, error: Array, best: int) -> tuple[float, float]:
    """Ends of an axis on which most methods have room; an outlier must not squeeze the others."""
    known = np.isfinite(value[best])
    centre = float(value[best] if known else np.nanmedian(value))
    distance = np.abs(value - centre) + error
    usual = max(float(np.nanmedian(distance)), 3.0 * float(error[best]) if known else 0.0)
    inside = distance <= ARROW_BEYOND * usual
    low = min(float((value - error)[inside].min(initial=np.inf)), centre - usual)
    high = max(float((value + error)[inside].max(initial=-np.inf)), centre + usual)
    spare = max(0.08 * (high - low), 1e-9 * abs(centre), 1e-300)
    return low - spare, high + spare


# Height of a panel (inch): without methods, and of a method.
PANEL_HEIGHT, METHOD_HEIGHT = 0.7, 0.14


def comparison(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """Coefficient of each force and asymptotic frequency by method, and the RMS in time and out of it.

    A method that does not apply has no row.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `compare`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    table = shown_methods(tree)
    marks, legend = _marks(table)
    names = [*table.force.values.tolist(), ASYMPTOTIC]
    wide = width >= TWO_COLUMNS
    across = min((3, 4), key=lambda columns: -(len(names) + 1) % columns) if wide else 3
    height = PANEL_HEIGHT + METHOD_HEIGHT * len(marks)
    figure, panels = grid(len(names) + 1, across if wide else 2 * across, width, height, sharing="y")
    for name, panel in zip(names, panels, strict=False):
        _coefficients(panel, compared_quantity(table, name), marks, _symbol(tree, name))
    _prediction(panels[-1], table, marks)
    letter(panels, fontsize=8)
    for at, panel in enumerate(panels):
        # Names stand once a row; the rows share them.
        panel.tick_params(labelleft=at % across == 0)
    figure.legend(
        handles=legend_marks(legend | OF_THE_RMS),
        ncols=6 if wide else 2,
        loc="outside upper center",
        frameon=False,
        fontsize=7,
    )
    return figure


def _coefficients(ax: Axes, data: xr.Dataset, marks: Sequence[Style], symbol: str) -> None:
    if np.isfinite(data.band_low):
        ax.axvspan(data.band_low, data.band_high, color="0.88", zorder=0)
    bars: dict[str, Any] = {"markeredgewidth": 0.9, "linewidth": 0.9, "capsize": 1.5, "linestyle": ""}
    for row, style in enumerate(marks):
        value, error, side = (data[name].values[row] for name in ("value", "error", "side"))
        if side:
            edge, arrow = (data.high, ">") if side > 0 else (data.low, "<")
            ax.plot(edge, row, arrow, color=style["color"], markersize=4, clip_on=False)
        elif np.isfinite(value):
            ax.errorbar(value, row, xerr=error, markersize=4, **style, **bars)
    ax.set(xlabel=_axis_label(symbol, data), xlim=(data.low, data.high))
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.locator_params(axis="x", nbins=3)
    _with_methods(ax, data)
    # Labels of a coefficient that is well known are long: larger ones run into each other.
    ax.tick_params(axis="x", labelsize=6)


def _prediction(ax: Axes, table: xr.Dataset, marks: Sequence[Style]) -> None:
    for row, style in enumerate(marks):
        pair = [float(table[name].values[row]) for name in PREDICTION]
        mark = {"color": style["color"], "marker": style["marker"], "markersize": 4, "linestyle": ""}
        ax.plot(pair, [row, row], "-", color=style["color"], linewidth=0.7)
        ax.plot(pair[:1], [row], markerfacecolor="white", **mark)
        ax.plot(pair[1:], [row], **mark)
    ax.axvline(1.0, color="0.6", linewidth=0.7, linestyle=":")
    ax.set(xlabel="RMS over noise", xscale="log")
    logarithmic_ticks(ax.xaxis, *ax.get_xlim())
    _with_methods(ax, table)


def _with_methods(ax: Axes, table: xr.Dataset) -> None:
    """Methods as rows, the first on top."""
    name_rows(ax, table.method.values.tolist())
    ax.tick_params(labelsize=7, which="both")
    ax.xaxis.label.set_fontsize(8)
    ax.grid(axis="y", color="0.93", linewidth=0.5)
    ax.set_axisbelow(True)


def _symbol(tree: xr.DataTree, quantity: str) -> str:
    """A force or the frequency as LaTeX writes it."""
    if quantity == ASYMPTOTIC:
        return r"\omega_\infty"
    result = next(node.ds for node in tree.children.values() if quantity in node.ds.get("force", ()))
    return library_of(result, whole=True)[quantity].latex_symbol


def _axis_label(symbol: str, data: xr.Dataset) -> str:
    """Symbol and unit; a power of ten is in the label, not in the ticks."""
    scale = f"$10^{{{data.power}}}$" if data.power else ""
    unit = " ".join(filter(None, (scale, unit_label(data.unit) if data.unit != "1" else ""))) or "1"
    return f"${symbol}$ ({unit})"
