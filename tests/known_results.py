"""Identifications with known coefficients, covariance and frequency, as a method would have returned them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from sysid_trib import load_library
from sysid_trib.forces import ForceLibrary
from sysid_trib.results.schema import Estimate, identification

# Le Bot et al. 2019, Sec. 3.
PAPER = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
W = 9.91


@dataclass(frozen=True)
class Known:
    """Stands for a method."""


def known(
    coefficients: Mapping[str, float],
    covariance: ArrayLike | None = None,
    *,
    w: float = W,
    library: ForceLibrary | None = None,
) -> xr.Dataset:
    """An identification; `covariance` is that of the coefficients and w, zero if left out."""
    offered = library or load_library()
    count = len(coefficients)
    values = np.zeros((count + 1, count + 1)) if covariance is None else np.asarray(covariance)
    estimate = Estimate(np.array(list(coefficients.values())), values, w, [1e-4])
    decay = xr.Dataset({"angle": ("time", [0.3, 0.2, 0.1, 0.0])}, {"time": [0.0, 0.01, 0.02, 0.03]})
    return identification(Known(), decay, offered.select(coefficients), estimate, offered=offered)


def correlated(values: NDArray[np.float64], part: float, seed: int = 7) -> NDArray[np.float64]:
    """A full covariance with standard errors of about this fraction of the values."""
    count = len(values)
    mixing = np.eye(count) + 0.5 * np.random.default_rng(seed).standard_normal((count, count)) / np.sqrt(
        count
    )
    scaled = part * np.abs(values)[:, None] * mixing
    return np.asarray(scaled @ scaled.T)
