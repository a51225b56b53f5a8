"""What figures share: colours, marks, legends, and axes where none are given."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette: told apart by colour-blind readers, and by their lines in print.
LINES: tuple[dict[str, Any], ...] = (
    {"color": "#D55E00", "linestyle": "--", "zorder": 4},
    {"color": "#0072B2", "linestyle": "-", "zorder": 3},
)
SERIES: tuple[dict[str, Any], ...] = (
    {"color": "#D55E00", "marker": ">", "linestyle": "--"},
    {"color": "#0072B2", "marker": "^", "linestyle": "-"},
    {"color": "#009E73", "marker": "v", "linestyle": "-."},
    {"color": "#CC79A7", "marker": "D", "linestyle": ":"},
    {"color": "#E69F00", "marker": "o", "linestyle": (0, (5, 1, 1, 1, 1, 1))},
    {"color": "#56B4E9", "marker": "s", "linestyle": (0, (1, 1))},
)
MARKS: dict[str, Any] = {
    "fmt": "o",
    "color": "0.5",
    "markerfacecolor": "none",
    "markersize": 3.5,
    "markeredgewidth": 0.7,
    "linewidth": 0.6,
}
LEGEND: dict[str, Any] = {
    "frameon": False,
    "fontsize": 8,
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 1.0),
    "borderaxespad": 0.1,
}
MOST_POINTS = 4000


def thinning(samples: int) -> int:
    """Every how many-th sample a curve is drawn by."""
    return max(1, samples // MOST_POINTS)


def line(series: Mapping[str, Any]) -> dict[str, Any]:
    """Line of a series."""
    return {"color": series["color"], "linestyle": series["linestyle"], "linewidth": 1.2}


def mark(series: Mapping[str, Any]) -> dict[str, Any]:
    """Open marks of a series."""
    size = {k: MARKS[k] for k in ("markerfacecolor", "markersize", "markeredgewidth")}
    return {"color": series["color"], "marker": series["marker"], **size}


def half_periods(ax: "Axes", x: ArrayLike, y: ArrayLike, error: ArrayLike) -> None:
    """Half periods of a record with their errors, named above the panel."""
    points = ax.errorbar(x, y, error, **MARKS)
    ax.legend([points], ["half periods of the record"], **LEGEND)


def in_latex(symbol: str) -> str:
    """A force's symbol as matplotlib writes it."""
    import sympy

    return f"${sympy.latex(sympy.Symbol(symbol))}$"


def axes(ax: "Axes | None") -> "Axes":
    """The axes given, or new ones."""
    if ax is not None:
        return ax
    from matplotlib.figure import Figure

    return Figure(figsize=(5.0, 3.2), layout="constrained").subplots()


def logarithmic_amplitude(ax: "Axes") -> None:
    """A logarithmic axis of amplitudes, with plain numbers at as many ticks as have room."""
    from matplotlib.ticker import MaxNLocator, NullLocator

    ax.set(ylabel="amplitude (rad)", yscale="log")
    low, high = ax.get_ylim()
    ax.yaxis.set_major_formatter("{x:g}")
    if high > 8.0 * low:
        ax.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "2346" else "")
    else:
        # Powers of ten and their multiples would leave all above 1 rad without a tick.
        ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
        ax.yaxis.set_minor_locator(NullLocator())
