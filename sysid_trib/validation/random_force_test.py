"""Tests of a residual motion: a random force, or a force that depends on angle, speed, amplitude or time.

If few cycles show the random force, the gain of columns without effect is not a chi-square, because they take
much of the information on its size. Simulated records of the model without them calibrate it (parametric
bootstrap about the same path).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import UsageError
from sysid_trib.likelihood import sensor_noise, variance_ratio
from sysid_trib.motion_fit import bands, kalman, linearised
from sysid_trib.motion_fit.innovations import TrackedRecord, track
from sysid_trib.results import signal_scale, variables
from sysid_trib.results.random_force import RandomForce, random_force_of
from sysid_trib.validation.residuals import FollowedRuns

NULL_DRAWS = 60
# Longer records are decimated to this number of samples, but not below this number per period.
MOST_SAMPLES, LEAST_PER_PERIOD = 8000, 20
ON = ("angle", "speed", "amplitude", "time", "any")
ASPECTS, SIZE_ON = ("force", "size"), ("amplitude", "speed", "time")
NUMBERS = ("p_value", "chi_square", "degrees_of_freedom", "likely_density", "density_p_value")
# Distances from the most likely ratio at which likelihoods are computed, in standard errors of its logarithm;
# below them the distances double, down to this number of e-folds, and then to a ratio of zero.
NEAR, E_FOLDS = np.array([-3.0, -1.5, 0.0, 1.5, 3.0]), 12.0


@signal_scale.in_units_of_the_motion
def random_force_dependence(
    decay: xr.Dataset, result: xr.Dataset, run: int = 0, *, seed: int = 0
) -> xr.Dataset:
    """Test whether a random force depends on angle, speed, amplitude or time.

    Parameters
    ----------
    decay, result : Dataset
        `angle(time)` of a run, and an identification of it with a random force.
    run : int
        Index of the run of the result that the decay is.
    seed : int
        Seed of the simulated records that calibrate the test.

    Returns
    -------
    Dataset
        `p_value` of a random force independent of motion and time (the smaller of both aspects, Bonferroni).
        Over `aspect` (the `force` itself, and the `size` of its random part) and `on` (angle, speed,
        amplitude, time, any): `dependence_p_value`, nan if not tested. For the force on any: `chi_square`,
        `degrees_of_freedom`. `likely_density` ((rad/s^2)^2/Hz), and `density_p_value` of the result's
        density. Attribute `every`: the decimation.

    Raises
    ------
    UsageError
        The result has no random force.
    DecayError
        The motion does not converge to the record.

    Notes
    -----
    The force is tested by the gain in likelihood due to accelerations that depend on the motion
    (`trial_forces`), with free start, sensor's zero and model parameters; the ratio of the two variances is
    free with and without them. The size is tested by `size_p_values`. Simulated records of the linear model
    calibrate both.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, 9.91)
    >>> record = st.simulate(model, np.arange(0.0, 15.0, 0.02), angle=0.3, random_force=1e-3, seed=0)
    >>> decay = record[["angle"]] + np.random.default_rng(0).normal(0.0, 1e-4, 750)
    >>> result = st.identify(decay, "zeta", st.methods.Direct(random_force="estimated"))
    >>> bool(st.validation.random_force_dependence(decay, result).p_value > 0.01)
    True
    """
    if not random_force_of(result, run):
        raise UsageError("This identification has no random force; take random_force='estimated'.")
    return dependence_on_motion(FollowedRuns({run: decay}, result), run, seed)


def dependence_on_motion(followed: FollowedRuns, run: int, seed: int = 0) -> xr.Dataset:
    """Compute `random_force_dependence` of the residual motion, even if the result has no random force.

    The test always has its own random force, in addition to the sensor's noise of the result's colour.
    """
    decay, result = followed.runs[run], followed.result
    samples, step = decay.sizes["time"], float(np.median(np.diff(decay.time.values)))
    per_period = 2.0 * np.pi / float(result.asymptotic_frequency) / step
    every = max(1, min(-(-samples // MOST_SAMPLES), int(per_period / LEAST_PER_PERIOD)))
    tracked = followed.tracked(run) if every == 1 else track(decay, result, run, every)
    w = tracked.model.reference_frequency
    tau = w * (tracked.time - tracked.time[0])
    by_column, depends_on = linearised.trial_forces(tracked.linear, tau)
    # A change of the frequency, without the impulses within a step.
    linear = _with_parameters(tracked, result, stiffness=-by_column[:, :, :1])
    # All parameters are free.
    null = kalman.likely_ratio(linear)
    records = _records_of_noise(linear, null.ratio, np.random.default_rng(seed))
    trial = trial_model(linear, by_column, records)
    sets = {on: np.flatnonzero(depends_on == on) for on in ("angle", "speed", "time")}
    gains = _likelihood_gains(trial, sets | {"any": np.arange(len(depends_on))}, null)
    untested = dict.fromkeys(ON, float("nan"))
    of_force = untested | {on: p_value for on, (_, _, p_value) in gains.items()}
    # Free coefficients may leave no random force, and then no size to test.
    of_size = untested | dict.fromkeys((*SIZE_ON, "any"), 1.0)
    if null.ratio > 0.0:
        of_size |= _size_p_values(trial, null.ratio, tau)
    p_value = min(1.0, 2.0 * min(of_force["any"], of_size["any"]))
    p_values = [[of_aspect[on] for on in ON] for of_aspect in (of_force, of_size)]
    chi_square, columns, _ = gains["any"]
    density = RandomForce.density_of(null.ratio * null.variance, w)
    deviances = [linear.rows(ratio).restricted_deviance()[0] for ratio in (tracked.ratio, null.ratio)]
    of_density = scipy.stats.chi2.sf(max(0.0, deviances[0] - deviances[1]), 1)
    numbers = (p_value, chi_square, columns, density, of_density)
    return dependence(numbers, p_values).assign_attrs(every=every)


def dependence(numbers: Sequence[float], p_values: ArrayLike) -> xr.Dataset:
    """Return the Dataset of `random_force_dependence` from `NUMBERS` and (aspect, on) p-values."""
    values = dict(zip(NUMBERS, numbers, strict=True)) | {"dependence_p_value": p_values}
    return xr.Dataset(variables.described("random_force", values), {"aspect": list(ASPECTS), "on": list(ON)})


def _with_parameters(tracked: TrackedRecord, result: xr.Dataset, *, stiffness: Array) -> kalman.LinearModel:
    """Return the record about the smoothed motion, with columns for all free parameters of its model.

    `stiffness` : increment of x and v at the end of a step due to the acceleration -x, (step, 2, 1).
    """
    offered, covariance = bands.parameters_of(result)
    kept = [at for at, name in enumerate(offered) if name in tracked.model.coefficients]
    shapes: list[str] = []
    if "shape_standard_error" in result:
        errors = result.shape_standard_error
        shapes = errors.shape_parameter.values[errors.values > 0.0].tolist()
    names = (*(offered[at] for at in kept), *shapes)
    linear = tracked.linear_about(tracked.linear.path, tracked.zero, names)
    # Directions in which parameters were free, without fixed or tied ones.
    covariance = covariance[np.ix_([*kept, -1], [*kept, -1])]
    size = np.sqrt(np.diag(covariance))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    # Relative variance below which a direction of the parameters was held or tied.
    free = size[:, None] * vectors[:, values > 1e-12]
    basis = scipy.linalg.block_diag(free[:-1], np.eye(linear.start.shape[1] - len(kept)))
    by_column = linear.by_column @ basis
    by_column[:, :2, : free.shape[1]] += stiffness * free[-1]
    return replace(
        linear,
        start=linear.start @ basis,
        by_column=by_column,
        observed_parameters=linear.observed_parameters @ basis,
    )


def _records_of_noise(linear: kalman.LinearModel, ratio: float, random: np.random.Generator) -> Array:
    """Return simulated noise records, (sample, draw), in units of the innovations of the sensor's noise."""
    random_walk = linearised.random_walk_about(linear, ratio, random, NULL_DRAWS)
    # Coloured noise depends on its past before the first sample.
    past = sensor_noise.memory_samples(linear.sensor_filter)
    white = random.standard_normal((past + len(random_walk), NULL_DRAWS))
    return np.asarray(random_walk + scipy.signal.lfilter([1.0], linear.sensor_filter, white, axis=0)[past:])


