"""Interactive figures of a search: where the gap asks for a force, who scores, what would have been seen."""

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from sysid_trib.plots.discovered import missing_force
from sysid_trib.plots.scored import BEST, FAR, by_family, marked, scan_title, shown_scans
from sysid_trib.printing.discovery_tables import strongest
from sysid_trib.reporting import drawing
from sysid_trib.reporting.parts import Panel
from sysid_trib.results.discoveries import added_effects, shapes_of

if TYPE_CHECKING:
    from bokeh.plotting import figure

# Okabe and Ito's palette as in the figures on paper: colour, mark, hollow.
KINDS = {
    "named": ("#D55E00", "D", False),
    "cannot be told from it": ("#0072B2", "s", False),
    "other candidates": (drawing.GREY, "o", True),
}


def map_panels(tree: xr.DataTree) -> list[Panel]:
    """Mean force that the gap asks for over angle and rate, before and after, in the same colours."""
    return [Panel(_map(tree, after), wide=False) for after in (False, True)]


def ranking_panels(tree: xr.DataTree) -> list[Panel]:
    """The candidates by score before each step and at the end."""
    return [Panel(_ranking(tree, scan), wide=False) for scan in shown_scans(tree)]


def _map(tree: xr.DataTree, after: bool) -> "figure":
    from bokeh.models import ColorBar, LinearColorMapper, Range1d
    from bokeh.palettes import RdBu11, interp_palette

    force, error, limit = missing_force(tree, after=after)
    x, v = np.meshgrid(force.x.values, force.v.values, indexing="ij")
    there = np.isfinite(force.values)
    made = drawing.panel("angle (rad)", "rate over w (rad)", height=380)
    # Both maps over the same angles and rates.
    reach = 1.1 * max(float(tree[name].x.max()) for name in ("discrepancy", "discrepancy_after"))
    made.x_range, made.y_range = Range1d(-reach, reach), Range1d(-reach, reach)
    made.title.text = f"{'after' if after else 'before'}: missing f in θ″ + w²θ = -w²f (mrad)"
    made.title.text_font_style, made.title.text_font_size, made.title.text_font = (
        "normal",
        "13px",
        drawing.FONT,
    )
    colors = LinearColorMapper(palette=interp_palette(RdBu11, 101), low=-limit, high=limit)
    width, height = (float(np.diff(axis.values)[0]) for axis in (force.x, force.v))
    cells = made.rect(
        "x",
        "y",
        width,
        height,
        source=drawing.columns(
            {"x": x[there], "y": v[there], "force": force.values[there], "error": error.values[there]}
        ),
        fill_color={"field": "force", "transform": colors},
        line_color=None,
    )
    told = [
        ("angle", "@x{%.3g} rad"),
        ("rate over w", "@y{%.3g} rad"),
        ("missing force", "@force{%.3g} ± @error{%.2g} mrad"),
    ]
    drawing.tell(made, [cells], told)
    made.add_layout(ColorBar(color_mapper=colors, width=10, padding=4, background_fill_alpha=0.0), "right")
    return made


def _ranking(tree: xr.DataTree, scan: int) -> "figure":
    found = tree["ranking"].to_dataset()
    one = found.isel(selection_step=[scan % found.sizes["selection_step"]])
    z = abs(one.z.isel(selection_step=0))
    named, tied = marked(tree, scan)
    chosen = strongest(one, BEST)
    # Those marked are shown, wherever they rank.
    chosen += [
        s for s in (*named, *tied) if s in z.candidate and s not in chosen and np.isfinite(z.sel(candidate=s))
    ]
    limit = one.threshold.item()
    size = z.sel(candidate=chosen).values
    far = bool(np.max(size, initial=0.0) > FAR * limit)
    left = min([0.5 * limit, *(0.7 * size)]) if far else 0.0
    label = f"score |z| {scan_title(tree, scan)}"
    made = drawing.panel(
        label, "", rows=chosen, log="x" if far else "", height=drawing.MARGIN + drawing.ROW * len(chosen)
    )
    right = 1.2 * max([limit, *size])
    if far:
        drawing.log_axis(made, left, right)
    else:
        made.x_range.update(start=0.0, end=right)
    for kind, (color, marker, hollow) in KINDS.items():
        members = [s for s in chosen if _kind(s, named, tied) == kind]
        if members:
            _scores(made, one.isel(selection_step=0).sel(candidate=members), left, color, marker, hollow)
    drawing.threshold(made, limit)
    return made


