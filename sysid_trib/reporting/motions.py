"""Interactive figures of a record and the motions of models: angle, what is left, envelope, frequency."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from sysid_trib.decays.half_sines import envelope as half_sine_envelope
from sysid_trib.errors import SysidTribError
from sysid_trib.reporting import drawing
from sysid_trib.reporting.parts import Panel

if TYPE_CHECKING:
    from bokeh.plotting import figure

# Colour and dash of each model's line, by its name, the last on top.
Lines = Mapping[str, tuple[str, str]]
IN_TIME = [("time", "@x{%.5g} s"), ("angle", "@y{%.5g} rad")]


def motion_panels(
    data: xr.Dataset, lines: Lines, noise: float, *, together: bool, label: str = "{}"
) -> list[Panel]:
    """Record and models, what each leaves, envelope, and frequency against amplitude.

    Parameters
    ----------
    data : `angle(time)` and `simulated_angle(model, time)`, rad.
    lines : the models, the last on top.
    noise : rad, of one sample; the band is twice as wide.
    together : what the models leave in one panel, else in one each with a scale of its own.
    label : of a model, about its name.
    """
    labels = {name: label.format(name) for name in lines}
    moving = {k: v for k, v in lines.items() if np.all(np.isfinite(data.simulated_angle.sel(model=k)))}
    record = _record(data, moving, labels)
    parts = [list(moving)] if together else [[name] for name in reversed(moving)]
    left = [_residual(data, {n: lines[n] for n in part}, labels, noise, record) for part in parts if part]
    found = dict(_envelopes(data, list(moving)))
    panels = [Panel(record), *map(Panel, left)]
    if "record" in found:
        panels += [Panel(draw(found, lines, labels), wide=False) for draw in (_envelope, _frequency)]
    return panels


def record_panel(data: xr.Dataset) -> Panel:
    """The record alone, the part that is held out on grey."""
    made = _record(data, {}, {})
    drawing.band(made, data.holdout_start.item(), float(data.time.values[-1]), along="y")
    return Panel(made)


def _record(data: xr.Dataset, lines: Lines, labels: Mapping[str, str]) -> "figure":
    made = drawing.panel("time (s)", "angle (rad)")
    time, angle = data.time.values, data.angle.values
    # Pale behind models, which must show.
    color = drawing.PALE if lines else drawing.GREY
    if time.size > drawing.MOST_POINTS:
        drawn = {"record": drawing.line(made, time, angle, color)}
    else:
        drawn = {"record": drawing.marks(made, {"x": time, "y": angle}, color, size=3.5)}
    for name, (color, dash) in lines.items():
        drawn[labels[name]] = drawing.line(
            made, time, data.simulated_angle.sel(model=name).values, color, dash=dash
        )
    drawing.tell(made, [drawn["record"]], IN_TIME)
    if lines:
        drawing.legend(made, [(name, [curve]) for name, curve in drawn.items()])
    return made


def _residual(
    data: xr.Dataset, lines: Lines, labels: Mapping[str, str], noise: float, record: "figure"
) -> "figure":
    made = drawing.panel("time (s)", "record \N{MINUS SIGN} model (mrad)", height=drawing.LOW, share_x=record)
    drawing.band(made, -2e3 * noise, 2e3 * noise)
    entries = []
    for name, (color, dash) in lines.items():
        gap = 1e3 * (data.angle - data.simulated_angle.sel(model=name)).values
        drawn = drawing.line(made, data.time.values, gap, color, dash=dash, width=1.0)
        drawing.tell(made, [drawn], [("time", "@x{%.5g} s"), (labels[name], "@y{%.4g} mrad")])
        entries.append((labels[name], [drawn]))
    drawing.legend(made, entries)
    return made


def _envelopes(data: xr.Dataset, models: Sequence[str]) -> Iterator[tuple[str, xr.Dataset]]:
    """The record's and each model's motion through the same half-sine fits, where there are such."""
    motions = {"record": data[["angle"]]}
    for name in models:
        motions[name] = xr.Dataset({"angle": data.simulated_angle.sel(model=name, drop=True)})
    for name, motion in motions.items():
        try:
            yield name, half_sine_envelope(motion)
        except SysidTribError:
            continue


def _envelope(found: Mapping[str, xr.Dataset], lines: Lines, labels: Mapping[str, str]) -> "figure":
    from bokeh.models import Range1d

    made = drawing.panel("time (s)", "amplitude (rad)", log="y")
    entries = []
    for name, (color, dash) in lines.items():
        if name in found:
            time, a = found[name].instant_time.values, found[name].amplitude.values
            entries.append((labels[name], [drawing.line(made, time, a, color, dash=dash)]))
    measured = found["record"]
    a, error = measured.amplitude.values, measured.amplitude_standard_error.values
    # Where the noise is as large as the swing, a bar would reach below zero.
    low, high = max(0.8 * float(a.min()), 0.2 * float(np.median(a))), 1.15 * float(a.max())
    columns = {"x": measured.instant_time.values, "y": a, "error": error}
    columns |= {"low": np.maximum(a - error, 0.1 * low), "high": a + error}
    drawn = drawing.marks(made, columns, drawing.GREY, hollow=True)
    made.y_range = Range1d(low, high)
    made.yaxis.ticker.desired_num_ticks = 5
    drawing.tell(made, [drawn], [("time", "@x{%.5g} s"), ("amplitude", "@y{%.5g} ± @error{%.2g} rad")])
    drawing.legend(made, [("record", [drawn]), *entries])
    return made


def _frequency(found: Mapping[str, xr.Dataset], lines: Lines, labels: Mapping[str, str]) -> "figure":
    from bokeh.models import Range1d

    made = drawing.panel("amplitude (rad)", "frequency (rad/s)")
    entries = []
    for name, (color, dash) in lines.items():
        if name in found:
            a, w = found[name].amplitude.values, found[name].frequency.values
            entries.append((labels[name], [drawing.line(made, a, w, color, dash=dash)]))
    measured = found["record"]
    w, error = measured.frequency.values, measured.frequency_standard_error.values
    columns = {"x": measured.amplitude.values, "y": w, "error": error, "low": w - error, "high": w + error}
    drawn = drawing.marks(made, columns, drawing.GREY, hollow=True)
    # A few wild points at the noise floor must not squeeze the course into a line.
    low, high = np.percentile(w, [3, 97])
    made.y_range = Range1d(low - 0.4 * (high - low), high + 0.4 * (high - low))
    made.x_range = Range1d(0.0, 1.05 * float(np.max(columns["x"])))
    told = [("amplitude", "@x{%.4g} rad"), ("frequency", "@y{%.6g} ± @error{%.2g} rad/s")]
    drawing.tell(made, [drawn], told)
    drawing.legend(made, [("record", [drawn]), *entries])
    return made
