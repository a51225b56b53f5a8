"""Homogeneity of the runs of one experiment, in their coefficients and in the random force."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood.random_force import DENSITY_UNITS, RandomForce, random_force_of
from sysid_trib.methods import method_of
from sysid_trib.results.references import (
    ASYMPTOTIC_FREQUENCY,
    comparable,
    comparison_covariance,
    comparison_values,
    stated_covariance,
)
from sysid_trib.results.schema import library_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import Variables, chi_square_test, variable, with_error


def random_force_of_each(results: Sequence[xr.Dataset | None], together: xr.Dataset) -> list[RandomForce]:
    """The random force of each run by its own identification; None of a run that alone decides nothing.

    One in which the most likely density is zero says no more: the common identification has its error.
    """
    forces = []
    for at, result in enumerate(results):
        force = RandomForce(np.nan) if result is None else random_force_of(result)
        if result is not None and not force:
            force = replace(force, standard_error=random_force_of(together, at).standard_error)
        forces.append(force)
    return forces


def density_agreement(forces: Sequence[RandomForce]) -> Variables:
    """Test whether the densities of runs are the same.

    Parameters
    ----------
    forces : sequence of RandomForce
        Of each run; one whose density or standard error is nan is left out.

    Returns
    -------
    dict of variables
        Over `run` the `random_force_density` with its error ((rad/s^2)^2/Hz); `density_chi_square`,
        `density_degrees_of_freedom` and `density_p_value`, nan where fewer than two runs tell a density.

    Notes
    -----
    A ratio of variances is tested by its logarithm: a density has the relative error e, its logarithm the
    standard error e. Where the most likely density is zero the deviance rises from there by one within the
    standard error u, as S/u. The statistic is the least sum of the runs' deviances at one common density.
    """
    densities = np.array([force.density for force in forces])
    errors = np.array([force.standard_error for force in forces])
    known = np.isfinite(densities) & np.isfinite(errors) & (errors > 0.0)
    statistic, count = np.nan, max(0, int(known.sum()) - 1)
    if count and np.any(densities[known] > 0.0):
        statistic = _least_deviance(densities[known], errors[known])
    p_value = float(chi2.sf(statistic, count)) if np.isfinite(statistic) else np.nan
    text = "deviance of one density for all runs"
    tested = chi_square_test((), statistic, count, text, p_value)
    return {
        **with_error(
            "random_force_density",
            ("run",),
            (densities, errors),
            "density of the random force by this run alone",
            DENSITY_UNITS,
        ),
        **{f"density_{name}": values for name, values in tested.items()},
    }


def _least_deviance(densities: np.ndarray, errors: np.ndarray) -> float:
    """Least sum over runs, by the common density."""
    zero = densities == 0.0
    logs, relative = np.log(densities[~zero]), errors[~zero] / densities[~zero]

    def deviance(log_density: float) -> float:
        return float(
            np.sum(((log_density - logs) / relative) ** 2) + np.sum(np.exp(log_density) / errors[zero])
        )

    # A run without a random force moves the common density down alone.
    low, high = logs.min() - 1.0, logs.max()
    while deviance(low - 1.0) < deviance(low):
        low -= 1.0
    return float(minimize_scalar(deviance, bounds=(low - 1.0, high + 1e-9), method="bounded").fun)


# Significance level below which runs, or methods, are said to disagree.
HOMOGENEITY_LEVEL = 0.01
CHI_SQUARE = "chi-square about the weighted mean"
MIXED_UNITS = "1; rad/s for the frequency"


@in_units_of_the_motion
def run_agreement(decays: Sequence[xr.Dataset], together: xr.Dataset) -> xr.Dataset:
    """Test whether the runs of one experiment have the same forces.

    Parameters
    ----------
    decays : sequence of Dataset
        The runs.
    together : Dataset
        The identification of all of them, whose method is run on each alone.

    Returns
    -------
    Dataset. Over `run` and `quantity` (each force, and the asymptotic frequency where it was fitted) the
    `value` from that run alone at the common reference frequency, with its `standard_error`; over `quantity`
    `chi_square` of the values about their weighted mean, `degrees_of_freedom`, `p_value`; and the same of all
    quantities with their covariances (`total_...`). nan for a run that alone cannot decide: `reason(run)`.
    attrs: `verdict` agree, disagree or unknown. With a random force in the common identification also what
    `density_agreement` says of its size in each run, and the attr `density_verdict`.

    Notes
    -----
    A random force is estimated in each run alone, so that its errors stand for that run.

    Cochran's Q. Large where a force changes from run to run (wear), or is of another form than the model's:
    then it changes with amplitude.
    """
    method, library = method_of(together), library_of(together, whole=True)
    kept = comparable(together)
    frequency = together.reference_frequency.item()
    free = together.reference_frequency_standard_error.item() > 0.0
    names = [*kept, ASYMPTOTIC_FREQUENCY] if free else kept
    values = np.full((len(decays), len(names)), np.nan)
    covariances = np.full((len(decays), len(names), len(names)), np.nan)
    reasons = []
    of_runs: list[xr.Dataset | None] = []
    for at, decay in enumerate(decays):
        try:
            result = method.identify(decay, library)
        except SysidTribError as error:
            reasons.append(str(error))
            of_runs.append(None)
            continue
        of_runs.append(result)
        values[at] = comparison_values(result, kept, frequency)[: len(names)]
        # A free motion has a frequency so precise that a coefficient's error does not know it.
        covariance = (
            comparison_covariance(result, kept, frequency)
            if random_force_of(together)
            else stated_covariance(result, kept)
        )
        covariances[at] = covariance[: len(names), : len(names)]
        reasons.append("")
    tested = _tested(names, values, covariances, reasons)
    if not random_force_of(together):
        return tested
    densities = density_agreement(random_force_of_each(of_runs, together))
    verdict = verdict_of(float(densities["density_p_value"][1]))
    return tested.assign(densities).assign_attrs(density_verdict=verdict)


def _tested(names: Sequence[str], values: Array, covariances: Array, reasons: Sequence[str]) -> xr.Dataset:
    errors = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    usable = np.isfinite(values).all(axis=1)
    v, c = values[usable], covariances[usable]
    of_quantities = [_homogeneity(v[:, [j]], c[:, [j]][:, :, [j]]) for j in range(len(names))]
    statistics, counts = np.array(of_quantities).T
    total = chi_square_test((), *_homogeneity(v, c), CHI_SQUARE)
    variables = {
        **with_error(
            "value", ("run", "quantity"), (values, errors), "value from this run alone", MIXED_UNITS
        ),
        "reason": variable("run", list(reasons), "why this run alone decides nothing"),
        **chi_square_test("quantity", statistics, counts, CHI_SQUARE),
        **{f"total_{name}": values_of_test for name, values_of_test in total.items()},
    }
    variables["standard_error"] = variables.pop("value_standard_error")
    verdict = verdict_of(float(total["p_value"][1]))
    return xr.Dataset(variables, {"quantity": list(names)}, {"verdict": verdict})


def verdict_of(p_value: float) -> str:
    """`disagree` where the p-value is below `HOMOGENEITY_LEVEL`, else `agree`."""
    return "unknown" if np.isnan(p_value) else "agree" if p_value >= HOMOGENEITY_LEVEL else "disagree"


def _homogeneity(values: Array, covariances: Array) -> tuple[float, float]:
    """Chi-square of (run, quantity) about their weighted mean, and degrees of freedom."""
    if len(values) < 2:
        return np.nan, 0.0
    return weighted_mean(values, covariances)[2], float((len(values) - 1) * values.shape[1])


def weighted_mean(values: Array, covariances: Array) -> tuple[Array, Array, float]:
    """Mean of runs with correlated errors, its covariance, and chi-square about it.

    Parameters
    ----------
    values : (run, quantity) array of float
    covariances : (run, quantity, quantity) array of float
    """
    # Coefficients differ by orders of magnitude: in units of their errors the matrices are well conditioned.
    unit = np.sqrt(np.mean(np.diagonal(covariances, axis1=1, axis2=2), axis=0))
    unit[unit == 0.0] = 1.0
    values, scale = values / unit, np.outer(unit, unit)
    weights = np.linalg.pinv(covariances / scale, hermitian=True)
    inverse = np.linalg.pinv(weights.sum(axis=0), hermitian=True)
    mean = inverse @ np.einsum("rij,rj->i", weights, values)
    deviation = values - mean
    statistic = float(np.einsum("ri,rij,rj->", deviation, weights, deviation))
    return unit * mean, scale * inverse, statistic
