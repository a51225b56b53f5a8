"""Interactive figures of a search: the missing force, the scores, and what would have been detected."""

from typing import Any

import numpy as np
import xarray as xr
from bokeh import plotting
from bokeh.models import ColorBar, LinearColorMapper, Range1d
from bokeh.palettes import RdBu11, interp_palette

from sysid_trib.plots.discovery_data import detectability_data, missing_force, rankings_data
from sysid_trib.plots.style import CANDIDATE_MARKS, DETECTABLE_MARKS, GREY
from sysid_trib.reporting import drawing
from sysid_trib.reporting.parts import Panel
from sysid_trib.results.signal_units import signal_label, signal_units, small_units


def map_panels(tree: xr.DataTree) -> list[Panel]:
    """Mean force over angle and rate that a model lacks, before and after, in the same colours."""
    return [Panel(_map(tree, after), wide=False) for after in (False, True)]


def ranking_panels(tree: xr.DataTree) -> list[Panel]:
    """The candidates by score before each step and at the end."""
    return [Panel(_ranking(data), wide=False) for data in rankings_data(tree)]


def _map(tree: xr.DataTree, after: bool) -> plotting.figure:
    force, error, limit = missing_force(tree, after=after)
    x, v = np.meshgrid(force.x.values, force.v.values, indexing="ij")
    there = np.isfinite(force.values)
    units = signal_units(tree)
    _, unit = small_units(units)
    made = drawing.panel(signal_label(units), f"rate over w ({units})", height=380)
    # Both maps over the same angles and rates.
    edge = 1.1 * max(float(tree[name].x.max()) for name in ("discrepancy", "discrepancy_after"))
    made.x_range, made.y_range = Range1d(-edge, edge), Range1d(-edge, edge)
    made.title.text = f"{'after' if after else 'before'}: missing f in θ″ + w²θ = -w²f ({unit})"
    colors = LinearColorMapper(palette=interp_palette(RdBu11, 101), low=-limit, high=limit)
    width, height = (float(np.diff(axis.values)[0]) for axis in (force.x, force.v))
    columns = {"x": x[there], "y": v[there], "force": force.values[there], "error": error.values[there]}
    fill: dict[str, Any] = {"fill_color": {"field": "force", "transform": colors}, "line_color": None}
    cells = made.rect("x", "y", width, height, source=drawing.columns(columns), **fill)
    tooltips = [
        ("angle", f"@x{{%.3g}} {units}"),
        ("rate over w", f"@y{{%.3g}} {units}"),
        ("missing force", f"@force{{%.3g}} ± @error{{%.2g}} {unit}"),
    ]
    drawing.tell(made, [cells], tooltips)
    made.add_layout(ColorBar(color_mapper=colors, width=10, padding=4, background_fill_alpha=0.0), "right")
    return made


def _ranking(data: xr.Dataset) -> plotting.figure:
    rows, log = data.candidate.values.tolist(), "x" if data.logarithmic else ""
    label = f"score |z| {data.title} (threshold {data.threshold.item():.3g})"
    made = drawing.list_panel(label, rows, log=log)
    if data.logarithmic:
        drawing.log_axis(made, data.low, 1.2 * data.high)
    else:
        made.x_range.update(start=data.low, end=data.high + 0.2 * (data.high - data.low))
    tooltips = [("@y", "@name"), ("z", "@z{%.4g}"), ("corrected p", "@p{%.2g}"), ("shapes", "@shapes")]
    for kind, style in CANDIDATE_MARKS.items():
        shown = data.isel(candidate=data.kind.values == kind)
        if shown.sizes["candidate"]:
            symbols, size = shown.candidate.values.tolist(), shown["size"].values
            if data.low == 0.0 or data.logarithmic:
                made.segment([data.low] * len(size), symbols, size, symbols, color=style["color"])
            columns = {"x": size, "y": symbols, "z": shown.z.values, "p": shown.p_value.values}
            columns |= {"name": shown["name"].values, "shapes": shown.shapes.values}
            drawing.tell(made, [drawing.marks(made, columns, style, size=8)], tooltips)
    if data.low < data.threshold:
        drawing.threshold(made, data.threshold.item())
    return made


def detectability_panel(tree: xr.DataTree) -> Panel:
    """Smallest coefficient of each candidate that the record would show, and effects that were identified."""
    data = detectability_data(tree)
    made = drawing.list_panel("detectable coefficient (own unit)", data.candidate.values.tolist(), log="x")
    both = data.dropna("candidate", subset=["start", "final"])
    rows = both.candidate.values.tolist()
    made.segment(both.start.values, rows, both.final.values, rows, color=GREY)
    detectable = [("@y", "@name, @formula"), ("family", "@family"), ("would be detected from", "@x{%.3g}")]
    for label, (name, size) in zip(
        DETECTABLE_MARKS, {"start": 6, "final": 6, "identified": 9}.items(), strict=True
    ):
        shown = data.dropna("candidate", subset=[name])
        columns = {"x": shown[name].values, "y": shown.candidate.values}
        columns |= {text: shown[text].values for text in ("name", "family", "formula")}
        drawn = drawing.marks(made, columns, DETECTABLE_MARKS[label], size=size)
        drawing.tell(made, [drawn], [("@y", "@x{%.4g}")] if name == "identified" else detectable)
    sizes = data[["start", "final", "identified"]].to_dataarray().values
    if np.isfinite(sizes).any():
        drawing.log_axis(made, 0.5 * np.nanmin(sizes), 2.0 * np.nanmax(sizes))
    return Panel(made)
