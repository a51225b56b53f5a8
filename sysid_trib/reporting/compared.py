"""Interactive figures of methods side by side: each quantity by method, and how well each predicts."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.plots.compared import FAMILIES, FREQUENCY, family_of, is_variant, limits, shown, values_of
from sysid_trib.printing.layout import value_with_error
from sysid_trib.reporting import drawing
from sysid_trib.reporting.parts import Panel
from sysid_trib.validation.comparison_table import column_power

if TYPE_CHECKING:
    from bokeh.plotting import figure

Array = NDArray[np.float64]


def quantity_panels(tree: xr.DataTree) -> list[Panel]:
    """One panel a force, and one for the asymptotic frequency."""
    names = [*shown(tree).force.values.tolist(), FREQUENCY]
    return [Panel(_quantity(tree, name), wide=False) for name in names]


def prediction_panel(tree: xr.DataTree) -> Panel:
    """RMS of record minus model over the noise: of the part identified from (open), and held out (full)."""
    found = shown(tree)
    methods = found.method.values
    made = drawing.panel(
        "RMS over the noise",
        "",
        rows=methods.tolist(),
        log="x",
        height=_height(found),
    )
    drawn = []
    for (color, marker, _), rows in _looks(tree).items():
        one = found.isel(method=rows)
        names = methods[rows].tolist()
        made.segment(one.train_over_noise.values, names, one.holdout_over_noise.values, names, color=color)
        for part, values in (
            ("first two thirds", one.train_over_noise),
            ("held-out third", one.holdout_over_noise),
        ):
            columns = {"x": values.values, "y": names, "part": [part] * len(names)}
            hollow = part != "held-out third"
            drawn.append(drawing.marks(made, columns, color, marker=marker, size=7, hollow=hollow))
    drawing.tell(made, drawn, [("method", "@y"), ("@part", "@x{%.3g} times the noise")])
    drawing.threshold(made, 1.0)
    ends = np.concatenate([found.train_over_noise.values, found.holdout_over_noise.values, [1.0]])
    drawing.log_axis(made, 0.8 * np.nanmin(ends), 1.3 * np.nanmax(ends))
    return Panel(made)


def _quantity(tree: xr.DataTree, quantity: str) -> "figure":
    found = shown(tree)
    value, error, _ = values_of(tree, quantity)
    methods = found.method.values
    best = methods.tolist().index(found.attrs["best"])
    low, high = limits(value, error, best)
    made = drawing.panel(_label(found, quantity), "", rows=methods.tolist(), height=_height(found))
    made.x_range.update(start=low, end=high)
    made.xaxis.ticker.desired_num_ticks = 4
    if np.isfinite(value[best]):
        drawing.band(made, value[best] - error[best], value[best] + error[best], along="y")
    drawn = []
    for (color, marker, hollow), rows in _looks(tree).items():
        there = rows[np.isfinite(value[rows])]
        inside = (low <= value[there]) & (value[there] <= high)
        for at, beyond in ((there[inside], False), (there[~inside], True)):
            if len(at):
                columns = _columns(methods[at], value[at], error[at], low, high, beyond=beyond)
                mark = drawing.marks(
                    made,
                    columns,
                    color,
                    marker="^" if beyond else marker,
                    size=8,
                    hollow=hollow and not beyond,
                )
                if beyond:
                    mark.glyph.angle = "turn"
                drawn.append(mark)
    drawing.tell(made, drawn, [("method", "@y"), (made.xaxis.axis_label, "@told")])
    return made


def _columns(
    methods: NDArray[np.str_], value: Array, error: Array, low: float, high: float, *, beyond: bool
) -> dict[str, Any]:
    """Marks with their bars within the axis; of values beyond it, arrows at its ends."""
    told = [value_with_error(float(v), float(e)) for v, e in zip(value, error, strict=True)]
    columns = {"x": value, "y": methods.tolist(), "told": told}
    if beyond:
        # An upright triangle turned to the left or to the right.
        inset = 0.02 * (high - low)
        turn = np.where(value > high, -0.5 * np.pi, 0.5 * np.pi)
        return columns | {"x": np.clip(value, low + inset, high - inset), "turn": turn}
    return columns | {"low": np.maximum(low, value - error), "high": np.minimum(high, value + error)}


def _looks(tree: xr.DataTree) -> dict[tuple[str, str, bool], NDArray[np.intp]]:
    """Rows of the methods that look alike, by colour, mark, and whether it is hollow."""
    looks: dict[tuple[str, str, bool], list[int]] = {}
    for row, method in enumerate(shown(tree).method.values.tolist()):
        color, marker, _ = FAMILIES[family_of(tree, method)]
        # Matplotlib writes a grey as a number.
        ink = color if color.startswith("#") else drawing.INK
        looks.setdefault((ink, marker, is_variant(tree, method)), []).append(row)
    return {look: np.array(rows) for look, rows in looks.items()}


def _label(found: xr.Dataset, quantity: str) -> str:
    if quantity == FREQUENCY:
        return "asymptotic frequency (rad/s)"
    one = found.sel(force=quantity)
    power, unit = column_power(one), one.unit.item()
    scale = f"1e{power:+03d}" if power else ""
    inside = " ".join(filter(None, (scale, unit if unit != "1" else "")))
    return f"{quantity} ({inside})" if inside else quantity


def _height(found: xr.Dataset) -> int:
    return drawing.MARGIN + drawing.ROW * found.sizes["method"]
