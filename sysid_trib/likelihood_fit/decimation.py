"""Fewer samples of a record that has many a period: what it can show is in its local means."""

import numpy as np
import xarray as xr
from scipy.signal import savgol_filter

from sysid_trib.decays.equilibrium import with_half_periods
from sysid_trib.decays.uniform import is_uniform
from sysid_trib.likelihood_fit.settings import DEFAULTS


def decimated(decay: xr.Dataset, per_period: int = DEFAULTS.samples_per_period) -> xr.Dataset:
    """The decay with some `per_period` samples a period, each from a parabola through its neighbours.

    A parabola over a sixtieth of a period follows the swing to a part in a million (Savitzky and Golay 1964),
    and no sample enters two of them: noise stays white, and its level falls. attrs: `decimated`.
    """
    time, angle, halves = with_half_periods(decay)
    steps = np.diff(time)
    factor = int(2.0 * np.median(halves.duration) / np.median(steps) / per_period)
    if factor < 2:
        return decay
    width = factor if factor % 2 else factor - 1
    smoothed = width >= 3 and is_uniform(time)
    if smoothed:
        angle = savgol_filter(angle, width, 2)
    kept = slice(factor // 2, None, factor)
    # What holds for the whole decay, such as its equilibrium, stays.
    fewer = decay.drop_dims("time").assign_coords(time=("time", time[kept], decay.time.attrs))
    fewer = fewer.assign(angle=("time", angle[kept], decay.angle.attrs))
    how = "parabolas" if smoothed else "single samples"
    return fewer.assign_attrs(decimated=f"{len(time)} samples to {fewer.sizes['time']}, by {how}")
