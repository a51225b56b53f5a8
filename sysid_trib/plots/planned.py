"""The next run: what each release and duration would tell, and where in time the models part."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots.style import (
    FULL_WIDTH,
    INK,
    LEGEND,
    ORANGE,
    grid,
    in_latex,
    letter,
    logarithmic_ticks,
    threshold,
)

PLAN_HEIGHT = 2.4


def plan(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """What each run leaves against its release: entropy of the models, and errors; where two models part.

    A line stands for an error that is wanted. Where none is and there is one model: the largest of all
    errors over the least.

    Parameters
    ----------
    data : Dataset
        Of `validation.plan`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    drawn = {"entropy left (nat)": data.entropy} if "parting" in data else {}
    limits = {f"error of {in_latex(symbol)}": float(error) for symbol, error in data.attrs["wanted"].items()}
    errors = [data.standard_error.sel(force=symbol) for symbol in data.attrs["wanted"]]
    drawn |= dict(zip(limits, errors, strict=True))
    if not drawn:
        drawn["largest error / least"] = (data.standard_error / data.standard_error.min("run")).max("force")
    figure, panels = grid(len(drawn) + ("parting" in data), 2, width, PLAN_HEIGHT)
    for panel, (name, values) in zip(panels, drawn.items(), strict=False):
        _against_release(panel, data.assign(shown=values))
        panel.set_ylabel(name)
        if name in limits:
            threshold(panel, limits[name], f"wanted: {limits[name]:g}")
            panel.set_yscale("log")
            logarithmic_ticks(panel.yaxis, *panel.get_ylim())
    panels[0].legend(**LEGEND, ncols=3)
    titles = [""] * len(panels)
    if "parting" in data:
        panels[-1].plot(data.time, data.parting, color=INK, linewidth=1.0)
        panels[-1].set(xlabel="time (s)", ylabel="log likelihood ratio", ylim=(0.0, None))
        threshold(panels[-1], np.log(data.attrs["odds"]), f"odds of {data.attrs['odds']:g} to 1")
        titles[-1] = " or ".join(data.parting.attrs["models"])
    if len(panels) > 1:
        letter(panels, titles)
    return figure


def _against_release(ax: Axes, data: xr.Dataset) -> None:
    """What is shown of each run, a line for a duration, and a ring about the best run."""
    durations = np.unique(data.duration.values)
    for at, length in enumerate(durations):
        rows = data.isel(run=np.flatnonzero(data.duration.values == length)).sortby("amplitude")
        shade = str(0.75 * (1.0 - (at + 1) / len(durations)))
        ax.plot(rows.amplitude, rows.shown, color=shade, marker="o", markersize=3, label=f"{length:.3g} s")
    ring: dict[str, Any] = {
        "color": ORANGE,
        "marker": "o",
        "markersize": 7,
        "fillstyle": "none",
        "linestyle": "",
    }
    ax.plot(data.amplitude[0], data.shown[0], **ring, label="best")
    ax.set_xlabel(f"release ({data.amplitude.attrs['units']})")
