"""Reference and asymptotic frequency of an identification, and their covariance with its coefficients."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.results.models import library_of


def asymptotic_frequency(library: ForceLibrary, coefficients: Array, reference: float) -> tuple[float, Array]:
    """Return w sqrt(1 + alpha - zeta^2), the frequency at rest, and its gradient by (coefficients, w)."""
    value = dict(zip(library.symbols, coefficients, strict=True))
    gradient = np.zeros(len(library) + 1)
    squared = 1.0
    # Alpha enters linearly, the damping ratio quadratically.
    if (elastic := library.role("x")) is not None:
        squared += value[elastic.symbol]
        gradient[library.symbols.index(elastic.symbol)] = 1.0
    for symbol, factor in library.damping_factors.items():
        squared -= (factor * value[symbol]) ** 2
        gradient[library.symbols.index(symbol)] = -2.0 * factor**2 * value[symbol]
    squared = max(squared, 0.0)
    root = np.sqrt(squared)
    gradient *= reference / (2.0 * root) if root > 0 else np.nan
    gradient[-1] = root
    return float(reference * root), gradient


def covariance_with_frequency(result: xr.Dataset) -> Array:
    """Return the covariance of coefficients and, last, reference frequency: (force + 1, force + 1)."""
    count = result.sizes["force"]
    w = result.reference_frequency.item()
    covariance = result.covariance.values
    error = result.reference_frequency_standard_error.item()
    whole = np.zeros((count + 1, count + 1))
    whole[:count, :count] = covariance
    if error > 0.0:
        inside = np.isclose(result.refers_to.values, w, rtol=1e-12)
        acting = library_of(result).select(result.force.values[inside].tolist())
        limit, gradient = asymptotic_frequency(acting, result.coefficient.values[inside], w)
        with_w = result.frequency_covariance.values
        if limit > 0.0:
            # A result states the covariance with the asymptotic frequency; that with w follows from it.
            with_w = (with_w - covariance[:, inside] @ gradient[:-1]) / gradient[-1]
        whole[:count, count] = whole[count, :count] = with_w
        whole[count, count] = error**2
    return whole
