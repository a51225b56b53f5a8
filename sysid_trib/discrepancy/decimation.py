"""Fewer samples of a record that has many a period: what it can show is in its local means."""

import numpy as np
import xarray as xr
from scipy.signal import savgol_filter

from sysid_trib.decays.half_sines import usable_half_periods

# Samples a period that are kept; a record is decimated from twice as many on.
KEPT = 60
# Largest unevenness of the time steps for which local means may be taken.
EVEN = 1e-3


def decimated(decay: xr.Dataset) -> xr.Dataset:
    """The decay with some sixty samples a period, each from a parabola through its neighbours.

    A parabola over a sixtieth of a period follows the swing to a part in a million (Savitzky and Golay 1964),
    and no sample enters two of them: noise stays white, and its level falls. attrs: `decimated`.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    halves = usable_half_periods(time, angle, str(decay.attrs.get("source", "decay")))
    steps = np.diff(time)
    each = int(2.0 * np.median(halves.duration) / np.median(steps) / KEPT)
    if each < 2:
        return decay
    width = each if each % 2 else each - 1
    uneven = np.ptp(steps) > EVEN * np.median(steps)
    if width >= 3 and not uneven:
        angle = savgol_filter(angle, width, 2)
    kept = slice(each // 2, None, each)
    # What is told of the whole decay, such as its equilibrium, stays.
    fewer = decay.drop_dims("time").assign_coords(time=("time", time[kept], decay.time.attrs))
    fewer = fewer.assign(angle=("time", angle[kept], decay.angle.attrs))
    told = "parabolas" if width >= 3 and not uneven else "single samples"
    return fewer.assign_attrs(decimated=f"{len(time)} samples to {fewer.sizes['time']}, by {told}")
