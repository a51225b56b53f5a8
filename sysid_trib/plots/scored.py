"""Figures of a discovery: how each candidate scores, and how weak an effect the record would show."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.plots.style import LEGEND, axes
from sysid_trib.printing.discovery_tables import strongest
from sysid_trib.results.discoveries import credible_set

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Candidates in a ranking.
BEST = 15
# Okabe and Ito's palette: the named effect, its twins, the others; full, half and open marks for print.
NAMED: dict[str, Any] = {"color": "#D55E00", "marker": "D", "markersize": 6}
TIED: dict[str, Any] = {"color": "#0072B2", "marker": "s", "markersize": 5}
OTHERS: dict[str, Any] = {"color": "0.45", "marker": "o", "markersize": 4, "markerfacecolor": "white"}
# A score beyond so many thresholds asks for a logarithmic axis.
FAR = 5.0
# Over so many times the smallest number there is room for powers of ten alone.
CROWDED = 100.0
# Height of a row and of what is about the panel, inch.
ROW, MARGIN = 0.17, 0.8


def rankings(tree: xr.DataTree) -> "Figure":
    """The ranking before each step and at the end, side by side.

    Parameters
    ----------
    tree : result of `discover`.
    """
    from matplotlib.figure import Figure

    scans = shown_scans(tree)
    across = min(len(scans), 2)
    rows = -(-len(scans) // across)
    figure = Figure(figsize=(3.6 * across, rows * (MARGIN + BEST * ROW) + 0.2), layout="constrained")
    panels = figure.subplots(rows, across, squeeze=False).ravel()
    for at, (scan, panel) in enumerate(zip(scans, panels, strict=False)):
        ranking(tree, panel, scan)
        panel.set_title(f"({chr(ord('a') + at)}) {scan_title(tree, scan)}", loc="left", fontsize=9)
    for panel in panels[len(scans) :]:
        panel.remove()
    figure.legend(handles=_handles(tree), ncols=4, loc="outside upper center", frameon=False, fontsize=8)
    return figure


def ranking(tree: xr.DataTree, ax: "Axes | None" = None, scan: int = 0) -> "Axes":
    """|z| of the best candidates in one scan, with the threshold; the named one and its twins marked.

    Parameters
    ----------
    tree : result of `discover`.
    scan : 0 before the first step, 1 before the second, ..., -1 at the end.
    """
    ax = axes(ax)
    found = tree["ranking"].to_dataset()
    scan %= found.sizes["selection_step"]
    one = found.isel(selection_step=[scan])
    named, tied = marked(tree, scan)
    chosen = strongest(one, BEST)
    # Those marked are shown, wherever they rank.
    chosen += [s for s in (*named, *tied) if s not in chosen and np.isfinite(_z(one, s))]
    limit = one.threshold.item()
    size = [abs(_z(one, symbol)) for symbol in chosen]
    # Scores in their hundreds and a threshold of four need a logarithm, else it hides the differences.
    far = max(size, default=0.0) > FAR * limit
    left = min([0.5 * limit, *(0.7 * z for z in size)]) if far else 0.0
    for row, (symbol, z) in enumerate(zip(chosen, size, strict=True)):
        style = NAMED if symbol in named else TIED if symbol in tied else OTHERS
        ax.plot([left, z], [row, row], "-", color=style["color"], linewidth=0.8)
        ax.plot([z], [row], linestyle="", **style)
        # Three digits, and no power of ten as long as there is room without.
        told = f"{float(f'{z:.3g}'):g}"
        text = ax.annotate(told, (z, row), (5, 0), textcoords="offset points", va="center", fontsize=6)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4})
    ax.axvline(limit, color="black", linewidth=0.8, linestyle="--")
    ax.set_yticks(range(len(chosen)), chosen)
    ax.set_ylim(max(len(chosen), 1) - 0.4, -0.6)
    right = max([limit, *size])
    if far:
        ax.set(xscale="log", xlim=(left, right * (right / left) ** 0.2))
        ax.xaxis.set_major_formatter("{x:g}")
        digits = "25" if right < CROWDED * left else ""
        ax.xaxis.set_minor_formatter(lambda z, _: f"{z:g}" if f"{z:e}"[0] in digits else "")
    else:
        ax.set_xlim(0.0, 1.15 * right)
    ax.set_xlabel("score |z|")
    ax.tick_params(labelsize=7, which="both")
    return ax


def forecasts(tree: xr.DataTree) -> "Figure":
    """The forecast, as high as it has candidates.

    Parameters
    ----------
    tree : result of `discover`.
    """
    from matplotlib.figure import Figure

    rows = tree["detectability"].sizes["candidate"]
    figure = Figure(figsize=(7.2, MARGIN + 0.155 * rows), layout="constrained")
    forecast(tree, figure.subplots())
    return figure


def forecast(tree: xr.DataTree, ax: "Axes | None" = None) -> "Axes":
    """Smallest coefficient that the record would show, of each candidate; effects found beside it.

    Parameters
    ----------
    tree : result of `discover`.
    """
    ax = axes(ax)
    first, last = (tree[name].to_dataset() for name in ("detectability", "detectability_after"))
    symbols = by_family(first)
    for row, symbol in enumerate(symbols):
        pair = [
            found.detectable.sel(candidate=symbol).item() if symbol in found.candidate else np.nan
            for found in (first, last)
        ]
        if not np.any(np.isfinite(pair)):
            ax.text(0.01, row, "not testable", transform=ax.get_yaxis_transform(), va="center", fontsize=6)
        elif np.isnan(pair[1]) and symbol in last.candidate:
            told: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 6}
            ax.annotate("start model only", (pair[0], row), (5, 0), **told)
        ax.plot(pair, [row, row], "-", color="0.6", linewidth=0.7)
        ax.plot(pair[:1], [row], **OTHERS)
        ax.plot(pair[1:], [row], marker="o", markersize=4, color="0.2")
    for at in range(tree["steps"].attrs["count"]):
        step = tree["steps"].isel(step=at)
        ax.plot([abs(step.coefficient.item())], [symbols.index(step.symbol.item())], linestyle="", **NAMED)
    _families(ax, first, symbols)
    ax.set_yticks(range(len(symbols)), symbols)
    ax.set_ylim(len(symbols) - 0.4, -0.6)
    ax.set_xlabel("coefficient of five standard errors (in the candidate's unit)")
    if any(np.any(np.isfinite(line.get_xdata())) for line in ax.lines):
        ax.set_xscale("log")
    ax.tick_params(axis="y", labelsize=6)
    ax.grid(axis="x", color="0.9", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.legend(handles=_forecast_handles(tree), ncols=3, **LEGEND)
    return ax


def by_family(found: xr.Dataset) -> list[str]:
    """Candidates of a forecast, those of a family together."""
    families = list(dict.fromkeys(found.family.values.tolist()))
    order = np.argsort([families.index(f) for f in found.family.values.tolist()], kind="stable")
    return found.candidate.values[order].tolist()


def _families(ax: "Axes", found: xr.Dataset, symbols: list[str]) -> None:
    """A band behind every second family, and its name at the right."""
    families = [found.family.sel(candidate=s).item() for s in symbols]
    for at, family in enumerate(dict.fromkeys(families)):
        rows = [row for row, one in enumerate(families) if one == family]
        if at % 2 == 0:
            ax.axhspan(rows[0] - 0.5, rows[-1] + 0.5, color="0.96", zorder=0)
        middle = 0.5 * (rows[0] + rows[-1])
        right = ax.get_yaxis_transform()
        ax.text(1.01, middle, family or "other", color="0.3", fontsize=7, va="center", transform=right)


def shown_scans(tree: xr.DataTree) -> list[int]:
    """The selection steps at which an effect of the final model was chosen, and the last."""
    chosen = tree["steps"].selection_step.values.tolist() if tree["steps"].attrs["count"] else []
    return [*sorted(set(chosen)), tree["ranking"].sizes["selection_step"] - 1]


def scan_title(tree: xr.DataTree, scan: int) -> str:
    """When a scan was made."""
    if scan == tree["ranking"].sizes["selection_step"] - 1:
        return "at the end"
    steps = np.flatnonzero(tree["steps"].selection_step.values == scan) + 1
    return f"before step {' and '.join(map(str, steps))}"


def marked(tree: xr.DataTree, scan: int) -> tuple[list[str], list[str]]:
    """The effects that were chosen at a selection step, and those that cannot be told from them."""
    if not tree["steps"].attrs["count"]:
        return [], []
    steps = tree["steps"].to_dataset()
    sets = [list(credible_set(steps.isel(step=at))) for at in np.flatnonzero(steps.selection_step == scan)]
    named = [each[0] for each in sets]
    return named, [symbol for each in sets for symbol in each[1:] if symbol not in named]


def _z(found: xr.Dataset, symbol: str) -> float:
    return float(found.z.sel(candidate=symbol).values[0]) if symbol in found.candidate else float("nan")


def _handles(tree: xr.DataTree) -> list[Any]:
    from matplotlib.lines import Line2D

    marks = {"named": NAMED, "cannot be told from it": TIED, "other candidates": OTHERS}
    handles = [Line2D([], [], linestyle="", label=label, **style) for label, style in marks.items()]
    return [*handles, Line2D([], [], color="black", linewidth=0.8, linestyle="--", label="threshold")]


def _forecast_handles(tree: xr.DataTree) -> list[Any]:
    from matplotlib.lines import Line2D

    marks = {
        "start model": OTHERS,
        "final model": {"marker": "o", "markersize": 4, "color": "0.2"},
        "found": NAMED,
    }
    return [Line2D([], [], linestyle="", label=label, **style) for label, style in marks.items()]
