"""What a record leaves open of the ratio of two variances, so that errors do not rest on one value of it.

With few degrees of freedom the most likely ratio is often far too small, or zero. Errors at that ratio alone
would be too small as well.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from sysid_trib.noise.variance_ratio import VarianceRatio, WhiteRows

# Logarithm of a probability, relative to the largest, that is left out.
NEGLIGIBLE_LOG_WEIGHT = 6.0
# Longest step between ratios, in their logarithm: a likelihood bends over a unit of it.
LONGEST_LOG_STEP = 0.5


class WeighedRatio(NamedTuple):
    """A ratio of variances, the variance of the sensor's noise with it, and the probability of both."""

    ratio: float
    variance: float
    weight: float


class _Likelihood(NamedTuple):
    """Of a ratio: its logarithm, deviance, variance, logarithm of the determinant, degrees of freedom."""

    logarithm: float
    deviance: float
    variance: float
    determinant: float
    degrees_of_freedom: float


def ratio_posterior(rows: Callable[[float], WhiteRows], estimate: VarianceRatio) -> list[WeighedRatio]:
    """The ratios that a record leaves open.

    Parameters
    ----------
    rows : callable
        The white rows of a ratio.
    estimate : VarianceRatio
        As `variance_ratio` gives it of these rows.

    Returns
    -------
    list of WeighedRatio
        Their probabilities sum to one; empty where the likelihood tells no upper end.

    Notes
    -----
    The restricted likelihood times Jeffreys' prior of both variances (1946), with which intervals have their
    coverage to a higher order (Welch and Peers 1963). By the logarithm of the ratio that is
    sqrt(tr A^2 - (tr A)^2/n), A the derivative of the logarithm of the covariance: in proportion to a small
    ratio, so that zero has no weight of its own, and constant where the ratio is known well. With D the
    logarithm of the restricted determinant, tr A = D' and tr A^2 = D' - D''.
    """
    centre = float(np.log(estimate.ratio if estimate.ratio > 0.0 else estimate.upper))
    if not np.isfinite(centre):
        return []
    step = float(np.nanmin([estimate.relative_error, LONGEST_LOG_STEP]))
    table = [*_outward(rows, centre - step, -step, estimate.deviance)[::-1]]
    table += _outward(rows, centre, step, estimate.deviance)
    logarithm, deviance, variance, determinant, degrees_of_freedom = np.array(table).T
    spline = CubicSpline(logarithm, determinant)
    slope, bend = spline(logarithm, 1), spline(logarithm, 2)
    prior = np.sqrt(np.maximum(slope - bend - slope**2 / degrees_of_freedom, 0.0))
    weight = prior * np.exp(0.5 * (np.min(deviance) - deviance))
    nodes = np.column_stack([np.exp(logarithm), variance, weight / np.sum(weight)])
    return [WeighedRatio(*node) for node in nodes.tolist()]


def _outward(
    rows: Callable[[float], WhiteRows], first: float, step: float, least: float
) -> list[_Likelihood]:
    """Likelihoods from a logarithm of the ratio on, as far as they count."""
    table = []
    for logarithm in first + step * np.arange(np.ceil(2.0 * NEGLIGIBLE_LOG_WEIGHT / abs(step))):
        white = rows(float(np.exp(logarithm)))
        deviance, variance = white.restricted_deviance()
        degrees_of_freedom = white.degrees_of_freedom
        determinant = deviance - degrees_of_freedom * np.log(variance)
        table.append(_Likelihood(float(logarithm), deviance, variance, determinant, degrees_of_freedom))
        # A small ratio has a prior that falls with it.
        if deviance > least + 2.0 * NEGLIGIBLE_LOG_WEIGHT or first - logarithm > NEGLIGIBLE_LOG_WEIGHT:
            break
    return table