class TrialModel(NamedTuple):
    """A record with nuisances, trial columns and noise records, as one linear model.

    Attributes
    ----------
    linear : LinearModel
        Linear model whose columns are these three kinds, in this order.
    ends : (int, int)
        Indices of the ends of the first two kinds.
    """

    linear: kalman.LinearModel
    ends: tuple[int, int]


def _white(trial: TrialModel, ratio: float) -> tuple[Array, Array, Array, float]:
    """Return rows at a ratio: nuisances, trial columns, records (the measured first); log determinant."""
    rows = trial.linear.rows(ratio)
    nuisances, tried, draws = np.split(rows.design, trial.ends, axis=1)
    return nuisances, tried, np.column_stack([rows.target, draws]), rows.log_determinant


def _deviances(trial: TrialModel, sets: Sequence[Index], ratio: float) -> Array:
    """Return minus twice the log likelihood at a ratio, with variance and columns profiled.

    First without the trial columns, then with each of the sets: (1 + set, 1 + draw).
    """
    nuisances, tried, records, log_determinant = _white(trial, ratio)
    basis = orthonormal(nuisances)
    rest = records - basis @ (basis.T @ records)
    squares = [np.sum(rest**2, axis=0)]
    for index in sets:
        further = tried[:, index] - basis @ (basis.T @ tried[:, index])
        squares.append(squares[0] - np.sum((orthonormal(further).T @ rest) ** 2, axis=0))
    return np.asarray(len(rest) * np.log(np.maximum(squares, 1e-300)) + log_determinant)


