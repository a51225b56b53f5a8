"""Random force in the motion: its size in every unit, and averages over its plausible sizes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import expit

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.likelihood.sensor_noise import colour_variables
from sysid_trib.likelihood.variance_ratio import VarianceRatio, WhiteRows
from sysid_trib.results.random_force import DENSITY_UNITS, RandomForce
from sysid_trib.results.variables import Variables, described

# Options of a method: estimate the random force, leave it out, or use a given one-sided density. With `auto`,
# `identify` and the commands decide from the record; a method used directly then has no random force.
RandomForceOption: TypeAlias = Literal["auto", "estimated", "off"] | float
OPTIONS = ("auto", "estimated", "off")


def check_random_force(option: RandomForceOption) -> None:
    """Raise an error for an option that is neither in `OPTIONS` nor a density.

    Raises
    ------
    UsageError
        The option is another word, or a negative or non-finite density.
    """
    if isinstance(option, str):
        if option not in OPTIONS:
            raise UsageError(f"random_force='{option}' must be one of {', '.join(OPTIONS)}, or a density.")
    elif not (np.isfinite(option) and option >= 0.0):
        raise UsageError(f"random_force={option} is not a density; give {DENSITY_UNITS}, 'auto' or 'off'.")


def is_fitted(option: RandomForceOption) -> bool:
    """Return true if a method has a random force in addition to the sensor's noise."""
    return option not in ("auto", "off")


def random_force_of_ratio(ratio: VarianceRatio, frequency: float, option: RandomForceOption) -> RandomForce:
    """Return the random force in SI units, tau = `frequency` t; a given density is returned as it is."""
    if not isinstance(option, str):
        return RandomForce(float(option))
    density = RandomForce.density_of(ratio.ratio * ratio.variance, frequency)
    error = density * ratio.relative_error
    if density == 0.0:
        error = RandomForce.density_of(ratio.upper * ratio.variance, frequency)
    return RandomForce(density, error, ratio.p_value)


def random_force_variables(forces: Sequence[RandomForce], filters: Sequence[Array] = ()) -> Variables:
    """Return the random forces of the runs as variables: their mean and, for several runs, each of them.

    `filters` : whitening filters of the sensor's noise in each run (see `colour_variables`).
    """
    parts = np.array([(force.density, force.standard_error, force.p_value) for force in forces]).T
    densities, errors, p_values = parts
    values: dict[str, Any] = {
        "random_force_density": densities.mean(),
        "random_force_standard_error": np.sqrt(np.sum(errors**2)) / len(forces),
        "random_force_p_value": np.minimum(1.0, len(forces) * np.min(p_values)),
    }
    if len(forces) > 1:
        values |= {f"run_{name}": of_runs for name, of_runs in zip(values, parts, strict=True)}
    return described("random_forces", values) | (colour_variables(filters) if filters else {})


# Log probability, relative to the largest, below which a ratio is neglected.
NEGLIGIBLE_LOG_WEIGHT = 6.0
# Longest step between logarithms of ratios; the likelihood changes its curvature over about one unit.
LONGEST_LOG_STEP = 0.5


def average_over_ratios(
    rows: Callable[[float], WhiteRows],
    estimate: VarianceRatio,
    samples: int,
    solved: Callable[[VarianceRatio], tuple[Array, Array]],
) -> tuple[Array, Array]:
    """Average parameters over the plausible ratios, and return the errors of that mean.

    Parameters
    ----------
    rows : callable
        Function that returns the white rows for a ratio.
    estimate : VarianceRatio
        Result of `variance_ratio` for these rows.
    samples : int
        Number of samples of the record.
    solved : callable
        Function that returns parameters and their covariance for a ratio and its variance.

    Returns
    -------
    shift : (parameter,) array of float
        Difference from the parameters at the most likely ratio to their mean.
    covariance : (parameter, parameter) array of float
        Increase of the covariance at the most likely ratio because the ratio is uncertain.

    Notes
    -----
    With few degrees of freedom the most likely ratio is often far too small, or zero, and errors at that
    ratio alone would be too small as well. Without a random force, the most likely ratio is above zero by
    chance in four of ten records.

    This is Bayesian model averaging (Hoeting et al. 1999). The mean is over the model with and the model
    without a random force, weighted by their probabilities (`probability_of_none`). So a ratio that is above
    zero by chance has almost no effect. The errors are about this mean, over the ratios above zero: they are
    valid for a random force that the record hardly shows.
    """
    best, best_covariance = solved(estimate)
    ratios, variances, weight = ratio_posterior(rows, estimate)
    if not len(ratios):
        return np.zeros_like(best), np.zeros_like(best_covariance)
    others = [
        solved(replace(estimate, ratio=ratio, variance=variance))
        for ratio, variance in zip(ratios.tolist(), variances.tolist(), strict=True)
    ]
    none, _ = solved(replace(estimate, ratio=0.0, variance=rows(0.0).restricted_deviance()[1]))
    change = np.array([values for values, _ in others]) - best
    probability = probability_of_none(estimate.gain, samples)
    shift = probability * (none - best) + (1.0 - probability) * (weight @ change)
    added = np.array([covariance for _, covariance in others]) - best_covariance
    off = change - shift
    return shift, np.tensordot(weight, added, 1) + (weight[:, None] * off).T @ off


