"""A fit with a random force as an identification."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.noise.noise_model import NoiseModel
from sysid_trib.noise.random_force import random_force_of_ratio, random_force_variables
from sysid_trib.noise.sensor_noise import colour_variables
from sysid_trib.results.birge import birge_ratio
from sysid_trib.results.variables import variable
from sysid_trib.trajectory_fit.least_squares import rms
from sysid_trib.trajectory_fit.problem import FitProblem
from sysid_trib.trajectory_fit.random_motion import RandomMotionFit
from sysid_trib.trajectory_fit.result import FitEstimate

INNOVATION_LAGS = 20


def pushed_identification(
    method: Any,
    problem: FitProblem,
    runs: Sequence[xr.Dataset],
    library: ForceLibrary,
    pushed: RandomMotionFit,
) -> xr.Dataset:
    """A fit with a random force as every method returns it.

    Parameters
    ----------
    method : dataclass with `shapes` and `random_force`
        The method, for the provenance.
    problem : FitProblem
        Records and parameters.
    runs : sequence of Dataset
        The decays.
    library : ForceLibrary
        All forces to choose from.
    pushed : RandomMotionFit
    """
    frequency = problem.parameters.model(pushed.values).reference_frequency
    filters = [run.linear.sensor_filter for run in pushed.runs]
    noises = [
        NoiseModel(float(np.sqrt(run.ratio.variance)), filter_).standard_deviation
        for run, filter_ in zip(pushed.runs, filters, strict=True)
    ]
    estimate = FitEstimate(problem, pushed.values, pushed.covariance, noises)
    freedoms = len(pushed.residual) - pushed.sensitivity.shape[1]
    chi_square = float(pushed.residual @ pushed.residual)
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (birge_ratio(chi_square, freedoms), "1", "Birge ratio of the innovations"),
        "innovation_rms": (
            [rms(run.innovations()) for run in pushed.runs],
            "rad",
            "RMS of what one step ahead is predicted wrongly",
        ),
    }
    result = estimate.identification(method, runs, library, extra)
    forces = [random_force_of_ratio(run.ratio, frequency, method.random_force) for run in pushed.runs]
    result = result.assign({**random_force_variables(forces), **colour_variables(filters)})
    lags = np.arange(1, 1 + min(INNOVATION_LAGS, len(pushed.residual) - 1))
    e = pushed.residual
    correlation = [float(e[lag:] @ e[:-lag]) / chi_square for lag in lags]
    name = "autocorrelation of the innovations"
    result = result.assign(autocorrelation=variable("lag", correlation, name, "1")).assign_coords(lag=lags)
    orders = ", ".join(str(len(filter_) - 1) for filter_ in filters)
    return result.assign_attrs(noise_model=f"autoregression of order {orders}, beside a random force")
