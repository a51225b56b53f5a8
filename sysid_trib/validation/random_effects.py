"""Random effects: values that scatter beyond their errors, between runs and laboratories (ISO 5725-2).

Value i of n is x_i' b + u_i + e_i: conditions x_i with effects b, a scatter u_i with the unknown variance
tau^2, and an error e_i with the stated variance s_i^2 (random-effects meta-regression; DerSimonian and Laird
1986, Viechtbauer 2007).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import UsageError

# Quantiles of an interval of 95 %, the upper first.
TAILS = (0.975, 0.025)
# Number of tau values in the average of an estimate, and the p-value of the largest.
TAUS, LAST_P_VALUE = 100, 1e-4


@dataclass(frozen=True)
class RandomEffects:
    """Values with their errors, and least squares of the columns on which they may depend.

    Attributes
    ----------
    values, errors : (value,) array of float
        Errors above zero.
    design : (value, column) array of float
        Design of full rank, with fewer columns than values.
    scatter : float, or (tau,) array of float
        The tau for the weights; with several, all results have one row per tau.
    """

    values: Array
    errors: Array
    design: Array
    scatter: float | Array = 0.0

    def with_scatter(self, tau: float | Array) -> "RandomEffects":
        """Return values and columns weighted with another tau, or with several."""
        return replace(self, scatter=tau)

    @property
    def degrees_of_freedom(self) -> int:
        """Values minus the effects of the columns."""
        return len(self.values) - self.design.shape[1]

    @property
    def weights(self) -> Array:
        """Inverse variances, (value,)."""
        return np.asarray(1.0 / (self.errors**2 + np.square(self.scatter)[..., None]))

    @cached_property
    def root(self) -> Array:
        """Triangular root of the covariance of the effects, (column, column)."""
        return np.linalg.inv(np.linalg.qr(self.design * np.sqrt(self.weights)[..., None], mode="r"))

    @cached_property
    def effects(self) -> Array:
        """Effects of the columns, (column,)."""
        moment = (self.weights * self.values) @ self.design
        return np.asarray(np.einsum("...ij,...kj,...k->...i", self.root, self.root, moment))

    @property
    def fitted(self) -> Array:
        """Values fitted by the effects, (value,)."""
        return np.asarray(self.effects @ self.design.T)

    @property
    def chi_square(self) -> Array:
        """Sum of the squared residuals over their variances."""
        return np.asarray(np.sum(self.weights * (self.values - self.fitted) ** 2, axis=-1))

    @cached_property
    def tau(self) -> float:
        """Standard deviation between values (Paule and Mandel 1982)."""
        return self._tau_of(self.degrees_of_freedom)

    @property
    def tau_interval(self) -> tuple[float, float]:
        """Ends of its Q-profile interval (Viechtbauer 2007), exact if the errors are.

        The chi-square about the weighted effects decreases with tau, and has its distribution at the true
        tau.
        """
        lower, upper = scipy.stats.chi2.ppf(TAILS, self.degrees_of_freedom)
        return self._tau_of(lower), self._tau_of(upper)

    @property
    def homogeneity_p_value(self) -> float:
        """p-value of no scatter in addition to the present tau."""
        return float(scipy.stats.chi2.sf(self.chi_square, self.degrees_of_freedom))

    def _tau_of(self, chi_square: float) -> float:
        """Return the scatter for which the residuals have a given chi-square; 0 if no scatter is needed."""

        def excess(tau: float) -> float:
            return float(self.with_scatter(tau).chi_square) - chi_square

        if excess(0.0) <= 0.0:
            return 0.0
        above = float(np.max(self.errors))
        while excess(above) > 0.0:
            above *= 2.0
        return float(scipy.optimize.brentq(excess, 0.0, above, xtol=1e-9 * above))

    @property
    def widened_covariance(self) -> Array:
        """Covariance of the effects from the residuals (Knapp and Hartung 2003).

        Residuals smaller than the errors do not reduce it (Roever et al. 2015).
        """
        scale = np.maximum(1.0, self.chi_square / self.degrees_of_freedom)
        return np.asarray(scale * (self.root @ self.root.T))

    def p_value(self, columns: Index) -> float:
        """Return the p-value of no effect of some columns (F)."""
        effects, covariance = self.effects[columns], self.widened_covariance[np.ix_(columns, columns)]
        statistic = float(effects @ np.linalg.solve(covariance, effects)) / len(columns)
        return float(scipy.stats.f.sf(statistic, len(columns), self.degrees_of_freedom))

    def deleted_residuals(self) -> Array:
        """Return the distance of each value from its prediction by all others, over scatter and error.

        The scatter is that of the others, which one distant value does not increase (externally standardised
        residuals; Viechtbauer and Cheung 2010). If few others scatter, their scatter is uncertain: the
        distance is then converted from Student's t at equal probability. nan if the others do not predict the
        value.
        """
        freedoms = self.degrees_of_freedom - 1
        if freedoms < 1:
            return np.full(len(self.values), np.nan)
        # Up to the largest tau, at which no value's others scatter more than expected; small values are
        # dense.
        taus = self._tau_of(freedoms) * np.linspace(0.0, 1.0, TAUS) ** 2
        sizes, others = self.with_scatter(taus)._without_each()
        at = np.maximum(np.argmax(others <= freedoms, axis=0), 1)
        value = np.arange(len(self.values))
        before, after = others[at - 1, value], others[at, value]
        scatters = others[0] > freedoms
        part = np.where(scatters, (before - freedoms) / np.where(before > after, before - after, 1.0), 0.0)
        size = sizes[at - 1, value] + part * (sizes[at, value] - sizes[at - 1, value])
        tail = np.maximum(scipy.stats.t.sf(np.abs(size), freedoms), np.finfo(float).tiny)
        return np.where(scatters, np.copysign(scipy.stats.norm.isf(tail), size), size)

    def _of_fitted(self) -> Array:
        """Return the variances of the fitted values, (value,)."""
        return np.asarray(np.sum((self.design @ self.root) ** 2, axis=-1))

    def _without_each(self) -> tuple[Array, Array]:
        """Return each value's standardised distance from the fit of all others, and their chi-square."""
        leverage = self.weights * self._of_fitted()
        # A value with a leverage this close to one is not predicted by the others.
        free = np.where(leverage < 1.0 - 1e-9, 1.0 - leverage, np.nan)
        size = (self.values - self.fitted) * np.sqrt(self.weights / free)
        return size, self.chi_square[..., None] - size**2

    def shrunken(self) -> tuple[Array, Array]:
        """Return shrunken estimates of the values and their standard errors, (value,) each.

        For one tau it is the mean of value and effects, weighted by both variances. It is averaged over tau
        with restricted likelihood times Jeffreys' prior, because few values leave tau uncertain.
        """
        last = self._tau_of(float(scipy.stats.chi2.ppf(LAST_P_VALUE, self.degrees_of_freedom)))
        taus = max(last, float(np.max(self.errors))) * np.logspace(-4.0, 0.0, TAUS)
        fits = self.with_scatter(taus)
        # Twice the log restricted likelihood, and the prior.
        of_root = np.log(np.abs(np.diagonal(fits.root, axis1=1, axis2=2)))
        likelihood = np.log(fits.weights).sum(axis=1) + 2.0 * of_root.sum(axis=1) - fits.chi_square
        prior = taus**2 * np.linalg.norm(fits.weights, axis=1)
        mass, towards = scipy.special.softmax(np.log(prior) + 0.5 * likelihood), self.errors**2 * fits.weights
        means = self.values + towards * (fits.fitted - self.values)
        variances = (1.0 - towards) * self.errors**2 + towards**2 * fits._of_fitted()
        mean = mass @ means
        return mean, np.sqrt(mass @ (variances + (means - mean) ** 2))


