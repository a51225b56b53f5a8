"""Interactive figures of the forces of a result: shares, power, coefficients, and the force still missing."""

from itertools import cycle
from typing import Any

import numpy as np
import xarray as xr
from bokeh import plotting
from bokeh.models import ColorBar, LinearColorMapper, Range1d
from bokeh.palettes import RdBu11, interp_palette

from sysid_trib.plots.overview import drawn_overview
from sysid_trib.plots.overview_data import INTERVAL, OverviewData, overview_data
from sysid_trib.plots.style import BLUE, ORANGE, SERIES
from sysid_trib.printing.layout import value_with_error
from sysid_trib.reporting import drawing
from sysid_trib.reporting.motions import time_panels
from sysid_trib.reporting.parts import Figures, Panel

# Shares beyond these, %, are errors alone.
LOWEST_SHARE, HIGHEST_SHARE = -110.0, 110.0


def glance_figures(tree: xr.DataTree, run: int, caption: str) -> Figures:
    """Record, residual and forces of a run, and what stands in their place on paper: the overview.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`, `compare` or `discover`.
    run : int
        Which of several runs, from 0.
    caption : str
        Below the figures.
    """
    data = overview_data(tree, run)
    # Of a discovery the residuals before and after stand with what explains them.
    in_time = [] if "steps" in tree.children else time_panels(data.motion, together=True)
    made = []
    if data.weighed is not None and data.power is not None:
        made += [_shares(data, "decay_share", "decay"), _shares(data, "frequency_share", "frequency shift")]
        made.append(_power(data))
    if data.results:
        made.append(_coefficients(data))
    if data.missing is not None:
        made += [_surface(data), _profiles(data)]
    # Forces that only dissipate shift no frequency: an empty figure is none.
    panels = [*in_time, *(Panel(figure, wide=False) for figure in made if figure.renderers)]
    return Figures(caption, panels, [drawn_overview(data)])


def _lines(
    made: plotting.figure, at: np.ndarray, curves: dict[str, np.ndarray], tooltips: drawing.Tooltips
) -> plotting.figure:
    """A line of each force, named in a legend and under the pointer."""
    entries = []
    for (symbol, values), series in zip(curves.items(), cycle(SERIES)):
        if np.any(np.isfinite(values) & (values != 0.0)):
            drawn = drawing.line(made, (at, values), {"color": series["color"]}, width=1.6)
            drawing.tell(made, [drawn], [("force", symbol), *tooltips])
            entries.append((symbol, [drawn]))
    drawing.legend(made, entries)
    return made


def _shares(data: OverviewData, quantity: str, of: str) -> plotting.figure:
    weighed, unit = data.weighed, data.units
    assert weighed is not None
    made = drawing.panel(f"amplitude ({unit})", f"share of the {of} (%)")
    curves = {s: 100.0 * weighed[quantity].sel(force=s).values for s in weighed.force.values.tolist()}
    low = 1.1 * min(0.0, *(float(np.nanmin(curve, initial=0.0)) for curve in curves.values()))
    made.y_range = Range1d(max(LOWEST_SHARE, low), HIGHEST_SHARE)
    tooltips = [("amplitude", f"@x{{%.3g}} {unit}"), ("share", "@y{%.3g} %")]
    return _lines(made, weighed.amplitude.values, curves, tooltips)


def _power(data: OverviewData) -> plotting.figure:
    power, unit = data.power, data.units
    assert power is not None
    made = drawing.panel("time (s)", f"power over Iω² ({unit}²/s)", log="y")
    curves = {s: np.abs(power.power.sel(force=s).values) for s in power.force.values.tolist()}
    tooltips = [("time", "@x{%.4g} s"), ("power", f"@y{{%.3g}} {unit}²/s")]
    return _lines(made, power.time.values, curves, tooltips)


def _coefficients(data: OverviewData) -> plotting.figure:
    """Coefficients of the main identification over their values, with 95 % intervals."""
    name, result = list(data.results.items())[-1]
    symbols = result.force.values.tolist()
    made = drawing.list_panel(f"coefficient by {name} over its value, 95 %", symbols)
    value, error = result.coefficient.values, result.standard_error.values
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.where(value != 0.0, INTERVAL * error / np.abs(value), np.nan)
    texts = [value_with_error(v, e) for v, e in zip(value.tolist(), error.tolist(), strict=True)]
    columns = {"x": np.ones(len(symbols)), "y": symbols, "low": 1.0 - part, "high": 1.0 + part, "text": texts}
    drawn = drawing.marks(made, columns, {"color": BLUE}, size=7)
    drawing.tell(made, [drawn], [("@y", "@text")])
    made.x_range.update(start=-0.5, end=2.5)
    drawing.threshold(made, 0.0)
    return made


def _surface(data: OverviewData) -> plotting.figure:
    missing, (factor, unit) = data.missing, data.motion.small_units
    assert missing is not None
    x, v = np.meshgrid(missing.x.values, missing.v.values, indexing="ij")
    force, error = (factor * missing[k].values for k in ("force", "force_standard_error"))
    there = np.isfinite(force)
    limit = data.colour_limit
    made = drawing.panel(data.motion.label, f"rate over ω ({data.units})", height=340)
    made.title.text = f"what is missing: f in θ″ + ω²θ = -ω²f ({unit})"
    colors = LinearColorMapper(palette=interp_palette(RdBu11, 101), low=-limit, high=limit)
    sides = [float(np.diff(axis.values)[0]) for axis in (missing.x, missing.v)]
    columns = {"x": x[there], "y": v[there], "force": force[there], "error": error[there]}
    fill: dict[str, Any] = {"fill_color": {"field": "force", "transform": colors}, "line_color": None}
    cells = made.rect("x", "y", *sides, source=drawing.columns(columns), **fill)
    drawing.tell(made, [cells], [("missing force", f"@force{{%.3g}} ± @error{{%.2g}} {unit}")])
    made.add_layout(ColorBar(color_mapper=colors, width=10, padding=4, background_fill_alpha=0.0), "right")
    return made


def _profiles(data: OverviewData) -> plotting.figure:
    factor, unit = data.motion.small_units
    signal = data.motion.label.split()[0]
    made = drawing.panel(
        f"{signal}, or rate over ω ({data.units})",
        f"mean missing force ({unit})",
        height=340,
    )
    entries = []
    for name, label, color in (("x", f"over {signal}", BLUE), ("v", "over rate", ORANGE)):
        assert data.missing is not None
        force = factor * data.missing[f"force_of_{name}"].values
        error = INTERVAL * factor * data.missing[f"force_of_{name}_standard_error"].values
        columns = {"x": data.missing[name].values, "y": force, "low": force - error, "high": force + error}
        entries.append((label, [drawing.marks(made, columns, {"color": color}, size=5)]))
    drawing.legend(made, entries)
    return made
