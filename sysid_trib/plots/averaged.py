"""Figure of signatures: how forces act on envelope and frequency over amplitude."""

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING

import xarray as xr

from sysid_trib.plots.style import SERIES, line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LABELS = {
    "sine": r"$\langle h\,\sin\varphi\rangle$ (rad)",
    "cosine": r"$\langle h\,\cos\varphi\rangle$ (rad)",
}


def signatures(found: Mapping[str, xr.Dataset]) -> "Figure":
    """Both averages of forces against amplitude: the first drives the envelope, the second the frequency.

    Parameters
    ----------
    found : by label, `signature` over a row of amplitudes.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 3.0), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True)
    for panel, (quantity, told), letter in zip(panels, LABELS.items(), "ab", strict=True):
        panel.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
        for (label, one), series in zip(found.items(), cycle(SERIES)):
            panel.plot(one.amplitude.values, one[quantity].values, label=label, **line(series))
        panel.set(xlabel="amplitude $a$ (rad)", ylabel=told)
        panel.set_title(f"({letter})", loc="left", fontsize=9)
    panels[0].set_xlim(0.0, None)
    lines, labels = panels[0].get_legend_handles_labels()
    figure.legend(lines, labels, ncols=4, loc="outside upper right", frameon=False, fontsize=8)
    return figure
