"""Single columns beside a model: what each would gain, and what of it the model's columns cannot make."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.likelihood import (
    RIDGE,
    Likelihood,
    RunProducts,
    likelihood,
)

# Distance of ratios between those tried, in their logarithm, at which single columns are judged.
COARSE_STEP = 0.1


@dataclass(frozen=True)
class Beside:
    """What single columns do beside a model.

    Attributes
    ----------
    deviance : (column,) array of float
        Of the model with each of them.
    coefficients, errors : (column,) array of float
        Of each.
    """

    deviance: Array
    coefficients: Array
    errors: Array


def each_beside(
    runs: Sequence[RunProducts], base: Sequence[int], columns: Sequence[int], model: Likelihood
) -> Beside:
    """Maximum likelihood of a model with one column more, for each of many.

    Parameters
    ----------
    runs : sequence of RunProducts
    base : sequence of int
        Columns of the model.
    columns : sequence of int
        Each added alone.
    model : Likelihood
        Of the model of `base`.

    Notes
    -----
    Of one run this is `likelihood`. Of several runs the coefficients are solved for the variances of the
    model without the column, and then each run's variances are the most likely ones beside them; and again
    for those of the model with the best column, since what is strong leaves another noise. The deviance is a
    little too high.
    """
    beside = _each_in_noise(runs, base, columns, model)
    if len(runs) == 1 or not len(columns):
        return beside
    likeliest = columns[int(np.argmin(beside.deviance))]
    again = _each_in_noise(runs, base, columns, likelihood(runs, [*base, likeliest]))
    better = again.deviance < beside.deviance
    return Beside(
        np.where(better, again.deviance, beside.deviance),
        np.where(better, again.coefficients, beside.coefficients),
        np.where(better, again.errors, beside.errors),
    )


def _each_in_noise(
    runs: Sequence[RunProducts], base: Sequence[int], columns: Sequence[int], model: Likelihood
) -> Beside:
    """The same, coefficients of several runs in the noise of a model."""
    every = [0, *base, *columns]
    parts = [run.products[:, every][:, :, every] for run in runs]
    count, inside = len(columns), len(base)
    if len(runs) == 1:
        solved = [_solved(part, inside) for part in parts[0]]
    else:
        solved = [_solved(_in_noise_of(runs, model, every[1:]), inside)]
    deviance, coefficient, error = np.zeros(count), np.empty(count), np.empty(count)
    for run, part in zip(runs, parts, strict=True):
        deviances, variance = np.empty((2, len(run.ratios), count))
        for g, products in enumerate(part):
            b, beta, _ = solved[g if len(runs) == 1 else 0]
            with np.errstate(over="ignore", invalid="ignore"):
                squares = _left_by(products, b, beta, inside)
            variance[g] = (np.maximum(squares, 0.0) + run.level_rows * run.level**2) / run.degrees_of_freedom
            deviances[g] = run.degrees_of_freedom * np.log(variance[g]) + run.log_determinant[g]
        least, place = _least(run.ratios, deviances)
        deviance += least
        if len(runs) == 1:
            beta, information = (np.array([solution[k] for solution in solved]) for k in (1, 2))
            coefficient = _at_place(beta, place)
            error = np.exp(_at_place(0.5 * np.log(variance / information), place))
    if len(runs) > 1:
        coefficient, error = solved[0][1], 1.0 / np.sqrt(solved[0][2])
    return Beside(deviance, coefficient, error)


def _solved(products: Array, inside: int) -> tuple[Array, Array, Array]:
    """Coefficients of the base beside each further column, (base, column), its own, and its information."""
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    scaled = products / np.outer(size, size)
    base = scaled[1 : 1 + inside, 1 : 1 + inside]
    right = np.column_stack([scaled[1 : 1 + inside, 0], scaled[1 : 1 + inside, 1 + inside :]])
    reduced = np.linalg.solve(base + RIDGE * np.eye(inside), right)
    of_target, of_columns = reduced[:, 0], reduced[:, 1:]
    cross = scaled[1 : 1 + inside, 1 + inside :]
    outside = np.maximum(1.0 - np.einsum("ij,ij->j", cross, of_columns), RIDGE)
    beta = (scaled[1 + inside :, 0] - cross.T @ of_target) / outside
    b = of_target[:, None] - of_columns * beta
    target, further = size[0], size[1 + inside :]
    return b * target / size[1 : 1 + inside, None], beta * target / further, outside * further**2


def _left_by(products: Array, b: Array, beta: Array, inside: int) -> Array:
    """Squares that the base and each further column leave of the target, (column,)."""
    base, further = slice(1, 1 + inside), np.arange(1 + inside, len(products))
    squares = products[0, 0] - 2.0 * (products[0, base] @ b + beta * products[0, further])
    inner = np.einsum("ij,ij->j", b, products[base, base] @ b)
    cross = 2.0 * beta * np.einsum("ij,ij->j", b, products[base, 1 + inside :])
    return np.asarray(squares + inner + cross + beta**2 * products[further, further])


def projected(
    runs: Sequence[RunProducts], model: Likelihood, base: Sequence[int], columns: Sequence[int]
) -> tuple[Array, Array]:
    """What of columns is outside of others, in the noise of a model.

    Returns
    -------
    part : (column,) array of float
        Of the length of each.
    products : (column, column) array of float
        Of what is outside, in units of the noise.
    """
    # The target goes before them.
    total = _in_noise_of(runs, model, [*base, *columns])[1:, 1:]
    inside, others = slice(len(base)), slice(len(base), None)
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    scaled = total / np.outer(size, size)
    inner, cross = scaled[inside, inside], scaled[inside, others]
    rest = scaled[others, others] - cross.T @ np.linalg.pinv(inner, rcond=1e-13, hermitian=True) @ cross
    part = np.sqrt(np.maximum(np.diag(rest), 0.0))
    return part, rest * np.outer(size[others], size[others])


def _in_noise_of(runs: Sequence[RunProducts], model: Likelihood, columns: Sequence[int]) -> Array:
    """Products of the target and columns, of all runs, in units of the noise of a model."""
    total = np.zeros((1 + len(columns), 1 + len(columns)))
    for run, ratio, variance in zip(runs, model.ratios, model.variances, strict=True):
        total += run.at(float(ratio), np.asarray(columns, dtype=int)) / variance
    return total


def correlation_of(products: Array) -> Array:
    """Products over the lengths of their columns."""
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    return np.asarray(products / np.outer(size, size))


def _least(ratios: Array, deviances: Array) -> tuple[Array, Array]:
    """Least deviance of each column, by splines over the ratios, and its place among them, (column,) each.

    Infinite where it overflows, so that nothing is gained.
    """
    finite = np.isfinite(deviances).all(axis=0)
    deviances = np.where(finite, deviances, 0.0)
    logs = np.log(ratios[1:])
    fine = np.linspace(logs[0], logs[-1], 1 + round((logs[-1] - logs[0]) / COARSE_STEP))
    between = CubicSpline(logs, deviances[1:])(fine)
    best = np.argmin(between, axis=0)
    least = between[best, np.arange(between.shape[1])]
    with_force = least < deviances[0]
    place = np.where(with_force, 1.0 + (fine[best] - logs[0]) / (logs[1] - logs[0]), 0.0)
    return np.where(finite, np.minimum(least, deviances[0]), np.inf), place


def _at_place(values: Array, place: Array) -> Array:
    """Values (ratio, column) between two ratios, (column,)."""
    lower = np.minimum(place.astype(int), len(values) - 2)
    part, column = place - lower, np.arange(values.shape[1])
    return np.asarray((1.0 - part) * values[lower, column] + part * values[lower + 1, column])
