"""Figure of methods side by side: one panel a force, and how well each method predicts."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.plots.style import axes
from sysid_trib.results.schema import library_of
from sysid_trib.validation.comparison_table import column_power

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# Okabe and Ito's palette, and a mark for print: what a method looks at.
FAMILIES: dict[str, tuple[str, str, str]] = {
    "trajectory": ("#009E73", "D", "trajectory"),
    "direct": ("#0072B2", "s", "direct"),
    "averaging": ("#D55E00", "o", "averaging"),
    "other": ("0.35", "^", "decrements and others"),
}
FREQUENCY = "asymptotic_frequency"
# Height of a panel (inch): of what is about it, and of a method.
MARGIN, ROW = 0.75, 0.16
TOLD = ("coefficient", FREQUENCY, "train_over_noise", "holdout_over_noise")
# A method farther from the best than this many times the usual distance is an arrow at the edge.
FAR = 5.0


def comparison(tree: xr.DataTree) -> "Figure":
    """Coefficient of each force and asymptotic frequency by method, and the RMS in time and out of it.

    A method that does not apply has no row.

    Parameters
    ----------
    tree : result of `compare`.
    """
    from matplotlib.figure import Figure

    found = shown(tree)
    names = [*found.force.values.tolist(), FREQUENCY]
    across = min((3, 4), key=lambda columns: -(len(names) + 1) % columns)
    rows = -(-(len(names) + 1) // across)
    height = rows * (MARGIN + ROW * found.sizes["method"])
    figure = Figure(figsize=(7.2, height + 0.3), layout="constrained")
    panels = figure.subplots(rows, across, sharey=True, squeeze=False).ravel()
    for name, panel in zip(names, panels, strict=False):
        coefficients(tree, name, panel)
    prediction(tree, panels[len(names)])
    for panel in panels[len(names) + 1 :]:
        panel.remove()
    for at, panel in enumerate(panels[: len(names) + 1]):
        panel.set_title(f"({chr(ord('a') + at)})", loc="left", fontsize=8)
        # Names stand once a row; the rows share them.
        panel.tick_params(labelleft=at % across == 0)
    figure.legend(handles=_handles(tree), ncols=6, loc="outside upper center", frameon=False, fontsize=7)
    return figure


def coefficients(tree: xr.DataTree, quantity: str, ax: "Axes | None" = None) -> "Axes":
    """One coefficient, or the `asymptotic_frequency`, by method with its standard error.

    The band is that of the method that predicts best; an arrow stands for a value beyond the edge.

    Parameters
    ----------
    tree : result of `compare`.
    quantity : symbol of a force, or `asymptotic_frequency`.
    """
    ax = axes(ax)
    found = shown(tree)
    value, error, label = values_of(tree, quantity)
    low, high = limits(value, error, found.method.values.tolist().index(found.attrs["best"]))
    at = found.method.values.tolist().index(found.attrs["best"])
    if np.isfinite(value[at]):
        ax.axvspan(value[at] - error[at], value[at] + error[at], color="0.88", zorder=0)
    for row, method in enumerate(found.method.values.tolist()):
        if not np.isfinite(value[row]):
            continue
        color, marker, _ = FAMILIES[family_of(tree, method)]
        if low <= value[row] <= high:
            ax.errorbar(value[row], row, xerr=error[row], fmt=marker, color=color, **_mark(tree, method))
        else:
            edge, arrow = (high, ">") if value[row] > high else (low, "<")
            ax.plot(edge, row, arrow, color=color, markersize=4, clip_on=False)
    ax.set(xlabel=label, xlim=(low, high))
    ax.ticklabel_format(axis="x", useOffset=False)
    ax.locator_params(axis="x", nbins=3)
    ax = _with_methods(ax, found)
    # Labels of a coefficient that is well known are long: larger ones run into each other.
    ax.tick_params(axis="x", labelsize=6)
    return ax


def prediction(tree: xr.DataTree, ax: "Axes | None" = None) -> "Axes":
    """RMS of record minus model over the noise: of the part identified from (open), and held out (full).

    Parameters
    ----------
    tree : result of `compare`.
    """
    ax = axes(ax)
    found = shown(tree)
    for row, method in enumerate(found.method.values.tolist()):
        color, marker, _ = FAMILIES[family_of(tree, method)]
        pair = [float(found[k].values[row]) for k in ("train_over_noise", "holdout_over_noise")]
        ax.plot(pair, [row, row], "-", color=color, linewidth=0.7)
        ax.plot(pair[:1], [row], marker, markerfacecolor="white", markersize=4, color=color)
        ax.plot(pair[1:], [row], marker, markersize=4, color=color)
    ax.axvline(1.0, color="0.6", linewidth=0.7, linestyle=":")
    label = "RMS of record \N{MINUS SIGN} model over noise\nopen: first two thirds; full: held out"
    ax.set(xlabel=label, xscale="log")
    return _with_methods(ax, found)


def shown(tree: xr.DataTree) -> xr.Dataset:
    """The comparison, of methods that found anything."""
    found = tree["comparison"].ds
    told = xr.concat(
        [
            found[name].notnull().any("force") if "force" in found[name].dims else found[name].notnull()
            for name in TOLD
        ],
        "what",
    )
    return found.isel(method=np.flatnonzero(told.any("what").values))


def _with_methods(ax: "Axes", found: xr.Dataset) -> "Axes":
    """Methods as rows, the first on top."""
    labels = found.method.values.tolist()
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) - 0.4, -0.6)
    ax.tick_params(labelsize=7)
    ax.xaxis.label.set_fontsize(8)
    ax.grid(axis="y", color="0.93", linewidth=0.5)
    ax.set_axisbelow(True)
    return ax


def values_of(tree: xr.DataTree, quantity: str) -> tuple[Array, Array, str]:
    """Values, errors, and the label of the axis; a power of ten is in the label, not in the ticks."""
    found = shown(tree)
    if quantity == FREQUENCY:
        named = (found[FREQUENCY], found[f"{FREQUENCY}_standard_error"])
        value, error = (column.values for column in named)
        return value, error, r"$\omega_\infty$ (rad/s)"
    one = found.sel(force=quantity)
    power, unit = column_power(one), one.unit.item()
    scale = f"$10^{{{power}}}$" if power else "" if unit != "1" else "1"
    label = f"${_latex(tree, quantity)}$ ({' '.join(filter(None, (scale, unit if unit != '1' else '')))})"
    return one.coefficient.values / 10.0**power, one.standard_error.values / 10.0**power, label


def _latex(tree: xr.DataTree, symbol: str) -> str:
    result = next(node.ds for node in tree.children.values() if symbol in node.ds.get("force", ()))
    return library_of(result, whole=True)[symbol].latex_symbol


def limits(value: Array, error: Array, best: int) -> tuple[float, float]:
    """Ends of an axis on which most methods have room; the wildest must not squeeze the others."""
    known = np.isfinite(value[best])
    centre = float(value[best] if known else np.nanmedian(value))
    reach = np.abs(value - centre) + error
    usual = max(float(np.nanmedian(reach)), 3.0 * float(error[best]) if known else 0.0)
    inside = reach <= FAR * usual
    low = min(float((value - error)[inside].min(initial=np.inf)), centre - usual)
    high = max(float((value + error)[inside].max(initial=-np.inf)), centre + usual)
    spare = max(0.08 * (high - low), 1e-9 * abs(centre), 1e-300)
    return low - spare, high + spare


def family_of(tree: xr.DataTree, method: str) -> str:
    """The family that the method states (see `MethodScope`)."""
    return str(tree["comparison"].ds.family.sel({"method": method}).item())


def _mark(tree: xr.DataTree, method: str) -> dict[str, Any]:
    """The first of a family full, its variants open."""
    face = {"markerfacecolor": "white"} if is_variant(tree, method) else {}
    return {"markersize": 4, "markeredgewidth": 0.9, "linewidth": 0.9, "capsize": 1.5} | face


def is_variant(tree: xr.DataTree, method: str) -> bool:
    """Whether a method comes after another of its family."""
    family = family_of(tree, method)
    same = [m for m in shown(tree).method.values.tolist() if family_of(tree, m) == family]
    return family != "other" and method != same[0]


def _handles(tree: xr.DataTree) -> list[Any]:
    from matplotlib.lines import Line2D

    there = {family_of(tree, m) for m in shown(tree).method.values.tolist()}
    return [
        Line2D([], [], color=color, marker=marker, linestyle="", markersize=4, label=label)
        for family, (color, marker, label) in FAMILIES.items()
        if family in there
    ]
