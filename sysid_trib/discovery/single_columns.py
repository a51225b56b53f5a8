"""Single columns with a model: what each would gain, and what physics allows it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array, Mask
from sysid_trib.forces.force import Force
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.likelihood import RIDGE, Likelihood, likelihood, most_likely_variance
from sysid_trib.likelihood.run_products import RunProducts
from sysid_trib.likelihood.trials import TrialEffect


def is_physical(force: Force, coefficient: ArrayLike, relative_force: float, strongest: float) -> Mask:
    """True if a force may have these coefficients: one that only takes energy is not negative.

    `relative_force` : of the force of coefficient 1, over the restoring force; `strongest` one may be.
    """
    drives = np.logical_and(force.passive, np.less(coefficient, 0.0))
    weak = np.abs(coefficient) * relative_force < strongest
    return np.logical_and(~drives, np.logical_or(force.kind == "sensor", weak))


def are_physical(
    trials: Sequence[TrialEffect], coefficients: Array, relative_force: Array, strongest: float
) -> Mask:
    """True where a trial may have its coefficient, (trial,)."""
    forces = zip(trials, coefficients, relative_force, strict=True)
    return np.array([is_physical(trial.force, c, size, strongest) for trial, c, size in forces], dtype=bool)


def strengths(model: FittedModel, columns: Sequence[Array]) -> Array:
    """RMS of each trial's column over that of the restoring force, (trial,)."""
    squares = np.sum([np.sum(column**2, axis=0) for column in columns], axis=0)
    return np.sqrt(squares / np.sum([np.sum(rows.path.stiffness_column**2) for rows in model.rows]))


@dataclass(frozen=True)
class SingleColumns:
    """What single columns do with a model.

    Attributes
    ----------
    deviance : (column,) array of float
        Of the model with each of them.
    coefficients, errors : (column,) array of float
        Of each.
    effective_rows : (column,) array of float
        As many rows of white noise as tell the error of each.
    """

    deviance: Array
    coefficients: Array
    errors: Array
    effective_rows: Array


# Products of the target and the base with all columns, (1 + base, column), and the columns' squares.
BaseProducts: TypeAlias = tuple[Array, Array]


def each_column(
    runs: Sequence[RunProducts], base: Sequence[int], columns: Sequence[int], model: Likelihood
) -> SingleColumns:
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
    model without the column, and then each run's variances are the most likely ones with them; and again
    for those of the model with the best column, since what is strong leaves another noise. The deviance is a
    little too high.

    Where a random force is most of the noise of a column, few rows may tell how large it is, and so the error
    of a column without effect: as many as the variance of this error's logarithm is that of a chi-square
    (Satterthwaite 1946; Giesbrecht, Burns 1985).
    """
    single = _each_in_noise(runs, base, columns, model)
    if len(runs) == 1 or not len(columns):
        return single
    likeliest = columns[int(np.argmin(single.deviance))]
    again = _each_in_noise(runs, base, columns, likelihood(runs, [*base, likeliest]))
    better = again.deviance < single.deviance
    pairs = zip(vars(again).values(), vars(single).values(), strict=True)
    return SingleColumns(*(np.where(better, its, other) for its, other in pairs))


def _each_in_noise(
    runs: Sequence[RunProducts], base: Sequence[int], columns: Sequence[int], model: Likelihood
) -> SingleColumns:
    """Gains of several runs' coefficients in the noise of a model."""
    every = [0, *base, *columns]
    parts = [_for_each_ratio(run, every, 1 + len(base)) for run in runs]
    count = len(columns)
    of_each = [[_solved(products) for products in part] for part in parts]
    if len(runs) > 1:
        together = _solved(_in_noise_of(runs, model, every, 1 + len(base)))
    deviance, coefficient, error = np.zeros(count), np.empty(count), np.empty(count)
    informations, scatters = np.empty((2, len(runs), count))
    for r, (run, part) in enumerate(zip(runs, parts, strict=True)):
        deviances, variance = np.empty((2, len(run.ratios), count))
        for g, products in enumerate(part):
            b, beta, *_ = of_each[r][g] if len(runs) == 1 else together
            squares = _left_by(products, b, beta)
            variance[g] = most_likely_variance(run, squares, run.products[g, 0, 0])
            deviances[g] = run.degrees_of_freedom * np.log(variance[g]) + run.log_determinant[g]
        least, place = _least(run.ratios, deviances)
        deviance += least
        information, left = (np.array([solution[k] for solution in of_each[r]]) for k in (2, 3))
        of_target = run.products[:, 0, 0]
        without = np.log(most_likely_variance(run, left, of_target))[:, None] - np.log(information)
        informations[r], scatters[r] = _without_effect(run, without, model, r)
        if len(runs) == 1:
            coefficient = _at_place(np.array([solution[1] for solution in of_each[r]]), place)
            error = np.exp(0.5 * _at_place(np.log(variance / information), place))
    if len(runs) > 1:
        coefficient, error = together[1], 1.0 / np.sqrt(together[2])
    weights = informations / np.sum(informations, axis=0)
    return SingleColumns(deviance, coefficient, error, 2.0 / np.sum(weights**2 * scatters, axis=0))


