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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import (
    RandomForceOption,
    random_force_of_ratio,
    random_force_variables,
)
from sysid_trib.likelihood.sensor_noise import NoiseModel, colour_variables
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.least_squares import FitEstimate
from sysid_trib.motion_fit.linearised import Derivatives, linearised_about, spline_path
from sysid_trib.motion_fit.parameters import Parameters
from sysid_trib.motion_fit.problem import FitProblem
from sysid_trib.motion_fit.stochastic_step import (
    Iterate,
    PushedRun,
    average_by_ratio,
    iterate,
    with_gains_over_colours,
)
from sysid_trib.records.decay import root_mean_square
from sysid_trib.records.inputs import KnownInput
from sysid_trib.results.effects import birge_ratio
from sysid_trib.results.variables import variable

PATIENCE = 10
# By what the relaxation changes where a step turns back, and where it goes on, by the cosine of their angle.
SHORTER, LONGER, TURNED = 0.5, 1.5, 0.3
LEAST_PART = 0.05


@dataclass(frozen=True)
class RandomMotionFit:
    """Parameters of most likelihood with a random force.

    Attributes
    ----------
    values : (parameter,) array of float
    covariance : (parameter, parameter) array of float
    runs : tuple of PushedRun
    residual : (sample,) array of float
        Normalised innovations of all runs, the predicted minus the measured.
    sensitivity : (sample, free) array of float
        Its derivative by the free parameters.
    """

    values: Array
    covariance: Array
    runs: tuple[PushedRun, ...]
    residual: Array
    sensitivity: Array


def fit_random_motion(
    parameters: Parameters,
    records: Sequence[tuple[Array, Array]],
    values: Array,
    random_force: RandomForceOption | Sequence[float] = "estimated",
    filters: Sequence[Array] | None = None,
    inputs: Sequence[Mapping[str, KnownInput]] | None = None,
) -> RandomMotionFit:
    """Fit a motion with a random force.

    Parameters
    ----------
    parameters : Parameters
        Fixed ones are held, ties hold, limits are not passed.
    records : sequence of ((sample,), (sample,)) arrays of float, s and rad
        Time and angle of each run.
    values : (parameter,) array of float
        First guess.
    random_force : "estimated", "off", float or one float for each run, (rad/s^2)^2/Hz
        One-sided density; estimated in each run with `estimated`.
    filters : sequence of (tap,) arrays of float, optional
        Each whitens the sensor's noise of a run; white where left out.
    inputs : sequence of mapping of str to KnownInput, optional
        What drives each run; none where left out.

    Returns
    -------
    RandomMotionFit

    Raises
    ------
    DecayError
        The iteration does not settle, or the motion cannot be computed.
    """
    symbols = parameters.library.symbols
    by = Derivatives((*symbols, *parameters.fit_shapes), parameters.reference_frequency is None)
    # Each path with the standard error of v on it.
    paths = [(spline_path(parameters.model(values), *record), np.zeros(len(record[0]))) for record in records]
    densities = [_density(random_force, run) for run in range(len(records))]
    now: Iterate | None = None
    best: Iterate | None = None
    part = 1.0
    for number in range(24):
        try:
            linear = _linear_models(parameters, records, values, paths, by, inputs)
            if filters is not None:
                linear = [
                    replace(run, sensor_filter=filter_) for run, filter_ in zip(linear, filters, strict=True)
                ]
        except SimulationError as error:
            raise DecayError(f"No motion of these forces follows the record ({error})") from None
        before, now = now, iterate(parameters, values, linear, densities, now)
        best = now if best is None or now.remaining < best.remaining else best
        # A step this small, in standard errors, changes nothing.
        # What may be left after so many iterations, where they hop between branches; it is then among the
        # errors.
        if best.remaining <= (0.02 if number < PATIENCE else 0.2):
            return _fit(parameters, best, densities)
        part = _relaxed(part, before, now)
        filtered = [(run.linear.path, *run.filtered_motion()) for run in now.runs]
        paths = [(last + part * (path - last), rate_error) for last, path, rate_error in filtered]
        values = _stepped(parameters, values, part * now.step)
    raise DecayError(
        "The fit with a random force does not settle; offer fewer forces, or take random_force='off'."
    )


