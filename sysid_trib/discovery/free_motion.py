"""Free motion of a fitted model and its residual, and the model as an identification."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.paths import RecordPath
from sysid_trib.errors import SimulationError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import random_force_variables
from sysid_trib.likelihood.sensor_noise import NoiseModel
from sysid_trib.likelihood.variance_ratio import p_value_of_gain
from sysid_trib.records.inputs import KnownInput
from sysid_trib.records.runs import one_or_all
from sysid_trib.results.random_force import RandomForce
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.results.variables import start_variables
from sysid_trib.simulation.initial_conditions import FittedMotion, fit_start
from sysid_trib.simulation.internal_states import begun_after
from sysid_trib.simulation.model import Model, sensor_error
from sysid_trib.simulation.motions import FEW_STEPS_A_PERIOD


@dataclass(frozen=True)
class FreeMotion:
    """Residual of a run from the fitted motion of a model without a random force.

    Attributes
    ----------
    time : (sample,) array of float, s
    motion : FittedMotion
        Motion of the model, with its start and the sensor's zero.
    residual : (sample,) array of float, rad
        Record minus model; the model includes the sensor's errors and its zero.
    noise : NoiseModel
        Noise of the sensor.
    model : Model
    inputs : mapping of str to KnownInput
        Inputs of the run by name.
    """

    time: Array
    motion: FittedMotion
    residual: Array
    noise: NoiseModel
    model: Model
    inputs: Mapping[str, KnownInput]

    @property
    def moving(self) -> int:
        """Samples before the motion stops."""
        if not np.isfinite(self.motion.stop_time):
            return len(self.time)
        return max(2, int(np.searchsorted(self.time, self.motion.stop_time)))

    @property
    def over_noise(self) -> float:
        """RMS residual over the sensor's noise."""
        return root_mean_square(self.residual) / self.noise.standard_deviation


def model_of_fit(model: FittedModel) -> Model:
    """Return forces, sensor errors, shapes and frequency of a fit whose paths have the fitted frequency."""
    held = model.rows[0].path.held
    trials = [*model.trials, *(trial for trial, _ in held)]
    library = ForceLibrary("model", tuple(trial.force for trial in trials))
    values = [*model.coefficients.tolist(), *(coefficient for _, coefficient in held)]
    coefficients = dict(zip(library.symbols, values, strict=True))
    shapes = {k: value for trial in trials for k, value in trial.shapes.items()}
    return Model(library, coefficients, model.rows[0].path.frequency, shapes)


def free_motions(model: FittedModel) -> list[FreeMotion]:
    """Return the free motion of a model in each of its runs."""
    fit = model_of_fit(model)
    return [free_motion(fit, rows.path, model.sensor(at)) for at, rows in enumerate(model.rows)]


def free_motion(model: Model, path: RecordPath, noise: NoiseModel) -> FreeMotion:
    """Compute the free motion of a model near a record; states and memory continue from the record before."""
    if (before := path.before) is not None:
        past = before.form.tau, *before.at_samples
        begun = (begun_after(force, *past, model.shapes, before.elapsed) for force in model.library)
        model = replace(model, library=replace(model.library, forces=tuple(begun)))
    # In the formulas, `t` starts at the first sample of this motion.
    later = model.library.counted_from(float(path.time[0]) - path.origin)
    acting = replace(
        model,
        library=later,
        coefficients={f.symbol: model.coefficients[f.symbol] for f in model.forces},
        inputs=path.inputs,
    )
    x, v = path.at_samples
    error, *_ = sensor_error(model, path.elapsed, x, v, ())
    begin = float(x[0]), float(v[0] * path.frequency)
    # `validation.residuals.fitted_motion` starts from an identification. Here, states and memory continue
    # from the path before a held-out part.
    try:
        # Limit the steps, so that a very stiff model fails early.
        motion = fit_start(acting, path.time, path.angle - error, begin, most_steps=FEW_STEPS_A_PERIOD)
    except SimulationError:
        # A model that cannot be simulated gets the motion of the smoothed record.
        motion = FittedMotion(*begin, 0.0, x, v, np.nan, {}, None)
    error, *_ = sensor_error(model, path.elapsed, motion.x, motion.v, ())
    residual = path.angle - motion.offset - error - motion.x
    return FreeMotion(path.time, motion, residual, noise, model, path.inputs)


def random_forces(model: FittedModel) -> list[RandomForce]:
    """Return the random force of a model in each of its runs."""
    of_fit, frequency = model.likelihood, model.rows[0].path.frequency
    densities = [RandomForce.density_of(q, frequency) for q in (of_fit.ratios * of_fit.variances).tolist()]
    estimates = zip(densities, of_fit.ratio_errors, of_fit.gains, strict=True)
    return [RandomForce(q, q * error, p_value_of_gain(gain)) for q, error, gain in estimates]


def total_covariance(model: FittedModel, widening: float, model_error: Array | None) -> Array:
    """Return the covariance of coefficients and frequency due to the noise, widened, and to the model."""
    covariance = widening**2 * model.covariance_with_frequency()
    return covariance if model_error is None else covariance + np.diag(model_error**2)


def model_identification(
    model: FittedModel,
    motions: Sequence[FreeMotion],
    runs: Sequence[xr.Dataset],
    widening: float = 1.0,
    model_error: Array | None = None,
) -> xr.Dataset:
    """Return a model as an identification whose errors include the random force of each run.

    `widening` : factor of the errors due to noise; `model_error` : (trial + 1,) additional errors of the
    coefficients and the frequency (rad/s), due to the model.
    """
    from sysid_trib.methods.direct import Direct

    identified = model_of_fit(model)
    levels = [motion.noise.standard_deviation for motion in motions]
    expected = root_mean_square([rows.path.sensor.standard_deviation for rows in model.rows])
    starts = [(of_run.motion.angle, of_run.motion.rate) for of_run in motions]
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (root_mean_square(levels) / expected, "1", "sensor's noise over that of its spectrum"),
        **start_variables(starts, [of_run.motion.offset for of_run in motions]),
    }
    fixed = {trial.force.symbol: coefficient for trial, coefficient in model.rows[0].path.held}
    values = np.append(model.coefficients, list(fixed.values()))
    # A held coefficient has no error; the last row is that of the frequency.
    covariance = np.zeros((len(values) + 1, len(values) + 1))
    free = [*range(len(model.trials)), len(values)]
    covariance[np.ix_(free, free)] = total_covariance(model, widening, model_error)
    shape_errors = {name: widening * error for name, error in model.shape_errors().items()}
    estimate = Estimate(values, covariance, identified.reference_frequency, levels, extra, shape_errors)
    # There is no held-out part where it was fitted.
    frequency = None if model.frequency_free else identified.reference_frequency
    method = Direct(frequency, shapes=dict(identified.shapes), constraints=fixed, random_force="estimated")
    library = identified.library
    result = identification(method, one_or_all(list(runs)), library, estimate, offered=library)
    result = Constraints(fixed).marked(result)
    filters = [rows.path.sensor.filter_ for rows in model.rows]
    return result.assign(random_force_variables(random_forces(model), filters))
