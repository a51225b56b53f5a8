"""Values with known errors that scatter by more than these: how much, about what, and where each really is.

Value i of n is x_i' b + u_i + e_i: conditions x_i with effects b, a scatter u_i of variance tau^2 that is
sought, an error e_i of variance s_i^2 that is stated (random-effects meta-regression; DerSimonian and Laird
1986, Viechtbauer 2007).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, f as f_distribution, norm, t as student

from sysid_trib.arrays import Array, Index

# Quantiles that an interval of 95 % lies between, the upper first.
TAILS = (0.975, 0.025)
# Values of tau that an estimate of one value averages over, and the p-value of the largest.
TAUS, LAST_P_VALUE = 100, 1e-4
# A value whose leverage lacks this of one has no others that predict it.
WHOLE_LEVERAGE = 1e-9


class Heterogeneity(NamedTuple):
    """Standard deviation between values, tau, with its interval; and the p-value of none."""

    value: float
    lower: float
    upper: float
    p_value: float


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

    def heterogeneity(self) -> Heterogeneity:
        """Paule-Mandel estimate and Q-profile interval (Viechtbauer 2007): exact where the errors are.

        The chi-square about the weighted effects falls with tau, and at the true one is distributed as such.
        """
        freedoms = self.degrees_of_freedom
        tails = chi2.ppf(TAILS, freedoms)
        p_value = float(chi2.sf(self.weighted(0.0).chi_square, freedoms))
        return Heterogeneity(self._tau_of(freedoms), self._tau_of(tails[0]), self._tau_of(tails[1]), p_value)

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
        """Of no effect of some columns at all (F; Knapp and Hartung 2003).

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
        """How far each value is from what all others let expect, over scatter and error: (value,).

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
        free = np.where(leverage < 1.0 - WHOLE_LEVERAGE, 1.0 - leverage, np.nan)
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
