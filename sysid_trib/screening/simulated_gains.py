"""What columns gain in rows of noise alone, both variances of each run profiled as in the record."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.stats import chi2

from sysid_trib.arrays import Array
from sysid_trib.likelihood_fit.likelihood import Likelihood, likelihood
from sysid_trib.likelihood_fit.run_products import RunProducts
from sysid_trib.likelihood_fit.run_rows import RunRows
from sysid_trib.regression.weak_form import cholesky_factor, whiten

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
