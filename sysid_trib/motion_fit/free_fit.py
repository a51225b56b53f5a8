"""Fit of the free motion: rounds with the noise of each run, bounds, and the fit as an identification."""

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import DecayError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, white_p_value
from sysid_trib.motion_fit.least_squares import (
    NO_FITTED_MOTION,
    Fit,
    calmer,
    fitted,
    grown,
    missed,
    nearby_best,
    stopped_by_bounds,
)
from sysid_trib.motion_fit.problem import FitProblem
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.results.effects import birge_ratio
from sysid_trib.simulation.measured_motion import MEASURED

# If the residual of a motion exceeds this fraction of the record, it does not follow the record.
LARGEST_UNFOLLOWED = 0.7


def identified_freely(
    method: Any, problem: FitProblem, first: Array, constraints: Constraints, *, coloured: bool
) -> xr.Dataset:
    """Return the fit of the free motion as an identification; a parameter that a bound stops is held there.

    Parameters
    ----------
    method : dataclass with `shapes`
        The method, for the provenance.
    problem : FitProblem
        Runs and parameters.
    first : (parameter,) array of float
        First guess.
    constraints : Constraints
        Those of each run.
    coloured : bool
        Whether residuals are whitened by an autoregression.

    Raises
    ------
    DecayError
        The motion does not follow the records.
    """
    fit = _fitted_in_its_noise(problem, first, coloured=coloured)
    parameters = fit.parameters
    while stopped := stopped_by_bounds(fit):
        fit = fitted(replace(fit.problem, parameters=fit.parameters.fix(stopped)), fit.values)
    return identification_of_fit(method, fit, fit.with_free(parameters), constraints)


def most_likely(problem: FitProblem, first: Array, *, coloured: bool) -> Fit:
    """Return the likelihood of the free motion about its best fit, without holding parameters at bounds.

    Raises
    ------
    DecayError
        The motion does not follow the records.
    """
    fit = _fitted_in_its_noise(problem, first, coloured=coloured)
    # With strong noise, a start at the first guess may give a better fit than the growing window.
    fit = min(fit, fitted(fit.problem, first), key=lambda tried: float(tried.residual @ tried.residual))
    _residuals(fit)
    return fit.in_its_noise()


def _fitted_in_its_noise(problem: FitProblem, first: Array, *, coloured: bool) -> Fit:
    """Return the fit of the free motion, in the noise of each run."""
    fit = fitted(problem, grown(problem, calmer(problem, first)))
    # Most rounds in which noise and fit are estimated in turn, for several runs or coloured noise. If the
    # motion does not follow the record, the residual is not noise, and each round would use all
    # evaluations.
    rounds = 3 if coloured or len(problem.records) > 1 else 0
    if rounds and missed(problem, fit.values) > LARGEST_UNFOLLOWED:
        rounds = 0
    # The discrepancy of a driven model is not the noise of a run; weights from it would let a run that
    # hardly moves dominate.
    if problem.driven and not _residual_is_white(fit):
        rounds = 0
        # A single run that the motion follows has one minimum.
        if len(problem.records) > 1:
            fit = nearby_best(fit)
    for _ in range(rounds):
        problem = problem.weighted(fit.values, coloured=coloured)
        fit = fitted(problem, fit.values)
    return fit


def _residual_is_white(fit: Fit) -> bool:
    """Return true if the residual of each run is white."""
    residuals = fit.problem.residuals(fit.values)
    return min(white_p_value(residual) for residual in residuals) >= WHITE_LEVEL


def _residuals(fit: Fit) -> list[Array]:
    """Return the residual of each run; raise an error if the motion does not follow the records."""
    counted, unphysical = [], not np.all(np.isfinite(fit.sensitivity))
    for record, residual in zip(fit.problem.records, fit.problem.residuals(fit.values), strict=True):
        counted.append(residual[record.uncounted :])
        unphysical |= np.max(np.abs(counted[-1])) > np.max(np.abs(record.angle))
    if unphysical:
        raise DecayError(NO_FITTED_MOTION)
    return counted


def identification_of_fit(method: Any, fit: Fit, unbounded: Fit, constraints: Constraints) -> xr.Dataset:
    """Return a fit as an identification, with the errors of the fit in which no bound holds a parameter."""
    problem, parameters = fit.problem, fit.parameters
    residuals, runs = _residuals(fit), problem.runs
    degrees_of_freedom = max(1, len(fit.residual) - len(parameters.free))
    reduced = fit.residual @ fit.residual / degrees_of_freedom
    covariance = reduced * unbounded.covariance
    noises = [sensor_noise(run) for run in runs]
    if any(record.inputs for record in problem.records):
        # A driven motion may contain components that no spline follows: the residual of the model is not
        # below the noise.
        noises = np.minimum(noises, [root_mean_square(residual) for residual in residuals]).tolist()
        if min(white_p_value(residual) for residual in residuals) < WHITE_LEVEL:
            # Errors of a driven record whose residual is not white.
            covariance = unbounded.clustered_covariance
    # Unit of the compared quantity.
    units = runs[0][MEASURED].attrs.get("units", "rad") if MEASURED in runs[0] else "rad"
    extra: dict[str, tuple[ArrayLike, str, str]]
    extra = {"residual_rms": ([root_mean_square(residual) for residual in residuals], units, "RMS residual")}
    levels = noises
    if MEASURED in runs[0]:
        measured = (xr.Dataset({"angle": ("time", r.angle)}, {"time": r.time}) for r in problem.records)
        levels = [sensor_noise(record) for record in measured]
        places = [parameters.of_run(run).stop - 1 for run in range(len(runs))]
        bias_errors = np.sqrt(np.diag(covariance)[places])
        extra["bias"] = (fit.values[places], units, "bias of the sensor about the mean of the swing")
        extra["bias_standard_error"] = (bias_errors, units, "standard error of the bias")
        extra["measured_noise"] = (levels, units, "noise of one sample of the measured quantity")
    if all(levels):
        chi_square = sum(float(r @ r) / level**2 for r, level in zip(residuals, levels, strict=True))
        ratio = birge_ratio(chi_square, degrees_of_freedom)
        extra["birge_ratio"] = (ratio, "1", "Birge ratio by the sensor's noise")
    result = problem.identification(method, fit.values, covariance, noises, extra)
    result = constraints.marked(result, parameters.constraints.fixed.keys() & constraints.bounds.keys())
    if MEASURED in runs[0]:
        result = result.assign(offset=0.0 * result.offset)
        result.attrs["compared_in"] = problem.records[0].sensor[0]
    orders = ", ".join(str(len(record.filter_) - 1) for record in problem.records)
    return result.assign_attrs(noise_model=f"autoregression of order {orders}")
