"""Variables of a result: values with their dimensions, unit and long name, as xarray takes them."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

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