def _kind(symbol: str, named: list[str], tied: list[str]) -> str:
    kinds = list(KINDS)
    return kinds[0] if symbol in named else kinds[1] if symbol in tied else kinds[2]


def _scores(on: "figure", found: xr.Dataset, left: float, color: str, marker: str, hollow: bool) -> None:
    symbols, z = found.candidate.values.tolist(), found.z.values
    on.segment([left] * len(z), symbols, np.abs(z), symbols, color=color, line_width=1.0)
    columns = {"x": np.abs(z), "y": symbols, "z": z, "name": found["name"].values.tolist()}
    columns |= {"p": found.p_value.values, "shapes": [_shapes_text(found, symbol) for symbol in symbols]}
    drawn = drawing.marks(on, columns, color, marker=marker, size=8, hollow=hollow)
    told = [("@y", "@name"), ("z", "@z{%.4g}"), ("corrected p", "@p{%.2g}"), ("shapes", "@shapes")]
    drawing.tell(on, [drawn], told)


def _shapes_text(found: xr.Dataset, symbol: str) -> str:
    return ", ".join(f"{symbol}.{name} = {value:.4g}" for name, value in shapes_of(found, symbol).items())


def forecast_panel(tree: xr.DataTree) -> Panel:
    """Smallest coefficient that the record would show, of each candidate; effects found beside it."""
    first, last = (tree[name].to_dataset() for name in ("detectability", "detectability_after"))
    symbols = by_family(first)
    made = drawing.panel(
        "detectable coefficient (own unit)",
        "",
        rows=symbols,
        log="x",
        height=drawing.MARGIN + drawing.ROW * len(symbols),
    )
    ends = {
        name: found.detectable.reindex(candidate=symbols)
        for name, found in (("start model", first), ("final model", last))
    }
    both = np.stack([end.values for end in ends.values()])
    seen = np.isfinite(both).any(axis=0)
    pairs = np.where(np.isfinite(both), both, both[::-1])[:, seen]
    rows = [s for s, yes in zip(symbols, seen, strict=True) if yes]
    made.segment(pairs[0], rows, pairs[1], rows, color=drawing.GREY, line_width=1.0)
    for name, end in ends.items():
        _strengths(made, first, end.dropna("candidate"), hollow=name == "start model")
    sizes = both[np.isfinite(both)]
    if found := added_effects(tree):
        color, marker, _ = KINDS["named"]
        values = np.abs(tree["steps"].coefficient.values)
        named = drawing.marks(made, {"x": values, "y": found}, color, marker=marker, size=9)
        drawing.tell(made, [named], [("@y", "found: @x{%.4g}")])
        sizes = np.append(sizes, values)
    if len(sizes):
        drawing.log_axis(made, 0.5 * sizes.min(), 2.0 * sizes.max())
    return Panel(made)


def _strengths(on: "figure", first: xr.Dataset, detectable: xr.DataArray, *, hollow: bool) -> None:
    symbols = detectable.candidate.values.tolist()
    about = first.sel(candidate=symbols)
    columns = {"x": detectable.values, "y": symbols, "name": about["name"].values.tolist()}
    columns |= {"family": about.family.values.tolist(), "formula": about.formula.values.tolist()}
    drawn = drawing.marks(on, columns, drawing.GREY if hollow else drawing.INK, size=6, hollow=hollow)
    told = [("@y", "@name, @formula"), ("family", "@family"), ("would be seen from", "@x{%.3g}")]
    drawing.tell(on, [drawn], told)
