"""Fewer samples of a record that has many a period: what it can show is in its local means."""

import numpy as np
import xarray as xr
from scipy.signal import savgol_filter

from sysid_trib.arrays import Array
from sysid_trib.decays.equilibrium import with_half_periods
from sysid_trib.decays.uniform import is_uniform
from sysid_trib.likelihood_fit.settings import DEFAULTS
from sysid_trib.noise.coarse_step import coarse_step
from sysid_trib.noise.level import sensor_noise

# Of a sensor of coarse steps at least so many samples a period are kept.
FEWEST_PER_PERIOD = 10


def decimated(decay: xr.Dataset, per_period: int = DEFAULTS.samples_per_period) -> xr.Dataset:
    """The decay with some `per_period` samples a period, each from a parabola through its neighbours.

    A parabola over a sixtieth of a period follows the swing to a part in a million (Savitzky and Golay 1964),
    and no sample enters two of them: noise stays white, and its level falls. The rounding of a sensor of
    coarse steps is white where the motion passes a step from one sample to the next: single samples that
    far apart. attrs: `decimated`.
    """
    time, angle, halves = with_half_periods(decay)
    period = 2.0 * np.median(halves.duration) / np.median(np.diff(time))
    apart = _apart_for_rounding(angle, coarse_step(decay, sensor_noise(decay)))
    factor = max(int(period / per_period), min(apart, int(period / FEWEST_PER_PERIOD)))
    if factor < 2:
        return decay
    width = factor if factor % 2 else factor - 1
    smoothed = not apart and width >= 3 and is_uniform(time)
    if smoothed:
        angle = savgol_filter(angle, width, 2)
    kept = slice(factor // 2, None, factor)
    # What holds for the whole decay, such as its equilibrium, stays.
    fewer = decay.drop_dims("time").assign_coords(time=("time", time[kept], decay.time.attrs))
    fewer = fewer.assign(angle=("time", angle[kept], decay.angle.attrs))
    how = "parabolas" if smoothed else "single samples"
    return fewer.assign_attrs(decimated=f"{len(time)} samples to {fewer.sizes['time']}, by {how}")


def _apart_for_rounding(angle: Array, step: float) -> int:
    """How many samples apart most values differ by a coarse step of the sensor; 0 of a fine one."""
    if not step:
        return 0
    apart = 1
    while apart < len(angle) // 2 and np.median(np.abs(angle[apart:] - angle[:-apart])) < step:
        apart += 1
    return apart
