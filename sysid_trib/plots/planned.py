"""Figure for planning: which measurement would tell twins apart."""

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from sysid_trib.discrepancy.model_probabilities import APART
from sysid_trib.plots.style import LEGEND, SERIES, axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def distinction(found: xr.DataArray, ax: "Axes | None" = None) -> "Axes":
    """By how many standard errors an effect differs from its twins, over measurements that may be made.

    Parameters
    ----------
    found : (measurement, other), standard errors; what is varied has coordinates with `long_name` and
        `units`. An `other` that never differs, the effect itself, is not drawn.
    """
    ax = axes(ax)
    measurement, other = found.dims
    varied = found[measurement]
    twins = [symbol for symbol in found[other].values.tolist() if found.sel({other: symbol}).any()]
    for symbol, series in zip(twins, cycle(SERIES)):
        values = found.sel({other: symbol}).values
        ax.plot(varied.values, values, label=symbol, markersize=4, linewidth=1.0, **series)
    apart = float(np.sqrt(APART))
    ax.axhline(apart, color="black", linewidth=0.8, linestyle="--", zorder=0)
    end = varied.values[-1], apart
    ax.annotate("told apart above", end, (0, 3), textcoords="offset points", ha="right", fontsize=8)
    ax.set(xlabel=f"{varied.attrs['long_name']} ({varied.attrs['units']})", yscale="log")
    ax.set_ylabel("difference (standard errors)")
    ax.legend(ncols=4, **LEGEND)
    return ax