def _without_effect(run: RunProducts, log_square: Array, model: Likelihood, at: int) -> tuple[Array, Array]:
    """Information on columns without effect, and the variance of its logarithm, (column,) each.

    `log_square` : of the squares of their errors, (ratio, column).
    """
    ratio, ratio_error = float(model.ratios[at]), float(model.ratio_errors[at])
    variance = 2.0 / run.degrees_of_freedom
    if ratio == 0.0:
        return np.exp(-log_square[0]), np.full(log_square.shape[1], variance)
    spline = CubicSpline(np.log(run.ratios[1:]), log_square[1:])
    of_ratio = (np.nan_to_num(ratio_error) * spline(np.log(ratio), 1)) ** 2
    return np.exp(-spline(np.log(ratio))), of_ratio + variance


def _for_each_ratio(run: RunProducts, columns: Sequence[int], count: int) -> list[BaseProducts]:
    """Products of a run's columns, of which the first, so many, are the target and the base."""
    at = np.asarray(columns, dtype=int)
    products, squares = run.products[:, at[:count, None], at], run.products[:, at, at]
    return list(zip(products, squares, strict=True))


def _solved(of_base: BaseProducts) -> tuple[Array, Array, Array, float]:
    """Coefficients of the base with each further column, (base, column), its own, and its information.

    And the squares that the base alone leaves.
    """
    products, squares = of_base
    count = len(products)
    size = np.sqrt(np.maximum(squares, 1e-300))
    scaled = products / np.outer(size[:count], size)
    base, cross = scaled[1:, 1:count], scaled[1:, count:]
    right = np.column_stack([scaled[1:, 0], cross])
    reduced = np.linalg.solve(base + RIDGE * np.eye(count - 1), right)
    of_target, of_columns = reduced[:, 0], reduced[:, 1:]
    outside = np.maximum(1.0 - np.einsum("ij,ij->j", cross, of_columns), RIDGE)
    beta = (scaled[0, count:] - cross.T @ of_target) / outside
    b = of_target[:, None] - of_columns * beta
    target, further = size[0], size[count:]
    left = target**2 * (1.0 - float(scaled[1:, 0] @ of_target))
    return b * target / size[1:count, None], beta * target / further, outside * further**2, left


def _left_by(of_base: BaseProducts, b: Array, beta: Array) -> Array:
    """Squares that the base and each further column leave of the target, (column,)."""
    products, of_columns = of_base
    count = len(products)
    target, further = products[0], products[1:, count:]
    squares = of_columns[0] - 2.0 * (target[1:count] @ b + beta * target[count:])
    inner = np.einsum("ij,ij->j", b, products[1:, 1:count] @ b)
    cross = 2.0 * beta * np.einsum("ij,ij->j", b, further)
    return np.asarray(squares + inner + cross + beta**2 * of_columns[count:])


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
    every = [*base, *columns]
    total, _ = _in_noise_of(runs, model, every, len(every))
    inside, others = slice(len(base)), slice(len(base), None)
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    scaled = total / np.outer(size, size)
    inner, cross = scaled[inside, inside], scaled[inside, others]
    rest = scaled[others, others] - cross.T @ np.linalg.pinv(inner, rcond=1e-13, hermitian=True) @ cross
    part = np.sqrt(np.maximum(np.diag(rest), 0.0))
    return part, rest * np.outer(size[others], size[others])


def _in_noise_of(
    runs: Sequence[RunProducts], model: Likelihood, columns: Sequence[int], count: int
) -> BaseProducts:
    """Products of the first columns, so many, with all, of all runs, in units of the noise of a model."""
    at = np.asarray(columns, dtype=int)
    products, squares = np.zeros((count, len(at))), np.zeros(len(at))
    for run, ratio, variance in zip(runs, model.ratios.tolist(), model.variances, strict=True):
        products += run.block(ratio, at[:count], at) / variance
        squares += run.squares(ratio, at) / variance
    return products, squares


def correlation_of(products: Array) -> Array:
    """Products over the lengths of their columns."""
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    return np.asarray(products / np.outer(size, size))


def _least(ratios: Array, deviances: Array) -> tuple[Array, Array]:
    """Least deviance of each column, by splines over the ratios, and its place among them, (column,) each."""
    logs = np.log(ratios[1:])
    # Distance of ratios between those tried, in their logarithm, at which single columns are judged.
    fine = np.linspace(logs[0], logs[-1], 1 + round((logs[-1] - logs[0]) / 0.1))
    between = CubicSpline(logs, deviances[1:])(fine)
    best = np.argmin(between, axis=0)
    least = between[best, np.arange(between.shape[1])]
    with_force = least < deviances[0]
    place = np.where(with_force, 1.0 + (fine[best] - logs[0]) / (logs[1] - logs[0]), 0.0)
    return np.minimum(least, deviances[0]), place


def _at_place(values: Array, place: Array) -> Array:
    """Values (ratio, column) between two ratios, (column,)."""
    lower = np.minimum(place.astype(int), len(values) - 2)
    part, column = place - lower, np.arange(values.shape[1])
    return np.asarray((1.0 - part) * values[lower, column] + part * values[lower + 1, column])
