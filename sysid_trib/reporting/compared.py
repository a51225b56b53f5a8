"""Interactive figures of methods side by side: each quantity by method, and how well each predicts."""

import numpy as np
import xarray as xr
from bokeh import plotting

from sysid_trib.plots.comparison_data import ASYMPTOTIC, PREDICTION, ComparisonData, comparison_data
from sysid_trib.printing.layout import value_with_error
from sysid_trib.reporting import drawing
from sysid_trib.reporting.parts import Panel


def quantity_panels(tree: xr.DataTree) -> list[Panel]:
    """One panel a force, and one for the asymptotic frequency."""
    data = comparison_data(tree)
    return [Panel(_quantity(data, name), wide=False) for name in data.quantities]


def prediction_panel(tree: xr.DataTree) -> Panel:
    """RMS of record minus model over the noise: of the part identified from (open), and held out (full)."""
    data = comparison_data(tree)
    table, style = data.table, _style(data)
    methods = table.method.values.tolist()
    made = drawing.list_panel("RMS over the noise", methods, log="x")
    first, last = (table[name].values for name in PREDICTION)
    made.segment(first, methods, last, methods, color=style["color"])
    drawn, faces = [], (["white"] * len(methods), style["color"])
    for (name, part), face in zip(PREDICTION.items(), faces, strict=True):
        columns = {"x": table[name].values, "y": methods, "part": [part] * len(methods)}
        drawn.append(drawing.marks(made, columns | style | {"markerfacecolor": face}, {}, size=7))
    drawing.tell(made, drawn, [("method", "@y"), ("@part", "@x{%.3g} times the noise")])
    drawing.threshold(made, 1.0)
    drawing.log_axis(made, 0.8 * np.nanmin([*first, *last, 1.0]), 1.3 * np.nanmax([*first, *last, 1.0]))
    return Panel(made)


def _style(data: ComparisonData) -> dict[str, list[str]]:
    """Columns of colours and marks, a row for each method."""
    styles = [{"markerfacecolor": style["color"]} | dict(style) for style in data.marks.values()]
    columns = {name: [style[name] for style in styles] for name in drawing.STYLED}
    return columns | {"marker": [drawing.MARKERS[marker] for marker in columns["marker"]]}


def _quantity(compared: ComparisonData, quantity: str) -> plotting.figure:
    data, style = compared.quantity(quantity), _style(compared)
    made = drawing.list_panel(_axis_label(quantity, data), data.method.values.tolist())
    made.x_range.update(start=data.low, end=data.high)
    made.xaxis.ticker.desired_num_ticks = 4
    if np.isfinite(data.band_low):
        drawing.band(made, data.band_low, data.band_high, along="y")
    value, error, side = (data[name].values for name in ("value", "error", "side"))
    # A value beyond the axis is an arrow at its end: an upright triangle, turned.
    inset, inside = 0.02 * (data.high - data.low), side == 0
    columns = {
        "x": np.where(inside, value, np.clip(value, data.low + inset, data.high - inset)),
        "y": data.method.values,
        "low": np.where(inside, np.maximum(data.low, value - error), np.nan),
        "high": np.where(inside, np.minimum(data.high, value + error), np.nan),
        "turn": -0.5 * np.pi * side,
        "text": [value_with_error(v, e) for v, e in zip(value.tolist(), error.tolist(), strict=True)],
        "color": style["color"],
        "marker": np.where(inside, style["marker"], "triangle"),
        "markerfacecolor": np.where(inside, style["markerfacecolor"], style["color"]),
    }
    drawn = drawing.marks(made, columns, {}, size=8)
    drawn.glyph.angle = "turn"
    drawing.tell(made, [drawn], [("method", "@y"), (made.xaxis.axis_label, "@text")])
    return made


def _axis_label(quantity: str, data: xr.Dataset) -> str:
    if quantity == ASYMPTOTIC:
        return "asymptotic frequency (rad/s)"
    scale = f"1e{data.power:+03d}" if data.power else ""
    inside = " ".join(filter(None, (scale, data.unit if data.unit != "1" else "")))
    return f"{quantity} ({inside})" if inside else quantity
