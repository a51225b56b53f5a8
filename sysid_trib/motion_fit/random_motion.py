"""Maximum likelihood of the innovations: a motion with a random force, as an identification.

The record is linearised about a path (first a spline, then the filtered motion); the Kalman filter makes the
record and all columns white; generalised least squares gives the step of the parameters, and the filter the
next path. At rest that is the extended Kalman filter, of whose innovations the likelihood is the maximum
(Ljung 1979; Kristensen, Madsen and Jorgensen 2004).

About the smoothed motion the columns would know the innovations to come, and their product would have a mean
that is not zero: of a random walk of twenty noise levels a bias of 1.3 standard errors in the elastic forces.

Where friction holds the body or nearly so, the linear model jumps with the path, and a whole step may lead
back and forth between branches. Then path and parameters go only a part of the step (relaxation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.likelihood.random_force import (
    RandomForceOption,
    random_force_of_ratio,
    random_force_variables,
)
from sysid_trib.likelihood.sensor_noise import NoiseModel, colour_variables
from sysid_trib.motion_fit.least_squares import Fit
from sysid_trib.motion_fit.linearised import linearised_about, spline_path
from sysid_trib.motion_fit.problem import FitProblem
from sysid_trib.motion_fit.stochastic_step import Iterate
from sysid_trib.records.decay import root_mean_square
from sysid_trib.results.effects import birge_ratio
from sysid_trib.results.variables import variable

PATIENCE = 10
# By what the relaxation changes where a step turns back, and where it goes on, by the cosine of their angle.
SHORTER, LONGER, TURNED = 0.5, 1.5, 0.3
LEAST_PART = 0.05


@dataclass(frozen=True)
class RandomMotionFit(Fit):
    """Parameters of most likelihood with a random force.

    Attributes
    ----------
    residual, sensitivity
        Normalised innovations of all runs, the predicted minus the measured.
    covariance : (parameter, parameter) array of float
    at : Iterate
        The last one.
    """

    covariance: Array
    at: Iterate


def fit_random_motion(
    problem: FitProblem, values: Array, random_force: RandomForceOption | Sequence[float] = "estimated"
) -> RandomMotionFit:
    """Fit a motion with a random force.

    Parameters
    ----------
    problem : FitProblem
        Fixed parameters are held, ties hold, limits are not passed; the records' filters whiten the sensor's
        noise.
    values : (parameter,) array of float
        First guess.
    random_force : "estimated", "off", float or one float for each run, (rad/s^2)^2/Hz
        One-sided density; estimated in each run with `estimated`.

    Raises
    ------
    DecayError
        The iteration does not settle, or the motion cannot be computed.
    """
    model = problem.parameters.model(values)
    # Each path with the standard error of v on it.
    paths = [(spline_path(model, run.time, run.angle), np.zeros(len(run.time))) for run in problem.records]
    densities = [_density(random_force, run) for run in range(len(paths))]
    now: Iterate | None = None
    best: Iterate | None = None
    part = 1.0
    for number in range(24):
        try:
            before, now = now, _linear(problem, values, paths).with_ratios(densities, now)
        except SimulationError as error:
            raise DecayError(f"No motion of these forces follows the record ({error})") from None
        best = now if best is None or now.remaining < best.remaining else best
        # A step this small, in standard errors, changes nothing.
        # What may be left after so many iterations, where they hop between branches; it is then among the
        # errors.
        if best.remaining <= (0.02 if number < PATIENCE else 0.2):
            return _fit(best, densities)
        part = _relaxed(part, before, now)
        filtered = [(model.path, *now.filtered_motion(run)) for run, model in enumerate(now.linear)]
        paths = [(last + part * (path - last), rate_error) for last, path, rate_error in filtered]
        values = now.stepped(part * now.solution[0])
    raise DecayError(
        "The fit with a random force does not settle; offer fewer forces, or take random_force='off'."
    )


def _fit(best: Iterate, densities: Sequence[float | None]) -> RandomMotionFit:
    """The fit after the last step, which is among its errors; so is a density that is not known exactly."""
    step, covariance = best.solution
    covariance = covariance + np.outer(step, step)
    for run, density in enumerate(densities):
        if density is None:
            shift, further = best.average_by_ratio(run)
            covariance, step = covariance + further, step + shift
    return RandomMotionFit(
        best.stepped(step),
        best.rows.design @ step - best.rows.target,
        best.rows.design,
        best.jacobian @ covariance @ best.jacobian.T,
        best.with_gains_over_colours(),
    )


def _relaxed(part: float, before: Iterate | None, now: Iterate) -> float:
    """The part of the step to go: less where it turns back on the last one, more where it goes on."""
    if before is None:
        return part
    # In the metric of the errors.
    first, second = (now.rows.design @ at.solution[0] for at in (before, now))
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    cosine = float(first @ second) / size if size > 0.0 else 0.0
    factor = SHORTER if cosine < -TURNED else LONGER if cosine > TURNED else 1.0
    return float(np.clip(factor * part, LEAST_PART, 1.0))


def _linear(problem: FitProblem, values: Array, paths: Sequence[tuple[Array, Array]]) -> Iterate:
    """The runs about their paths."""
    parameters = problem.parameters
    model, linear = parameters.model(values), []
    for record, (path, rate_error), start in zip(
        problem.records, paths, parameters.per_run(values), strict=True
    ):
        of_run, given = replace(model, inputs=record.inputs), (record.time, record.angle)
        around = linearised_about(of_run, given, path, start, parameters.common, rate_error)
        linear.append(replace(around, sensor_filter=record.filter_))
    return Iterate(parameters, values, linear)


def _density(random_force: RandomForceOption | Sequence[float], run: int) -> float | None:
    """The density that is given for a run; None where it is to be estimated."""
    if random_force == "estimated":
        return None
    if random_force in ("auto", "off"):
        return 0.0
    return float(random_force) if isinstance(random_force, int | float) else float(random_force[run])


INNOVATION_LAGS = 20


def stochastic_identification(method: Any, problem: FitProblem, fit: RandomMotionFit) -> xr.Dataset:
    """A fit with a random force as every method returns it.

    Parameters
    ----------
    method : dataclass with `shapes` and `random_force`
        The method, for the provenance.
    problem : FitProblem
        Records and parameters.
    fit : RandomMotionFit
    """
    frequency = problem.parameters.model(fit.values).reference_frequency
    filters, ratios = [run.sensor_filter for run in fit.at.linear], fit.at.ratios
    noises = [
        NoiseModel(float(np.sqrt(ratio.variance)), filter_).standard_deviation
        for ratio, filter_ in zip(ratios, filters, strict=True)
    ]
    e, chi_square = fit.residual, float(fit.residual @ fit.residual)
    birge = birge_ratio(chi_square, len(e) - fit.sensitivity.shape[1])
    rms = [root_mean_square(fit.at.innovations(run)) for run in range(len(filters))]
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (birge, "1", "Birge ratio of the innovations"),
        "innovation_rms": (rms, "rad", "RMS of what one step ahead is predicted wrongly"),
    }
    result = problem.identification(method, fit.values, fit.covariance, noises, extra)
    forces = [random_force_of_ratio(ratio, frequency, method.random_force) for ratio in ratios]
    result = result.assign({**random_force_variables(forces), **colour_variables(filters)})
    lags = np.arange(1, 1 + min(INNOVATION_LAGS, len(e) - 1))
    correlation = [float(e[lag:] @ e[:-lag]) / chi_square for lag in lags]
    name = "autocorrelation of the innovations"
    result = result.assign(autocorrelation=variable("lag", correlation, name, "1")).assign_coords(lag=lags)
    orders = ", ".join(str(len(filter_) - 1) for filter_ in filters)
    return result.assign_attrs(noise_model=f"autoregression of order {orders}, beside a random force")
