"""Is anything left? Generic forces, whatever their name, and slow oscillations, whatever their cause."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from sysid_trib.discrepancy.baseline import Baseline, project_out
from sysid_trib.discrepancy.candidate_sensitivities import ReferenceMotion
from sysid_trib.trajectory_fit.sensitivities import responses

Array = NDArray[np.float64]

POWERS = range(4)
HARMONICS = range(1, 5)
# Directions whose singular value is below this part of the largest are not tested.
RANK = 1e-3


@dataclass(frozen=True)
class OmnibusTest:
    """A test that knows no candidate.

    Attributes
    ----------
    names : (shape,) such as `r^2 sin 3 phi`; z : (shape,) score of each.
    chi_square, freedom : of all together; p_value : of the most telling of these and of the strongest line in
        the spectrum, corrected.
    """

    names: tuple[str, ...]
    z: Array
    chi_square: float
    freedom: int
    p_value: float


def omnibus(baseline: Baseline, references: Sequence[ReferenceMotion]) -> OmnibusTest:
    """Test what is left against 36 generic forces r^k (1, cos m phi, sin m phi), k = 0..3, m = 1..4."""
    space = baseline.column_space
    names, _ = _shapes(references[0])
    moved = baseline.white([responses(course.about, _shapes(course)[1]) for course in references])
    moved = moved / np.linalg.norm(moved, axis=0)
    outside = project_out(moved, space)
    size = np.linalg.norm(outside, axis=0)
    residual = project_out(baseline.residual, space)
    z = outside.T @ residual / np.maximum(size, 1e-12)
    z = np.where(size > RANK, z, 0.0)
    basis, singular, _ = np.linalg.svd(outside, full_matrices=False)
    basis = basis[:, singular > RANK * singular[0]]
    total, freedom = float(np.sum((basis.T @ residual) ** 2)), basis.shape[1]
    largest = len(z) * 2.0 * norm.sf(float(np.max(np.abs(z))))
    least = min(chi2.sf(total, freedom), largest, _strongest_line(baseline, residual))
    return OmnibusTest(tuple(names), z, total, freedom, float(min(1.0, 3.0 * least)))


def _strongest_line(baseline: Baseline, residual: Array) -> float:
    """Chance of as strong a line in the spectrum of noise: no force of the motion makes one of its own.

    A line of white noise of unit variance has an exponentially distributed power (Schuster 1898).
    """
    chance = 1.0
    for part in baseline.split_by_run(residual):
        power = np.abs(np.fft.rfft(part)) ** 2 / len(part)
        chance = min(chance, len(power) * float(np.exp(-np.max(power))))
    return min(1.0, chance * len(baseline.noises))


def _shapes(course: ReferenceMotion) -> tuple[list[str], Array]:
    """Names and values along the motion, (point, shape)."""
    about = course.about
    r, phase = about.amplitude / np.max(about.amplitude), about.phase
    names, columns = [], []
    for k in POWERS:
        names.append(f"r^{k}")
        columns.append(r**k)
        for m in HARMONICS:
            for name, wave in (("cos", np.cos(m * phase)), ("sin", np.sin(m * phase))):
                names.append(f"r^{k} {name} {m} phi")
                columns.append(r**k * wave)
    return names, np.stack(columns, axis=1)
