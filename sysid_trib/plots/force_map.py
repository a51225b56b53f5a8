"""Figures of a discovery: the mean force over angle and rate that a model lacks."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from sysid_trib.plots.discovery_data import DOT_BEYOND, held_out_sentence, missing_force
from sysid_trib.plots.style import FULL_WIDTH, LEGEND, TWO_COLUMNS, footnote, letter, new_figure
from sysid_trib.results.signal_units import signal_label, signal_symbol, signal_units, small_units

# Of a map beside another, inch.
MAP_HEIGHT = 3.5


def disagreement(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """The map of the missing force before and after, in the same colours.

    Dots mark cells beyond three standard errors.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    width : float, inch
        A narrow figure, as that of a column of 88 mm (3.46), has the maps below each other.
    """
    beside = width >= TWO_COLUMNS
    figure = new_figure(width, MAP_HEIGHT if beside else 2.0 * MAP_HEIGHT * width / TWO_COLUMNS)
    first, second = figure.subplots(*((1, 2) if beside else (2, 1)), sharex=True, sharey=True)
    _map(tree, first, after=False)
    mesh = _map(tree, second, after=True)
    letter((first, second), ("before", "after"))
    if beside:
        second.set_ylabel("")
    else:
        first.set_xlabel("")
        handles, labels = first.get_legend_handles_labels()
        for panel in (first, second):
            panel.get_legend().remove()
        figure.legend(handles, labels, loc="outside upper right", frameon=False, fontsize=LEGEND["fontsize"])
    units = signal_units(tree)
    x, unit = signal_symbol(units), small_units(units)[1]
    bar = figure.colorbar(mesh, ax=[first, second], extend="both", shrink=0.9)
    bar.set_label(f"missing $f$ ({unit}),\n" + rf"$\ddot{{{x}}} + \omega^2 {x} = -\omega^2 f$")
    footnote(figure, held_out_sentence(tree))
    return figure


def _map(tree: xr.DataTree, ax: Axes, after: bool) -> QuadMesh:
    force, error, limit = missing_force(tree, after=after)
    mesh = draw_cells(ax, force, error, limit)
    ax.legend(**LEGEND)
    units = signal_units(tree)
    x = signal_symbol(units)
    labels = f"{signal_label(units).split()[0]} ${x}$ ({units})", rf"$\dot{{{x}}}/\omega$ ({units})"
    ax.set(xlabel=labels[0], ylabel=labels[1], aspect="equal")
    return mesh


def draw_cells(ax: Axes, force: xr.DataArray, error: xr.DataArray, limit: float) -> QuadMesh:
    """A force over angle and rate as colours that end at `limit`, with dots where it is beyond the noise."""
    x, v, values = force.x.values, force.v.values, force.values
    look: dict[str, Any] = {"cmap": "RdBu_r", "norm": TwoSlopeNorm(0.0, -limit, limit), "rasterized": True}
    mesh = ax.pcolormesh(x, v, values.T, shading="nearest", **look)
    at_x, at_v = np.nonzero(np.abs(values) > DOT_BEYOND * error.values)
    label = f"beyond {DOT_BEYOND:g} standard errors"
    ax.plot(x[at_x], v[at_v], ".", color="black", markersize=2.5, label=label)
    return mesh
