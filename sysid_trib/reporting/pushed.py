"""Interactive figures of a motion that is pushed at random."""

import numpy as np
import xarray as xr
from bokeh import plotting
from numpy.typing import ArrayLike

from sysid_trib import plots
from sysid_trib.plots.motion_data import drawn_samples
from sysid_trib.plots.random_force_figures import BAND_WIDTH, span_starts
from sysid_trib.plots.style import BLUE, INK, ORANGE, new_figure
from sysid_trib.reporting import drawing
from sysid_trib.reporting.parts import Figures, Panel
from sysid_trib.results.signal_units import signal_units, small_units

HEIGHT_PX = 220


def random_force_figures(caption: str, followed: xr.Dataset, bands: xr.Dataset | None) -> Figures:
    """Innovations with their autocorrelation, the random force over time, and predictions.

    Parameters
    ----------
    caption : str
        Below the figures.
    followed : Dataset
        Result of `innovations`.
    bands : Dataset, optional
        Result of `prediction_bands`.
    """
    innovation = _innovations(followed)
    panels = [
        Panel(innovation),
        Panel(_random_force(followed, innovation)),
        Panel(_autocorrelation(followed), wide=False),
    ]
    on_paper, force = [plots.innovations(followed)], new_figure(7.2, 2.4)
    plots.random_force(followed, force.subplots())
    on_paper.append(force)
    if bands is not None:
        panels.append(Panel(_predictions(bands), wide=False))
        predicted = new_figure(7.2, 2.4)
        plots.prediction_bands(bands, predicted.subplots())
        on_paper.append(predicted)
    return Figures(caption, panels, on_paper)


def _innovations(data: xr.Dataset) -> plotting.figure:
    factor, unit = small_units(signal_units(data))
    made = drawing.panel("time (s)", f"innovation ({unit})", height=HEIGHT_PX)
    time, innovation = data.time.values, factor * data.innovation.values
    _band(made, time, factor * BAND_WIDTH * data.innovation_standard_deviation.values)
    shown = drawn_samples(innovation)
    drawing.marks(made, {"x": time[shown], "y": innovation[shown]}, {"color": BLUE}, size=2)
    return made


def _random_force(data: xr.Dataset, beside: plotting.figure) -> plotting.figure:
    made = drawing.panel(
        "time (s)", f"random force ({signal_units(data)}/s²)", height=HEIGHT_PX, share_x=beside
    )
    first = span_starts(data.random_force.values)
    # Each span as a level: its end is the start of the next.
    at, of = np.repeat(first, 2)[1:], np.repeat(first, 2)[:-1]
    time, force = data.time.values[at], data.random_force.values[of]
    _band(made, time, BAND_WIDTH * data.random_force_standard_error.values[of], force)
    drawing.line(made, (time, force), {"color": BLUE}, width=1.0)
    return made


def _autocorrelation(data: xr.Dataset) -> plotting.figure:
    made = drawing.panel("lag (samples)", "autocorrelation", height=HEIGHT_PX)
    width = BAND_WIDTH / np.sqrt(data.sizes["time"])
    drawing.band(made, -width, width)
    lags, values = data.lag.values, data.autocorrelation.values
    stems = {"x": lags, "y": values, "low": np.zeros(len(lags)), "high": values}
    drawing.marks(made, stems, {"color": BLUE}, size=5)
    return made


def _predictions(data: xr.Dataset) -> plotting.figure:
    factor, unit = small_units(signal_units(data))
    made = drawing.panel("time (s)", f"record \N{MINUS SIGN} prediction ({unit})", height=HEIGHT_PX)
    missed = factor * (data.measured - data.predicted).values
    width = factor * BAND_WIDTH * data.predicted_standard_error.values
    for at, time in enumerate(data.time_ahead.values):
        _band(made, time, width[at])
        drawing.line(made, (time, missed[at]), {"color": ORANGE}, width=1.0)
    drawing.line(made, (data.time_ahead.values[[0, -1], [0, -1]], np.zeros(2)), {"color": INK}, width=0.5)
    return made


def _band(on: plotting.figure, x: ArrayLike, width: ArrayLike, middle: ArrayLike = 0.0) -> None:
    """A grey band of a half width about a curve."""
    low, high = np.asarray(middle) - np.asarray(width), np.asarray(middle) + np.asarray(width)
    on.varea(x=np.asarray(x), y1=low, y2=high, fill_color=drawing.BAND_GREY, level="underlay")
