"""The next run: what each release and duration would tell, and where in time the models part."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sysid_trib.plots.style import FULL_WIDTH, INK, LEGEND, ORANGE, grid, letter

PLAN_HEIGHT = 2.4


def plan(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """Entropy of the models that each run leaves, or its errors, against the release; where the models part.

    Parameters
    ----------
    data : Dataset
        Of `validation.plan`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    several = "parting" in data
    figure, panels = grid(1 + several, 1 + several, width, PLAN_HEIGHT)
    unit = data.amplitude.attrs["units"]
    durations = np.unique(data.duration.values)
    for at, length in enumerate(durations):
        rows = data.isel(run=np.flatnonzero(data.duration.values == length)).sortby("amplitude")
        relative = (rows.standard_error / data.standard_error.min("run")).max("force")
        shade = str(0.75 * (1.0 - (at + 1) / len(durations)))
        values = rows.entropy if several else relative
        panels[0].plot(rows.amplitude, values, color=shade, marker="o", markersize=3, label=f"{length:.3g} s")
    panels[0].plot(
        data.amplitude[0],
        data.entropy[0] if several else (data.standard_error[0] / data.standard_error.min("run")).max(),
        color=ORANGE,
        marker="o",
        markersize=7,
        fillstyle="none",
        linestyle="",
        label="best",
    )
    panels[0].set(
        xlabel=f"release ({unit})", ylabel="entropy left (nat)" if several else "largest error / best"
    )
    panels[0].legend(**LEGEND, ncols=3)
    if several:
        panels[1].plot(data.time, data.parting, color=INK, linewidth=1.0)
        panels[1].axhline(np.log(data.attrs["odds"]), color=ORANGE, linewidth=0.8)
        panels[1].set(xlabel="time (s)", ylabel="log likelihood ratio", ylim=(0.0, None))
        letter(panels)
    return figure
