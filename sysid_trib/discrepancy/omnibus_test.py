"""Omnibus test: forces of any form, and lines in the spectrum, whatever their name or cause."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline, project_out
from sysid_trib.discrepancy.candidate_sensitivities import ReferenceMotion
from sysid_trib.trajectory_fit.sensitivities import responses

TRIAL_POWERS = range(4)
TRIAL_HARMONICS = range(1, 5)
# Directions whose singular value is below this part of the largest are not tested.
RANK = 1e-3


@dataclass(frozen=True)
class OmnibusTest:
    """A test that knows no candidate.

    Attributes
    ----------
    names : tuple of str
        Trial forces, such as `r^2 sin 3 phi`.
    z : (trial_force,) array of float
        Score of each.
    p_value : float
        The smallest of those of all together, of the highest score and of the strongest line in the spectrum,
        corrected for three tests.
    """

    names: tuple[str, ...]
    z: Array
    p_value: float


def omnibus(baseline: Baseline, references: Sequence[ReferenceMotion]) -> OmnibusTest:
    """Test the residual against 36 trial forces r^k (1, cos m phi, sin m phi), k = 0..3, m = 1..4.

    Parameters
    ----------
    baseline : Baseline
        The model fitted.
    references : sequence of ReferenceMotion
        Its motion in each run.
    """
    space = baseline.column_space
    names, _ = _trial_forces(references[0])
    columns = baseline.problem.white([responses(run.about, _trial_forces(run)[1]) for run in references])
    columns = project_out(columns / np.linalg.norm(columns, axis=0), space)
    size = np.linalg.norm(columns, axis=0)
    residual = project_out(baseline.residual, space)
    z = np.where(size > RANK, columns.T @ residual / np.maximum(size, 1e-12), 0.0)
    basis, singular, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, singular > RANK * singular[0]]
    total, count = float(np.sum((basis.T @ residual) ** 2)), basis.shape[1]
    largest = len(z) * 2.0 * norm.sf(float(np.max(np.abs(z))))
    least = min(chi2.sf(total, count), largest, _strongest_line(baseline, residual))
    return OmnibusTest(tuple(names), z, float(min(1.0, 3.0 * least)))


def _strongest_line(baseline: Baseline, residual: Array) -> float:
    """P-value of the strongest line in the spectrum: no force of the motion makes one of its own.

    A line of white noise of unit variance has an exponentially distributed power (Schuster 1898).
    """
    powers = [np.abs(np.fft.rfft(part)) ** 2 / len(part) for part in baseline.split_by_run(residual)]
    least = min(len(power) * float(np.exp(-np.max(power))) for power in powers)
    return min(1.0, least * len(powers))


def _trial_forces(reference: ReferenceMotion) -> tuple[list[str], Array]:
    """Names and values along the motion, (point, trial_force)."""
    motion = reference.about
    r, phase = motion.amplitude / np.max(motion.amplitude), motion.phase
    waves = {"": np.ones_like(phase)}
    for m in TRIAL_HARMONICS:
        waves |= {f" cos {m} phi": np.cos(m * phase), f" sin {m} phi": np.sin(m * phase)}
    trials = {f"r^{k}{name}": r**k * wave for k in TRIAL_POWERS for name, wave in waves.items()}
    return list(trials), np.stack(list(trials.values()), axis=1)
