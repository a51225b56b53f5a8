"""How a residual grows along a motion: the error of frequency or decay that it means, and where that acts."""

import numpy as np
from scipy.stats import chi2

from sysid_trib.arrays import Array

# Errors of a rate in proportion to a power of the amplitude, or to time.
SHAPES = {"small amplitude": -1.0, "large amplitude": 1.0, "larger amplitude": 2.0, "late times": None}
# A trend counts if it explains this part of chi-square at least, and is significant at this level.
EXPLAINED_PART, LEVEL = 0.5, 1e-3


def trend(value: Array, error: Array, run: Array, tau: Array, amplitude: Array) -> tuple[Array, str]:
    """Rate at which a quantity grows, as a constant and one further term that fits best.

    Parameters
    ----------
    value, error : (span,) array of float
        The quantity and its standard error.
    run, tau, amplitude : (span,) array
        Of each span; tau = w t.

    Returns
    -------
    rate : (span,) array of float
        The rate, over tau.
    where : str
        Where it differs most.

    Notes
    -----
    A conservative force a^(p+1) makes the phase slip at a rate a^p; what the model can adjust itself, its
    frequency or its viscous friction, is in the constant. So where the force acts is where the rate changes.
    """
    # What is not known counts for nothing.
    known = np.isfinite(value) & np.isfinite(error) & (error > 0.0)
    value, error = np.where(known, value, 0.0), np.where(known, error, np.inf)
    offsets = (run[:, None] == np.unique(run)).astype(float)
    plain = np.column_stack([offsets, tau])
    steady, chi_square = _fitted(plain, value, error)
    constant = best = np.full(len(value), steady[-1]), "all amplitudes"
    if len(value) <= plain.shape[1] + 1:
        return constant
    least = chi_square
    for name, power in SHAPES.items():
        rate = tau - tau.min() if power is None else amplitude**power
        values, remaining = _fitted(np.column_stack([plain, _integral(rate, tau, run)]), value, error)
        if remaining < least:
            least = remaining
            best = values[-2] + values[-1] * rate, name.replace("larger", "large")
    counts = chi_square - least > max(EXPLAINED_PART * chi_square, float(chi2.isf(LEVEL, 1)))
    return best if counts else constant


def _fitted(columns: Array, value: Array, error: Array) -> tuple[Array, float]:
    """Weighted least squares: coefficients and chi-square."""
    size = np.maximum(np.linalg.norm(columns / error[:, None], axis=0), np.finfo(float).tiny)
    values = np.linalg.lstsq(columns / error[:, None] / size, value / error, rcond=1e-12)[0] / size
    return values, float(np.sum(((value - columns @ values) / error) ** 2))


def _integral(rate: Array, tau: Array, run: Array) -> Array:
    """Integral of a rate over tau, from the first span of each run."""
    steps = np.diff(tau) * 0.5 * (rate[1:] + rate[:-1])
    total = np.concatenate([[0.0], np.cumsum(np.where(np.diff(run) == 0, steps, 0.0))])
    return np.asarray(total)
