"""Fits near their end: Gauss-Newton with one table of sensitivities, each step the price of one motion."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError
from sysid_trib.trajectory_fit.problem import FitProblem

STEPS = 6
# A step that takes less than this from chi-square is the last.
SETTLED = 0.1
# Shape parameters are moved by this part of themselves to see what they do.
SHAPE_STEP = 1e-4


def chord(problem: FitProblem, values: Array, table: Array) -> tuple[Array, float, bool]:
    """Descend from a first guess with sensitivities that were taken nearby.

    Parameters
    ----------
    problem : FitProblem
        Records and parameters, none of them fixed or tied.
    values : (parameter,) array of float
        The first guess.
    table : (sample, parameter) array of float
        Sensitivities of the whitened motion; columns of nan (shape parameters) are taken by differences.

    Returns
    -------
    The values, their chi-square, and whether the descent settled.
    """
    low, high = problem.parameters.limits
    values = np.clip(values, low, high)
    residual = _residual(problem, values)
    best = float(residual @ residual)
    if not np.isfinite(best):
        return values, best, False
    for at in np.flatnonzero(~np.isfinite(table).all(axis=0)):
        moved = values.copy()
        moved[at] += SHAPE_STEP * max(abs(moved[at]), 1e-3)
        table[:, at] = (_residual(problem, moved) - residual) / (moved[at] - values[at])
    size = np.linalg.norm(table, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    inverse = np.linalg.pinv(table / size, rcond=1e-10)
    for _ in range(STEPS):
        step = -(inverse @ residual) / size
        for part in (1.0, 0.3):
            trial = np.clip(values + part * step, low, high)
            left = _residual(problem, trial)
            if float(left @ left) < best:
                break
        else:
            return values, best, best - float(left @ left) > -SETTLED
        gain, best = best - float(left @ left), float(left @ left)
        values, residual = trial, left
        if gain < SETTLED:
            return values, best, True
    return values, best, False


def _residual(problem: FitProblem, values: Array) -> Array:
    """The whitened residual, infinite where there is no such model (a frequency below zero)."""
    try:
        return problem.white_residual(values)
    except SysidTribError:
        return np.full(1, np.inf)
