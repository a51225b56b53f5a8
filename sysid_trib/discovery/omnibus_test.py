"""Omnibus test: forces of any form, and spectral lines of any cause."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
import scipy.sparse as sp
from scipy.linalg import block_diag

from sysid_trib.arrays import Array, Mask
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.likelihood import Likelihood, likelihood, of_many_rows
from sysid_trib.discovery.engine.paths import RecordPath
from sysid_trib.discovery.engine.run_products import RunProducts, products_of
from sysid_trib.discovery.engine.run_rows import RunRows
from sysid_trib.discovery.single_columns import each_column, known_directions, known_finely, strengths
from sysid_trib.records.smoothing import KNOTS_PER_PERIOD

# Two families of tests decide whether anything is missing: the candidates, and forces of any form. Each has
# half of the significance level, so that the level holds for both together.
FAMILIES = 2
# Tests in the second family.
OMNIBUS_TESTS = 4
# Random draws of the largest score, and the tail probability at which it is compared with independent tests.
NOISE_DRAWS, TAIL = 4000, 0.01
TRIAL_POWERS = range(4)
TRIAL_HARMONICS = range(1, 5)
# Number of draws that gives mean and variance of the gain to a sixth.
ROWS_OF_NOISE = 60


def independent_tests(correlation: Array, seed: int = 0) -> float:
    """Return the number of independent tests with the same quantile of the largest score as these.

    The quantile of the largest |z| of noise is simulated; Bonferroni's formula then gives the number.

    Notes
    -----
    The scores are R g, with the random draws g and the symmetric root R of the correlation, which depends
    continuously on the correlation (Higham 2008, section 6.2). A triangular factor does not: for similar
    columns, rounding decides which of them it expresses by the others.
    """
    if not len(correlation):
        return 1.0
    variances, axes = np.linalg.eigh(correlation)
    # Directions with less than this fraction of the largest variance do not change the scores.
    kept = variances > 1e-6 * variances[-1]
    half = axes[:, kept]
    root = half * np.sqrt(variances[kept])
    # For columns that the model nearly spans, rounding errors may give correlations above one.
    root /= np.maximum(1.0, np.linalg.norm(root, axis=1))[:, None]
    draws = np.random.default_rng(seed).standard_normal((len(axes), NOISE_DRAWS), np.float32)
    scores = root.astype(np.float32) @ (half.T.astype(np.float32) @ draws)
    largest = np.quantile(np.max(np.abs(scores), axis=0), 1.0 - TAIL)
    return max(1.0, TAIL / (2.0 * float(scipy.stats.norm.sf(largest))))


def corrected(p_value: float) -> float:
    """Return the p-value of the smallest omnibus p-value, with that of the candidates (Bonferroni)."""
    return min(1.0, FAMILIES * OMNIBUS_TESTS * p_value)


def trial_names() -> list[str]:
    """Return the names of the 36 trial forces r^k (1, cos m phi, sin m phi), k = 0..3, m = 1..4."""
    waves = ["", *(f" {wave} {m} phi" for m in TRIAL_HARMONICS for wave in ("cos", "sin"))]
    return [f"r^{k}{wave}" for k in TRIAL_POWERS for wave in waves]


def trial_columns(path: RecordPath) -> Array:
    """Return the rows of the trial forces along a path, (row, trial_force)."""
    _, x, v, _ = path.points
    amplitude, phase = np.hypot(x, v), np.arctan2(-v, x)
    r = amplitude / np.max(amplitude)
    waves = [np.ones_like(phase), *(f(m * phase) for m in TRIAL_HARMONICS for f in (np.cos, np.sin))]
    forces = np.stack([r**k * wave for k in TRIAL_POWERS for wave in waves], axis=1)
    return np.asarray(path.integrals @ forces)


def omnibus(
    products: Sequence[RunProducts],
    along: Sequence[Array],
    testable: Mask,
    model: FittedModel,
    whole: Likelihood,
) -> tuple[Array, float]:
    """Test the residual of a model against forces of any form.

    Parameters
    ----------
    products : sequence of RunProducts
        Products with the model's columns first and the trial forces last.
    along : sequence of (row, trial_force) array of float
        The columns of the trial forces in each run.
    testable : (trial_force,) array of bool
        Trial forces whose columns differ from those of the model.
    model : FittedModel
    whole : Likelihood
        Likelihood of the model's columns among the products.

    Returns
    -------
    z : (trial_force,) array of float
        Score of each: the root of its gain alone, with the sign of its coefficient. It is 0 for trial forces
        that are not testable, or whose details are finer than the known motion.
    p_value : float
        The smallest p-value of the largest score, of the strongest spectral line, of the part of the record
        with the largest residual and, if these do not reject, of all trial forces together; `corrected`.

    Notes
    -----
    Both variances of each run take their most likely values with and without trial forces. So a force is
    found even if the fit attributed it to a random force.
    """
    aside = [trial_columns(rows.path) for rows in model.possible_rows()]
    tested = known_finely(model, along, aside) & testable
    base, count = range(1, 1 + model.columns), products[0].products.shape[1]
    deviance, coefficients, _, rows = each_column(products, base, range(count - len(tested), count), whole)
    gains = np.maximum(0.0, whole.deviance - deviance)
    scores = np.sqrt(gains * of_many_rows(rows, 1 + model.columns))
    z = np.where(tested, scores * np.sign(coefficients), 0.0)
    largest = len(z) * 2.0 * float(scipy.stats.norm.sf(np.max(np.abs(z))))
    residuals = model.white_residuals()
    least = min(largest, _strongest_line(residuals), _largest_part(residuals))
    if corrected(least) >= model.settings.level:
        mixtures = known_directions(model, along, aside)
        mixtures, mixed, together = _of_possible_size(products, along, mixtures, model)
        gain = max(0.0, whole.deviance - together.deviance)
        # By chance, the gain exceeds a chi-square with this number of degrees of freedom: simulate if it
        # matters.
        if corrected(float(scipy.stats.chi2.sf(gain, mixtures.shape[1]))) < model.settings.level:
            tried = [columns @ mixtures for columns in along]
            least = _p_value_by_simulation(gain, model, whole, tried, mixed)
    return z, corrected(least)


def _of_possible_size(
    products: Sequence[RunProducts], along: Sequence[Array], mixtures: Array, model: FittedModel
) -> tuple[Array, list[RunProducts], Likelihood]:
    """Return the mixtures of trial forces that are not stronger than a missing force may be.

    Also return their products, and the likelihood of the model with them.
    """
    count, tried = products[0].products.shape[1], along[0].shape[1]
    columns = np.array([*range(1, 1 + model.columns), *range(count - tried, count)])
    while True:
        mix = block_diag(np.eye(1 + model.columns), mixtures)
        mixed = [replace(run, products=mix.T @ run.of(columns) @ mix) for run in products]
        together = likelihood(mixed, range(1, mix.shape[1]))
        relative_force = strengths(model, [forces @ mixtures for forces in along])
        coefficients = together.coefficients[model.columns :]
        possible = np.abs(coefficients) * relative_force < model.settings.strongest
        if possible.all():
            return mixtures, mixed, together
        mixtures = mixtures[:, possible]


def _strongest_line(residuals: Sequence[Array]) -> float:
    """Return the p-value of the strongest spectral line; forces that depend on the motion cause no line.

    The power of white noise of unit variance is exponentially distributed at each line (Schuster 1898).
    """
    # The rows are white. `validation.lack_of_fit.spectral_line` excludes harmonics and has no given level.
    powers = [np.abs(np.fft.rfft(residual)) ** 2 / len(residual) for residual in residuals]
    least = min(len(power) * float(np.exp(-np.max(power))) for power in powers)
    return min(1.0, least * len(powers))


def _largest_part(residuals: Sequence[Array]) -> float:
    """Return the p-value of the largest mean square over sections of one period, two, four, ...

    A force that starts late or ends early leaves a larger residual there, if it is attributed to a random
    force.
    """
    tests, least = 0, 1.0
    for residual in residuals:
        length = KNOTS_PER_PERIOD
        while length <= len(residual) // 2:
            parts = len(residual) // length
            squares = np.sum(residual[: parts * length].reshape(parts, length) ** 2, axis=1)
            tests, least = tests + parts, min(least, float(scipy.stats.chi2.sf(np.max(squares), length)))
            length *= 2
    return min(1.0, max(1, tests) * least)


def _p_value_by_simulation(
    gain: float,
    model: FittedModel,
    null: Likelihood,
    tested: Sequence[Array],
    products: Sequence[RunProducts],
) -> float:
    """Return the probability that columns without effect gain at least as much.

    Parameters
    ----------
    gain : float
        Decrease of the deviance of the record by the columns.
    model : FittedModel
    null : Likelihood
        Likelihood of the model.
    tested : sequence of (row, column) array of float
        The tested columns of each run.
    products : sequence of RunProducts
        Products of the target, the model's columns and the tested columns.

    Notes
    -----
    Many columns take part of the information on the size of a random force, and they are not all independent.
    Their gain is therefore not a chi-square with their number of degrees of freedom. It is approximated by a
    chi-square with the mean and variance of gains in simulated noise (parametric bootstrap; Satterthwaite
    1946).
    """
    random = np.random.default_rng(model.settings.seed)
    tables = [np.column_stack(pair) for pair in zip(model.tables, tested, strict=True)]
    noises = zip(null.ratios.tolist(), np.sqrt(null.variances).tolist(), strict=True)
    runs = zip(model.rows, tables, products, noises, strict=True)
    drawn = [_of_noise(rows, table, of_run, *noise, random) for rows, table, of_run, noise in runs]
    every = range(1, 1 + tables[0].shape[1])
    gains = []
    for draw in zip(*drawn, strict=True):
        without = likelihood(draw, every[: model.columns]).deviance
        gains.append(max(0.0, without - likelihood(draw, every).deviance))
    mean, variance = float(np.mean(gains)), float(np.var(gains, ddof=1))
    count = 2.0 * mean**2 / variance if variance > 0.0 else np.inf
    return float(scipy.stats.chi2.sf(gain * count / mean, count)) if np.isfinite(count) else 1.0


def _of_noise(
    rows: RunRows,
    table: Array,
    products: RunProducts,
    ratio: float,
    deviation: float,
    random: np.random.Generator,
) -> list[RunProducts]:
    """Return the products of a run whose target is noise alone, for each draw."""
    lower = rows.factor(ratio)
    factor = sp.diags_array(lower, offsets=-np.arange(len(lower)), shape=(len(table), len(table)))
    noise = deviation * (factor @ random.standard_normal((len(table), ROWS_OF_NOISE)))
    every, columns = np.column_stack([noise, table]), np.arange(table.shape[1])
    of_draws, _ = products_of(rows.band, rows.path.form.gram, every, products.ratios)
    # The level estimated from the spectrum scatters as well.
    count = products.level_rows
    scatter = random.chisquare(count, ROWS_OF_NOISE) / count if count else np.ones(ROWS_OF_NOISE)
    drawn = []
    for draw, level in enumerate((deviation * np.sqrt(scatter)).tolist()):
        at = np.append(draw, ROWS_OF_NOISE + columns)
        drawn.append(replace(products, products=of_draws[:, at[:, None], at], level=level))
    return drawn
