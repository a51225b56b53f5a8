"""Figures: each declares its results for `--plot`, pages and tests, and fits its texts."""

import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial, wraps
from types import MappingProxyType
from typing import Any, TypeVar, cast

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import LayoutEngine
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator
from matplotlib.transforms import Bbox

from sysid_trib.errors import UsageError
from sysid_trib.results.kinds import is_of_driven, kind_of
from sysid_trib.results.variables import group_names, record_groups

Draw = TypeVar("Draw", bound=Callable[..., Figure])
# Kinds of results of records, by `kind_of`.
RESULTS = ("cross_check", "laws", "driven", "compare", "difference", "discover")
# Kinds that a figure can show.
RESULT_KINDS = (
    *RESULTS,
    *("look", "backbone", "plan", "response"),
)
# Texts for results of these kinds, in messages.
NAMED_KINDS = {
    "cross_check": "identify by two methods",
    "driven": "identify by two methods",
    "response": "forced_response",
}
OF_KIND = {
    "identify": "an identification by one method",
    "cross_check": "a result of identify by two methods",
    "driven": "a result of identify of a driven record",
    **{kind: f"a result of {kind}" for kind in ("laws", "compare", "difference", "discover")},
}
NO_CAPTIONS: Mapping[str, str] = MappingProxyType({})


def _type(given: object) -> str:
    """Return the name of an object's type."""
    return type(given).__name__


@dataclass(frozen=True)
class Declared:
    """A figure, and the results that it shows (see `shows`)."""

    draw: Callable[..., Figure]
    kinds: tuple[str, ...]
    block: str
    groups: tuple[str, ...]
    captions: Mapping[str, str]
    of_record: Callable[[Any], Any] | None = None

    def figure(self, given: Any, *args: Any, **options: Any) -> Figure:
        """Draw the given object, if it contains the data of the figure.

        Parameters
        ----------
        given : Dataset, DataTree or record
            A result, the shown part of a result, or a record if the figure can show records.
        *args, **options
            Further arguments of the function that draws.

        Raises
        ------
        UsageError
            The object lacks the data of the figure.
        """
        known = isinstance(given, xr.Dataset | xr.DataTree) and "angle" not in given
        if not known and self.of_record is not None:
            return self.draw(self.of_record(given), *args, **options)
        if not isinstance(given, xr.Dataset | xr.DataTree):
            raise UsageError(
                f"plots.{self.name} shows {self._shown()}, not an object of type {_type(given)}."
            )
        tree = given if isinstance(given, xr.DataTree) else xr.DataTree(given)
        kind = kind_of(tree)
        if self.groups and tree.children:
            drawings = [draw for _, run, draw in self.drawings(tree) if run == options.get("run", 0)]
            if not drawings:
                raise UsageError(self._refusal(tree))
            whole = "run" in inspect.signature(self.draw).parameters
            return self.draw(given, *args, **options) if whole else drawings[0](*args, **options)
        # A dataset that is not a whole result may be the shown group.
        part = not kind and (self.groups or not set(self.kinds) <= set(RESULTS))
        if kind not in self.kinds and not part:
            raise UsageError(self._refusal(tree))
        try:
            return self.draw(tree if kind and not self.groups else given, *args, **options)
        # A dataset that is not a result lacks some variable.
        except (KeyError, AttributeError) as error:
            if kind:
                raise
            raise UsageError(
                f"plots.{self.name} shows {self._shown()}; this dataset lacks {error}."
            ) from error

    @property
    def name(self) -> str:
        """Return the name of the function that draws the figure."""
        return self.draw.__name__

    def _shown(self) -> str:
        """Describe the data of the figure."""
        kinds = [NAMED_KINDS.get(kind, kind) for kind in self.kinds]
        parts = f" with the group {self.groups[0]}" if self.groups and set(self.kinds) <= set(RESULTS) else ""
        record = " and of a record" if self.of_record is not None else ""
        return f"results of {', '.join(dict.fromkeys(kinds))}{parts}{record}"

    def _refusal(self, tree: xr.DataTree) -> str:
        """State that a result lacks the data of the figure, and which figures it has."""
        kind = kind_of(tree)
        if not kind:
            return f"plots.{self.name} shows {self._shown()}; this object is not such a result."
        others = [figure.name for figure in figures_of(kind) if any(True for _ in figure.drawings(tree))]
        instead = f"; its figures are {', '.join(others)}" if others else ""
        return f"plots.{self.name} shows {self._shown()}; this is {OF_KIND[kind]}{instead}."

    @property
    def of_each_run(self) -> bool:
        """True if the figure is drawn for each run of a result."""
        return "run" in inspect.signature(self.draw).parameters

    def caption(self, tree: xr.DataTree) -> str:
        """Return the caption on a page: the docstring before the parameters."""
        said = (inspect.getdoc(self.draw) or "").partition("\n\nParameters\n")[0]
        kind = "driven" if is_of_driven(tree) else kind_of(tree)
        return self.captions.get(kind, " ".join(said.split()))

    def drawings(self, tree: xr.DataTree) -> Iterator[tuple[str, int, Callable[..., Figure]]]:
        """Yield file name, run and drawing function, if the result contains the data of the figure."""
        name = self.draw.__name__
        if self.groups:
            of_these = re.compile(rf"(?:{'|'.join(self.groups)})((?:_\d+)?)")
            ends = dict.fromkeys(match[1] for child in tree.children if (match := of_these.fullmatch(child)))
            for end in ends:
                data = [tree[f"{g}{end}"].to_dataset() for g in self.groups if f"{g}{end}" in tree.children]
                yield f"{name}{end}", int(end[1:] or 1) - 1, partial(self.draw, *data)
        elif self.of_each_run:
            for run, label in enumerate(group_names(name, len(record_groups(tree)))):
                yield label, run, partial(self.draw, tree, run)
        else:
            yield name, 0, partial(self.draw, tree if tree.children else tree.to_dataset())


