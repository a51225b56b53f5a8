"""What figures share: colours, marks, legends, grids of panels, and axes where none are given."""

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import LayoutEngine
from matplotlib.lines import Line2D
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator
from matplotlib.transforms import Bbox

from sysid_trib.arrays import Array
from sysid_trib.printing.exported import unit_in_latex

Style = Mapping[str, Any]

# Okabe and Ito's palette: readers with defects of colour vision distinguish it, and print shows its lines.
ORANGE, BLUE, GREEN, PINK, YELLOW, SKY = "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
INK, GREY = "#333333", "#737373"
# The first model of two and the second: a dashed line on a full one shows both where they agree.
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
# Of figures of many panels, and of the smallest sign, points: exponents too.
FONT_SIZE, SMALLEST_SIGN = 7.5, 6.0
# Of a figure over the whole page, and the least at which two panels stand side by side, inch.
FULL_WIDTH, TWO_COLUMNS = 7.2, 5.0
# Of a figure that has a caption below it on a page, inch.
TALLEST = 9.0
# A text beside the point that it annotates.
LABEL_OFFSET: dict[str, Any] = {"textcoords": "offset points", "va": "center"}
# Behind a text that may lie on lines.
WHITE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}
THRESHOLD: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": "--"}
# Over less than so many times the smallest number not enough numbers are round.
SHORT_AXIS = 8.0
# Times that a figure is laid out anew, and points between a title and a legend.
LAYOUTS, BETWEEN_TEXTS = 3, 6.0
# Points between the numbers of ticks.
BETWEEN_TICKS = 3.0
# Characters of a unit for which numbers in a panel have room.
LONG_UNIT = 4
LEGEND: dict[str, Any] = {
    "frameon": False,
    "fontsize": FONT_SIZE,
    "columnspacing": 0.9,
    "handlelength": 1.6,
    "handletextpad": 0.3,
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "borderaxespad": 0.1,
}


def line(series: Style) -> dict[str, Any]:
    """Line of a series."""
    return {"color": series["color"], "linestyle": series["linestyle"], "linewidth": 1.2}


def mark(series: Style) -> dict[str, Any]:
    """Open marks of a series."""
    return {"color": series["color"], "marker": series["marker"], **OPEN_MARKS}


def line_with_band(ax: Axes, x: Array, value: Array, error: Array, series: Style, label: str) -> None:
    """The line of a series in a band of one standard error."""
    ax.plot(x, value, label=label, **line(series))
    ax.fill_between(x, value - error, value + error, color=series["color"], alpha=0.2, linewidth=0)


def interval(
    ax: Axes, row: float, value: float, error: Any, limits: tuple[float, float], **look: Any
) -> None:
    """A value with its error in a row; an arrow at the edge where it is beyond the limits, nothing of nan."""
    low, high = limits
    if low <= value <= high:
        ax.errorbar(value, row, xerr=error, **look)
    elif np.isfinite(value):
        at, arrow = (high, ">") if value > high else (low, "<")
        ax.plot(at, row, arrow, color=look["color"], markersize=look["markersize"], clip_on=False)


def in_latex(symbol: str) -> str:
    """A force's symbol as matplotlib writes it."""
    from sysid_trib.forces.notation import symbol_latex

    return f"${symbol_latex(symbol)}$"


def new_figure(width: float, height: float) -> Figure:
    """An empty figure, its size in inches, that keeps labels apart."""
    return LiteralFigure(figsize=(width, min(height, TALLEST)), layout="constrained")


