"""A result at a glance: the record, what is left of it, the forces, and the force that is missing."""

from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots.looked import CURVE_LABELS, draw_curve, driven_overview
from sysid_trib.plots.motion_panels import draw_in_time
from sysid_trib.plots.named_effects import draw_cells
from sysid_trib.plots.overview_data import (
    DOT_BEYOND,
    INTERVAL,
    OverviewData,
    held_out_sentence,
    overview_data,
)
from sysid_trib.plots.style import (
    FONT_SIZE,
    FULL_WIDTH,
    LEGEND,
    MODEL_LINES,
    SERIES,
    TWO_COLUMNS,
    WHITE,
    footnote,
    in_latex,
    letter,
    line,
    new_figure,
    short_unit,
)
from sysid_trib.printing.layout import value_with_error
from sysid_trib.results.files import is_of_driven

# Of a row of panels, and of one of residuals, over the page and in a column, inch.
ROW_HEIGHT, RESIDUAL_HEIGHT = (1.75, 1.45), (1.2, 1.0)
# Coefficients for which there is room in it, and of each more.
ROOM_FOR, COEFFICIENT_HEIGHT = 3, 0.25
# Panels of the residuals of one model or two, in the figure's mosaic.
RESIDUAL_PANELS = "BK"
# A coefficient is drawn from so far below zero to so far above it, in units of its value; its numbers stand
# beside, where the axis goes on.
COEFFICIENT_RANGE, END_OF_NUMBERS = (-0.5, 2.0), 5.0
MISSING_TITLE = f"missing force; dots: beyond {DOT_BEYOND:g} errors"
TOO_FEW = "too few samples a period"
EFFECTIVE_TITLE = "The model does not explain the record."