def weighted_mean(values: Array, covariances: Array) -> tuple[Array, Array, float]:
    """Return the mean of runs with correlated errors, its covariance, and chi-square about it.

    Parameters
    ----------
    values : (run, quantity) array of float
    covariances : (run, quantity, quantity) array of float
    """
    # Coefficients differ by orders of magnitude; in units of their errors the matrices are well conditioned.
    unit = np.sqrt(np.mean(np.diagonal(covariances, axis1=1, axis2=2), axis=0))
    unit[unit == 0.0] = 1.0
    values, scale = values / unit, np.outer(unit, unit)
    weights = np.linalg.pinv(covariances / scale, hermitian=True)
    inverse = np.linalg.pinv(weights.sum(axis=0), hermitian=True)
    mean = inverse @ np.einsum("rij,rj->i", weights, values)
    deviation = values - mean
    statistic = float(np.einsum("ri,rij,rj->", deviation, weights, deviation))
    return unit * mean, scale * inverse, statistic


def mean_of_runs(values: Array, covariances: Array) -> tuple[Array, Array, Array, Array]:
    """Return the mean of runs whose quantities may scatter beyond their errors; see `weighted_mean`.

    Return also its covariance due to errors and scatter; the standard deviation of the scatter (nan for a
    single run); and the degrees of freedom of the errors (Satterthwaite 1946), infinite without scatter. A
    quantity without errors is that of the first run.
    """
    if len(values) == 1:
        nothing = np.full(values.shape[1], np.nan)
        return values[0], covariances[0], nothing, np.full_like(nothing, np.inf)
    errors = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    design, between = np.ones((len(values), 1)), np.zeros(values.shape[1])
    for at in np.flatnonzero(np.all(errors > 0.0, axis=0)):
        between[at] = RandomEffects(values[:, at], errors[:, at], design).tau
    scattered = covariances + np.diag(between**2)
    mean, covariance, _ = weighted_mean(values, scattered)
    fixed = np.all(errors == 0.0, axis=0)
    mean[fixed] = values[0][fixed]
    # Only the runs determine the part of the variance that is due to scatter.
    part = np.divide(between**2, np.diag(scattered.mean(axis=0)), out=np.zeros_like(mean), where=~fixed)
    freedoms = np.divide(len(values) - 1.0, part**2, out=np.full_like(mean, np.inf), where=part > 0.0)
    return mean, covariance, between, freedoms


