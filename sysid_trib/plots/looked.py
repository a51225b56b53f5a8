"""What a record holds: the record with its decays, their amplitudes, and the spectrum."""

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots.style import BLUE, MODEL_LINES, ORANGE, grid, letter, line, logarithmic_amplitude

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
