"""Single columns with a model: their independent parts, gains, and resolution.

A column is resolved if it is the same along another equally likely motion: a random force hides the motion.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array, Mask
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.likelihood import RIDGE, Likelihood, likelihood, most_likely_variance
from sysid_trib.discovery.engine.run_products import RunProducts, has_products
from sysid_trib.discovery.engine.trials import TrialEffect
from sysid_trib.forces.force import Force


def is_physical(force: Force, coefficient: ArrayLike, relative_force: float, strongest: float) -> Mask:
    """Return true if a force may have these coefficients: a dissipative force has no negative coefficient.

    `relative_force` : RMS force of coefficient 1 over that of the restoring force; `strongest` : its upper
    limit.
    """
    drives = np.logical_and(force.passive, np.less(coefficient, 0.0))
    weak = np.abs(coefficient) * relative_force < strongest
    return np.logical_and(~drives, np.logical_or(force.kind == "sensor", weak))


def are_physical(
    model: FittedModel, trials: Sequence[TrialEffect], coefficients: Array, columns: Sequence[Array]
) -> Mask:
    """Return true if a trial may have its coefficient given a model, (trial,); by each run's column."""
    forces = zip(trials, coefficients, strengths(model, columns), strict=True)
    most = model.settings.strongest
    return np.array([is_physical(trial.force, c, size, most) for trial, c, size in forces], dtype=bool)


def strengths(model: FittedModel, columns: Sequence[Array]) -> Array:
    """Return the RMS of each trial's column over that of the restoring force, (trial,)."""
    squares = np.sum([np.sum(column**2, axis=0) for column in columns], axis=0)
    return np.sqrt(squares / np.sum([np.sum(rows.path.stiffness_column**2) for rows in model.rows]))


def where_finite(columns: Sequence[Array]) -> tuple[Mask, list[Array]]:
    """Return the mask of columns that are finite in every run, and the columns with zeros elsewhere."""
    good = np.all([has_products(column) for column in columns], axis=0)
    return good, [np.where(good, column, 0.0) for column in columns]


def products_with(model: FittedModel, *further: Sequence[Array]) -> list[RunProducts]:
    """Return the products of each run's target, the model's columns, and further ones of each run."""
    tables = zip(model.rows, model.tables, *further, strict=True)
    return [rows.products(np.column_stack(parts)) for rows, *parts in tables]


def each_column(
    runs: Sequence[RunProducts], base: Sequence[int], columns: Sequence[int], model: Likelihood
) -> Array:
    """Return the maximum likelihood of a model with one more column, for each of many columns.

    Parameters
    ----------
    runs : sequence of RunProducts
    base : sequence of int
        Columns of the model.
    columns : sequence of int
        Columns to be added one at a time.
    model : Likelihood
        Likelihood of the model of `base`.

    Returns
    -------
    (4, column) array of float
        The deviance with each column, its coefficient, the coefficient's error, and the number of rows of
        white noise that would determine this error as well.

    Notes
    -----
    For one run this is `likelihood`. For several runs the coefficients are solved at the variances of the
    model without the column, then the variances of each run are maximised. This is repeated with the
    variances of the model with the best column, because a strong column changes the noise. The deviance is a
    little too high.

    If most of the noise of a column is a random force, only few rows may determine the size of this force,
    and thus the error of a column without effect. Their number is that of a chi-square whose logarithm has
    the same variance as this error's (Satterthwaite 1946; Giesbrecht, Burns 1985).
    """
    single = _each_in_noise(runs, base, columns, model)
    if len(runs) == 1 or not len(columns):
        return single
    likeliest = columns[int(np.argmin(single[0]))]
    again = _each_in_noise(runs, base, columns, likelihood(runs, [*base, likeliest]))
    return np.where(again[0] < single[0], again, single)