# Two results under equal conditions differ by less than this number of standard deviations in 95 of 100 cases
# (ISO 5725-6).
LIMIT = 2.8
DEVIATIONS = ("repeatability", "between_laboratory", "reproducibility")


def precision(values: Array, laboratories: Array) -> tuple[Array, Array, Array]:
    """Return the analysis of variance of results by laboratory.

    Parameters
    ----------
    values : (result,) array of float
    laboratories : (result,) array of str
        Laboratory of each result.

    Returns
    -------
    repeatability, between_laboratory, reproducibility : (3,) array of float
        Standard deviations with their intervals of 95 %: value, lower, upper.

    Raises
    ------
    UsageError
        There are fewer than two laboratories, or none has repeated results.

    Notes
    -----
    This is ISO 5725-2, 7.4, with the unweighted means of the laboratories, for which the intervals are valid
    with different numbers of results (Thomas and Hultquist 1978). The intervals use modified large samples:
    for the difference Ting et al. 1990, for the sum Graybill and Wang 1980.
    """
    _, group = np.unique(laboratories, return_inverse=True)
    counts = np.bincount(group)
    p, n = len(counts), len(values)
    if p < 2 or n == p:
        raise UsageError(
            f"{n} results of {p} laboratories do not determine repeatability and "
            f"reproducibility; name a column "
            "with at least two laboratories, one of which has several runs."
        )
    means = np.bincount(group, values) / counts
    within = float(np.sum((values - means[group]) ** 2)) / (n - p)
    repeats = p / float(np.sum(1.0 / counts))
    between = repeats * float(np.var(means, ddof=1))
    freedoms = p - 1, n - p
    lower, upper = scipy.stats.chi2.ppf(TAILS, freedoms[1])
    of_repeats = within, within * freedoms[1] / lower, within * freedoms[1] / upper
    # Relative limits of chi-squares below and above their means, for each mean square.
    tails = np.array(freedoms) / scipy.stats.chi2.ppf(np.array(TAILS)[:, None], freedoms)
    (g1, g2), (h1, h2) = 1.0 - tails[0], tails[1] - 1.0
    high, low = scipy.stats.f.ppf(TAILS, *freedoms)
    g12 = ((high - 1.0) ** 2 - (g1 * high) ** 2 - h2**2) / high
    h12 = ((1.0 - low) ** 2 - (h1 * low) ** 2 - g2**2) / low
    below = (g1 * between) ** 2 + (h2 * within) ** 2 + g12 * between * within
    above = (h1 * between) ** 2 + (g2 * within) ** 2 + h12 * between * within
    of_laboratories = _with_ends(between - within, np.sqrt(np.maximum(0.0, [below, above])))
    rest = (repeats - 1.0) * within
    of_results = _with_ends(between + rest, np.hypot([g1 * between, h1 * between], [g2 * rest, h2 * rest]))
    return (
        np.sqrt(of_repeats),
        np.sqrt(np.maximum(0.0, of_laboratories) / repeats),
        # If laboratories scatter less than their repetitions, their scatter is zero (ISO 5725-2).
        np.sqrt(np.maximum(of_results / repeats, [within, 0.0, 0.0])),
    )


def _with_ends(mean: float, distances: Array) -> Array:
    """Return a mean, and the ends of its interval at distances below and above."""
    return np.array([mean, mean - distances[0], mean + distances[1]])
