"""Omnibus test: forces of any form, and lines in the spectrum, whatever their name or cause."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2, norm

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.columns_beside import each_beside
from sysid_trib.discrepancy.likelihood import Likelihood, RunProducts, likelihood, of_many_rows
from sysid_trib.discrepancy.model_fit import FittedModel
from sysid_trib.discrepancy.paths import RecordPath
from sysid_trib.discrepancy.simulated_gains import TestedRun, p_value_by_simulation
from sysid_trib.noise.smoothing import KNOTS_PER_PERIOD

TRIAL_POWERS = range(4)
TRIAL_HARMONICS = range(1, 5)
# Directions whose part outside of the model's columns is smaller than this are not tested.
OUTSIDE = 1e-3


@dataclass(frozen=True)
class OmnibusTest:
    """A test that knows no candidate.

    Attributes
    ----------
    names : tuple of str
        TrialEffect forces, such as `r^2 sin 3 phi`.
    z : (trial_force,) array of float
        Score of each: the root of what it gains alone, with the sign of its coefficient.
    p_value : float
        The smallest of those of the highest score, of the strongest line in the spectrum, of the part of the
        record in which most is left and, where these do not reject, of all together; corrected for four
        tests.
    """

    names: tuple[str, ...]
    z: Array
    p_value: float


def trial_names() -> tuple[str, ...]:
    """Names of the 36 trial forces r^k (1, cos m phi, sin m phi), k = 0..3, m = 1..4."""
    waves = ["", *(f" {wave} {m} phi" for m in TRIAL_HARMONICS for wave in ("cos", "sin"))]
    return tuple(f"r^{k}{wave}" for k in TRIAL_POWERS for wave in waves)


def trial_columns(path: RecordPath) -> Array:
    """Rows of the trial forces along a path, (row, trial_force)."""
    points = path.points
    amplitude, phase = np.hypot(points.x, points.v), np.arctan2(-points.v, points.x)
    r = amplitude / np.max(amplitude)
    waves = [np.ones_like(phase)]
    for m in TRIAL_HARMONICS:
        waves += [np.cos(m * phase), np.sin(m * phase)]
    forces = np.stack([r**k * wave for k in TRIAL_POWERS for wave in waves], axis=1)
    return np.asarray(points.integrals @ forces)


def omnibus(
    products: Sequence[RunProducts],
    base: Sequence[int],
    trials: Sequence[int],
    outside: Array,
    model: FittedModel,
    whole: Likelihood,
) -> OmnibusTest:
    """Test what a model leaves against forces of any form.

    Parameters
    ----------
    products : sequence of RunProducts
    base, trials : sequence of int
        Columns of the model, and of the trial forces.
    outside : (trial_force,) array of float
        Part of each that the model's columns cannot make.
    model : FittedModel
    whole : Likelihood
        Of its columns among the products.

    Notes
    -----
    With and without trial forces both variances of each run take their most likely values: what a random
    force has been blamed for is found.
    """
    single = each_beside(products, base, trials, whole)
    gains = np.maximum(0.0, whole.deviance - single.deviance)
    scores = np.sqrt(gains * of_many_rows(single.effective_rows, 1 + len(base))) * np.sign(
        single.coefficients
    )
    z = np.where(outside > OUTSIDE, scores, 0.0)
    kept = [column for column, part in zip(trials, outside, strict=True) if part > OUTSIDE]
    largest = len(z) * 2.0 * float(norm.sf(np.max(np.abs(z))))
    residuals = model.white_residuals()
    least = min(largest, _strongest_line(residuals), _largest_part(residuals))
    if 4.0 * least >= model.settings.level:
        gain = max(0.0, whole.deviance - likelihood(products, [*base, *kept]).deviance)
        # Chance gains more than a chi-square of their number: simulated where that would decide.
        if 4.0 * float(chi2.sf(gain, len(kept))) < model.settings.level:
            tested = np.asarray(kept, dtype=int) - trials[0]
            runs = [
                TestedRun(
                    rows,
                    np.column_stack([table, trial_columns(rows.path)[:, tested]]),
                    replace(of_run, products=of_run.of(np.array([*base, *kept]))),
                )
                for rows, table, of_run in zip(model.rows, model.tables, products, strict=True)
            ]
            least = p_value_by_simulation(gain, runs, len(base), whole, model.settings.seed)
    return OmnibusTest(trial_names(), z, min(1.0, 4.0 * least))


def _strongest_line(residuals: Sequence[Array]) -> float:
    """P-value of the strongest line in the spectrum: no force of the motion makes one of its own.

    A line of white noise of unit variance has an exponentially distributed power (Schuster 1898).
    """
    powers = [np.abs(np.fft.rfft(residual)) ** 2 / len(residual) for residual in residuals]
    least = min(len(power) * float(np.exp(-np.max(power))) for power in powers)
    return min(1.0, least * len(powers))


def _largest_part(residuals: Sequence[Array]) -> float:
    """P-value of the largest squares of parts of one period, two, four, ...

    A force that comes late or ends early, while a random force is blamed, leaves more there than elsewhere.
    """
    tests, least = 0, 1.0
    for residual in residuals:
        length = KNOTS_PER_PERIOD
        while length <= len(residual) // 2:
            parts = len(residual) // length
            squares = np.sum(residual[: parts * length].reshape(parts, length) ** 2, axis=1)
            tests, least = tests + parts, min(least, float(chi2.sf(np.max(squares), length)))
            length *= 2
    return min(1.0, max(1, tests) * least)