def _each_in_noise(
    runs: Sequence[RunProducts], base: Sequence[int], columns: Sequence[int], model: Likelihood
) -> Array:
    """Return the results of `each_column`, with common coefficients of the runs, in the noise of a model."""
    every, first = np.array([0, *base, *columns], dtype=int), np.arange(1 + len(base))
    together = _solved(*_in_noise_of(runs, model, every, len(first))) if len(runs) > 1 else None
    deviance, coefficient, error = np.zeros((3, len(columns)))
    informations, scatters = np.empty((2, len(runs), len(columns)))
    for r, run in enumerate(runs):
        parts = zip(run.products[:, every[first, None], every], run.products[:, every, every], strict=True)
        of_ratios = [(part, _solved(*part)) for part in parts]
        of_target = run.products[:, 0, 0]
        squares = np.array([_left_by(*part, *(together or solved)[:2]) for part, solved in of_ratios])
        variance = most_likely_variance(run, squares, of_target[:, None])
        deviances = run.degrees_of_freedom * np.log(variance) + run.log_determinant[:, None]
        least, place = _least(run.ratios, deviances)
        deviance += least
        beta, information, left = (np.array([solved[k] for _, solved in of_ratios]) for k in (1, 2, 3))
        without = np.log(most_likely_variance(run, left, of_target))[:, None] - np.log(information)
        informations[r], scatters[r] = _without_effect(run, without, model, r)
        coefficient = _at_place(beta, place)
        error = np.exp(0.5 * _at_place(np.log(variance / information), place))
    if together is not None:
        coefficient, error = together[1], 1.0 / np.sqrt(together[2])
    weights = informations / np.sum(informations, axis=0)
    return np.array([deviance, coefficient, error, 2.0 / np.sum(weights**2 * scatters, axis=0)])


def _without_effect(run: RunProducts, log_square: Array, model: Likelihood, at: int) -> tuple[Array, Array]:
    """Return the information on columns without effect, and the variance of its logarithm, (column,) each.

    `log_square` : logarithm of the squared errors of the columns, (ratio, column).
    """
    ratio, ratio_error = float(model.ratios[at]), float(model.ratio_errors[at])
    variance = 2.0 / run.degrees_of_freedom
    if ratio == 0.0:
        return np.exp(-log_square[0]), np.full(log_square.shape[1], variance)
    spline = CubicSpline(np.log(run.ratios[1:]), log_square[1:])
    of_ratio = (np.nan_to_num(ratio_error) * spline(np.log(ratio), 1)) ** 2
    return np.exp(-spline(np.log(ratio))), of_ratio + variance


def _solved(products: Array, squares: Array) -> tuple[Array, Array, Array, float]:
    """Return coefficients of the base with each further column, (base, column), its own, and its information.

    Also return the residual squares of the base alone. `products` : products of the target and the base with
    all columns, (1 + base, 1 + base + column); `squares` : squares of all columns.
    """
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


def _left_by(products: Array, of_columns: Array, b: Array, beta: Array) -> Array:
    """Return the residual squares of the target on the base and each further column, (column,)."""
    count = len(products)
    target, further = products[0], products[1:, count:]
    squares = of_columns[0] - 2.0 * (target[1:count] @ b + beta * target[count:])
    inner = np.einsum("ij,ij->j", b, products[1:, 1:count] @ b)
    cross = 2.0 * beta * np.einsum("ij,ij->j", b, further)
    return np.asarray(squares + inner + cross + beta**2 * of_columns[count:])


def projected(
    runs: Sequence[RunProducts], model: Likelihood, base: Sequence[int], columns: Sequence[int]
) -> tuple[Array, Array]:
    """Return the parts of columns outside the span of other columns, in the noise of a model.

    Returns
    -------
    part : (column,) array of float
        Length of the outside part of each column, as a fraction of its whole length.
    products : (column, column) array of float
        Products of the outside parts, in units of the noise.
    """
    every = np.array([*base, *columns], dtype=int)
    total, _ = _in_noise_of(runs, model, every, len(every))
    inside, others = slice(len(base)), slice(len(base), None)
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    scaled = total / np.outer(size, size)
    inner, cross = scaled[inside, inside], scaled[inside, others]
    rest = scaled[others, others] - cross.T @ np.linalg.pinv(inner, rcond=1e-13, hermitian=True) @ cross
    part = np.sqrt(np.maximum(np.diag(rest), 0.0))
    return part, rest * np.outer(size[others], size[others])


def _in_noise_of(
    runs: Sequence[RunProducts], model: Likelihood, at: Array, count: int
) -> tuple[Array, Array]:
    """Return products of the first `count` columns with all, and squares, of all runs in a model's noise."""
    products, squares = np.zeros((count, len(at))), np.zeros(len(at))
    for run, ratio, variance in zip(runs, model.ratios.tolist(), model.variances, strict=True):
        products += run.block(ratio, at[:count], at) / variance
        squares += run.squares(ratio, at) / variance
    return products, squares


def correlation_of(products: Array) -> Array:
    """Return products divided by the lengths of their columns; 0 for a column of zero length."""
    size = np.sqrt(np.maximum(np.diag(products), 0.0))
    lengths = np.outer(size, size)
    return np.divide(products, lengths, out=np.zeros_like(products), where=lengths > 0.0)


