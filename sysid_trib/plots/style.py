"""Common parts of figures: colours, marks, ticks, letters, grids of panels, and default axes."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullLocator

from sysid_trib.plots.figure import FONT_SIZE, FULL_WIDTH, TWO_COLUMNS, new_figure
from sysid_trib.printing.exported import unit_in_latex

Style = Mapping[str, Any]

# Palette of Okabe and Ito: distinguishable with defects of colour vision; lines and marks differ in print.
ORANGE = "#D55E00"
BLUE = "#0072B2"
GREEN = "#009E73"
PINK = "#CC79A7"
YELLOW = "#E69F00"
SKY = "#56B4E9"
INK = "#333333"
GREY = "#737373"
# First and second of two models: a dashed line on a solid one shows both where they agree.
MODEL_LINES: tuple[dict[str, Any], ...] = (
    {"color": ORANGE, "linestyle": "--", "zorder": 4},
    {"color": BLUE, "linestyle": "-", "zorder": 3},
)
SERIES: tuple[dict[str, Any], ...] = (
    {"color": ORANGE, "marker": ">", "linestyle": "--"},
    {"color": BLUE, "marker": "^", "linestyle": "-"},
    {"color": GREEN, "marker": "v", "linestyle": "-."},
    {"color": PINK, "marker": "D", "linestyle": ":"},
    {"color": YELLOW, "marker": "o", "linestyle": (0, (5, 1, 1, 1, 1, 1))},
    {"color": SKY, "marker": "s", "linestyle": (0, (1, 1))},
)
# Kinds of candidates, by the words of the legend: full, half and open marks for print.
CANDIDATE_MARKS: dict[str, dict[str, Any]] = {
    "named": {"color": ORANGE, "marker": "D", "markersize": 6},
    "competing effects": {"color": BLUE, "marker": "s", "markersize": 5},
    "other candidates": {"color": GREY, "marker": "o", "markersize": 4, "markerfacecolor": "white"},
}
OPEN_MARKS: dict[str, Any] = {"markerfacecolor": "none", "markersize": 3.5, "markeredgewidth": 0.7}
BAR_WIDTH = 0.6
# A text next to the point that it annotates.
LABEL_OFFSET: dict[str, Any] = {"textcoords": "offset points", "va": "center"}
# Background of a text that may overlap lines.
WHITE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}
THRESHOLD: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": "--"}
# Below this ratio of the largest to the smallest number, too few numbers are round.
SHORT_AXIS = 8.0
# Numbers of an axis that are written without a power of ten.
SMALLEST_PLAIN, LARGEST_PLAIN = 1e-3, 1e5
# Largest number of characters of a unit for which numbers in a panel have space.
LONG_UNIT = 4
# Text of a panel for a result without any identification.
ALL_FAILED = "all methods failed"


def line(series: Style) -> dict[str, Any]:
    """Return the line of a series."""
    return {"color": series["color"], "linestyle": series["linestyle"], "linewidth": 1.2}


def mark(series: Style) -> dict[str, Any]:
    """Return open marks of a series."""
    return {"color": series["color"], "marker": series["marker"], **OPEN_MARKS}


def interval(
    ax: Axes, row: float, value: float, error: Any, limits: tuple[float, float], **look: Any
) -> None:
    """Draw a value with its error in a row; an arrow at the edge if beyond the limits, nothing for nan."""
    low, high = limits
    usual: dict[str, Any] = {"fmt": "o", "markersize": 3, "linewidth": 1.0}
    look = usual | look
    if low <= value <= high:
        ax.errorbar(value, row, xerr=error, **look)
    elif np.isfinite(value):
        at, arrow = (high, ">") if value > high else (low, "<")
        ax.plot(at, row, arrow, color=look["color"], markersize=look["markersize"], clip_on=False)


def in_latex(symbol: str) -> str:
    """Return the symbol of a force in matplotlib's notation."""
    from sysid_trib.forces.notation import symbol_latex

    return f"${symbol_latex(symbol)}$"


def unit_label(unit: str) -> str:
    """Return a unit with its powers in matplotlib's notation, which supports fewer escapes than LaTeX."""
    return unit_in_latex(unit).replace(r"\&", "&").replace(r"\#", "#")


def short_unit(unit: str, of_record: str) -> tuple[str, str]:
    """Return a coefficient's unit for its value, and an axis text on it; a long unit of a record is `u`.

    Exponents are not raised: in texts of this size they would be too small to read.
    """
    long = len(of_record) > LONG_UNIT
    written = unit.replace(of_record, "u") if long else unit
    return "" if unit == "1" else f" {written}", f"; u: {of_record}" if long else ""


