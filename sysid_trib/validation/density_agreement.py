"""Whether a random force has the same size in all runs: then it is a property of the experiment."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from sysid_trib.noise.random_force import DENSITY_UNITS, RandomForce, random_force_of
from sysid_trib.results.variables import Variables, chi_square_test, with_error


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