def overview(tree: xr.DataTree, run: int = 0, *, width: float = FULL_WIDTH) -> Figure:
    """A result at a glance, one figure for `cross_check`, `compare` and `discover`.

    Frequency and damping ratio against amplitude, the record's with their 95 % bands and the models', where
    there is a backbone. Record and models; the residual of each; each force's share of the decay and of the
    frequency shift against amplitude; coefficients with 95 % intervals; and the force that is still missing,
    over angle and rate, with its uncertainty. Of a discovery `story` shows the residuals and what is missing.
    Of driven records the inputs, the record with the motion of the answer, and the residuals of the models.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check`, `compare` or `discover`.
    run : int
        Which of several runs, from 0.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    if is_of_driven(tree):
        # Its motion has no half periods.
        figure = driven_overview(tree, run, width=width)
        footnote(figure, held_out_sentence(tree))
        return figure
    return drawn_overview(overview_data(tree, run), width)


def drawn_overview(data: OverviewData, width: float = FULL_WIDTH) -> Figure:
    """The overview of its numbers."""
    wide, rows = width >= TWO_COLUMNS, ["IJ"] if data.backbone is not None else []
    models = () if data.of_discovery else data.models or ("",)
    residuals = RESIDUAL_PANELS[: len(models)]
    rows += [name * 2 for name in ("A", *residuals)] + ["CD"]
    rows += ["EE"] if data.of_discovery else ["EF"] if wide else ["EE", "FF"]
    heights = [(RESIDUAL_HEIGHT if row[0] in RESIDUAL_PANELS else ROW_HEIGHT)[not wide] for row in rows]
    most = max((result.sizes["force"] for result in data.results.values()), default=0)
    heights[-2 if rows[-1] == "FF" else -1] += COEFFICIENT_HEIGHT * max(0, most - ROOM_FOR)
    with mpl.rc_context({"font.size": FONT_SIZE, "axes.titlesize": FONT_SIZE + 0.5}):
        figure = new_figure(width, sum(heights))
        panels = figure.subplot_mosaic(";".join(rows), height_ratios=heights)
        draw_in_time([panels["A"], *(panels[name] for name in residuals)], data.motion, models)
        if data.backbone is not None:
            for panel, name in zip("IJ", CURVE_LABELS, strict=True):
                draw_curve(panels[panel], data.backbone[0], name, data.backbone[1])
        _shares(panels["C"], data, "decay_share", "share of decay (%)")
        _shares(panels["D"], data, "frequency_share", "share of shift (%)")
        _coefficients(panels["E"], data)
        titles = [""] * len(panels)
        if "F" in panels:
            _surface(panels["F"], data, "right" if wide else "bottom")
            titles[-1] = MISSING_TITLE
        letter(panels.values(), titles, fontsize=FONT_SIZE + 0.5)
        footnote(figure, data.held_out)
        if not data.holds:
            figure.suptitle(EFFECTIVE_TITLE, fontsize=FONT_SIZE, color="0.3")
    return figure


def _no_data(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, ha="center", va="center", color="0.4", transform=ax.transAxes)
    ax.set(xticks=[], yticks=[])


def _series(forces: list[str]) -> dict[str, Any]:
    return dict(zip(forces, cycle(SERIES)))


def _shares(ax: Axes, data: OverviewData, quantity: str, label: str) -> None:
    """Share of each force with a band of one standard error, against amplitude."""
    if data.weighed is None or not np.isfinite(data.weighed[quantity].values).any():
        _no_data(ax, "no force acts here")
        return
    amplitude = data.weighed.amplitude.values
    for symbol, series in _series(data.weighed.force.values.tolist()).items():
        part, error = (100.0 * data.weighed[name].sel(force=symbol).values for name in _pair(quantity))
        if np.any(np.abs(part) > 0.0):
            ax.plot(amplitude, part, label=in_latex(symbol), **line(series))
            look: dict[str, Any] = {"color": series["color"], "alpha": 0.2, "linewidth": 0}
            ax.fill_between(amplitude, part - error, part + error, **look)
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    low, high = ax.get_ylim()
    ax.set(xlabel=f"amplitude ({data.units})", ylabel=label, xlim=(amplitude[0], amplitude[-1]))
    # Errors of shares may exceed all that a share can be.
    ax.set_ylim(max(low, -110.0), min(high, 110.0))
    ax.legend(ncols=6, **LEGEND)


def _coefficients(ax: Axes, data: OverviewData) -> None:
    """Each coefficient over its value by the main identification, with 95 % intervals, and in numbers."""
    if not data.results:
        _no_data(ax, "all methods failed")
        return
    main = list(data.results.values())[-1]
    symbols = main.force.values.tolist()
    for at, ((name, result), style) in enumerate(zip(data.results.items(), _styles(data), strict=True)):
        shift = 0.3 * (at - 0.5 * (len(data.results) - 1))
        ax.plot([], [], "o-", markersize=3, linewidth=1.0, color=style["color"], label=name)
        for row, symbol in enumerate(symbols):
            scale = main.coefficient.sel(force=symbol).item()
            if symbol in result.force and scale != 0.0:
                of_force = result.sel(force=symbol)
                error = INTERVAL * abs(of_force.standard_error.item() / scale)
                _interval(ax, of_force.coefficient.item() / scale, error, row + shift, style["color"])
    note: dict[str, Any] = {"ha": "right", "va": "center", "fontsize": FONT_SIZE - 1}
    for row, symbol in enumerate(symbols):
        of_force = main.sel(force=symbol)
        text = value_with_error(of_force.coefficient.item(), of_force.standard_error.item())
        unit = short_unit(of_force.unit.item(), data.units)[0]
        written = ax.text(0.99, row, f"{text}{unit}", transform=ax.get_yaxis_transform(), **note)
        written.set_bbox(WHITE)
    ax.axvline(0.0, color="0.6", linewidth=0.6, linestyle=":")
    ax.axvline(1.0, color="0.85", linewidth=0.6, zorder=0)
    ax.set_yticks(range(len(symbols)), [in_latex(symbol) for symbol in symbols])
    ax.set(xlim=(COEFFICIENT_RANGE[0], END_OF_NUMBERS), xticks=[0, 1, 2], ylim=(len(symbols) - 0.4, -0.7))
    ax.set_xlabel(f"coefficient over its value, 95 % intervals{short_unit('', data.units)[1]}")
    ax.legend(ncols=2, **LEGEND)


def _interval(ax: Axes, value: float, error: float, row: float, color: Any) -> None:
    """A value with its interval; an arrow where the interval leaves the range that is drawn."""
    (low, high), look = COEFFICIENT_RANGE, {"color": color, "markersize": 3, "clip_on": False}
    ends = (value - error, value + error)
    ax.plot(np.clip(ends, low, high), [row, row], color=color, linewidth=1.0)
    for end in ends:
        ax.plot(np.clip(end, low, high), row, "<" if end < low else ">" if end > high else "|", **look)
    if low <= value <= high:
        ax.plot(value, row, "o", **look)


def _surface(ax: Axes, data: OverviewData, bar_at: str) -> None:
    """Mean force over angle and rate, and dots where it is beyond three standard errors."""
    if data.missing is None:
        _no_data(ax, TOO_FEW)
        return
    factor, unit = data.motion.small_units
    force, error = (factor * data.missing[name] for name in _pair("force"))
    mesh = draw_cells(ax, force, error, data.colour_limit)
    bar = ax.figure.colorbar(mesh, ax=ax, extend="both", pad=0.02, location=bar_at)
    bar.set_label(f"force over $I\\omega^2$ ({unit})")
    ax.set(xlabel=data.motion.label, ylabel=f"rate over $\\omega$ ({data.units})")


def _pair(name: str) -> tuple[str, str]:
    return name, f"{name}_standard_error"


def _styles(data: OverviewData) -> list[Any]:
    """The styles of identifications: those of their motions."""
    if len(data.results) == 1:
        return [data.motion.lines.get(next(iter(data.results)), MODEL_LINES[1])]
    pairs = zip(data.results, MODEL_LINES, strict=True)
    return [data.motion.lines.get(name, style) for name, style in pairs]
