"""What the interactive figures share: axes, lines, marks with errors, tooltips."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from bokeh import models, plotting
from numpy.typing import ArrayLike

from sysid_trib.plots.motion_data import drawn_samples
from sysid_trib.plots.style import Style, columns_of_legend

RECORD_GREY, BAND_GREY = "#b3b3b3", "#e4e4e4"
# Heights of a panel, px: usual, of residuals, and of a list without its rows; and of a row. A list that is
# shorter than its axis is not legible.
PANEL_HEIGHT_PX, RESIDUAL_HEIGHT_PX, LIST_HEIGHT_PX, ROW_HEIGHT_PX = 300, 220, 70, 19
FEWEST_ROWS = 3
# Characters of a legend that a narrow screen has room for.
NARROW_LEGEND = 46
DASHES = {"-": "solid", "--": "dashed"}
# Matplotlib's marks by bokeh's names.
MARKERS = {"o": "circle", "s": "square", "D": "diamond", "^": "triangle"}
STYLED = ("color", "marker", "markerfacecolor")
Tooltips = Sequence[tuple[str, str]]


def panel(
    x_label: str,
    y_label: str,
    *,
    height: int = PANEL_HEIGHT_PX,
    share_x: plotting.figure | None = None,
    rows: Sequence[str] = (),
    log: str = "",
) -> plotting.figure:
    """Empty axes as wide as their place.

    Parameters
    ----------
    x_label, y_label : str
        Labels of the axes.
    height : int, px
        Height of the panel.
    share_x : figure, optional
        A figure with the same x axis: both zoom together.
    rows : sequence of str
        Names on the y axis, the first on top; without them it holds numbers.
    log : str
        The axes with a logarithmic scale, such as "x".
    """
    free = models.DataRange1d
    return plotting.figure(
        height=height,
        sizing_mode="stretch_width",
        tools="pan,box_zoom,xwheel_zoom,reset,save",
        # A long list must not keep a finger from scrolling the page.
        active_drag=None if rows else "box_zoom",
        active_scroll=None,
        x_axis_label=x_label,
        y_axis_label=y_label,
        x_range=share_x.x_range if share_x is not None else models.Range1d() if rows else free(),
        y_range=models.FactorRange(*reversed(rows)) if rows else free(),
        x_axis_type="log" if "x" in log else "linear",
        y_axis_type="log" if "y" in log else "auto",
    )


def line(
    on: plotting.figure, curve: tuple[ArrayLike, ArrayLike], style: Style, *, width: float = 1.3
) -> models.GlyphRenderer:
    """A curve, decimated."""
    x, y = (np.asarray(values, dtype=float) for values in curve)
    shown = drawn_samples(y)
    source = models.ColumnDataSource(columns({"x": x[shown], "y": y[shown]}))
    dash = DASHES[style.get("linestyle", "-")]
    return on.line("x", "y", source=source, color=style["color"], line_dash=dash, line_width=width)


def marks(on: plotting.figure, data: Mapping[str, Any], style: Style, *, size: float) -> models.GlyphRenderer:
    """Marks at the columns `x` and `y`, with bars over `low` to `high` where there are such columns.

    Columns `color`, `marker` and `markerfacecolor` give each mark its own style. Bars are along x where y
    holds names.
    """
    source = models.ColumnDataSource(columns(data))
    styled = dict(style) | {name: {"field": name} for name in STYLED if name in data}
    color, marker = styled["color"], styled.get("marker", "o")
    if "low" in data:
        named = isinstance(on.y_range, models.FactorRange)
        ends = ("low", "y", "high", "y") if named else ("x", "low", "x", "high")
        on.segment(*ends, source=source, color=color, line_width=1.2).glyph.line_alpha = 0.8
    drawn = on.scatter("x", "y", source=source, size=size, marker=MARKERS.get(str(marker), marker))
    drawn.glyph.update(line_color=color, fill_color=styled.get("markerfacecolor", color))
    return drawn


def tell(on: plotting.figure, drawn: Sequence[models.GlyphRenderer], tooltips: Tooltips) -> None:
    """What the pointer shows of marks and curves: names, and columns such as `@x{%.4g} s`."""
    formats = {text.split("{")[0]: "printf" for _, text in tooltips if "{%" in text}
    shown: dict[str, Any] = {"renderers": list(drawn), "tooltips": list(tooltips), "formatters": formats}
    on.add_tools(models.HoverTool(point_policy="snap_to_data", **shown))


def legend(on: plotting.figure, entries: Sequence[tuple[str, Sequence[models.GlyphRenderer]]]) -> None:
    """A legend above the figure; a click on an entry hides what it stands for."""
    columns = columns_of_legend([label for label, _ in entries], len(entries), NARROW_LEGEND)
    items = [(label, list(drawn)) for label, drawn in entries]
    on.add_layout(models.Legend(items=items, ncols=columns), "above")


def band(on: plotting.figure, low: float, high: float, *, along: str = "x") -> None:
    """A grey band from `low` to `high`, over the whole length of the axis `along`."""
    ends = {"bottom": low, "top": high} if along == "x" else {"left": low, "right": high}
    look: dict[str, Any] = {"fill_color": BAND_GREY, "fill_alpha": 1.0, "line_color": None, "level": "image"}
    on.add_layout(models.BoxAnnotation(**ends, **look))


def log_axis(on: plotting.figure, low: float, high: float) -> None:
    """Axis x from `low` to `high`, logarithmic, with as many labels as a narrow screen has room for."""
    on.x_range.update(start=low, end=high)
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    if np.log10(high / low) > 2.5:
        on.xaxis.ticker = models.FixedTicker(ticks=10.0 ** decades[:: 1 + decades.size // 6])
        return
    on.xaxis.ticker = models.FixedTicker(ticks=np.outer(10.0**decades, [1.0, 2.0, 5.0]).ravel())
    on.xaxis.formatter = models.BasicTickFormatter()


def list_panel(x_label: str, rows: Sequence[str], *, log: str = "") -> plotting.figure:
    """Empty axes, as high as there are rows."""
    height = LIST_HEIGHT_PX + ROW_HEIGHT_PX * max(FEWEST_ROWS, len(rows))
    return panel(x_label, "", rows=rows, log=log, height=height)


def threshold(on: plotting.figure, at: float) -> None:
    """A dashed line across the axis x."""
    on.add_layout(models.Span(location=at, dimension="height"))


def columns(data: Mapping[str, Any]) -> dict[str, Any]:
    """Columns for the page; heights in half their bytes: a screen shows three digits, the pointer five.

    Not `x`: times may be counted from long ago.
    """
    arrays = {name: np.asarray(column) for name, column in data.items()}
    return {
        name: column.astype(np.float32)
        if column.dtype == float and name != "x"
        else column.tolist()
        if column.dtype.kind in "UO"
        else column
        for name, column in arrays.items()
    }
