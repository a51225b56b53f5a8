"""Columns in noise alone, both variances profiled as in the record: what they gain by chance."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.stats import chi2

from sysid_trib.arrays import Array, Mask
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.likelihood import Likelihood, likelihood
from sysid_trib.likelihood.run_products import RunProducts, has_products
from sysid_trib.likelihood.run_rows import RunRows
from sysid_trib.likelihood.trials import TrialEffect
from sysid_trib.likelihood.weak_form import cholesky_factor, whiten


def base_of(model: FittedModel, effects: Sequence[str] = ()) -> Array:
    """Orthonormal base of the model's columns, those of `effects` left out, (row, column)."""
    kept = model.columns_without(effects)
    return np.linalg.qr(np.vstack([table[:, kept] for table in model.white_tables()]))[0]


def outside_of(
    model: FittedModel, columns: Sequence[Array], base: Array | None = None
) -> tuple[Array, Array]:
    """What of columns is outside of the model's, and which part of each.

    Parameters
    ----------
    model : FittedModel
    columns : sequence of (row, column) array of float
        Of each run.
    base : (row, base_column) array of float, optional
        Of the model's columns, or of some: `base_of`; by default of all.

    Returns
    -------
    outside : (row, column) array of float
        In units of the noise.
    part : (column,) array of float
    """
    base = base_of(model) if base is None else base
    white = np.vstack(
        [
            rows.whitened(np.where(has_products(column), column, 0.0), model.likelihood, at)
            for at, (rows, column) in enumerate(zip(model.rows, columns, strict=True))
        ]
    )
    rest = white - base @ (base.T @ white)
    return rest, np.linalg.norm(rest, axis=0) / np.maximum(np.linalg.norm(white, axis=0), 1e-300)


def known_finely(
    model: FittedModel, columns: Sequence[Array], aside: Sequence[Array], effects: Sequence[str] = ()
) -> Mask:
    """True if columns are the same along a motion that is as likely, (column,).

    Parameters
    ----------
    model : FittedModel
    columns, aside : sequence of (row, column) array of float
        Of each run, along its path and along one of `model.possible_rows`.
    effects : sequence of str
        Of the model, which these may replace: with them they need not be told apart.

    Notes
    -----
    With a random force a motion is known as well as the sensor tells it. What a column gains along the path
    is its square correlation with the one along the motion: but for a part that `tolerance` allows.
    """
    base = base_of(model, effects)
    (here, part), (there, _) = (outside_of(model, tables, base) for tables in (columns, aside))
    return _alike(here, there, model.settings.tolerance) | (part < model.settings.testable)


def are_known_finely(model: FittedModel, trials: Sequence[TrialEffect], effects: Sequence[str]) -> Mask:
    """`known_finely` of trials; without a random force of all."""
    if not np.any(model.likelihood.ratios):
        return np.ones(len(trials), dtype=bool)
    # Drawn again, and not kept with each screening: they are as large as the rows of the model.
    possible = model.possible_rows(np.random.default_rng(model.settings.seed))
    here, aside = ([run.coarse_columns(trials) for run in rows] for rows in (model.rows, possible))
    return known_finely(model, here, aside, effects)


def known_directions(model: FittedModel, columns: Sequence[Array], aside: Sequence[Array]) -> Array:
    """Mixtures of columns that are the same along a motion that is as likely, (column, direction).

    Of directions outside of the model's columns that are orthogonal in its noise. Parameters as of
    `known_finely`: columns that differ little may be known though their difference is not.
    """
    base = base_of(model)
    (here, part), (there, _) = (outside_of(model, tables, base) for tables in (columns, aside))
    length = np.where(part < model.settings.testable, np.inf, np.linalg.norm(here, axis=0))
    _, size, mixtures = np.linalg.svd(here / length, full_matrices=False)
    mixtures = mixtures[size > model.settings.testable * size[0]].T / length[:, None]
    return mixtures[:, _alike(here @ mixtures, there @ mixtures, model.settings.tolerance)]


def _alike(here: Array, there: Array, tolerance: float) -> Mask:
    """True if columns correlate but for such a part of their squares, (column,)."""
    along = np.einsum("ij,ij->j", here, there)
    return along >= np.sqrt(1.0 - tolerance) * np.linalg.norm(here, axis=0) * np.linalg.norm(there, axis=0)


# Draws from which mean and variance of the gain are known to a sixth.
ROWS_OF_NOISE = 60


class TestedRun(NamedTuple):
    """A run with the model's columns, then those tested, (row, column); and their products."""

    rows: RunRows
    table: Array
    products: RunProducts


def p_value_by_simulation(
    gain: float, runs: Sequence[TestedRun], model_columns: int, null: Likelihood, seed: int
) -> float:
    """Probability that columns without effect gain as much.

    Parameters
    ----------
    gain : float
        By how much they lower the deviance of the record.
    runs : sequence of TestedRun
    model_columns : int
        Number of the model's columns.
    null : Likelihood
        Of the model.
    seed : int

    Notes
    -----
    Many columns take a part of what tells the size of a random force, and are not all independent: their gain
    is no chi-square of their number. It is one that has the mean and the variance of gains in rows of noise
    alone (parametric bootstrap; Satterthwaite 1946).
    """
    random = np.random.default_rng(seed)
    deviations = np.sqrt(null.variances)
    drawn = [
        _of_noise(run, float(ratio), float(deviation), random)
        for run, ratio, deviation in zip(runs, null.ratios, deviations, strict=True)
    ]
    every = range(1, 1 + runs[0].table.shape[1])
    gains = []
    for products in zip(*drawn, strict=True):
        without = likelihood(products, every[:model_columns]).deviance
        gains.append(max(0.0, without - likelihood(products, every).deviance))
    mean, variance = float(np.mean(gains)), float(np.var(gains, ddof=1))
    if variance <= 0.0:
        return 1.0
    degrees_of_freedom = 2.0 * mean**2 / variance
    return float(chi2.sf(gain * degrees_of_freedom / mean, degrees_of_freedom))


def _of_noise(
    run: TestedRun, ratio: float, deviation: float, random: np.random.Generator
) -> list[RunProducts]:
    """Products of a run with noise alone as the target, for each draw."""
    rows, table, products = run
    gram, count = rows.path.form.gram, len(table)
    lower = cholesky_factor(rows.band, gram, ratio)
    factor = sp.diags_array(lower, offsets=-np.arange(len(lower)), shape=(count, count))
    noise = deviation * (factor @ random.standard_normal((count, ROWS_OF_NOISE)))
    squares, cross = [], []
    for tried in products.ratios:
        white = whiten(cholesky_factor(rows.band, gram, float(tried)), np.column_stack([table, noise]))
        columns, targets = white[:, : table.shape[1]], white[:, table.shape[1] :]
        squares.append(np.sum(targets**2, axis=0))
        cross.append(columns.T @ targets)
    of_squares, of_cross = np.array(squares), np.array(cross)
    # The level that the spectrum gives scatters as well.
    level_rows = products.level_rows
    scatter = (
        random.chisquare(level_rows, ROWS_OF_NOISE) / level_rows if level_rows else np.ones(ROWS_OF_NOISE)
    )
    of_draws = []
    for draw in range(ROWS_OF_NOISE):
        whole = products.products.copy()
        whole[:, 0, 0] = of_squares[:, draw]
        whole[:, 0, 1:] = whole[:, 1:, 0] = of_cross[:, :, draw]
        level = deviation * float(np.sqrt(scatter[draw]))
        of_draws.append(replace(products, products=whole, level=level))
    return of_draws