_DECLARED: dict[str, Declared] = {}


def shows(
    *kinds: str,
    block: str = "",
    groups: tuple[str, ...] = (),
    captions: Mapping[str, str] = NO_CAPTIONS,
    of_record: Callable[[Any], Any] | None = None,
) -> Callable[[Draw], Draw]:
    """Declare that a function draws a figure of results.

    The function is called with the result, and with `run` if each run has its own figure; or with the
    datasets of `groups` that are in the result, for each run if they are numbered by runs.

    Parameters
    ----------
    *kinds : str
        Kinds of result, from `RESULT_KINDS`.
    block : str
        Title of the page section that contains the figure; if empty, only `--plot` draws it.
    groups : tuple of str
        Groups of the result that are drawn.
    captions : mapping of str to str
        Captions for kinds of result to which only a part of the docstring applies.
    of_record : callable, optional
        Function that computes the drawn data from a record, if the figure can also show a record.

    Returns
    -------
    callable
        Decorator that registers a function and returns it with a check that its first argument has these
        data.
    """
    if others := {*kinds, *captions} - set(RESULT_KINDS):
        raise ValueError(f"No result is of the kind {', '.join(sorted(others))}; there are {RESULT_KINDS}.")

    def declare(draw: Draw) -> Draw:
        declared = Declared(draw, kinds, block, groups, captions, of_record)
        _DECLARED[draw.__name__] = declared

        @wraps(draw)
        def checked(*args: Any, **options: Any) -> Figure:
            return declared.figure(*args, **options)

        return cast(Draw, checked)

    return declare


def figures_of(kind: str) -> list[Declared]:
    """Return the figures of a kind of result."""
    from sysid_trib import plots

    # A figure is registered when its module is imported.
    names = [name for name in dir(plots) if getattr(plots, name)]
    return [_DECLARED[name] for name in names if name in _DECLARED and kind in _DECLARED[name].kinds]