class LiteralFigure(Figure):
    """A figure that gives texts room, and draws one of a file as it is where it only looks like mathematics.

    What fits depends on fonts, units and names, so that it is measured when the figure is drawn: labels
    longer than their panel are broken, a legend above a panel has the columns that fit beside its title. A
    text with exponents is larger where they would be smaller than any text.
    """

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure."""
        for ax in self.axes:
            # Labels of ticks are written when they are asked for.
            _ = ax.get_xticklabels(), ax.get_yticklabels()
        for text in self.findobj(Text):
            part = _smallest_part(text.get_text())
            if not part:
                text.set_parse_math(False)
            elif part * float(text.get_fontsize()) < SMALLEST_SIGN:
                text.set_fontsize(SMALLEST_SIGN / part)
        engine = self.get_layout_engine()
        if engine is not None and self._drawn != self._texts():
            self._give_room(engine, renderer)
            for ax in self.axes:
                _thin_ticks(ax.xaxis, renderer)
                _thin_ticks(ax.yaxis, renderer)
            self._drawn = self._texts()
        super().draw(renderer)

    # Size and texts when they were given room.
    _drawn: tuple[object, ...] = ()

    def _texts(self) -> tuple[object, ...]:
        return *self.get_size_inches(), *(text.get_text() for text in self.findobj(Text))

    def _give_room(self, engine: LayoutEngine, renderer: RendererBase) -> None:
        """Break labels and legends, first in panels of short labels: a long one would squeeze them all."""
        labels = [label for ax in self.axes for label in _labels(ax)]
        texts = [_words(text.get_text()) for _, text, _ in labels]
        legends = [(ax, legend) for ax in self.axes if (legend := ax.get_legend()) is not None]
        for _, text, _ in labels:
            text.set_text("x" if text.get_text().strip() else "")
        for _, legend in legends:
            legend.set_in_layout(False)
        engine.execute(self)
        for _, legend in legends:
            legend.set_in_layout(True)
        for _ in range(LAYOUTS):
            before = self._texts()
            for (ax, text, side), words in zip(labels, texts, strict=True):
                _fill(text, words, getattr(ax.get_window_extent(renderer), side), renderer)
            for ax, _ in legends:
                _fit_legend(ax, renderer)
            if self._texts() == before:
                break
            engine.execute(self)


def _thin_ticks(axis: Axis, renderer: RendererBase) -> None:
    """Hide numbers of ticks that would run into others, those of the minor ones first; names stay."""
    if isinstance(axis.get_major_locator(), FixedLocator):
        return
    low, high = sorted(axis.get_view_interval())
    kept, between = list[Bbox](), float(renderer.points_to_pixels(BETWEEN_TICKS))  # type: ignore[arg-type]
    for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
        if tick.label1.get_visible() and tick.label1.get_text() and low <= tick.get_loc() <= high:
            box = tick.label1.get_window_extent(renderer)
            tick.label1.set_visible(not box.count_overlaps(kept))
            kept += [box.padded(between)] if tick.label1.get_visible() else []


def _titles(ax: Axes) -> list[Text]:
    return [child for child in ax.get_children() if isinstance(child, Text) and child not in ax.texts]


def _labels(ax: Axes) -> list[tuple[Axes, Text, str]]:
    """Labels and titles of a panel, with the side that has room for each."""
    across = [ax.xaxis.label, *_titles(ax)]
    return [(ax, ax.yaxis.label, "height"), *((ax, text, "width") for text in across)]


def _words(text: str) -> list[str]:
    """The words of a text; mathematics is one."""
    return re.findall(r"(?:\$[^$]*\$|[^\s$]|\$)+", text)


def _fill(text: Text, words: list[str], room: float, renderer: RendererBase) -> None:
    """Write words in as few lines as have room, a unit on lines of its own."""

    def fits(line: str) -> bool:
        text.set_text(line)
        extent = text.get_window_extent(renderer)
        return max(extent.width, extent.height) <= room

    lines, whole = [""], fits(" ".join(words))
    for word in words:
        joined = f"{lines[-1]} {word}".strip()
        if whole or not lines[-1] or (not word.startswith("(") and fits(joined)):
            lines[-1] = joined
        else:
            lines.append(word)
    text.set_text("\n".join(lines))


def _fit_legend(ax: Axes, renderer: RendererBase) -> None:
    """Give the legend above a panel the columns that fit beside the title, or put the title above it."""
    legend, box = ax.get_legend(), ax.get_window_extent(renderer)
    scale = float(renderer.points_to_pixels(1.0))  # type: ignore[arg-type]
    if legend is None or legend.get_window_extent(renderer).y0 < box.y0 + 0.9 * box.height:
        return
    titles = [title for title in _titles(ax) if title.get_text()]
    room = box.width - max((title.get_window_extent(renderer).width for title in titles), default=0.0)
    room -= BETWEEN_TEXTS * scale
    labels = [text.get_text() for text in legend.get_texts()]
    spacing = ("columnspacing", "handlelength", "handletextpad")
    look: dict[str, Any] = LEGEND | {name: getattr(legend, name) for name in spacing}
    look["fontsize"] = legend.get_texts()[0].get_fontsize()
    for count in range(legend._ncols - 1, 0, -1):  # type: ignore[attr-defined]
        if legend.get_window_extent(renderer).width <= room:
            return
        handles = [handle for handle in legend.legend_handles if handle is not None]
        legend = ax.legend(handles, labels, ncols=count, **look)
    extent = legend.get_window_extent(renderer)
    for title in titles if extent.width > room else ():
        pad, size = extent.height / scale, title.get_fontsize()
        ax.set_title(title.get_text(), loc="left", fontsize=size, pad=pad)


@lru_cache(maxsize=1000)
def _smallest_part(text: str) -> float:
    """Size of an exponent in a text over that of the text; 0 if matplotlib cannot write its mathematics."""
    size: float = FontProperties().get_size_in_points()
    try:
        lines = [MathTextParser("path").parse(line) for line in text.split("\n") if "$" in text]
    except ValueError:
        return 0.0
    return min((sign[1] for line in lines for sign in line.glyphs), default=size) / size


def unit_label(unit: str) -> str:
    """A unit with its powers, as matplotlib writes it: it knows fewer escapes than LaTeX."""
    return unit_in_latex(unit).replace(r"\&", "&").replace(r"\#", "#")


def short_unit(unit: str, of_record: str) -> tuple[str, str]:
    """A coefficient's unit behind its value, and what its axis says of it: a record's long one is `u`.

    Exponents are not raised: in texts of this size they would be too small to read.
    """
    long = len(of_record) > LONG_UNIT
    written = unit.replace(of_record, "u") if long else unit
    return "" if unit == "1" else f" {written}", f"; u: {of_record}" if long else ""


def axes(ax: Axes | None) -> Axes:
    """The axes given, or new ones."""
    return new_figure(TWO_COLUMNS, 3.2).subplots() if ax is None else ax


def grid(
    count: int, across: int, width: float, row_height: float, *, sharing: str = ""
) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels, `across` in a row, fewer in a narrow one, and room above for a legend.

    Parameters
    ----------
    count, across : int
        Panels in all, and in a row.
    width, row_height : float, inch
        Size of the figure, and of a row.
    sharing : {"", "x", "y"}
        Axis that all panels share.
    """
    # No panel is narrower than three in a row of the whole page.
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
    """Letters above panels, with a title each where there are titles."""
    texts = list(titles)
    for at, panel in enumerate(panels):
        title = f"({chr(ord('a') + at)}) {texts[at] if texts else ''}"
        panel.set_title(title.rstrip(), loc="left", fontsize=fontsize)