def _least(ratios: Array, deviances: Array) -> tuple[Array, Array]:
    """Return the smallest deviance of each column, by splines over the ratios, and its index, (column,)."""
    logs = np.log(ratios[1:])
    # Step of the logarithm of the ratio, between the grid ratios, at which single columns are evaluated.
    fine = np.linspace(logs[0], logs[-1], 1 + round((logs[-1] - logs[0]) / 0.1))
    between = CubicSpline(logs, deviances[1:])(fine)
    best = np.argmin(between, axis=0)
    least = between[best, np.arange(between.shape[1])]
    with_force = least < deviances[0]
    place = np.where(with_force, 1.0 + (fine[best] - logs[0]) / (logs[1] - logs[0]), 0.0)
    return np.minimum(least, deviances[0]), place


def _at_place(values: Array, place: Array) -> Array:
    """Return values (ratio, column) interpolated between two ratios, (column,)."""
    lower = np.minimum(place.astype(int), len(values) - 2)
    part, column = place - lower, np.arange(values.shape[1])
    return np.asarray((1.0 - part) * values[lower, column] + part * values[lower + 1, column])


def base_of(model: FittedModel, without: Sequence[str] = ()) -> Array:
    """Return an orthonormal base of the model's columns without those of some forces, (row, column)."""
    kept = model.columns_without(without)
    return np.linalg.qr(np.vstack([table[:, kept] for table in model.white_tables()]))[0]


def outside_of(model: FittedModel, columns: Sequence[Array], base: Array) -> tuple[Array, Array]:
    """Return the parts of columns outside the span of the base, (row, column), and their fractions.

    `columns` : (row, column) of each run. `base` : orthonormal base of all or some of the model's columns.
    """
    white = np.vstack(
        [
            rows.whitened(np.where(has_products(column), column, 0.0), model.likelihood, at)
            for at, (rows, column) in enumerate(zip(model.rows, columns, strict=True))
        ]
    )
    rest = white - base @ (base.T @ white)
    return rest, np.linalg.norm(rest, axis=0) / np.maximum(np.linalg.norm(white, axis=0), 1e-300)


def known_finely(
    model: FittedModel, columns: Sequence[Array], aside: Sequence[Array], without: Sequence[str] = ()
) -> Mask:
    """Return the mask of columns that are the same along an equally likely motion, (column,).

    `columns`, `aside` : (row, column) of each run, along its path and along one of `model.possible_rows`;
    `without` : effects of the model that the columns may replace, and so need not be separated from.

    Notes
    -----
    With a random force the sensor limits the knowledge of the motion. The gain of a column along the path is
    reduced by its squared correlation with the column along the motion; `tolerance` is the largest reduction.
    """
    base = base_of(model, without)
    (here, part), (there, _) = (outside_of(model, tables, base) for tables in (columns, aside))
    return _alike(here, there, model.settings.tolerance) | (part < model.settings.testable)


def are_known_finely(model: FittedModel, trials: Sequence[TrialEffect]) -> Mask:
    """Apply `known_finely` to trials; without a random force all are true."""
    if not np.any(model.likelihood.ratios):
        return np.ones(len(trials), dtype=bool)
    # Drawn again for each call instead of stored: these rows are as large as those of the model.
    possible = model.possible_rows()
    here, aside = ([run.coarse_columns(trials) for run in rows] for rows in (model.rows, possible))
    return known_finely(model, here, aside, without=model.effects)


def known_directions(model: FittedModel, columns: Sequence[Array], aside: Sequence[Array]) -> Array:
    """Return the mixtures of columns that are the same along an equally likely motion, (column, direction).

    The directions are outside the span of the model's columns and orthogonal in its noise. Parameters as in
    `known_finely`. The mean of two similar columns may be resolved although their difference is not.
    """
    base = base_of(model)
    (here, part), (there, _) = (outside_of(model, tables, base) for tables in (columns, aside))
    length = np.where(part < model.settings.testable, np.inf, np.linalg.norm(here, axis=0))
    _, size, mixtures = np.linalg.svd(here / length, full_matrices=False)
    mixtures = mixtures[size > model.settings.testable * size[0]].T / length[:, None]
    return mixtures[:, _alike(here @ mixtures, there @ mixtures, model.settings.tolerance)]


def _alike(here: Array, there: Array, tolerance: float) -> Mask:
    """Return the mask of columns whose squared correlation is at least 1 minus the tolerance, (column,)."""
    along = np.einsum("ij,ij->j", here, there)
    return along >= np.sqrt(1.0 - tolerance) * np.linalg.norm(here, axis=0) * np.linalg.norm(there, axis=0)