def probability_of_none(gain: float, samples: int) -> float:
    """Return the probability of a zero ratio if another one lowers the deviance by `gain`; equal priors.

    It follows from the Bayesian information criterion (Schwarz 1978). Jeffreys' prior, over all ratios up to
    impulses visible in each sample, also increases with the root of the number of samples.
    """
    return float(expit(0.5 * (np.log(samples) - gain)))


def ratio_posterior(rows: Callable[[float], WhiteRows], estimate: VarianceRatio) -> Array:
    """Return the plausible ratios of a record.

    Parameters
    ----------
    rows : callable
        Function that returns the white rows for a ratio.
    estimate : VarianceRatio
        Result of `variance_ratio` for these rows.

    Returns
    -------
    (3, ratio) array of float
        The ratios, the variance of the sensor's noise with each, and the probability of both; the
        probabilities sum to one. Empty if the likelihood gives no upper limit.

    Notes
    -----
    This is the restricted likelihood times Jeffreys' prior of both variances (1946), whose intervals have the
    correct coverage to a higher order (Welch and Peers 1963). As a density of the log ratio the prior is
    sqrt(tr A^2 - (tr A)^2/n), with A the derivative of the logarithm of the covariance. It is proportional to
    a small ratio, so zero has no weight, and constant where the ratio is well determined. With D the
    logarithm of the restricted determinant, tr A = D' and tr A^2 = D' - D''.
    """
    centre = float(np.log(estimate.ratio if estimate.ratio > 0.0 else estimate.upper))
    if not np.isfinite(centre):
        return np.empty((3, 0))
    step = float(np.nanmin([estimate.relative_error, LONGEST_LOG_STEP]))
    table = [*_outward(rows, centre - step, -step, estimate.deviance)[::-1]]
    table += _outward(rows, centre, step, estimate.deviance)
    logarithm, deviance, variance, determinant, degrees_of_freedom = np.array(table).T
    spline = CubicSpline(logarithm, determinant)
    slope, bend = spline(logarithm, 1), spline(logarithm, 2)
    prior = np.sqrt(np.maximum(slope - bend - slope**2 / degrees_of_freedom, 0.0))
    if not np.any(prior > 0.0):
        # The determinant is hardly bent, as where the ratio is well determined: the prior is constant there.
        prior = np.ones_like(prior)
    weight = prior * np.exp(0.5 * (np.min(deviance) - deviance))
    return np.stack([np.exp(logarithm), variance, weight / np.sum(weight)])


def _outward(
    rows: Callable[[float], WhiteRows], first: float, step: float, least: float
) -> list[tuple[float, ...]]:
    """Return the likelihoods for log ratios from `first` outward, until they are negligible.

    Each entry has log ratio, deviance, variance, log determinant and degrees of freedom.
    """
    table: list[tuple[float, ...]] = []
    for logarithm in first + step * np.arange(np.ceil(2.0 * NEGLIGIBLE_LOG_WEIGHT / abs(step))):
        white = rows(float(np.exp(logarithm)))
        deviance, variance = white.restricted_deviance()
        degrees_of_freedom = white.degrees_of_freedom
        determinant = deviance - degrees_of_freedom * np.log(variance)
        table.append((float(logarithm), deviance, variance, determinant, degrees_of_freedom))
        # The prior of a small ratio decreases with the ratio.
        if deviance > least + 2.0 * NEGLIGIBLE_LOG_WEIGHT or first - logarithm > NEGLIGIBLE_LOG_WEIGHT:
            break
    return table
