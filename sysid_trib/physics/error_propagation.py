"""Quantities with standard errors: checked, and propagated to first order."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError

# Of a standard error, and of the value itself: the step of a numerical derivative.
STEP_OF_ERROR = 1e-3
STEP_OF_VALUE = 1e-7


def propagate(
    function: Callable[[Array], ArrayLike], values: Array, covariance: Array
) -> tuple[Array, Array]:
    """A function's values and standard errors, to first order, by central differences.

    Parameters
    ----------
    function : callable
        Takes the values, gives an array of any shape.
    values : (value,) array of float
        Where it is evaluated.
    covariance : (value, value) array of float
        Covariance of the values.

    Returns
    -------
    tuple of array
        What the function gives, and its standard error.
    """
    result = np.asarray(function(values), dtype=float)
    errors = np.sqrt(np.diag(covariance))
    slopes = np.zeros((*result.shape, len(values)))
    for i in np.flatnonzero(errors > 0):
        step = np.zeros(len(values))
        step[i] = max(STEP_OF_ERROR * errors[i], STEP_OF_VALUE * abs(values[i]))
        above, below = (np.asarray(function(values + s * step), dtype=float) for s in (1.0, -1.0))
        slopes[..., i] = (above - below) / (2.0 * step[i])
    variance = np.einsum("...i,ij,...j->...", slopes, covariance, slopes)
    return result, np.sqrt(np.maximum(variance, 0.0))


def propagate_measured(
    function: Callable[[Array], ArrayLike], *measured: tuple[str, float, float]
) -> tuple[Array, Array]:
    """A function of quantities that were measured apart from each other, with its standard error.

    Parameters
    ----------
    function : callable
        Takes their values as one array.
    *measured : tuple of (str, float, float)
        Name, value and standard error of each quantity.

    Raises
    ------
    UsageError
        A quantity that is not positive, or a negative error.
    """
    for quantity in measured:
        check_quantity(*quantity)
    _, values, errors = zip(*measured, strict=True)
    return propagate(function, np.array(values), np.diag(np.square(errors)))


def amplitude_row(amplitude: ArrayLike) -> Array:
    """Amplitudes as a row; UsageError unless they are positive angles, a number or one row of them."""
    a = np.asarray(amplitude, dtype=float)
    if a.ndim > 1 or a.size == 0 or not np.all(np.isfinite(a) & (a > 0)):
        raise UsageError("Amplitudes must be positive angles in rad: a number or one row of numbers.")
    return np.atleast_1d(a)


def check_quantity(name: str, value: float, error: float = 0.0) -> None:
    """Refuse a quantity that is not a finite positive number, or a standard error that is negative.

    Raises
    ------
    UsageError
        Either of them.
    """
    if not (np.isfinite(value) and value > 0):
        raise UsageError(f"The {name} must be a positive number, not {value}.")
    if not (np.isfinite(error) and error >= 0):
        raise UsageError(f"The standard error of the {name} must be a number >= 0, not {error}.")
