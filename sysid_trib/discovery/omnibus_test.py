"""Omnibus test: forces of any form, and lines in the spectrum, whatever their name or cause."""

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

# Families of tests that decide whether anything is missing: candidates, and forces of any form. Each has its
# part of the level, so that a record without missing forces is rejected no more often than that.
FAMILIES = 2
# In the second of these.
OMNIBUS_TESTS = 4
# Draws of the largest score of noise, and the quantile at which it is compared with independent tests.
NOISE_DRAWS, TAIL = 4000, 0.01
TRIAL_POWERS = range(4)
TRIAL_HARMONICS = range(1, 5)
# Draws from which mean and variance of the gain are known to a sixth.
ROWS_OF_NOISE = 60


def independent_tests(correlation: Array, seed: int = 0) -> float:
    """Return number of independent tests whose largest score is as large as that of these correlated ones.

    The quantile of the largest |z| of noise, by drawing; then Bonferroni's number for it.

    Notes
    -----
    Scores are R g, with g the draws and R the symmetric root of the correlation. It goes with it continuously
    (Higham 2008, section 6.2); a triangular factor does not: which of columns that are alike it takes for
    mixtures of the others, and so which draws are whose, is a matter of rounding.
    """
    if not len(correlation):
        return 1.0
    variances, axes = np.linalg.eigh(correlation)
    # Directions of less than this part of the largest variance move no score.
    kept = variances > 1e-6 * variances[-1]
    half = axes[:, kept]
    root = half * np.sqrt(variances[kept])
    # Columns that the model nearly spans are rounding errors, and may correlate by more than one.
    root /= np.maximum(1.0, np.linalg.norm(root, axis=1))[:, None]
    draws = np.random.default_rng(seed).standard_normal((len(axes), NOISE_DRAWS), np.float32)
    scores = root.astype(np.float32) @ (half.T.astype(np.float32) @ draws)
    largest = np.quantile(np.max(np.abs(scores), axis=0), 1.0 - TAIL)
    return max(1.0, TAIL / (2.0 * float(scipy.stats.norm.sf(largest))))


def corrected(p_value: float) -> float:
    """Return the p-value of the smallest of the omnibus tests, with that of the candidates (Bonferroni)."""
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
        The model's columns are the first, the trial forces the last.
    along : sequence of (row, trial_force) array of float
        The trial forces in each run.
    testable : (trial_force,) array of bool
        Columns that differ from those of the model.
    model : FittedModel
    whole : Likelihood
        Of its columns among the products.

    Returns
    -------
    z : (trial_force,) array of float
        Score of each: the root of what it gains alone, with the sign of its coefficient; 0 of those that are
        not testable, or that act more finely than the motion is known.
    p_value : float
        The smallest of those of the highest score, of the strongest line in the spectrum, of the part of the
        record in which most is left and, where these do not reject, of all together; `corrected`.

    Notes
    -----
    With and without trial forces both variances of each run take their most likely values: what a random
    force has been blamed for is found.
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
        # Chance gains more than a chi-square of their number: simulated where that would decide.
        if corrected(float(scipy.stats.chi2.sf(gain, mixtures.shape[1]))) < model.settings.level:
            tried = [columns @ mixtures for columns in along]
            least = _p_value_by_simulation(gain, model, whole, tried, mixed)
    return z, corrected(least)


def _of_possible_size(
    products: Sequence[RunProducts], along: Sequence[Array], mixtures: Array, model: FittedModel
) -> tuple[Array, list[RunProducts], Likelihood]:
    """Return the mixtures whose force is not stronger than a missing force may be.

    With their products, and the likelihood of the model with them.
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
    """Return the p-value of the strongest line in the spectrum; forces of the motion cause no such line.

    A line of white noise of unit variance has an exponentially distributed power (Schuster 1898).
    """
    # The rows are white. `validation.lack_of_fit.spectral_line` excludes harmonics and takes no level.
    powers = [np.abs(np.fft.rfft(residual)) ** 2 / len(residual) for residual in residuals]
    least = min(len(power) * float(np.exp(-np.max(power))) for power in powers)
    return min(1.0, least * len(powers))


def _largest_part(residuals: Sequence[Array]) -> float:
    """Return the p-value of the largest squares of parts of one period, two, four, ...

    A force that comes late or ends early, while a random force is blamed, leaves more there than elsewhere.
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
    """Return the probability that columns without effect gain as much.

    Parameters
    ----------
    gain : float
        Decrease of the deviance of the record by the columns.
    model : FittedModel
    null : Likelihood
        Of the model.
    tested : sequence of (row, column) array of float
        The columns, of each run.
    products : sequence of RunProducts
        Products of the target, the model's columns and those that are tested.

    Notes
    -----
    Many columns take a part of what tells the size of a random force, and are not all independent: their gain
    is no chi-square of their number. It is one that has the mean and the variance of gains in rows of noise
    alone (parametric bootstrap; Satterthwaite 1946).
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
    """Return the products of a run with noise alone as the target, for each draw."""
    lower = rows.factor(ratio)
    factor = sp.diags_array(lower, offsets=-np.arange(len(lower)), shape=(len(table), len(table)))
    noise = deviation * (factor @ random.standard_normal((len(table), ROWS_OF_NOISE)))
    every, columns = np.column_stack([noise, table]), np.arange(table.shape[1])
    of_draws, _ = products_of(rows.band, rows.path.form.gram, every, products.ratios)
    # The level that the spectrum gives scatters as well.
    count = products.level_rows
    scatter = random.chisquare(count, ROWS_OF_NOISE) / count if count else np.ones(ROWS_OF_NOISE)
    drawn = []
    for draw, level in enumerate((deviation * np.sqrt(scatter)).tolist()):
        at = np.append(draw, ROWS_OF_NOISE + columns)
        drawn.append(replace(products, products=of_draws[:, at[:, None], at], level=level))
    return drawn
