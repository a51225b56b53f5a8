"""A record as it looks from afar: between which values it is, part by part."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array

EDGES = ("lowest", "highest")
# Of a record's time: enough to see how it decays, whether it stops, and what does not belong to it.
OUTLINE_PARTS = 60


def outline_of(decay: xr.Dataset) -> Array:
    """Lowest and highest value in each part of a decay's time: (edge, part), in its unit.

    A part without a sample is nan.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    edges = np.full((len(EDGES), OUTLINE_PARTS), np.nan)
    firsts = np.searchsorted(time, np.linspace(time[0], time[-1], OUTLINE_PARTS + 1)[:-1])
    holds = np.diff(np.append(firsts, len(time))) > 0
    for at, of_all in enumerate((np.minimum, np.maximum)):
        edges[at, holds] = of_all.reduceat(angle, firsts[holds])
    return edges