def _fit(parameters: Parameters, best: Iterate, densities: Sequence[float | None]) -> RandomMotionFit:
    """The fit after the last step, which is among its errors; so is a density that is not known exactly."""
    jacobian = parameters.by_free(np.eye(len(best.values)), best.values)
    covariance, step = best.covariance + np.outer(best.step, best.step), best.step
    for run, density in enumerate(densities):
        if density is None:
            average = average_by_ratio(parameters, best, run)
            covariance, step = covariance + average.covariance, step + average.shift
    return RandomMotionFit(
        _stepped(parameters, best.values, step),
        jacobian @ covariance @ jacobian.T,
        with_gains_over_colours(parameters, best),
        best.rows.design @ step - best.rows.target,
        best.rows.design,
    )


def _relaxed(part: float, before: Iterate | None, now: Iterate) -> float:
    """The part of the step to go: less where it turns back on the last one, more where it goes on."""
    if before is None:
        return part
    # In the metric of the errors.
    first, second = now.rows.design @ before.step, now.rows.design @ now.step
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    cosine = float(first @ second) / size if size > 0.0 else 0.0
    factor = SHORTER if cosine < -TURNED else LONGER if cosine > TURNED else 1.0
    return float(np.clip(factor * part, LEAST_PART, 1.0))


def _linear_models(
    parameters: Parameters,
    records: Sequence[tuple[Array, Array]],
    values: Array,
    paths: Sequence[tuple[Array, Array]],
    by: Derivatives,
    inputs: Sequence[Mapping[str, KnownInput]] | None,
) -> list[LinearModel]:
    model, per_run = parameters.model(values), parameters.per_run(values)
    models = [replace(model, inputs=known) for known in inputs or [{}] * len(records)]
    return [
        linearised_about(of_run, *record, path, at_start, replace(by, rate_error=rate_error))
        for of_run, record, (path, rate_error), at_start in zip(models, records, paths, per_run, strict=True)
    ]


def _density(random_force: RandomForceOption | Sequence[float], run: int) -> float | None:
    """The density that is given for a run; None where it is to be estimated."""
    if random_force == "estimated":
        return None
    if random_force in ("auto", "off"):
        return 0.0
    return float(random_force) if isinstance(random_force, int | float) else float(random_force[run])


def _stepped(parameters: Parameters, values: Array, step: Array) -> Array:
    """The next values, within their limits."""
    low, high = (limit[parameters.free] for limit in parameters.limits)
    return parameters.expand(np.clip(values[parameters.free] + step, low, high))


INNOVATION_LAGS = 20


def stochastic_identification(
    method: Any,
    problem: FitProblem,
    runs: Sequence[xr.Dataset],
    library: ForceLibrary,
    stochastic: RandomMotionFit,
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
    stochastic : RandomMotionFit
    """
    frequency = problem.parameters.model(stochastic.values).reference_frequency
    filters = [run.linear.sensor_filter for run in stochastic.runs]
    noises = [
        NoiseModel(float(np.sqrt(run.ratio.variance)), filter_).standard_deviation
        for run, filter_ in zip(stochastic.runs, filters, strict=True)
    ]
    estimate = FitEstimate(problem, stochastic.values, stochastic.covariance, noises)
    freedoms = len(stochastic.residual) - stochastic.sensitivity.shape[1]
    chi_square = float(stochastic.residual @ stochastic.residual)
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (birge_ratio(chi_square, freedoms), "1", "Birge ratio of the innovations"),
        "innovation_rms": (
            [root_mean_square(run.innovations()) for run in stochastic.runs],
            "rad",
            "RMS of what one step ahead is predicted wrongly",
        ),
    }
    result = estimate.identification(method, runs, library, extra)
    forces = [random_force_of_ratio(run.ratio, frequency, method.random_force) for run in stochastic.runs]
    result = result.assign({**random_force_variables(forces), **colour_variables(filters)})
    lags = np.arange(1, 1 + min(INNOVATION_LAGS, len(stochastic.residual) - 1))
    e = stochastic.residual
    correlation = [float(e[lag:] @ e[:-lag]) / chi_square for lag in lags]
    name = "autocorrelation of the innovations"
    result = result.assign(autocorrelation=variable("lag", correlation, name, "1")).assign_coords(lag=lags)
    orders = ", ".join(str(len(filter_) - 1) for filter_ in filters)
    return result.assign_attrs(noise_model=f"autoregression of order {orders}, beside a random force")
