"""Fits near their end: Gauss-Newton with one table of sensitivities, each step the price of one motion."""

import numpy as np
from numpy.typing import NDArray

from sysid_trib.errors import SysidTribError
from sysid_trib.trajectory_fit.least_squares import limits
from sysid_trib.trajectory_fit.problem import Problem

Array = NDArray[np.float64]

STEPS = 6
# A step that takes less than this from chi-square is the last.
SETTLED = 0.1
# Shape parameters are moved by this part of themselves to see what they do.
REACH = 1e-4


def chord(problem: Problem, unknown: Array, table: Array) -> tuple[Array, float, bool]:
    """Descend from a first guess with sensitivities that were taken nearby.

    Parameters
    ----------
    unknown : the first guess; table : (sample, unknown) sensitivities of the whitened motion; columns of nan
        (shape parameters) are taken by differences.

    Returns
    -------
    The unknowns, their chi-square, and whether the descent settled.
    """
    low, high = limits(problem, len(unknown))
    unknown = np.clip(unknown, low, high)
    residual = _residual(problem, unknown)
    best = float(residual @ residual)
    if not np.isfinite(best):
        return unknown, best, False
    for at in np.flatnonzero(~np.isfinite(table).all(axis=0)):
        moved = unknown.copy()
        moved[at] += REACH * max(abs(moved[at]), 1e-3)
        table[:, at] = (_residual(problem, moved) - residual) / (moved[at] - unknown[at])
    size = np.linalg.norm(table, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    inverse = np.linalg.pinv(table / size, rcond=1e-10)
    for _ in range(STEPS):
        step = -(inverse @ residual) / size
        for part in (1.0, 0.3):
            trial = np.clip(unknown + part * step, low, high)
            left = _residual(problem, trial)
            if float(left @ left) < best:
                break
        else:
            return unknown, best, best - float(left @ left) > -SETTLED
        gain, best = best - float(left @ left), float(left @ left)
        unknown, residual = trial, left
        if gain < SETTLED:
            return unknown, best, True
    return unknown, best, False


def _residual(problem: Problem, unknown: Array) -> Array:
    """The whitened residual, infinite where there is no such model (a frequency below zero)."""
    try:
        return problem.white_residual(unknown)
    except SysidTribError:
        return np.full(1, np.inf)
