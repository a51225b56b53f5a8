"""Quantities with errors: checked, propagated to first order, labelled."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid_trib.errors import UsageError

Array = NDArray[np.float64]
Variables = dict[str, tuple[tuple[str, ...], ArrayLike, dict[str, str]]]

# Of a standard error, and of the value itself: the step of a numerical derivative.
STEP = 1e-3
LEAST_STEP = 1e-7


def propagated(
    function: Callable[[Array], ArrayLike], values: Array, covariance: Array
) -> tuple[Array, Array]:
    """A function's values and standard errors, to first order, by central differences."""
    at = np.asarray(function(values), dtype=float)
    errors = np.sqrt(np.diag(covariance))
    moved = np.flatnonzero(errors > 0)
    slopes = np.zeros((*at.shape, len(values)))
    for i in moved:
        step = np.zeros(len(values))
        step[i] = max(STEP * errors[i], LEAST_STEP * abs(values[i]))
        above, below = (np.asarray(function(values + s * step), dtype=float) for s in (1.0, -1.0))
        slopes[..., i] = (above - below) / (2.0 * step[i])
    variance = np.einsum("...i,ij,...j->...", slopes, covariance, slopes)
    return at, np.sqrt(np.maximum(variance, 0.0))


def amplitudes(amplitude: ArrayLike) -> Array:
    """Amplitudes as a row; UsageError unless they are positive angles, a number or one row of them."""
    a = np.asarray(amplitude, dtype=float)
    if a.ndim > 1 or a.size == 0 or not np.all(np.isfinite(a) & (a > 0)):
        raise UsageError("Amplitudes must be positive angles in rad: a number or one row of numbers.")
    return np.atleast_1d(a)


def check_quantity(name: str, value: float, error: float, *, positive: bool = True) -> None:
    """Refuse a quantity that is not a finite positive number, or an error that is negative.

    Raises
    ------
    UsageError
        Either of them.
    """
    if not np.isfinite(value) or (positive and value <= 0):
        raise UsageError(f"The {name} must be a positive number, not {value}.")
    if not (np.isfinite(error) and error >= 0):
        raise UsageError(f"The standard error of the {name} must be a number >= 0, not {error}.")


def with_error(
    name: str, dims: tuple[str, ...], found: tuple[ArrayLike, ArrayLike], units: str, long_name: str
) -> Variables:
    """A labelled variable and its `..._standard_error`."""
    return {
        name: (dims, found[0], {"units": units, "long_name": long_name}),
        f"{name}_standard_error": (
            dims,
            found[1],
            {"units": units, "long_name": f"standard error of the {long_name}"},
        ),
    }
