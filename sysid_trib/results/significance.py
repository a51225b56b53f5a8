"""Which coefficients of an identification differ from zero."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Mask

# A coefficient of fewer standard errors may be zero (99.7 % of a Gaussian).
SIGNIFICANT_ERRORS = 3.0


def significant(result: xr.Dataset) -> Mask:
    """Whether each coefficient differs from zero; one that is held is as large as it was given.

    Parameters
    ----------
    result : Dataset
        An identification.

    Returns
    -------
    (force,) array of bool
    """
    size, error = np.abs(result.coefficient.values), result.standard_error.values
    return np.asarray(result.active.values & (size > 0.0) & (size >= SIGNIFICANT_ERRORS * error), dtype=bool)


def determines(result: xr.Dataset) -> bool:
    """Whether the record decides anything of the forces: one coefficient at least differs from zero."""
    return bool(significant(result).any())
