"""Interactive figures of a record and the motions of models: angle, residuals, envelope, frequency."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr
from bokeh import plotting
from bokeh.models import GlyphRenderer, Range1d
from numpy.typing import ArrayLike

from sysid_trib.plots.motion_data import MOST_POINTS, MotionData
from sysid_trib.plots.style import GREY
from sysid_trib.reporting import drawing
from sysid_trib.reporting.parts import Panel

Curve = tuple[ArrayLike, ArrayLike]
Entries = list[tuple[str, Sequence[GlyphRenderer]]]


def time_panels(drawn: MotionData, *, together: bool) -> list[Panel]:
    """Record and models, and residuals, over time.

    Parameters
    ----------
    drawn : MotionData
        The record and its models.
    together : bool
        Whether the residuals of all models share a panel, else each has a panel and a scale of its own.
    """
    record = _record(drawn)
    parts = [list(drawn.lines)] if together else [[name] for name in drawn.lines]
    return [Panel(record), *(Panel(_residual(drawn, part, record)) for part in parts if part)]


def half_period_panels(drawn: MotionData) -> list[Panel]:
    """Envelope, and frequency against amplitude, of the record and its models."""
    if "record" not in drawn.half_periods:
        return []
    return [Panel(draw(drawn), wide=False) for draw in (_envelope, _frequency)]


def record_panel(data: xr.Dataset) -> Panel:
    """The record alone, the part that is held out on grey."""
    made = _record(MotionData(data, np.nan, {}, {}))
    drawing.band(made, data.holdout_start.item(), float(data.time.values[-1]), along="y")
    return Panel(made)


def _record(drawn: MotionData) -> plotting.figure:
    made = drawing.panel("time (s)", drawn.label)
    # Pale behind models, which must show.
    color = drawing.RECORD_GREY if drawn.lines else GREY
    if drawn.time.size > MOST_POINTS:
        points = drawing.line(made, (drawn.time, drawn.angle), {"color": color})
    else:
        points = drawing.marks(made, {"x": drawn.time, "y": drawn.angle}, {"color": color}, size=3.5)
    drawing.tell(made, [points], [("time", "@x{%.5g} s"), ("angle", f"@y{{%.5g}} {drawn.units}")])
    if drawn.lines:
        curves = {name: (drawn.time, drawn.motion(name)) for name in drawn.lines}
        _with_models(made, drawn, [("record", [points])], curves)
    return made


def _residual(drawn: MotionData, models: Sequence[str], record: plotting.figure) -> plotting.figure:
    factor, unit = drawn.small_units
    label, height = f"record \N{MINUS SIGN} model ({unit})", drawing.RESIDUAL_HEIGHT_PX
    made = drawing.panel("time (s)", label, height=height, share_x=record)
    drawing.band(made, -2.0 * factor * drawn.noise, 2.0 * factor * drawn.noise)
    curves = _with_models(made, drawn, [], {n: (drawn.time, drawn.residual(n)) for n in models}, width=1.0)
    for name, curve in curves.items():
        drawing.tell(made, [curve], [("time", "@x{%.5g} s"), (drawn.labels[name], f"@y{{%.4g}} {unit}")])
    return made


def _envelope(drawn: MotionData) -> plotting.figure:
    made = drawing.panel("time (s)", f"amplitude ({drawn.units})", log="y")
    low, high = drawn.amplitude_limits()
    made.y_range = Range1d(low, high)
    made.yaxis.ticker.desired_num_ticks = 5
    # Where the noise is as large as the swing, a bar would reach below zero.
    tooltips = [("time", "@x{%.5g} s"), ("amplitude", f"@y{{%.5g}} ± @error{{%.2g}} {drawn.units}")]
    return _half_periods(made, drawn, "instant_time", "amplitude", 0.1 * low, tooltips)


def _frequency(drawn: MotionData) -> plotting.figure:
    made = drawing.panel(f"amplitude ({drawn.units})", "frequency (rad/s)")
    made.y_range = Range1d(*drawn.frequency_limits())
    made.x_range = Range1d(0.0, 1.05 * drawn.half_periods["record"].amplitude.values.max())
    tooltips = [("amplitude", f"@x{{%.4g}} {drawn.units}"), ("frequency", "@y{%.6g} ± @error{%.2g} rad/s")]
    return _half_periods(made, drawn, "amplitude", "frequency", -np.inf, tooltips)


def _half_periods(
    made: plotting.figure, drawn: MotionData, x: str, y: str, lowest: float, tooltips: drawing.Tooltips
) -> plotting.figure:
    """Half periods of the record with bars from `lowest` on, and the lines of the models."""
    measured = drawn.half_periods["record"]
    value, error = measured[y].values, measured[f"{y}_standard_error"].values
    columns = {"x": measured[x].values, "y": value, "error": error}
    columns |= {"low": np.maximum(value - error, lowest), "high": value + error}
    curves = {n: (fit[x].values, fit[y].values) for n, fit in drawn.half_periods.items() if n != "record"}
    points = drawing.marks(made, columns, {"color": GREY, "markerfacecolor": "white"}, size=5.0)
    drawing.tell(made, [points], tooltips)
    _with_models(made, drawn, [("record", [points])], curves)
    return made


def _with_models(
    made: plotting.figure,
    drawn: MotionData,
    entries: Entries,
    curves: Mapping[str, Curve],
    width: float = 1.3,
) -> dict[str, GlyphRenderer]:
    """Curves of models over what is drawn, and the legend."""
    lines = drawn.lines
    order = sorted(curves, key=lambda name: lines[name]["zorder"])
    made_lines = {name: drawing.line(made, curves[name], lines[name], width=width) for name in order}
    drawing.legend(made, [*entries, *((drawn.labels[name], [made_lines[name]]) for name in curves)])
    return made_lines
