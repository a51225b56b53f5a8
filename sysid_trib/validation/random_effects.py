"""Values with known errors that scatter by more than these: between runs, and laboratories (ISO 5725-2).

Value i of n is x_i' b + u_i + e_i: conditions x_i with effects b, a scatter u_i of variance tau^2 that is
sought, an error e_i of variance s_i^2 that is stated (random-effects meta-regression; DerSimonian and Laird
1986, Viechtbauer 2007).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, f as f_distribution, norm, t as student

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import UsageError

# Quantiles that an interval of 95 % lies between, the upper first.
TAILS = (0.975, 0.025)
# Values of tau that an estimate of one value averages over, and the p-value of the largest.
TAUS, LAST_P_VALUE = 100, 1e-4


@dataclass(frozen=True)
class Weighted:
    """Generalised least squares at one tau.

    Attributes
    ----------
    effects : (column,) array of float
    covariance : (column, column) array of float
    chi_square : float
        Of the residuals.
    deviance : float
        Minus twice the logarithm of the restricted likelihood.
    weights : (value,) array of float
    """

    effects: Array
    covariance: Array
    chi_square: float
    deviance: float
    weights: Array


@dataclass(frozen=True)
class RandomEffects:
    """Values with their errors, and the columns of what they may depend on.

    Attributes
    ----------
    values, errors : (value,) array of float
        Errors above zero.
    design : (value, column) array of float
        Of full rank, with fewer columns than values.
    """

    values: Array
    errors: Array
    design: Array

    @property
    def degrees_of_freedom(self) -> int:
        """Values beyond the columns."""
        return len(self.values) - self.design.shape[1]

    def weighted(self, tau: float) -> Weighted:
        """Least squares with the weights of a scatter."""
        weights = 1.0 / (self.errors**2 + tau**2)
        root = np.sqrt(weights)
        q, r = np.linalg.qr(self.design * root[:, None])
        effects = np.linalg.solve(r, q.T @ (self.values * root))
        inverse = np.linalg.inv(r)
        chi_square = float(np.sum(weights * (self.values - self.design @ effects) ** 2))
        information = 2.0 * float(np.sum(np.log(np.abs(np.diag(r)))))
        deviance = chi_square - float(np.sum(np.log(weights))) + information
        return Weighted(effects, inverse @ inverse.T, chi_square, deviance, weights)

    @cached_property
    def tau(self) -> float:
        """Standard deviation between values (Paule and Mandel 1982)."""
        return self._tau_of(self.degrees_of_freedom)

    @property
    def tau_interval(self) -> tuple[float, float]:
        """Ends of its Q-profile interval (Viechtbauer 2007): exact where the errors are.

        The chi-square about the weighted effects falls with tau, and at the true one is distributed as such.
        """
        lower, upper = chi2.ppf(TAILS, self.degrees_of_freedom)
        return self._tau_of(lower), self._tau_of(upper)

    @property
    def homogeneity_p_value(self) -> float:
        """p-value of no scatter."""
        return float(chi2.sf(self.weighted(0.0).chi_square, self.degrees_of_freedom))

    def _tau_of(self, chi_square: float) -> float:
        """The scatter by which the residuals have a chi-square; 0 where none need be."""

        def excess(tau: float) -> float:
            return self.weighted(tau).chi_square - chi_square

        if excess(0.0) <= 0.0:
            return 0.0
        above = float(np.max(self.errors))
        while excess(above) > 0.0:
            above *= 2.0
        return float(brentq(excess, 0.0, above, xtol=1e-9 * above))

    def p_value(self, tau: float, columns: Index) -> float:
        """p-value of no effect of some columns at all (F; Knapp and Hartung 2003).

        Residuals smaller than the errors narrow nothing (Roever et al. 2015).
        """
        fit = self.weighted(tau)
        wider = max(1.0, fit.chi_square / self.degrees_of_freedom)
        effects, covariance = fit.effects[columns], fit.covariance[np.ix_(columns, columns)]
        statistic = float(effects @ np.linalg.solve(covariance, effects)) / (wider * len(columns))
        return float(f_distribution.sf(statistic, len(columns), self.degrees_of_freedom))

    def effect_errors(self, tau: float) -> Array:
        """Standard errors of the effects, by the same distribution as `p_value`."""
        fit = self.weighted(tau)
        wider = max(1.0, fit.chi_square / self.degrees_of_freedom)
        return np.asarray(np.sqrt(wider * np.diag(fit.covariance)))

    def deleted_residuals(self) -> Array:
        """Distance of each value from what all others let expect, over scatter and error: (value,).

        The scatter is that of the others, which one far value does not widen (externally standardised
        residuals; Viechtbauer and Cheung 2010). Where they scatter at all, few of them tell by how much: the
        distance is then of the same probability as Student's. nan where the others expect nothing.
        """
        freedoms = self.degrees_of_freedom - 1
        if freedoms < 1:
            return np.full(len(self.values), np.nan)
        # At the last one no value's others scatter more than they should; small ones are looked at closely.
        taus = self._tau_of(freedoms) * np.linspace(0.0, 1.0, TAUS) ** 2
        sizes, others = (np.array(rows) for rows in zip(*map(self._without_each, taus), strict=True))
        at = np.maximum(np.argmax(others <= freedoms, axis=0), 1)
        value = np.arange(len(self.values))
        before, after = others[at - 1, value], others[at, value]
        scatters = others[0] > freedoms
        part = np.where(scatters, (before - freedoms) / np.where(before > after, before - after, 1.0), 0.0)
        size = sizes[at - 1, value] + part * (sizes[at, value] - sizes[at - 1, value])
        tail = np.maximum(student.sf(np.abs(size), freedoms), np.finfo(float).tiny)
        return np.where(scatters, np.copysign(norm.isf(tail), size), size)

    def _without_each(self, tau: float) -> tuple[Array, Array]:
        """Each value's distance from the fit of all others, standardised, and their chi-square."""
        fit = self.weighted(tau)
        leverage = fit.weights * np.einsum("ia,ab,ib->i", self.design, fit.covariance, self.design)
        # A value whose leverage lacks this of one has no others that predict it.
        free = np.where(leverage < 1.0 - 1e-9, 1.0 - leverage, np.nan)
        size = (self.values - self.design @ fit.effects) * np.sqrt(fit.weights / free)
        return size, fit.chi_square - size**2

    def shrunken(self) -> tuple[Array, Array]:
        """Where each value really is, with the others' help, and its standard error: (value,) each.

        At one tau the mean of value and effects, weighted by both variances. What few values leave open of
        tau is averaged over: restricted likelihood times Jeffreys' prior.
        """
        last = self._tau_of(float(chi2.ppf(LAST_P_VALUE, self.degrees_of_freedom)))
        last = max(last, float(np.max(self.errors)))
        taus = last * np.logspace(-4.0, 0.0, TAUS)
        fits = [self.weighted(tau) for tau in taus]
        prior = [tau * np.sqrt(np.sum(fit.weights**2)) for tau, fit in zip(taus, fits, strict=True)]
        log_mass = np.log(prior) + np.log(taus) - 0.5 * np.array([fit.deviance for fit in fits])
        mass = np.exp(log_mass - np.max(log_mass))
        mass /= mass.sum()
        means, variances = zip(
            *(self._at(tau, fit) for tau, fit in zip(taus, fits, strict=True)), strict=True
        )
        mean = mass @ np.array(means)
        return mean, np.sqrt(mass @ (np.array(variances) + (np.array(means) - mean) ** 2))

    def _at(self, tau: float, fit: Weighted) -> tuple[Array, Array]:
        """Values and variances where tau is known."""
        fitted = self.design @ fit.effects
        of_fitted = np.einsum("ia,ab,ib->i", self.design, fit.covariance, self.design)
        towards = self.errors**2 * fit.weights
        mean = self.values + towards * (fitted - self.values)
        return mean, (1.0 - towards) * self.errors**2 + towards**2 * of_fitted


# Two results of one kind differ by less than so many standard deviations in 95 of 100 cases (ISO 5725-6).
LIMIT = 2.8
DEVIATIONS = {
    "repeatability": "standard deviation of repetitions within a laboratory",
    "between_laboratory": "standard deviation between laboratories",
    "reproducibility": "standard deviation of results of different laboratories",
}


def precision(values: Array, laboratories: Array) -> tuple[Array, Array, Array]:
    """Analysis of variance of results by laboratory.

    Parameters
    ----------
    values : (result,) array of float
    laboratories : (result,) array of str
        Which laboratory each is of.

    Returns
    -------
    repeatability, between_laboratory, reproducibility : (3,) array of float
        Standard deviations with their intervals of 95 %: value, lower, upper.

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
    return (
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
