"""The sensor's noise as a result holds it: its level, and its colour where it has one."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.noise.noise_model import NoiseModel
from sysid_trib.results.per_run import noise_of_run
from sysid_trib.results.variables import Variables, variable

FILTER = "noise_filter"


def colour_variables(filters: Sequence[Array]) -> Variables:
    """What whitens the sensor's noise in each run, as variables of a result; none where all is white.

    Parameters
    ----------
    filters : (run,) sequence of (tap,) arrays of float
        Autoregressions; the first coefficient of each is 1.
    """
    taps = max(len(filter_) for filter_ in filters)
    if taps == 1:
        return {}
    table = np.stack([np.pad(filter_, (0, taps - len(filter_))) for filter_ in filters])
    text = "autoregression that whitens the sensor's noise"
    if len(filters) == 1:
        return {FILTER: variable("tap", table[0], text, "1")}
    return {FILTER: variable(("run", "tap"), table, text, "1")}


def sensor_noise_of(result: xr.Dataset, run: int = 0) -> NoiseModel:
    """The sensor's noise in one run of an identification; white where it says nothing of a colour."""
    level = noise_of_run(result, run)
    if FILTER not in result:
        return NoiseModel(level, np.ones(1))
    table = result[FILTER]
    filter_ = np.trim_zeros(table.values[run] if "run" in table.dims else table.values, "b")
    return NoiseModel(level / NoiseModel(1.0, filter_).standard_deviation, filter_)