def trial_model(linear: kalman.LinearModel, by_column: Array, records: Array) -> TrialModel:
    """Return a record with columns that act in each step, (step, 2, column), and records (sample, draw)."""
    (size, nuisances), (_, states, tried), draws = linear.start.shape, by_column.shape, records.shape[1]
    by = np.pad(by_column, ((0, 0), (0, size - states), (0, draws)))
    whole = replace(
        linear,
        start=np.pad(linear.start, ((0, 0), (0, tried + draws))),
        by_column=np.concatenate([linear.by_column, by], axis=2),
        observed_parameters=np.hstack([np.pad(linear.observed_parameters, ((0, 0), (0, tried))), records]),
    )
    return TrialModel(whole, (nuisances, nuisances + tried))


def _likelihood_gains(
    trial: TrialModel, sets: Mapping[str, Index], null: variance_ratio.VarianceRatio
) -> dict[str, tuple[float, int, float]]:
    """Return chi-square of each set of columns given the nuisances, number of columns, p-value of no effect.

    The chi-square is the gain, scaled to the expected mean (Bartlett 1937). Columns that are combinations of
    the nuisances are not counted. `null` : model without the columns, from which the noise records were
    drawn; if it has no random force, the fit with the columns has none either.
    """
    nuisances, tried, _, _ = _white(trial, null.ratio)
    size = np.linalg.norm(tried, axis=0)
    unit = tried / np.where(size > 0.0, size, 1.0)
    basis = orthonormal(nuisances)
    _, r, order = scipy.linalg.qr(unit - basis @ (basis.T @ unit), mode="economic", pivoting=True)
    # Least fraction of a column outside of the others for an additional column.
    further = order[np.abs(np.diag(r)) > 1e-2]
    chosen = {name: np.intersect1d(index, further) for name, index in sets.items()}
    least = _deviances(trial, list(chosen.values()), 0.0)
    if null.ratio > 0.0:
        error = float(np.clip(np.nan_to_num(null.relative_error, nan=1.0), 0.02, 1.0))
        doublings = int(np.ceil(np.log2(E_FOLDS / (3.0 * error))))
        far = NEAR[0] * 2.0 ** np.arange(max(1, doublings), 0, -1)
        logarithms = float(np.log(null.ratio)) + error * np.concatenate([far, NEAR])
        table = [_deviances(trial, list(chosen.values()), float(ratio)) for ratio in np.exp(logarithms)]
        least = np.minimum(_least(logarithms, np.array(table)), least)
    tested = dict.fromkeys(chosen, (0.0, 0, 1.0))
    for (name, index), gain in zip(chosen.items(), np.maximum(least[0] - least[1:], 0.0), strict=True):
        if count := len(index):
            chi_square = float(gain[0] * count / np.mean(gain[1:]))
            tested[name] = chi_square, count, float(scipy.stats.chi2.sf(chi_square, count))
    return tested


def orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis of the span of some columns."""
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(np.linalg.qr(columns / np.where(size > 0.0, size, 1.0))[0])


def _least(logarithms: Array, table: Array) -> Array:
    """Return the minimum of each curve over the ratios, by the parabola through its three lowest values."""
    at = np.clip(np.argmin(table, axis=0), 1, len(table) - 2)
    x = [logarithms[at + side] for side in (-1, 0, 1)]
    y = [np.take_along_axis(table, (at + side)[None], axis=0)[0] for side in (-1, 0, 1)]
    left, right = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = (right - left) / (x[2] - x[0])
    curved = np.where(curvature > 0.0, curvature, 1.0)
    middle = 0.5 * (x[0] + x[1])
    best = np.clip(middle - 0.5 * left / curved, x[0], x[2])
    value = y[0] + (best - x[0]) * (left + curvature * (best - x[1]))
    return np.where(curvature > 0.0, value, np.min(table, axis=0))


def _size_p_values(trial: TrialModel, ratio: float, tau: Array) -> dict[str, float]:
    """Return p-values of a random force of constant size, for each possible dependence and for `any`.

    The statistic is the mean of amplitude, speed over amplitude, or time, over the steps, each weighted by
    the squared smoothed disturbance r' Q r (Durbin and Koopman 2012, 4.5); together they give Hotelling's
    T^2. Noise records are drawn at this ratio. `tau` : reference frequency times time, (sample,).
    """
    nuisances, _, records, _ = _white(trial, ratio)
    basis = orthonormal(nuisances)
    white = records - basis @ (basis.T @ records)
    linear, _ = trial
    path = linear.path
    gain, variance = linear.gains(ratio)
    source = linear.observed_states[:, :, None] * (white / np.sqrt(variance)[:, None])[:, None, :]
    # The states of coloured noise are not part of the motion.
    smoothed = linear.recursion(gain, source, backward=True)[1:, : path.shape[1]]
    weights = np.einsum("kad,kab,kbd->kd", smoothed, linear.steps.diffusion, smoothed, optimize=True)
    amplitude = np.hypot(path[:, 0], path[:, 1])
    on = np.stack([amplitude, np.abs(path[:, 1]) / np.maximum(amplitude, 1e-300), tau])
    on = 0.5 * (on[:, :-1] + on[:, 1:])
    on = (on - on.mean(axis=1, keepdims=True)) / np.maximum(on.std(axis=1, keepdims=True), 1e-300)
    means = on @ weights / np.sum(weights, axis=0)
    measured, null = means[:, 0], means[:, 1:]
    size, draws = null.shape
    excess = measured - null.mean(axis=1)
    # Mean and covariance come from `draws` records: the measured one differs from them by slightly more.
    covariance = (1.0 + 1.0 / draws) * np.cov(null)
    z = excess / np.sqrt(np.diag(covariance))
    p_values = 2.0 * scipy.stats.t.sf(np.abs(z), draws - 1)
    squared = float(excess @ np.linalg.pinv(covariance) @ excess)
    joint = scipy.stats.f.sf(squared * (draws - size) / (size * (draws - 1)), size, draws - size)
    return {**dict(zip(SIZE_ON, p_values.tolist(), strict=True)), "any": float(joint)}
