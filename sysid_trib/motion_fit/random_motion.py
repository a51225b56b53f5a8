"""Identification of a motion with a random force, by maximum likelihood of the innovations.

The record is linearised about a path (first a spline, then the filtered motion). The Kalman filter whitens
the record and all columns. Generalised least squares gives the step of the parameters, and the filter gives
the next path. After convergence this is the extended Kalman filter, and the likelihood of its innovations is
at its maximum (Ljung 1979; Kristensen, Madsen and Jorgensen 2004).

The smoothed motion cannot replace the filtered motion: the columns would contain future innovations, and
their product with the innovations would have a nonzero mean. For a random walk of twenty noise levels this
gives a bias of 1.3 standard errors in the elastic forces.

If friction holds the body or nearly so, the linear model changes abruptly with the path, and whole steps may
alternate between branches. Then path and parameters take only a fraction of the step (relaxation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.likelihood.colour import most_likely_colour
from sysid_trib.likelihood.random_force import (
    RandomForceOption,
    average_over_ratios,
    random_force_of_ratio,
    random_force_variables,
)
from sysid_trib.likelihood.sensor_noise import MOST_LAGS, NoiseModel, autocorrelation
from sysid_trib.likelihood.variance_ratio import VarianceRatio, WhiteRows, held_ratio
from sysid_trib.motion_fit.kalman import LinearModel, likely_ratio
from sysid_trib.motion_fit.least_squares import Fit, stopped_by_bounds
from sysid_trib.motion_fit.linearised import linearised_about, spline_path
from sysid_trib.motion_fit.parameters import Parameters
from sysid_trib.motion_fit.problem import FitProblem
from sysid_trib.results.effects import birge_ratio
from sysid_trib.results.random_force import RandomForce
from sysid_trib.results.variables import described

PATIENCE = 10
# Factors of the relaxation if a step turns back, and if it continues; the cosine of their angle that decides
# this.
SHORTER, LONGER, TURNED = 0.5, 1.5, 0.3
LEAST_PART = 0.05


@dataclass(frozen=True)
class Iterate:
    """Iterate of the fit, and its next step.

    Attributes
    ----------
    parameters : Parameters
    values : (parameter,) array of float
        Values about which the runs are linear.
    linear : sequence of LinearModel
        Linear models of the runs about their filtered paths, with columns for the free parameters.
    ratios : sequence of VarianceRatio
        Ratio of each run: per_tau of the random force over the variance of the sensor's noise.
    """

    parameters: Parameters
    values: Array
    linear: Sequence[LinearModel]
    ratios: Sequence[VarianceRatio] = ()

    def with_ratios(self, density: float | None, before: "Iterate | None") -> "Iterate":
        """Return the iterate with the ratio of each run, from a density ((rad/s^2)^2/Hz) or the likelihood.

        Ratios are searched near those of the last iterate, if there is one.
        """
        frequency, ratios = self.parameters.model(self.values).reference_frequency, []
        for run, linear in enumerate(self.linear):
            last = before.ratios[run] if before else None
            if density is None:
                ratios.append(likely_ratio(linear, last.ratio if last else None))
            else:
                per_tau = RandomForce(density).per_tau(frequency)
                ratios.append(held_ratio(linear.rows, per_tau, last.variance if last else None))
        return replace(self, ratios=ratios)

    @cached_property
    def rows(self) -> WhiteRows:
        """Normalised innovations of all runs as one regression on the free parameters."""
        targets, designs = [], []
        for linear, ratio in zip(self.linear, self.ratios, strict=True):
            of_run, size = linear.rows(ratio.ratio), np.sqrt(ratio.variance)
            targets.append(of_run.target / size)
            designs.append(of_run.design / size)
        return WhiteRows(np.concatenate(targets), np.concatenate(designs), 0.0)

    @cached_property
    def solution(self) -> tuple[Array, Array]:
        """Step of the free parameters within their limits, and their covariance without limits.

        Parameters that would pass a limit are set to it, and the others are solved again.
        """
        rows, free = self.rows, self.parameters.free
        step, inverse = rows.solution()
        low, high = (limit[free] - self.values[free] for limit in self.parameters.limits)
        passed = (step < low) | (step > high)
        if passed.any():
            limited = np.clip(step, low, high)
            target = rows.target - rows.design[:, passed] @ limited[passed]
            rest = replace(rows, target=target, design=rows.design[:, ~passed])
            limited[~passed] = np.clip(rest.solution()[0], low[~passed], high[~passed])
            step = limited
        return step, inverse

    @property
    def remaining(self) -> float:
        """Largest step of any parameter, in standard errors."""
        step, covariance = self.solution
        return float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))

    def filtered_motion(self, run: int) -> tuple[Array, Array]:
        """Return the filtered path (sample, state), and v's standard error (sample,), rad.

        Both are at the most likely parameters.
        """
        linear, ratio = self.linear[run], self.ratios[run]
        change, covariance = linear.filtered_motion(ratio.ratio, self.solution[0])
        return linear.path + change[..., 0], np.sqrt(ratio.variance * np.maximum(covariance[:, 1, 1], 0.0))

    def innovations(self, run: int) -> Array:
        """Return the errors of one-step predictions, (sample,), rad."""
        return self.linear[run].innovations(self.ratios[run].ratio, self.solution[0])[1][:, 0]

    def stepped(self, step: Array) -> Array:
        """Return the parameters after a step of the free ones, within their limits."""
        free = self.parameters.free
        low, high = (limit[free] for limit in self.parameters.limits)
        return self.parameters.expand(np.clip(self.values[free] + step, low, high))

    def average_by_ratio(self, run: int) -> tuple[Array, Array]:
        """Return the mean step of the free parameters over the plausible ratios of a run."""

        def solved(ratio: VarianceRatio) -> tuple[Array, Array]:
            return replace(self, ratios=[*self.ratios[:run], ratio, *self.ratios[run + 1 :]]).solution

        linear = self.linear[run]
        return average_over_ratios(linear.rows, self.ratios[run], len(linear.record), solved)

    def with_gains_over_colours(self) -> "Iterate":
        """Return the iterate with the gain of each random force over sensor noise alone of any colour.

        Both colours are the most likely ones of the order that the sensor's noise has. With the random force,
        the ratio is held, so the gain is no larger than with ratio and colour free.
        """
        ratios = list(self.ratios)
        for run, (linear, ratio) in enumerate(zip(self.linear, self.ratios, strict=True)):
            if len(linear.sensor_filter) > 1 and ratio.gain != 0.0:
                deviances = [partial(_deviance, linear, of) for of in (0.0, ratio.ratio)]
                start, samples = [linear.sensor_filter], len(linear.record)
                without, least = (most_likely_colour(of, start, samples=samples)[1] for of in deviances)
                ratios[run] = replace(ratio, gain=max(0.0, without - least))
        return replace(self, ratios=ratios)

    def penalised_deviance(self) -> float:
        """Return the deviance of the innovations with the penalty of the BIC for the colours."""
        total = 0.0
        for linear, ratio in zip(self.linear, self.ratios, strict=True):
            total += linear.rows(ratio.ratio).restricted_deviance()[0]
            total += (len(linear.sensor_filter) - 1) * float(np.log(len(linear.record)))
        return total


def _deviance(linear: LinearModel, ratio: float, colour: Array) -> float:
    """Return the deviance of a run's innovations for a ratio and a colour of the sensor's noise."""
    return replace(linear, sensor_filter=colour).rows(ratio).restricted_deviance()[0]


def fit_random_motion(
    problem: FitProblem, values: Array, random_force: RandomForceOption = "estimated"
) -> tuple[Fit, Array, Iterate]:
    """Fit a motion with a random force: normalised innovations of all runs, predicted minus measured.

    Return the fit, the covariance of all parameters, and the iterate of the last step.

    Parameters
    ----------
    problem : FitProblem
        Fixed parameters, ties and limits are respected; the filters of the records whiten the sensor's noise.
    values : (parameter,) array of float
        First estimate.
    random_force : "estimated" or float, (rad/s^2)^2/Hz
        One-sided density; by default it is estimated in each run.

    Raises
    ------
    DecayError
        The iteration does not converge, or the motion cannot be computed.
    """
    models = (problem.parameters.model(values, run) for run in range(len(problem.records)))
    pairs = zip(models, problem.records, strict=True)
    # Each path, with the standard error of v along it.
    paths = [(spline_path(model, run.time, run.angle), np.zeros(len(run.time))) for model, run in pairs]
    # None: the density is estimated.
    density = None if isinstance(random_force, str) else float(random_force)
    now: Iterate | None = None
    best: Iterate | None = None
    part = 1.0
    for number in range(24):
        try:
            before, now = now, _linear(problem, values, paths).with_ratios(density, now)
        except SimulationError as error:
            raise DecayError(f"No motion with these forces follows the record ({error})") from None
        best = now if best is None or now.remaining < best.remaining else best
        # A step smaller than the first number (in standard errors) has no effect. The second number is for
        # later iterations, which may alternate between branches; the remaining step is then included in the
        # errors.
        if best.remaining <= (0.02 if number < PATIENCE else 0.2):
            return _fit(problem, best, density)
        part = _relaxed(part, before, now)
        filtered = [(model.path, *now.filtered_motion(run)) for run, model in enumerate(now.linear)]
        paths = [(last + part * (path - last), rate_error) for last, path, rate_error in filtered]
        values = now.stepped(part * now.solution[0])
    raise DecayError(
        "The fit with a random force does not converge; offer fewer forces, or use random_force='off'."
    )


def _fit(problem: FitProblem, best: Iterate, density: float | None) -> tuple[Fit, Array, Iterate]:
    """Return the fit after the last step; its errors include this step and an uncertain density."""
    step, covariance = best.solution
    covariance = covariance + np.outer(step, step)
    for run in range(len(best.linear)) if density is None else ():
        shift, added = best.average_by_ratio(run)
        covariance, step = covariance + added, step + shift
    jacobian, rows = problem.parameters.jacobian(best.values), best.rows
    fit = Fit(problem, best.stepped(step), rows.design @ step - rows.target, rows.design)
    return fit, jacobian @ covariance @ jacobian.T, best.with_gains_over_colours()


def _relaxed(part: float, before: Iterate | None, now: Iterate) -> float:
    """Return the relative step length: shorter after a turn back, longer in the same direction."""
    if before is None:
        return part
    # Compare the steps in the metric of the errors.
    first, second = (now.rows.design @ at.solution[0] for at in (before, now))
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    cosine = float(first @ second) / size if size > 0.0 else 0.0
    factor = SHORTER if cosine < -TURNED else LONGER if cosine > TURNED else 1.0
    return float(np.clip(factor * part, LEAST_PART, 1.0))


def _linear(problem: FitProblem, values: Array, paths: Sequence[tuple[Array, Array]]) -> Iterate:
    """Return the runs, linear about their paths."""
    parameters, linear = problem.parameters, []
    jacobian = parameters.jacobian(values)
    of_runs = zip(problem.records, paths, parameters.per_run(values), strict=True)
    for run, (record, (path, rate_error), start) in enumerate(of_runs):
        model, acting = parameters.model(values, run), parameters.acting(run)
        names = tuple(parameters.common[at] for at in acting)
        given = record.time, record.angle
        model = replace(model, inputs=record.inputs)
        around = linearised_about(model, given, path, start, names, rate_error)
        columns = np.concatenate([jacobian[acting], jacobian[parameters.of_run(run)]])
        linear.append(replace(around.by_parameters(columns), sensor_filter=record.filter_))
    return Iterate(parameters, values, linear)


def identified_with_random_force(method: Any, problem: FitProblem, values: Array) -> xr.Dataset:
    """Return the fit of the innovations as an identification.

    Parameters
    ----------
    method : dataclass with `shapes` and `random_force`
        The method: the option of its random force, and the provenance.
    problem : FitProblem
        Runs, with the filters of the sensor's noise, and parameters.
    values : (parameter,) array of float
        First guess.

    Raises
    ------
    DecayError
        No fit settles.
    """
    return _stochastic_identification(method, *_within_bounds(problem, values, method.random_force))


def _within_bounds(
    problem: FitProblem, values: Array, random_force: RandomForceOption
) -> tuple[Fit, Array, Iterate]:
    """Return the fit of the innovations; a parameter that a bound stops is held there."""
    fit, covariance, at = _likelier_of(problem, values, random_force)
    while stopped := stopped_by_bounds(fit):
        problem = replace(problem, parameters=problem.parameters.fix(stopped))
        values = problem.parameters.expand(fit.values[problem.parameters.free])
        # Keep the errors of the first fit, in which the parameters at bounds are free.
        fit, _, at = _likelier_of(problem, values, random_force)
    return fit, covariance, at


def _likelier_of(
    problem: FitProblem, values: Array, random_force: RandomForceOption
) -> tuple[Fit, Array, Iterate]:
    """Return the more likely of the fits in coloured and in white noise."""
    fit = fit_random_motion(problem, values, random_force)
    white = [np.ones(1)] * len(problem.records)
    if all(len(record.filter_) == 1 for record in problem.records):
        return fit
    try:
        in_white = fit_random_motion(problem.with_filters(white), values, random_force)
    except DecayError:
        return fit
    return min(fit, in_white, key=lambda tried: tried[2].penalised_deviance())


def _stochastic_identification(method: Any, fit: Fit, covariance: Array, at: Iterate) -> xr.Dataset:
    """Return a fit with a random force in the form that every method returns."""
    frequency = fit.parameters.model(fit.values).reference_frequency
    filters, ratios = [run.sensor_filter for run in at.linear], at.ratios
    sensors = [NoiseModel(float(np.sqrt(r.variance)), f) for r, f in zip(ratios, filters, strict=True)]
    noises = [sensor.standard_deviation for sensor in sensors]
    e, chi_square = fit.residual, float(fit.residual @ fit.residual)
    birge = birge_ratio(chi_square, len(e) - fit.sensitivity.shape[1])
    rms = [root_mean_square(at.innovations(run)) for run in range(len(filters))]
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (birge, "1", "Birge ratio of the innovations"),
        "innovation_rms": (rms, "rad", "RMS of the one-step prediction errors"),
    }
    result = fit.problem.identification(method, fit.values, covariance, noises, extra)
    forces = [random_force_of_ratio(ratio, frequency, method.random_force) for ratio in ratios]
    result = result.assign(random_force_variables(forces, filters))
    correlation = autocorrelation(e, min(MOST_LAGS, len(e) - 1))
    white = described("innovations", {"autocorrelation": correlation})
    result = result.assign(white).assign_coords(lag=np.arange(1, 1 + len(correlation)))
    orders = ", ".join(str(len(filter_) - 1) for filter_ in filters)
    return result.assign_attrs(noise_model=f"autoregression of order {orders}, with a random force")
