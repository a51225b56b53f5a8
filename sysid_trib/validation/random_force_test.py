"""Tests of what is left of a motion: a random force, or one on angle, speed, amplitude or time."""

from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.stats import chi2, f as f_distribution, t as t_distribution

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.likelihood.random_force import DENSITY_UNITS, RandomForce, random_force_of
from sysid_trib.likelihood.variance_ratio import VarianceRatio
from sysid_trib.motion_fit.bands import parameters_of
from sysid_trib.motion_fit.kalman import LinearModel, likely_ratio
from sysid_trib.motion_fit.linearised import Derivatives, trial_forces
from sysid_trib.motion_fit.tracked import FollowedRuns, TrackedRecord, linear_about, track
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import Variables, variable
from sysid_trib.validation.likelihood_gain import (
    TrialModel,
    likelihood_gains,
    orthonormal,
    simulated_records,
    trial_model,
)

SIZE_ON = ("amplitude", "speed", "time")


def size_p_values(trial: TrialModel, ratio: float, tau: Array) -> dict[str, float]:
    """P-values of a random force whose size depends on nothing, by what it may depend on, and of `any`.

    Parameters
    ----------
    trial : TrialModel
        With records of noise alone at the ratio.
    ratio : float
        Of the two variances.
    tau : (sample,) array of float
        Instants, reference frequency times time.

    Notes
    -----
    The statistic is the mean of amplitude, speed over amplitude, or time, over the steps, each weighted by
    the squared smoothed disturbance r' Q r (Durbin and Koopman 2012, 4.5); together they make Hotelling's
    T^2.
    """
    weights = _disturbances(trial, ratio)
    path = trial.linear.path
    amplitude = np.hypot(path[:, 0], path[:, 1])
    on = np.stack([amplitude, np.abs(path[:, 1]) / np.maximum(amplitude, 1e-300), tau])
    on = 0.5 * (on[:, :-1] + on[:, 1:])
    on = (on - on.mean(axis=1, keepdims=True)) / np.maximum(on.std(axis=1, keepdims=True), 1e-300)
    means = on @ weights / np.sum(weights, axis=0)
    measured, null = means[:, 0], means[:, 1:]
    draws = null.shape[1]
    excess = measured - null.mean(axis=1)
    # Mean and covariance are those of `draws` records: the measured one differs from them by a bit more.
    covariance = (1.0 + 1.0 / draws) * np.cov(null)
    z = excess / np.sqrt(np.diag(covariance))
    p_values = 2.0 * t_distribution.sf(np.abs(z), draws - 1)
    size = len(excess)
    squared = float(excess @ np.linalg.pinv(covariance) @ excess)
    joint = f_distribution.sf(squared * (draws - size) / (size * (draws - 1)), size, draws - size)
    return {**dict(zip(SIZE_ON, p_values.tolist(), strict=True)), "any": float(joint)}


def _disturbances(trial: TrialModel, ratio: float) -> Array:
    """Squared smoothed disturbances of the steps, the measured record first: (step, 1 + draw)."""
    nuisances, _, records, _ = trial.white(ratio)
    basis = orthonormal(nuisances)
    white = records - basis @ (basis.T @ records)
    linear = trial.linear
    gain, variance = linear.gains(ratio)
    observed, _ = linear.with_sensor_states
    source = observed[:, :, None] * (white / np.sqrt(variance)[:, None])[:, None, :]
    # The states of coloured noise are no motion.
    smoothed = linear.recursion(gain, source, backward=True)[1:, : linear.path.shape[1]]
    return np.asarray(np.einsum("kad,kab,kbd->kd", smoothed, linear.steps.diffusion, smoothed, optimize=True))


NULL_DRAWS = 60
# Of longer records every second sample is taken (third, ...), but no fewer than so many a period.
MOST_SAMPLES, LEAST_PER_PERIOD = 8000, 20
ON = ("angle", "speed", "amplitude", "time", "any")
ASPECTS = ("force", "size")


@in_units_of_the_motion
def random_force_dependence(
    decay: xr.Dataset, result: xr.Dataset, run: int = 0, *, seed: int = 0
) -> xr.Dataset:
    """Test whether a random force depends on angle, speed, amplitude or time: then it is no random force.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        An identification of it with a random force.
    run : int
        Which of the result's runs the decay is.
    seed : int
        Of the simulated records that calibrate the test.

    Returns
    -------
    Dataset
        `p_value` of a random force that depends on nothing (the least of both aspects, Bonferroni). Over
        `aspect` (the `force` itself, and the `size` of what is random) and `on` (angle, speed, amplitude,
        time, any): `dependence_p_value`, nan where it is not tested. Of the force on any: `chi_square`,
        `degrees_of_freedom`. `likely_density` ((rad/s^2)^2/Hz), and `density_p_value` of the result's.
        attrs: `every`, of how many samples one was taken.

    Raises
    ------
    UsageError
        The result has no random force.
    DecayError
        The motion does not settle on the record.

    Notes
    -----
    The force: by how much accelerations that go with the motion (`trial_forces`) raise the likelihood, where
    the start, the sensor's zero and all parameters of the model are free with them, and the ratio of the
    two variances is free with and without. The size: `size_p_values`. Records that are simulated in the
    linear model calibrate both.
    """
    if not random_force_of(result, run):
        raise UsageError("This identification has no random force; take random_force='estimated'.")
    return dependence_on_motion(FollowedRuns({run: decay}, result), run, seed)


