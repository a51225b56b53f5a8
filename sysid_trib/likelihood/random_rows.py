"""Regression along the smoothed motion of a record with a random force, in both noises' covariance.

The motions, smoothed with both noises, are those of `fit_model`; the ratio of the two variances is that of
most restricted likelihood there, with the colour of the sensor's noise that makes the rows likeliest.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import SimulationError
from sysid_trib.likelihood.colour import MAX_COLOUR, colour_above, most_likely_colour, of_order
from sysid_trib.likelihood.exact_motions import (
    SLIPPED,
    along_exact_motions,
    first_motion,
    free_motion,
    missed_by,
)
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.model_fit import fit_model
from sysid_trib.likelihood.paths import RecordPath
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.likelihood.ratio_posterior import NOTHING_OPEN, average_over_ratios
from sysid_trib.likelihood.rows import Regression
from sysid_trib.likelihood.sensor_noise import NoiseModel
from sysid_trib.likelihood.start_model import (
    ABOVE,
    likelihood_by_colour,
    recoloured,
    refitted,
    with_sensor_noises,
)
from sysid_trib.likelihood.variance_ratio import (
    VarianceRatio,
    WhiteRows,
    held_ratio,
    ratio_span,
    rows_by_ratio,
    variance_ratio,
)
from sysid_trib.records.smoothing import smooth
from sysid_trib.simulation.initial_conditions import FittedMotion


def with_random_force(
    begun: Regression, active: Mask, option: RandomForceOption
) -> tuple[Regression, bool, tuple[Array, Array]]:
    """Estimate forces, a random force and the sensor's noise, along motions that are smoothed with them.

    Parameters
    ----------
    begun : Regression
        With a first estimate.
    active : (force,) array of bool
        Forces that are in the model.
    option : "estimated" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, held.

    Returns
    -------
    regression : Regression
        Along the smoothed motions, with noises; of it the last solution is still to be taken.
    settled : bool
        Whether motions and estimate have stopped moving.
    further : pair of array of float
        Of coefficients and reference frequency: what moves the last solution, and is added to its covariance,
        since the ratios of the two variances are not known exactly.

    Raises
    ------
    DecayError
        The rows are degenerate.
    """
    estimated = isinstance(option, str)
    # What a driven model lacks is no noise of the sensor, whatever its colour.
    of_colour = estimated and not any(path.inputs for path in begun.paths)
    paths = [replace(path, density=None if estimated else float(option)) for path in begun.paths]
    if of_colour:
        paths = [replace(path, sensor=_sensor_above(path)) for path in paths]
    model = fit_model(
        paths,
        begun.trials,
        frequency_free=begun.frequency_free,
        first=np.append(begun.coefficients, 0.0),
        constraints=begun.constraints.keep(active),
    )
    model = refitted(model)
    if of_colour:
        model = _with_colours_alone(recoloured(model, restricted=True))
    regression = begun.about([rows.path for rows in model.rows], model.coefficients, operators=model.rows)
    noises = tuple(_noises(regression, active, model, run, of_colour) for run in range(len(paths)))
    regression = replace(regression, noises=noises)
    if not any(noise.ratio for noise in noises):
        regression = along_exact_motions(regression, regression.solve(active), active) or regression
    further = _average_by_ratios(regression, active) if estimated else NOTHING_OPEN
    if not regression.motions:
        motions = [_motion_of(path, regression, active) for path in regression.paths]
        regression = replace(regression, motions=tuple(motions))
    return regression, model.settled, further


def _sensor_above(path: RecordPath) -> NoiseModel:
    """Noise of the sensor by the spectrum above what a path follows; as it is where that is white."""
    tau = path.form.tau
    found = colour_above(path.angle - smooth(tau, path.angle)[0], tau, ABOVE)
    return found if len(found.filter_) > 1 else path.sensor


def _colour_alone(model: FittedModel, run: int, order: int) -> tuple[NoiseModel, float]:
    """Most likely noise of the sensor where there is no random force, of an order, and its deviance."""
    by_colour = likelihood_by_colour(model, run, restricted=True, alone=True)
    path = model.rows[run].path
    starts = [of_order(start, order) for start in (np.ones(1), path.sensor.filter_)]
    filter_, deviance = most_likely_colour(
        lambda colour: by_colour(colour).deviance, starts, samples=float(path.form.rows)
    )
    return NoiseModel(float(np.sqrt(by_colour(filter_).variances[0])), filter_), deviance


def _with_colours_alone(model: FittedModel) -> FittedModel:
    """The model with a colour of one order more where that alone explains what a random force does.

    Then a random force has to be likely with that colour.
    """
    sensors = list[NoiseModel]()
    for run, rows in enumerate(model.rows):
        sensor = rows.path.sensor
        if model.noises(run)[0] and len(sensor.filter_) <= MAX_COLOUR:
            alone, deviance = _colour_alone(model, run, len(sensor.filter_))
            # One parameter more, and a random force less.
            if deviance < likelihood_by_colour(model, run, restricted=True)(sensor.filter_).deviance:
                sensor = alone
        sensors.append(sensor)
    same = all(a is rows.path.sensor for a, rows in zip(sensors, model.rows, strict=True))
    return model if same else with_sensor_noises(model, sensors)


def _noises(
    regression: Regression, active: Mask, model: FittedModel, run: int, of_colour: bool
) -> VarianceRatio:
    """Noises of a run of most restricted likelihood, or by the random force that is given.

    The gain of the random force is over noise of the sensor alone in a colour of its own, of the same order:
    a higher one could resonate as the motion does.
    """
    path, rows = regression.paths[run], _by_ratio(regression, run, active)
    if path.given_force is not None:
        return held_ratio(rows, path.given_force, path.sensor.innovation**2)
    duration, step = float(np.ptp(path.form.tau)), float(np.median(np.diff(path.form.tau)))
    noise, filter_ = variance_ratio(rows, *ratio_span(duration, step), path.ratio), path.sensor.filter_
    if not of_colour or len(filter_) == 1 or not noise.ratio:
        return noise
    with_force = likelihood_by_colour(model, run, restricted=True)(filter_).deviance
    return replace(noise, gain=max(0.0, _colour_alone(model, run, len(filter_) - 1)[1] - with_force))


def _by_ratio(regression: Regression, run: int, active: Mask) -> Callable[[float], WhiteRows]:
    """Rows of a run by the ratio of its two variances, with the columns that it has."""
    rows, constraints = regression.rows[run], regression.constraints.keep(active)
    target, *columns = regression.free_table(run, constraints).T
    table = np.asfortranarray(np.stack([*(column for column in columns if np.any(column)), target], axis=1))
    known = rows.path.settings.level_rows, rows.path.sensor.innovation
    return rows_by_ratio(rows.band, rows.path.form.gram, table, known=known)


def _average_by_ratios(regression: Regression, active: Mask) -> tuple[Array, Array]:
    """Shift and further covariance of coefficients and frequency over the open ratios of each run."""

    def solved(at: int, ratio: VarianceRatio) -> tuple[Array, Array]:
        """With another ratio of a run, and the covariance."""
        noises = *regression.noises[:at], ratio, *regression.noises[at + 1 :]
        solution = replace(regression, noises=noises).solve(active)
        return solution.values, solution.covariance

    shift, covariance = NOTHING_OPEN
    for at, path in enumerate(regression.paths):
        rows, noise = _by_ratio(regression, at, active), regression.noises[at]
        by, further = average_over_ratios(rows, noise, len(path.time), partial(solved, at))
        shift, covariance = shift + by, covariance + further
    return shift, covariance


def _motion_of(path: RecordPath, regression: Regression, active: Mask) -> FittedMotion:
    """The free motion of a run's model where it follows the record, else the smoothed one."""
    smoothed, coefficients = first_motion(path), np.where(active, regression.coefficients, 0.0)
    try:
        free = free_motion(path, regression.trials, coefficients, active, smoothed, near=True)
    except SimulationError:
        return smoothed
    follows = missed_by(path, free, regression.trials, coefficients) <= SLIPPED
    return free if follows else smoothed
