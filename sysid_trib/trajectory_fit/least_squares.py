"""Least squares of motions on records, over a window that grows where the first guess is far."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sysid_trib.trajectory_fit.problem import Problem

Array = NDArray[np.float64]

# Parts of the record to which the fit is extended in turn, so that a phase slip cannot trap it.
WINDOWS = (0.06, 0.12, 0.22, 0.4, 0.65)
# A start whose motion is this near to the record (RMS, of the record's) needs no growing window.
NEAR = 0.1
MAX_EVALUATIONS = 60
# Steps, in units of the solution, below which a fit is done.
TOLERANCE = 1e-12


def grown(problem: Problem, unknown: Array, *, tolerance: float = TOLERANCE) -> Array:
    """Extend the fit over the records window by window, unless the start follows them already."""
    pairs = zip(problem.residuals(unknown), problem.records, strict=True)
    if all(rms(left) < NEAR * rms(record.angle) for left, record in pairs):
        return unknown
    for part in WINDOWS:
        unknown = fitted(problem.first(part), unknown, tolerance=tolerance)
    return unknown


def fitted(
    problem: Problem, unknown: Array, *, tolerance: float = TOLERANCE, evaluations: int = MAX_EVALUATIONS
) -> Array:
    """Unknowns of least whitened residual, from a first guess."""
    return least(problem, unknown, tolerance, evaluations)[0]


def least(
    problem: Problem, unknown: Array, tolerance: float = TOLERANCE, evaluations: int = MAX_EVALUATIONS
) -> tuple[Array, Array, Array]:
    """The same, with the whitened residual (sample,) and its sensitivities (sample, unknown) there."""
    low, high = limits(problem, len(unknown))
    bounded = bool(np.any(np.isfinite(low)) or np.any(np.isfinite(high)))
    inside = np.clip(unknown, np.nextafter(low, np.inf), np.nextafter(high, -np.inf))

    # The optimiser asks for sensitivities where it has just asked for residuals.
    @lru_cache(maxsize=1)
    def residuals(*unknown: float) -> list[Array]:
        return problem.residuals(np.array(unknown))

    found = least_squares(
        lambda unknown: problem.white(residuals(*unknown)),
        inside,
        jac=lambda unknown: problem.white_sensitivity(unknown, residuals(*unknown)),
        bounds=(low, high) if bounded else (-np.inf, np.inf),
        method="trf" if bounded else "lm",
        x_scale="jac",
        xtol=tolerance,
        ftol=tolerance,
        gtol=0.01 * tolerance,
        max_nfev=evaluations,
    )
    return np.asarray(found.x, dtype=float), np.asarray(found.fun), np.asarray(found.jac)


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def limits(problem: Problem, count: int) -> tuple[Array, Array]:
    """Lowest and highest value of each unknown, from the bounds and the shapes' limits."""
    low, high = np.full(count, -np.inf), np.full(count, np.inf)
    given = dict(problem.bounds)
    for force in problem.library:
        given |= {
            f"{force.symbol}.{k}": given.get(f"{force.symbol}.{k}", (s.low, s.high))
            for k, s in force.shape.items()
        }
    for at, name in enumerate(problem.names):
        if name in given:
            low[at], high[at] = given[name]
    return low, high
