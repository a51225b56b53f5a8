"""Figure of signatures: how forces act on envelope and frequency over amplitude."""

from collections.abc import Mapping
from itertools import cycle

import xarray as xr
from matplotlib.figure import Figure

from sysid_trib.plots.style import SERIES, letter, line, new_figure

SIGNATURE_LABELS = {
    "sine": r"$\langle h\,\sin\varphi\rangle$ (rad)",
    "cosine": r"$\langle h\,\cos\varphi\rangle$ (rad)",
}


def signatures(averages: Mapping[str, xr.Dataset]) -> Figure:
    """Both averages of forces against amplitude: the first drives the envelope, the second the frequency.

    Parameters
    ----------
    averages : mapping of str to xr.Dataset
        By label, `signature` over a row of amplitudes.
    """
    figure = new_figure(7.2, 3.0)
    panels = figure.subplots(1, 2, sharex=True)
    for panel, (quantity, axis_label) in zip(panels, SIGNATURE_LABELS.items(), strict=True):
        panel.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
        for (label, force), series in zip(averages.items(), cycle(SERIES)):
            panel.plot(force.amplitude.values, force[quantity].values, label=label, **line(series))
        panel.set(xlabel="amplitude $a$ (rad)", ylabel=axis_label)
    letter(panels)
    panels[0].set_xlim(0.0, None)
    lines, labels = panels[0].get_legend_handles_labels()
    figure.legend(lines, labels, ncols=4, loc="outside upper right", frameon=False, fontsize=8)
    return figure
