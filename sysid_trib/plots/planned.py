"""Figure for planning: which measurement would separate competing effects."""

from itertools import cycle

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from sysid_trib.likelihood_fit.settings import DEFAULTS
from sysid_trib.plots.style import LEGEND, SERIES, THRESHOLD, axes


def distinction(differences: xr.DataArray, ax: Axes | None = None) -> Axes:
    """By how many standard errors an effect differs from competing ones, over measurements to choose from.

    Parameters
    ----------
    differences : xr.DataArray, (measurement, other)
        Standard errors. What is varied is a coordinate with `long_name` and `units`. An `other` that never
        differs, the effect itself, is not drawn.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    """
    ax = axes(ax)
    measurement, other = differences.dims
    varied = differences[measurement]
    competing = {s: differences.sel({other: s}).values for s in differences[other].values.tolist()}
    drawn = [(symbol, values) for symbol, values in competing.items() if values.any()]
    for (symbol, values), series in zip(drawn, cycle(SERIES)):
        ax.plot(varied.values, values, label=symbol, markersize=4, linewidth=1.0, **series)
    separable = float(np.sqrt(DEFAULTS.outside_of_set))
    ax.axhline(separable, zorder=0, **THRESHOLD)
    end = varied.values[-1], separable
    ax.annotate("separable above", end, (0, 3), textcoords="offset points", ha="right", fontsize=8)
    ax.set(xlabel=f"{varied.attrs['long_name']} ({varied.attrs['units']})", yscale="log")
    ax.set_ylabel("difference (standard errors)")
    ax.legend(ncols=4, **LEGEND)
    return ax