def dependence_on_motion(followed: FollowedRuns, run: int, seed: int = 0) -> xr.Dataset:
    """`random_force_dependence`, of what is left of the motion even where the result has no random force.

    The test has a random force of its own in any case, besides the sensor's noise of the result's colour.
    """
    decay, result = followed.runs[run], followed.result
    every = _every(decay, result)
    tracked = followed.tracked(run) if every == 1 else track(decay, result, run, every)
    tau = tracked.model.reference_frequency * (tracked.time - tracked.time[0])
    by_column, depends_on = trial_forces(tracked.linear, tau)
    # As a change of the frequency does, but what pushes the motion within a step has no part in it.
    linear = _with_parameters(tracked, result, stiffness=-by_column[:, :, :1])
    # All parameters are free.
    null = likely_ratio(linear)
    records = simulated_records(linear, null.ratio, NULL_DRAWS, np.random.default_rng(seed))
    trial = trial_model(linear, by_column, records)
    sets = {on: np.flatnonzero(depends_on == on) for on in ("angle", "speed", "time")}
    gains = likelihood_gains(trial, sets | {"any": np.arange(len(depends_on))}, null)
    of_force = dict.fromkeys(ON, 1.0) | {on: gain.p_value for on, gain in gains.items()}
    # Free coefficients may leave no random force at all, and nothing that has a size.
    of_size = dict.fromkeys(ON, 1.0)
    if null.ratio > 0.0:
        of_size |= size_p_values(trial, null.ratio, tau)
    of_force["amplitude"] = of_size["angle"] = float("nan")
    p_value = min(1.0, 2.0 * min(of_force["any"], of_size["any"]))
    p_values = [[of_aspect[on] for on in ON] for of_aspect in (of_force, of_size)]
    text = "gain of the likelihood by forces that go with the motion"
    variables = {
        "p_value": variable((), p_value, "p-value of a random force that depends on nothing", "1"),
        "dependence_p_value": variable(
            ("aspect", "on"), p_values, "p-value of no dependence of the random force", "1"
        ),
        "chi_square": variable((), gains["any"].chi_square, text, "1"),
        "degrees_of_freedom": variable((), gains["any"].columns, "degrees of freedom", "1"),
        **_density_variables(linear, tracked, null),
    }
    return xr.Dataset(variables, {"aspect": list(ASPECTS), "on": list(ON)}, {"every": every})


def _every(decay: xr.Dataset, result: xr.Dataset) -> int:
    """Number of samples of which one is taken."""
    samples = decay.sizes["time"]
    step = float(np.median(np.diff(decay.time.values)))
    per_period = 2.0 * np.pi / float(result.asymptotic_frequency) / step
    return max(1, min(-(-samples // MOST_SAMPLES), int(per_period / LEAST_PER_PERIOD)))


def _with_parameters(tracked: TrackedRecord, result: xr.Dataset, *, stiffness: Array) -> LinearModel:
    """The record about the smoothed motion with columns for all that was free in the identification.

    `stiffness` is what the acceleration -x adds to x and v by the end of a step, (step, 2, 1).
    """
    model = tracked.model
    offered, covariance = parameters_of(result)
    kept = [at for at, name in enumerate(offered) if name in model.coefficients]
    names = (*(offered[at] for at in kept), *_fitted_shapes(result))
    by = Derivatives(names, frequency=False)
    linear = linear_about(tracked, tracked.linear.path, tracked.zero, by)
    free = _free_directions(covariance[np.ix_([*kept, -1], [*kept, -1])])
    count, directions = len(kept), free.shape[1]
    basis = np.zeros((by.count, directions + by.count - count))
    basis[:count, :directions] = free[:-1]
    basis[count:, directions:] = np.eye(by.count - count)
    by_column = linear.by_column @ basis
    by_column[:, :2, :directions] += stiffness * free[-1]
    return replace(
        linear,
        start=linear.start @ basis,
        by_column=by_column,
        observed_parameters=linear.observed_parameters @ basis,
    )


def _fitted_shapes(result: xr.Dataset) -> tuple[str, ...]:
    if "shape_standard_error" not in result:
        return ()
    errors = result.shape_standard_error
    return tuple(errors.shape_parameter.values[errors.values > 0.0].tolist())


def _free_directions(covariance: Array) -> Array:
    """Directions in which parameters were free, (parameter, direction): not where they are fixed or tied."""
    size = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(np.where(size > 0.0, size, 1.0), np.where(size > 0.0, size, 1.0))
    values, vectors = np.linalg.eigh(scaled)
    # Part of a variance below which a direction of the parameters was held or tied.
    return np.asarray(size[:, None] * vectors[:, values > 1e-12])


def _density_variables(linear: LinearModel, tracked: TrackedRecord, null: VarianceRatio) -> Variables:
    """The most likely density, and whether that in the result is as likely."""
    density = RandomForce.density_of(null.ratio * null.variance, tracked.model.reference_frequency)
    deviances = [linear.rows(ratio).restricted_deviance()[0] for ratio in (tracked.ratio, null.ratio)]
    return {
        "likely_density": variable((), density, "most likely density of the random force", DENSITY_UNITS),
        "density_p_value": variable(
            (), chi2.sf(max(0.0, deviances[0] - deviances[1]), 1), "p-value of the density in the result", "1"
        ),
    }
