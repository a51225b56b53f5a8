"""Repeatability and reproducibility of a measurement that several laboratories repeat (ISO 5725-2)."""

from typing import NamedTuple

import numpy as np
from scipy.stats import chi2, f as f_distribution

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.validation.random_effects import TAILS

# Two results of one kind differ by less than so many standard deviations in 95 of 100 cases (ISO 5725-6).
LIMIT = 2.8
DEVIATIONS = {
    "repeatability": "standard deviation of repetitions within a laboratory",
    "between_laboratory": "standard deviation between laboratories",
    "reproducibility": "standard deviation of results of different laboratories",
}


class Precision(NamedTuple):
    """Standard deviations with intervals of 95 %: (value, lower, upper) each."""

    repeatability: Array
    between_laboratory: Array
    reproducibility: Array


def precision(values: Array, laboratories: Array) -> Precision:
    """Analysis of variance of results by laboratory.

    Parameters
    ----------
    values : (result,) array of float
    laboratories : (result,) array of str
        Which laboratory each is of.

    Returns
    -------
    Precision

    Raises
    ------
    UsageError
        Fewer than two laboratories, or none has repeated anything.

    Notes
    -----
    ISO 5725-2, 7.4, with the unweighted means of the laboratories, whose intervals hold where they have
    different numbers of results (Thomas and Hultquist 1978); intervals by modified large samples: of the
    difference Ting et al. 1990, of the sum Graybill and Wang 1980.
    """
    _, group = np.unique(laboratories, return_inverse=True)
    counts = np.bincount(group)
    p, n = len(counts), len(values)
    if p < 2 or n == p:
        raise UsageError(
            f"{n} results of {p} laboratories have no repeatability and reproducibility; name a column with "
            "two laboratories at least, one of which has several runs."
        )
    means = np.bincount(group, values) / counts
    within = float(np.sum((values - means[group]) ** 2)) / (n - p)
    repeats = p / float(np.sum(1.0 / counts))
    between = repeats * float(np.var(means, ddof=1))
    freedoms = p - 1, n - p
    lower, upper = chi2.ppf(TAILS, freedoms[1])
    of_repeats = within, within * freedoms[1] / lower, within * freedoms[1] / upper
    of_laboratories = _difference(between, within, freedoms)
    of_results = _sum(between, (repeats - 1.0) * within, freedoms)
    return Precision(
        np.sqrt(of_repeats),
        np.sqrt(np.maximum(0.0, of_laboratories) / repeats),
        # Where laboratories scatter by less than their repetitions, they do not scatter (ISO 5725-2).
        np.sqrt(np.maximum(np.array(of_results) / repeats, [within, 0.0, 0.0])),
    )


def _parts(freedoms: tuple[int, int]) -> tuple[Array, Array]:
    """By which parts chi-squares are below and above their means: (of each mean square,) both."""
    tails = chi2.ppf(np.array(TAILS)[:, None], freedoms)
    below, above = np.array(freedoms) / tails
    return 1.0 - below, above - 1.0


def _difference(first: float, second: float, freedoms: tuple[int, int]) -> Array:
    """First mean square minus the second, with its interval."""
    (g1, g2), (h1, h2) = _parts(freedoms)
    high, low = f_distribution.ppf(TAILS, *freedoms)
    g12 = ((high - 1.0) ** 2 - (g1 * high) ** 2 - h2**2) / high
    h12 = ((1.0 - low) ** 2 - (h1 * low) ** 2 - g2**2) / low
    below = (g1 * first) ** 2 + (h2 * second) ** 2 + g12 * first * second
    above = (h1 * first) ** 2 + (g2 * second) ** 2 + h12 * first * second
    mean = first - second
    return np.array([mean, mean - np.sqrt(max(0.0, below)), mean + np.sqrt(max(0.0, above))])


def _sum(first: float, second: float, freedoms: tuple[int, int]) -> Array:
    """Sum of both, with its interval."""
    below, above = (np.hypot(part[0] * first, part[1] * second) for part in _parts(freedoms))
    mean = first + second
    return np.array([mean, mean - below, mean + above])
