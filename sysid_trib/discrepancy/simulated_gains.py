"""What columns gain in rows of noise alone, both variances of each run profiled as in the record."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.stats import chi2

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.likelihood import Likelihood, RunProducts, likelihood
from sysid_trib.discrepancy.run_rows import RunRows
from sysid_trib.regression.weak_form import cholesky_factor, whiten

# Draws from which mean and variance of the gain are known to a sixth.
DRAWS = 60


def p_value_by_simulation(
    gain: float,
    rows: Sequence[RunRows],
    tables: Sequence[Array],
    products: Sequence[RunProducts],
    base: int,
    null: Likelihood,
    seed: int,
) -> float:
    """Probability that columns without effect gain as much.

    Parameters
    ----------
    gain : float
        By how much they lower the deviance of the record.
    rows : sequence of RunRows
    tables : sequence of (row, column) array of float
        Of each run: the model's columns, then those tried.
    products : sequence of RunProducts
        Of the same columns.
    base : int
        Number of the model's.
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
    drawn = [
        _drawn(run, table, of_run, float(ratio), float(np.sqrt(variance)), random)
        for run, table, of_run, ratio, variance in zip(
            rows, tables, products, null.ratios, null.variances, strict=True
        )
    ]
    every = range(1, 1 + tables[0].shape[1])
    gains = []
    for runs in zip(*drawn, strict=True):
        without = likelihood(runs, every[:base]).deviance
        gains.append(max(0.0, without - likelihood(runs, every).deviance))
    mean, variance = float(np.mean(gains)), float(np.var(gains, ddof=1))
    if variance <= 0.0:
        return 1.0
    degrees_of_freedom = 2.0 * mean**2 / variance
    return float(chi2.sf(gain * degrees_of_freedom / mean, degrees_of_freedom))


def _drawn(
    rows: RunRows,
    table: Array,
    products: RunProducts,
    ratio: float,
    deviation: float,
    random: np.random.Generator,
) -> list[RunProducts]:
    """Products of a run with noise alone as the target, for each draw."""
    gram = rows.path.form.gram
    lower = cholesky_factor(rows.band, gram, ratio)
    count = table.shape[0]
    factor = sp.diags_array(lower, offsets=-np.arange(len(lower)), shape=(count, count))
    noise = deviation * (factor @ random.standard_normal((count, DRAWS)))
    squares, cross = [], []
    for tried in products.ratios:
        white = whiten(cholesky_factor(rows.band, gram, float(tried)), np.column_stack([table, noise]))
        columns, targets = white[:, : table.shape[1]], white[:, table.shape[1] :]
        squares.append(np.sum(targets**2, axis=0))
        cross.append(columns.T @ targets)
    of_squares, of_cross = np.array(squares), np.array(cross)
    # The level that the spectrum gives scatters as well.
    rows_of_level = products.level_rows
    scatter = random.chisquare(rows_of_level, DRAWS) / rows_of_level if rows_of_level else np.ones(DRAWS)
    drawn = []
    for at in range(DRAWS):
        whole = products.products.copy()
        whole[:, 0, 0] = of_squares[:, at]
        whole[:, 0, 1:] = whole[:, 1:, 0] = of_cross[:, :, at]
        drawn.append(replace(products, products=whole, level=deviation * float(np.sqrt(scatter[at]))))
    return drawn