def threshold(ax: Axes, value: float, text: str) -> None:
    """A level line, named above its right end."""
    ax.axhline(value, **THRESHOLD)
    place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    note = ax.annotate(text, (1.0, value), (-3, 3), ha="right", fontsize=FONT_SIZE, **place)
    note.set_bbox(WHITE)


def footnote(figure: Figure, text: str) -> None:
    """A sentence below all panels, if there is one."""
    if text:
        figure.supxlabel(text, x=0.01, ha="left", fontsize=7, color="0.3")


def name_rows(ax: Axes, names: list[str]) -> None:
    """Names as rows, the first on top."""
    ax.set_yticks(range(len(names)), names)
    ax.set_ylim(max(len(names), 1) - 0.4, -0.6)


def row_lines(ax: Axes) -> None:
    """A faint line behind each row."""
    ax.grid(axis="y", color="0.93", linewidth=0.5)
    ax.set_axisbelow(True)


def legend_above(figure: Figure, handles: list[Line2D], columns: int, fontsize: float) -> None:
    """A legend of a whole figure, above all panels."""
    place: dict[str, Any] = {"loc": "outside upper center", "frameon": False, "fontsize": fontsize}
    figure.legend(handles=handles, ncols=columns, **place)


def legend_marks(styles: Mapping[str, Style]) -> list[Line2D]:
    """Marks for a legend, by their labels."""
    usual: dict[str, Any] = {"linestyle": "", "markersize": 4}
    return [Line2D([], [], label=label, **usual | dict(style)) for label, style in styles.items()]


def logarithmic_ticks(axis: Axis, low: float, high: float) -> None:
    """Plain numbers on a logarithmic axis from `low` to `high`, as many as have room."""
    axis.set_major_formatter("{x:g}")
    if high > SHORT_AXIS * low:
        axis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "235" else "")
        return
    # Powers of ten and their multiples would leave most of the axis without a tick.
    axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    axis.set_minor_locator(NullLocator())


def logarithmic_amplitude(ax: Axes, units: str = "rad") -> None:
    """A logarithmic axis of amplitudes, with plain numbers at as many ticks as have room."""
    ax.set(ylabel=f"amplitude ({units})", yscale="log")
    logarithmic_ticks(ax.yaxis, *ax.get_ylim())
