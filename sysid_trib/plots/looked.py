"""A record as it is: its decays and spectrum; a driven one with its inputs."""

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots.motion_data import drawn_samples
from sysid_trib.plots.motion_panels import RECORD_POINTS, curve
from sysid_trib.plots.style import (
    BLUE,
    FULL_WIDTH,
    LEGEND,
    MODEL_LINES,
    ORANGE,
    grid,
    letter,
    line,
    logarithmic_amplitude,
    new_figure,
    unit_label,
)
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.variables import record_groups, signal_units

WIDTH, HEIGHT = 7.2, 2.1
# Points of a long record that are drawn.
MOST_POINTS_DRAWN = 20_000


def look(tree: xr.DataTree) -> Figure:
    """The record with its decays marked, amplitude over time, and the spectral density of each decay.

    Parameters
    ----------
    tree : DataTree
        Of `look`.
    """
    figure, panels = grid(3, 1, WIDTH, HEIGHT)
    decays = [node.to_dataset() for name, node in tree.children.items() if name.startswith("decay")]
    records = [node.to_dataset() for name, node in tree.children.items() if name.startswith("record")]
    unit = str(records[0].angle.attrs["units"])
    for record in records:
        drawn = record.isel(time=slice(None, None, max(1, record.sizes["time"] // MOST_POINTS_DRAWN)))
        panels[0].plot(drawn.time, drawn.angle, color="0.6", linewidth=0.5)
    for decay in decays:
        panels[0].axvspan(decay.start.item(), decay.stop.item(), color=BLUE, alpha=0.12, linewidth=0)
        panels[1].plot(decay.instant_time, decay.amplitude, **line(MODEL_LINES[0]))
        panels[2].plot(decay.frequency_line, decay.spectrum, color=ORANGE, linewidth=0.8)
    _label(panels, unit, records[0].angle.attrs["long_name"])
    letter(panels)
    return figure


def _label(panels: list[Axes], unit: str, name: str) -> None:
    panels[0].set(xlabel="time (s)", ylabel=f"{name} ({unit})")
    panels[1].set(xlabel="time (s)")
    logarithmic_amplitude(panels[1], unit)
    panels[2].set(xlabel="frequency (Hz)", ylabel=f"density ({unit}$^2$/Hz)", xscale="log", yscale="log")


COLOURS = (ORANGE, BLUE)
# Of one panel, inch: its label has room.
INPUT_HEIGHT = 1.6


def driven(tree: xr.DataTree, run: int = 0) -> Figure:
    """Inputs, record and motion of the answer, and the residuals of the models, over time.

    Parameters
    ----------
    tree : DataTree
        Result of `identify` of a driven record.
    run : int
        Which of several runs, from 0.
    """
    record, answer = tree[record_groups(tree)[run]].to_dataset(), tree["comparison"].attrs["answer"]
    inputs, time, unit = inputs_of(record), record.time.values, signal_units(tree)
    figure = new_figure(FULL_WIDTH, INPUT_HEIGHT * (len(inputs) + 2))
    panels = figure.subplots(len(inputs) + 2, 1, sharex=True, squeeze=False)[:, 0].tolist()
    for panel, (name, given) in zip(panels, inputs.items(), strict=False):
        curve(panel, time[0] + given.elapsed, given.values, {"color": "0.3", "linewidth": 0.6})
        units = str(record[name].attrs.get("units", ""))
        panel.set_ylabel(f"input {name}{f' ({unit_label(units)})' if units else ''}")
    motion, residual = panels[-2:]
    curve(motion, time, record.angle.values, RECORD_POINTS)
    for name, colour in zip(record.model.values.tolist(), COLOURS, strict=False):
        simulated = record.simulated_angle.sel(model=name).values
        if name == answer:
            curve(motion, time, simulated, {"color": colour, "linewidth": 0.8, "label": name})
        remainder = record.angle.values - simulated
        rms = float(np.sqrt(np.mean(remainder**2)))
        shown = drawn_samples(remainder)
        label = f"{name}, RMS {rms:.3g} {unit_label(unit)}"
        residual.plot(time[shown], remainder[shown], color=colour, linewidth=0.6, label=label)
    symbol = "angle" if unit == "rad" else "displacement"
    motion.set_ylabel(f"{symbol} ({unit_label(unit)})")
    residual.set(xlabel="time (s)", ylabel=f"record \N{MINUS SIGN}\nmodel ({unit_label(unit)})")
    for panel in (motion, residual):
        panel.legend(ncols=3, **LEGEND)
    residual.set_xlim(time[0], time[-1])
    letter(panels)
    return figure
