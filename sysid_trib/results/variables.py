"""Variables of a result: values with their dimensions, unit and long name, as xarray takes them."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

Variable: TypeAlias = tuple[tuple[str, ...], Any, dict[str, str]]
Variables: TypeAlias = dict[str, Variable]

# A coefficient's unit differs from force to force.
PER_FORCE_UNIT = "see the coordinate unit"


def variable(dims: str | tuple[str, ...], values: ArrayLike, long_name: str, units: str = "") -> Variable:
    """A variable with its attributes.

    Parameters
    ----------
    dims : str or tuple of str
        Names of the dimensions; `()` of a scalar.
    values : array_like
        The values.
    long_name : str
        What they are.
    units : str
        Their unit, "1" of a pure number; none of texts and of true or false.
    """
    attrs = {"units": units, "long_name": long_name} if units else {"long_name": long_name}
    return ((dims,) if isinstance(dims, str) else dims), values, attrs


def text_variable(dims: str | tuple[str, ...], values: ArrayLike, long_name: str) -> Variable:
    """A variable of texts; an array of them has the width of its longest."""
    return variable(dims, np.asarray(values, dtype=str), long_name)


def with_error(
    name: str,
    dims: str | tuple[str, ...],
    values_and_errors: tuple[ArrayLike, ArrayLike],
    long_name: str,
    units: str = "1",
) -> Variables:
    """A variable and its `..._standard_error`, of the same dimensions and unit."""
    values, errors = values_and_errors
    return {
        name: variable(dims, values, long_name, units),
        f"{name}_standard_error": variable(dims, errors, f"standard error of the {long_name}", units),
    }


def chi_square_test(
    dims: str | tuple[str, ...],
    chi_square: ArrayLike,
    degrees_of_freedom: ArrayLike,
    long_name: str,
    p_value: ArrayLike | None = None,
) -> Variables:
    """A chi-square with its degrees of freedom and p-value, computed unless it is given."""
    if p_value is None:
        p_value = chi2.sf(chi_square, degrees_of_freedom)
    return {
        "chi_square": variable(dims, chi_square, long_name, "1"),
        "degrees_of_freedom": variable(dims, degrees_of_freedom, "degrees of freedom", "1"),
        "p_value": variable(dims, p_value, f"p-value of the {long_name}", "1"),
    }