# Font size of figures with many panels, and of the smallest characters such as exponents, points.
FONT_SIZE = 7.5
SMALLEST_SIGN = 6.0
# Width of a figure over the full page, width of a column of a journal (88 mm), and the smallest width for two
# panels side by side, inch.
FULL_WIDTH = 7.2
ONE_COLUMN = 3.46
TWO_COLUMNS = 5.0
# Height of a figure with a caption below it on a page, inch.
TALLEST = 9.0
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


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of this size in inches that keeps its labels apart."""
    return LiteralFigure(figsize=(width, min(height, TALLEST)), layout="constrained")


class LiteralFigure(Figure):
    """A figure that makes space for texts, and draws texts that only look like mathematics unchanged.

    The space depends on fonts, units and names, so texts are measured when the figure is drawn: labels longer
    than their panel are broken into lines, and a legend above a panel has as many columns as fit next to the
    title. A text with exponents is enlarged if the exponents would be smaller than any other text.
    """

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure."""
        for ax in self.axes:
            # Labels of ticks are only computed on request.
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

    # Size and texts at the last layout.
    _drawn: tuple[object, ...] = ()

    def _texts(self) -> tuple[object, ...]:
        return *self.get_size_inches(), *(text.get_text() for text in self.findobj(Text))

    def _give_room(self, engine: LayoutEngine, renderer: RendererBase) -> None:
        """Break labels and legends into lines, first with placeholders: a long one would squeeze all."""
        labels = [label for ax in self.axes for label in _labels(ax)]
        # A mathematical expression counts as one word.
        texts = [re.findall(r"(?:\$[^$]*\$|[^\s$]|\$)+", text.get_text()) for _, text, _ in labels]
        legends = [legend for ax in self.axes if (legend := ax.get_legend()) is not None]
        for _, text, _ in labels:
            text.set_text("x" if text.get_text().strip() else "")
        for legend in legends:
            legend.set_in_layout(False)
        engine.execute(self)
        for legend in legends:
            legend.set_in_layout(True)
        # Texts that fit anew change the layout, a little less each time.
        for _ in range(3):
            before = self._texts()
            for (ax, text, side), words in zip(labels, texts, strict=True):
                _fill(text, words, getattr(ax.get_window_extent(renderer), side), renderer)
            for ax in self.axes:
                _fit_legend(ax, renderer)
            if self._texts() == before:
                break
            engine.execute(self)


def _thin_ticks(axis: Axis, renderer: RendererBase) -> None:
    """Hide tick numbers that would overlap others, those of minor ticks first; names are kept."""
    if isinstance(axis.get_major_locator(), FixedLocator):
        return
    low, high = sorted(axis.get_view_interval())
    kept, between = list[Bbox](), float(renderer.points_to_pixels(3.0))  # type: ignore[arg-type]
    for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
        if tick.label1.get_visible() and tick.label1.get_text() and low <= tick.get_loc() <= high:
            box = tick.label1.get_window_extent(renderer)
            tick.label1.set_visible(not box.count_overlaps(kept))
            kept += [box.padded(between)] if tick.label1.get_visible() else []


def _titles(ax: Axes) -> list[Text]:
    return [child for child in ax.get_children() if isinstance(child, Text) and child not in ax.texts]


def _labels(ax: Axes) -> list[tuple[Axes, Text, str]]:
    """Return the labels and titles of a panel, and the side whose length limits each."""
    across = [ax.xaxis.label, *_titles(ax)]
    return [(ax, ax.yaxis.label, "height"), *((ax, text, "width") for text in across)]


def _fill(text: Text, words: list[str], room: float, renderer: RendererBase) -> None:
    """Write words in as few lines as fit, with a unit on separate lines."""

    def fits(line: str) -> bool:
        text.set_text(line)
        extent = text.get_window_extent(renderer)
        return max(extent.width, extent.height) <= room

    lines = [""]
    whole = fits(" ".join(words))
    for word in words:
        joined = f"{lines[-1]} {word}".strip()
        if whole or not lines[-1] or (not word.startswith("(") and fits(joined)):
            lines[-1] = joined
        else:
            lines.append(word)
    text.set_text("\n".join(lines))


def _fit_legend(ax: Axes, renderer: RendererBase) -> None:
    """Reduce the columns of a legend above a panel until it fits beside the title, or move the title up."""
    legend = ax.get_legend()
    box = ax.get_window_extent(renderer)
    scale = float(renderer.points_to_pixels(1.0))  # type: ignore[arg-type]
    if legend is None or legend.get_window_extent(renderer).y0 < box.y0 + 0.9 * box.height:
        return
    titles = [title for title in _titles(ax) if title.get_text()]
    room = box.width - max((title.get_window_extent(renderer).width for title in titles), default=0.0)
    # Six points between the title and the legend.
    room -= 6.0 * scale
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
        pad = extent.height / scale
        size = title.get_fontsize()
        ax.set_title(title.get_text(), loc="left", fontsize=size, pad=pad)


@lru_cache(maxsize=1000)
def _smallest_part(text: str) -> float:
    """Return the relative size of an exponent in a text; 0 if matplotlib cannot draw its mathematics."""
    size: float = FontProperties().get_size_in_points()
    try:
        lines = [MathTextParser("path").parse(line) for line in text.split("\n") if "$" in text]
    except ValueError:
        return 0.0
    return min((sign[1] for line in lines for sign in line.glyphs), default=size) / size
