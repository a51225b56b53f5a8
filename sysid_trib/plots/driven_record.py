"""A driven record: its inputs, its motion with that of the answer, and what each model leaves."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sysid_trib.plots.motion_data import drawn_samples
from sysid_trib.plots.motion_panels import RECORD_POINTS, curve
from sysid_trib.plots.style import BLUE, FULL_WIDTH, LEGEND, ORANGE, letter, new_figure, unit_label
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.per_run import record_groups
from sysid_trib.results.signal_units import signal_units

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