def axes(ax: Axes | None) -> Axes:
    """Return the given axes, or new ones."""
    return new_figure(TWO_COLUMNS, 3.2).subplots() if ax is None else ax


def grid(
    count: int, across: int, width: float, row_height: float, *, sharing: str = ""
) -> tuple[Figure, list[Axes]]:
    """Return a figure of `count` panels, `across` in a row (fewer if narrow), with space for a legend.

    Parameters
    ----------
    count, across : int
        Number of all panels, and of panels in a row.
    width, row_height : float, inch
        Size of the figure, and of a row.
    sharing : {"", "x", "y"}
        Axis that all panels share.
    """
    # No panel is narrower than one of three in a row of the full page.
    across = max(1, min(across, count, round(across * width / FULL_WIDTH)))
    rows = -(-count // across)
    figure = new_figure(width, rows * row_height + 0.3)
    panels = figure.subplots(
        rows, across, squeeze=False, sharex=sharing == "x", sharey=sharing == "y"
    ).ravel()
    for panel in panels[count:]:
        panel.remove()
    return figure, panels[:count].tolist()


def letter(panels: Iterable[Axes], titles: Iterable[str] = (), fontsize: float = 9) -> None:
    """Write letters above panels, and titles if there are any."""
    texts = list(titles)
    for at, panel in enumerate(panels):
        title = f"({chr(ord('a') + at)}) {texts[at] if texts else ''}"
        panel.set_title(title.rstrip(), loc="left", fontsize=fontsize)


def threshold(ax: Axes, value: float, text: str) -> None:
    """Draw a level line, named above its right end."""
    ax.axhline(value, **THRESHOLD)
    place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    note = ax.annotate(text, (1.0, value), (-3, 3), ha="right", fontsize=FONT_SIZE, **place)
    note.set_bbox(WHITE)


def no_data(ax: Axes, text: str) -> None:
    """Write a text in an empty panel."""
    ax.text(0.5, 0.5, text, ha="center", va="center", color="0.4", transform=ax.transAxes)
    ax.set(xticks=[], yticks=[])


def footnote(figure: Figure, text: str) -> None:
    """Write a sentence below all panels, if there is one."""
    if text:
        figure.supxlabel(text, x=0.01, ha="left", fontsize=7, color="0.3")


def name_rows(ax: Axes, names: list[str]) -> None:
    """Name the rows, the first on top."""
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(max(len(names), 1) - 0.4, -0.6)


def row_lines(ax: Axes) -> None:
    """Draw a faint line behind each row."""
    ax.grid(axis="y", color="0.93", linewidth=0.5)
    ax.set_axisbelow(True)


def legend_above(figure: Figure, handles: list[Line2D], columns: int, fontsize: float) -> None:
    """Draw one legend of a figure above all panels."""
    place: dict[str, Any] = {"loc": "outside upper center", "frameon": False, "fontsize": fontsize}
    figure.legend(handles=handles, ncols=columns, **place)


def legend_marks(styles: Mapping[str, Style]) -> list[Line2D]:
    """Draw marks for a legend, by their labels."""
    usual: dict[str, Any] = {"linestyle": "", "markersize": 4}
    return [Line2D([], [], label=label, **usual | dict(style)) for label, style in styles.items()]


def power_of_ten(value: float) -> str:
    """Return a number as a multiple of a power of ten, for a figure."""
    digits, exponent = f"{value:.6e}".split("e")
    power = f"10^{{{int(exponent)}}}"
    return f"${power}$" if float(digits) == 1.0 else f"${float(digits):g} \\cdot {power}$"


def logarithmic_ticks(axis: Axis, low: float, high: float) -> None:
    """Draw numbers on a logarithmic axis from `low` to `high`, as many as have room, all in one style."""
    is_plain = low >= SMALLEST_PLAIN and high <= LARGEST_PLAIN
    text = "{:g}".format if is_plain else power_of_ten
    axis.set_major_formatter(lambda value, _: text(value))
    if high > SHORT_AXIS * low:
        axis.set_minor_formatter(lambda value, _: text(value) if f"{value:e}"[0] in "235" else "")
        return
    # Powers of ten and their multiples would leave most of the axis without a tick.
    axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    axis.set_minor_locator(NullLocator())
