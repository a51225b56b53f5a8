"""How a gap grows along a motion: the error of frequency or decay that it means, and where that acts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

Array = NDArray[np.float64]

# Errors of a rate in proportion to a power of the amplitude, or to time.
SHAPES = {"small amplitude": -1.0, "large amplitude": 1.0, "larger amplitude": 2.0, "late times": None}
# A trend is told where it takes this part of chi-square at least, with less than this chance in noise.
TAKES, CHANCE = 0.5, 1e-3


@dataclass(frozen=True)
class Trend:
    """Rate of change of a quantity over tau, (span,), and where the rate differs most."""

    rate: Array
    where: str


def trend(value: Array, error: Array, run: Array, tau: Array, amplitude: Array) -> Trend:
    """Rate at which a quantity grows, as a constant and one further term that fits best.

    Parameters
    ----------
    value, error : (span,) the quantity and its standard error.
    run, tau, amplitude : (span,) of each span; tau = w t.

    Notes
    -----
    A conservative force a^(p+1) makes the phase slip at a rate a^p; what the model can adjust itself, its
    frequency or its viscous friction, is in the constant. So where the force acts is where the rate changes.
    """
    apart = (run[:, None] == np.unique(run)).astype(float)
    plain = np.column_stack([apart, tau])
    steady, chi_square = _fitted(plain, value, error)
    found = Trend(np.full(len(value), steady[-1]), "all amplitudes")
    best = chi_square
    if len(value) <= plain.shape[1] + 1:
        return found
    for name, power in SHAPES.items():
        rate = tau - tau.min() if power is None else amplitude**power
        fitted, left = _fitted(np.column_stack([plain, _summed(rate, tau, run)]), value, error)
        if left < best:
            best = left
            found = Trend(fitted[-2] + fitted[-1] * rate, name.replace("larger", "large"))
    gained = chi_square - best
    told = gained > max(TAKES * chi_square, float(chi2.isf(CHANCE, 1)))
    return found if told else Trend(np.full(len(value), steady[-1]), "all amplitudes")


def _fitted(columns: Array, value: Array, error: Array) -> tuple[Array, float]:
    size = np.linalg.norm(columns / error[:, None], axis=0)
    found = np.linalg.lstsq(columns / error[:, None] / size, value / error, rcond=1e-12)[0] / size
    return found, float(np.sum(((value - columns @ found) / error) ** 2))


def _summed(rate: Array, tau: Array, run: Array) -> Array:
    """Integral of a rate over tau, from the first span of each run."""
    steps = np.diff(tau) * 0.5 * (rate[1:] + rate[:-1])
    total = np.concatenate([[0.0], np.cumsum(np.where(np.diff(run) == 0, steps, 0.0))])
    return np.asarray(total)
