"""Common array functions: RMS, variables of a Dataset, derivatives, and linearly dependent columns."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Index: TypeAlias = NDArray[np.intp]
Variable: TypeAlias = tuple[tuple[str, ...], Any, dict[str, str]]
Variables: TypeAlias = dict[str, Variable]

# Just above the rounding errors of signatures: forces that agree to a millionth do not count as dependent.
DEPENDENCE = 1e-11
# Smallest weight of columns of unit length; smaller weights are rounding errors.
SMALLEST_PART = 1e-8


def root_mean_square(values: ArrayLike) -> float:
    """Return the RMS of numbers."""
    return float(np.sqrt(np.mean(np.square(values))))


def variable(dims: str | tuple[str, ...], values: ArrayLike, long_name: str, units: str = "") -> Variable:
    """Return a variable with its attributes.

    Parameters
    ----------
    dims : str or tuple of str
        Names of the dimensions; `()` for a scalar.
    values : array_like
        The values.
    long_name : str
        Meaning of the variable.
    units : str
        Unit of the values, "1" for a dimensionless number; empty for texts and booleans.
    """
    attrs = {"units": units, "long_name": long_name} if units else {"long_name": long_name}
    return ((dims,) if isinstance(dims, str) else dims), values, attrs


def with_error(
    name: str,
    dims: str | tuple[str, ...],
    values_and_errors: tuple[ArrayLike, ArrayLike],
    long_name: str,
    units: str = "1",
) -> Variables:
    """Return a variable and its `..._standard_error`, of the same dimensions and unit."""
    values, errors = values_and_errors
    return {
        name: variable(dims, values, long_name, units),
        f"{name}_standard_error": variable(dims, errors, f"standard error of the {long_name}", units),
    }


def jacobian(function: Callable[[Array], ArrayLike], at: Array, errors: Array) -> Array:
    """Return the derivatives of values by parameters with these errors, by central differences.

    Parameters
    ----------
    function : callable
        Function of the parameters; its result is an array of any shape.
    at, errors : (parameter,) array of float
        Point of differentiation, and standard errors; a step is a thousandth of the error.

    Returns
    -------
    (..., parameter) array of float
    """
    steps = np.clip(1e-3 * errors + 1e-300, 1e-7 * np.abs(at), None)
    slopes = []
    for step, unit in zip(steps, np.eye(len(at)), strict=True):
        above, below = (np.asarray(function(at + side * step * unit), dtype=float) for side in (1.0, -1.0))
        slopes.append((above - below) / (2.0 * step))
    return np.stack(slopes, axis=-1)


def dependent_columns(table: Array) -> list[tuple[int, ...]]:
    """Return the minimal groups of linearly dependent columns of a matrix.

    Parameters
    ----------
    table : (row, column) array of float
        Finite matrix. Columns of zeros are in no group.

    Returns
    -------
    list of tuple of int
        Proportional columns first, in complete groups; then, for each further column that is a combination of
        previous columns, a group of this column and the fewest previous columns that it is a combination of.
    """
    # The triangular factor has the same lengths and residuals, but few rows.
    table = np.asarray(np.linalg.qr(np.asarray(table, dtype=float), mode="r"), dtype=float)
    norms = np.linalg.norm(table, axis=0)
    floor = 1e-14 * norms.max(initial=0.0)
    unit = {i: table[:, i] / norm for i, norm in enumerate(norms) if norm > floor}
    groups: list[list[int]] = []
    for i, column in unit.items():
        like = next((g for g in groups if _fitted(column, [unit[g[0]]])[1] < DEPENDENCE), None)
        if like is None:
            groups.append([i])
        else:
            like.append(i)
    basis: list[int] = []
    combined = []
    for i in (group[0] for group in groups):
        weights, residual = _fitted(unit[i], [unit[j] for j in basis])
        if residual < DEPENDENCE:
            # The combination of independent columns is unique.
            combined.append(tuple(sorted((*np.array(basis)[np.abs(weights) > SMALLEST_PART].tolist(), i))))
        else:
            basis.append(i)
    return [tuple(group) for group in groups if len(group) > 1] + combined


def _fitted(column: Array, others: list[Array]) -> tuple[Array, float]:
    """Return the weights of other columns in a column of unit length, and the norm of the residual."""
    if not others:
        return np.zeros(0), 1.0
    matrix = np.column_stack(others)
    weights = np.asarray(np.linalg.lstsq(matrix, column, rcond=None)[0], dtype=float)
    return weights, float(np.linalg.norm(column - matrix @ weights))
