"""The forced response of a model: amplitude and phase against frequency, in both sweeps, with bands."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from sysid_trib.plots.style import (
    BLUE,
    FULL_WIDTH,
    GREY,
    INK,
    LEGEND,
    OPEN_MARKS,
    ORANGE,
    grid,
    letter,
    unit_label,
)

RESPONSE_HEIGHT = 2.8
SWEEP_LINES: dict[str, dict[str, Any]] = {
    "down": {"color": BLUE, "linestyle": "-"},
    "up": {"color": ORANGE, "linestyle": "--"},
    "unstable": {"color": GREY, "linestyle": ":"},
}
SIMULATED: dict[str, Any] = OPEN_MARKS | {"color": INK, "marker": "o", "linestyle": "", "zorder": 4}


def response(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """Amplitude with its 95 % band, and phase, against frequency; marks are motions that were simulated.

    Parameters
    ----------
    data : Dataset
        Of `forced_response`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    figure, panels = grid(2, 2, width, RESPONSE_HEIGHT)
    amplitude, phase = panels
    w, unit = data.frequency.values, data.amplitude.attrs["units"]
    for sweep, look in SWEEP_LINES.items():
        motions = data.sel(sweep=sweep)
        if not motions.amplitude.notnull().any():
            continue
        ends = motions.amplitude_low.values, motions.amplitude_high.values
        amplitude.fill_between(w, *ends, color=look["color"], alpha=0.2, linewidth=0)
        label = "unstable" if sweep == "unstable" else f"sweep {sweep}"
        amplitude.plot(w, motions.amplitude, linewidth=1.0, label=label, **look)
        phase.plot(w, np.unwrap(np.nan_to_num(motions.phase)) + 0.0 * motions.phase, linewidth=1.0, **look)
    amplitude.plot(data.check_frequency, data.simulated_amplitude, label="simulated", **SIMULATED)
    amplitude.set(xlabel="frequency (rad/s)", ylabel=f"amplitude ({unit_label(unit)})", ylim=(0.0, None))
    phase.set(xlabel="frequency (rad/s)", ylabel="phase (rad)")
    amplitude.legend(**LEGEND, ncols=2)
    letter(panels)
    return figure
