"""Runs of one experiment: whether they have the same forces, and the same random force."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from scipy.optimize import minimize_scalar

from sysid_trib.arrays import Array
from sysid_trib.likelihood.random_force import DENSITY_UNITS, random_force_of
from sysid_trib.methods import method_of
from sysid_trib.results import references, schema
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import Variables, chi_square_test, described, with_error
from sysid_trib.validation.refits import at_reference, refit

# Significance level below which runs, or methods, are said to disagree.
HOMOGENEITY_LEVEL = 0.01


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
    method, library = method_of(together), schema.library_of(together, whole=True)
    kept, frequency = references.comparable(together), together.reference_frequency.item()
    results, reasons = zip(*(refit(method, [decay], library) for decay in decays), strict=True)
    free = together.reference_frequency_standard_error.item() > 0.0
    names = [*kept, *[references.ASYMPTOTIC_FREQUENCY] * free]
    count = len(names)
    values, covariances = at_reference(results, kept, frequency)
    if not random_force_of(together):
        # A free motion has a frequency so precise that a coefficient's error does not know it.
        for at in np.flatnonzero(np.isfinite(values[:, -1])):
            covariances[at] = references.stated_covariance(results[at], kept)
    values, covariances = values[:, :count], covariances[:, :count, :count]
    usable = np.isfinite(values).all(axis=1)
    v, c, text = values[usable], covariances[usable], "chi-square about the weighted mean"
    one_by_one = [_homogeneity(v[:, [j]], c[:, [j]][:, :, [j]]) for j in range(count)]
    statistics, counts = np.array(one_by_one).T
    total = chi_square_test((), *_homogeneity(v, c), text)
    errors = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    variables: Variables = {
        **described("run_agreement", {"value": values, "standard_error": errors, "reason": list(reasons)}),
        **chi_square_test("quantity", statistics, counts, text),
        **{f"total_{name}": values_of_test for name, values_of_test in total.items()},
    }
    attrs = {"verdict": verdict_of(float(total["p_value"][1]))}
    if random_force_of(together):
        variables |= density_agreement(results, together)
        attrs["density_verdict"] = verdict_of(float(variables["density_p_value"][1]))
    return xr.Dataset(variables, {"quantity": names}, attrs)


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


def density_agreement(results: Sequence[xr.Dataset | None], together: xr.Dataset) -> Variables:
    """Test whether the densities of the random force are the same in all runs.

    Parameters
    ----------
    results : sequence of Dataset or None
        Of each run by itself; None of a run that alone decides nothing.
    together : Dataset
        The identification of all of them.

    Returns
    -------
    dict of variables
        Over `run` the `random_force_density` with its error ((rad/s^2)^2/Hz); `density_chi_square`,
        `density_degrees_of_freedom` and `density_p_value`, nan where fewer than two runs tell a density.

    Notes
    -----
    A ratio of variances is tested by its logarithm: a density has the relative error e, its logarithm the
    standard error e. Where the most likely density is zero the deviance rises from there by one within the
    standard error u, as S/u; that of the common identification is taken, as such a run says no more. The
    statistic is the least sum of the runs' deviances at one common density.
    """
    densities, errors = np.full((2, len(results)), np.nan)
    for at, result in enumerate(results):
        if result is not None:
            force = random_force_of(result)
            densities[at] = force.density
            errors[at] = (force if force else random_force_of(together, at)).standard_error
    known = np.isfinite(densities) & np.isfinite(errors) & (errors > 0.0)
    zero, some = known & (densities == 0.0), known & (densities > 0.0)
    statistic, count = np.nan, max(0, int(known.sum()) - 1)
    if count and some.any():
        logs, relative = np.log(densities[some]), errors[some] / densities[some]

        def deviance(log_density: float) -> float:
            of_some = np.sum(((log_density - logs) / relative) ** 2)
            return float(of_some + np.sum(np.exp(log_density) / errors[zero]))

        statistic = minimize_scalar(deviance, bracket=(logs.min() - 1.0, logs.max())).fun
    text = "density of the random force by this run alone"
    tested = chi_square_test((), statistic, count, "deviance of one density for all runs")
    return {
        **with_error("random_force_density", "run", (densities, errors), text, DENSITY_UNITS),
        **{f"density_{name}": values for name, values in tested.items()},
    }
