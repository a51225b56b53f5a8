"""The equation of small deviations about a motion: how it acts on the noise."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force
from sysid_trib.regression.problem import RunRegression
from sysid_trib.regression.weak_form import cholesky_factor, coloured, covariance_band, noise_operator

# Width, in units of the local amplitude, over which the noise feels a jump of a force at zero.
JUMP_WIDTH = 0.8


@dataclass(frozen=True)
class DeviationOperator:
    """Operator of small deviations.

    Attributes
    ----------
    matrix : (row, sample) sparse array of float
    acting : (row, sample) sparse array of float
        The same on the innovations of the sensor's noise; equal where that is white.
    factor : (band, row) array of float
        Cholesky factor of the covariance of its rows in the sensor's noise, of unit innovations, and in the
        random force; lower banded.
    """

    matrix: sp.csr_matrix
    acting: sp.csr_matrix
    factor: Array


def linearised(run: RunRegression) -> DeviationOperator:
    """The operator of small deviations about a run's reference trajectory, with what whitens its rows."""
    matrix, acting = deviation_matrices(run)
    ratio = 0.0 if run.noises is None else run.noises.ratio.ratio
    band = covariance_band(acting @ acting.T)
    return DeviationOperator(matrix, acting, cholesky_factor(band, run.problem.form.gram, ratio))


def deviation_matrices(run: RunRegression) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """`matrix` and `acting` of `DeviationOperator`."""
    k = (run.frequency / run.problem.nominal_frequency) ** 2
    stiffness, damping = partial_derivatives(run)
    matrix = noise_operator(run.problem.form, k * stiffness, np.sqrt(k) * damping)
    return matrix, matrix if run.noises is None else coloured(matrix, run.noises.filter_)


def partial_derivatives(run: RunRegression) -> tuple[Array, Array]:
    """Stiffness 1 + sum c dh/dx and damping sum c dh/dv along the reference trajectory.

    Returns
    -------
    stiffness, damping : (sample,) array of float

    Notes
    -----
    A force that jumps with v, as sign(v), damps the noise by a spike at each reversal. The test functions
    see no spike, but its mean: a sharper one would whiten away what they can see. A jump at zero is therefore
    distributed over `JUMP_WIDTH`.
    """
    problem, path = run.problem, run.reference
    amplitude = np.hypot(path.x, path.v) + 1e-12
    derivatives = [np.ones_like(path.x), np.zeros_like(path.x)]
    for force, coefficient in zip(problem.library, run.coefficients, strict=True):
        if not force.memoryless or coefficient == 0.0:
            continue
        for i, (name, along) in enumerate((("x", path.x), ("v", path.v))):
            if name not in force.formula.names:
                continue

            def h(value: Array, force: Force = force, i: int = i) -> Array:
                point = (value, path.v) if i == 0 else (path.x, value)
                return force.value(*point, problem.elapsed, shapes=problem.shapes)

            # A step in proportion never crosses zero, where the jump is.
            step = 1e-5 * np.where(along == 0.0, 1.0, along)
            slope = (h(along + step) - h(along)) / step
            jump = h(np.full_like(along, 1e-12)) - h(np.full_like(along, -1e-12))
            bump = np.clip(1.0 - (along / (JUMP_WIDTH * amplitude)) ** 2, 0.0, None)
            slope = slope + jump * bump**2 * 15.0 / (16.0 * JUMP_WIDTH * amplitude)
            derivatives[i] = derivatives[i] + coefficient * slope
    return derivatives[0], derivatives[1]
