"""Regression along the smoothed motion of a record that is pushed at random, in both noises' covariance.

The noise of the rows is the operator on the sensor's noise, plus integrals of the random force. The most
likely noise of the sensor (best linear unbiased prediction, Robinson 1991) is subtracted from the record:
that is the smoothed motion, and the columns are taken along it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve_banded
from scipy.signal import lfilter

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.noise.colour import NoisePair, sensor_colour
from sysid_trib.noise.random_force import RandomForce, RandomForceOption
from sysid_trib.noise.residual_noise import NoiseModel
from sysid_trib.noise.smoothing import smooth
from sysid_trib.noise.variance_ratio import VarianceRatio, WhiteRows, held_ratio, ratio_span, variance_ratio
from sysid_trib.regression.constraint_map import ConstraintMap
from sysid_trib.regression.linearisation import DeviationOperator, deviation_matrices
from sysid_trib.regression.problem import NearbyMotion, ReferenceTrajectory, RunRegression, Runs
from sysid_trib.regression.rows import Rows, run_weights, stack_rows, weak_rows
from sysid_trib.regression.solution import Solution, solve
from sysid_trib.regression.weak_form import cholesky_factor, covariance_band, whiten
from sysid_trib.trajectory_fit.refined_columns import has_slipped, simulated, step_in_errors

MAX_SMOOTHED_PATHS = 12
# Round in which the colour of the sensor's noise is estimated, by a motion that is no longer the first guess.
COLOUR_ROUND = 1
# Points of each sample's cell at which forces that jump are averaged.
POINTS_OF_CELL = 16
# Lines of the spectrum above the swing say what the sensor's noise is, within the swing's band it may differ:
# they count as so many samples.
DEGREES_OF_PRIOR = 5


@dataclass(frozen=True)
class PushedRegression:
    """A regression with a random force.

    Attributes
    ----------
    runs : tuple of RunRegression
        Along their smoothed motions, with `noises`.
    rows : Rows
        About these motions; of them the last solution is still to be taken.
    settled : bool
        Whether the estimate has stopped moving.
    """

    runs: Runs
    rows: Rows
    settled: bool


def regress_pushed(
    runs: Runs, active: Mask, constraints: ConstraintMap, option: RandomForceOption
) -> PushedRegression:
    """Estimate forces, a random force and the sensor's noise, along motions that are smoothed with them.

    Parameters
    ----------
    runs : tuple of RunRegression
        With a first estimate.
    active : (force,) array of bool
        Forces that are in the model.
    constraints : ConstraintMap
    option : "auto" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, held.

    Returns
    -------
    PushedRegression
        Where no random force is the most likely, along the free motion.

    Raises
    ------
    DecayError
        The rows are degenerate.
    """
    sensitivities: list[Array | None] = [None] * len(runs)
    settled = False
    for turn in range(MAX_SMOOTHED_PATHS):
        anchored = [_beside_motion(run, active, near) for run, near in zip(runs, sensitivities, strict=True)]
        runs, sensitivities = tuple(run for run, _ in anchored), [near for _, near in anchored]
        # Beside a density that is given, as in records that are simulated, the sensor's noise is white.
        colour = turn == COLOUR_ROUND and isinstance(option, str)
        pairs = [_with_noises(run, active, constraints, option, colour) for run in runs]
        runs, operators = tuple(run for run, _ in pairs), [operator for _, operator in pairs]
        rows = stack_rows(runs, [weak_rows(run, near) for run, near in zip(runs, operators, strict=True)])
        solution = solve(rows, runs[0], active, constraints)
        after = solution.applied_to(runs)
        settled = bool(np.all(np.abs(step_in_errors(runs, after, rows, solution)) <= 1.0))
        last = PushedRegression(runs, rows, settled)
        if settled and turn >= COLOUR_ROUND:
            break
        runs = _smoothed(after, operators, solution)
    return last


def _beside_motion(
    run: RunRegression, active: Mask, sensitivity: Array | None
) -> tuple[RunRegression, Array | None]:
    """A run with its path beside a free motion of its present model, where that follows the record."""
    problem, path = run.problem, run.reference
    features = problem.features(run.frequency)

    def columns(x: Array, v: Array) -> Array:
        acceleration = np.gradient(v, problem.form.tau)
        return features.cell_averages(problem.elapsed, x, v, acceleration, POINTS_OF_CELL)

    try:
        beside, sensitivity = simulated(run, active, sensitivity)
        followed = not has_slipped(beside)
    except SimulationError:
        followed = False
    if not followed:
        along = columns(path.x, path.v)
        return replace(run, reference=ReferenceTrajectory(path.x, path.v, along, exact=False)), None
    free = beside.reference
    k = (run.frequency / problem.nominal_frequency) ** 2
    along = columns(free.x, free.v)
    near = NearbyMotion(free.x, k * (free.x + along @ beside.coefficients))
    if run.noises is None:
        # The first path: the free motion itself.
        reference = ReferenceTrajectory(free.x, free.v, along, exact=False, near=near)
    else:
        reference = ReferenceTrajectory(path.x, path.v, columns(path.x, path.v), exact=False, near=near)
    # The zero of the sensor is that of the rows, which know the random force.
    return replace(beside, reference=reference, offset=run.offset), sensitivity


def _sensors(run: RunRegression) -> list[NoiseModel]:
    """What the sensor's noise may be by what the free motion leaves: with a random force, and without.

    By what the spline leaves where no free motion follows the record.
    """
    problem, near = run.problem, run.reference.near
    tau = problem.form.tau * (run.frequency / problem.nominal_frequency)
    if near is None:
        unexplained = problem.angle - smooth(problem.form.tau, problem.angle).x
        return [NoiseModel(float(np.std(unexplained)), np.ones(1))]
    deviation = problem.angle - run.offset - near.x
    pushed, free = (sensor_colour(deviation, tau, random_force=pushed) for pushed in (True, False))
    return [pushed] if len(pushed.filter_) == len(free.filter_) == 1 else [pushed, free]


def _with_noises(
    run: RunRegression, active: Mask, constraints: ConstraintMap, option: RandomForceOption, colour: bool
) -> tuple[RunRegression, DeviationOperator]:
    """The run with its two noises, by the restricted likelihood of its own rows; its operator.

    With `colour` the sensor's noise is estimated anew first.
    """
    if colour:
        sensors = _sensors(run)
    else:
        sensors = [NoiseModel(run.problem.noise, np.ones(1)) if run.noises is None else run.noises.sensor]
    tried = [_with_ratio(run, sensor, active, constraints, option) for sensor in sensors]
    best, operator = min(tried, key=lambda pair: pair[0].ratio.deviance)
    # A random force must be better than none beside whatever noise of the sensor.
    none = min(noises.ratio.deviance + noises.ratio.gain for noises, _ in tried)
    ratio = replace(best.ratio, gain=none - best.ratio.deviance)
    return replace(run, noises=replace(best, ratio=ratio)), operator


def _with_ratio(
    run: RunRegression,
    sensor: NoiseModel,
    active: Mask,
    constraints: ConstraintMap,
    option: RandomForceOption,
) -> tuple[NoisePair, DeviationOperator]:
    """The ratio of the two variances beside a sensor's noise of one colour, and the operator with both."""
    last = None if run.noises is None else run.noises.ratio
    kept, form = constraints.keep(active), run.problem.form
    no_ratio = VarianceRatio(0.0, 1.0, np.nan, np.nan, 0.0)
    matrix, acting = deviation_matrices(replace(run, noises=NoisePair(no_ratio, sensor)))
    weak = weak_rows(run, DeviationOperator(matrix, acting, np.empty(0)))
    free = weak.columns @ (weak.scale[:, None] * kept.matrix)
    target = weak.target - weak.columns @ (weak.scale * kept.constant)
    table = np.column_stack([free, weak.nuisances, target])
    band = covariance_band(acting @ acting.T)
    prior = np.zeros((DEGREES_OF_PRIOR, table.shape[1]))
    prior[:, -1] = sensor.innovation

    def rows(ratio: float) -> WhiteRows:
        factor = cholesky_factor(band, form.gram, ratio)
        white = np.concatenate([whiten(factor, table), prior])
        return WhiteRows(white[:, -1], white[:, :-1], 2.0 * float(np.sum(np.log(factor[0]))))

    if isinstance(option, str):
        low, high = ratio_span(float(form.tau[-1] - form.tau[0]), float(np.median(np.diff(form.tau))))
        ratio = variance_ratio(rows, low, high, last.ratio if last else None)
    else:
        per_tau = RandomForce(float(option)).per_tau(run.problem.nominal_frequency)
        ratio = held_ratio(rows, per_tau, last.variance if last else None)
    factor = cholesky_factor(band, form.gram, ratio.ratio)
    return NoisePair(ratio, sensor), DeviationOperator(matrix, acting, factor)


def _smoothed(runs: Runs, operators: Sequence[DeviationOperator], solution: Solution) -> Runs:
    """The runs along the next smoothed motions: the record, without the most likely noise of the sensor."""
    lengths = [operator.matrix.shape[0] for operator in operators]
    residuals = np.split(solution.residual, np.cumsum(lengths)[:-1])
    weights = run_weights(runs) if len(runs) > 1 else np.ones(1)
    return tuple(
        _along_smoothed(run, operator, residual / weight)
        for run, operator, residual, weight in zip(runs, operators, residuals, weights, strict=True)
    )


def _along_smoothed(run: RunRegression, operator: DeviationOperator, residual: Array) -> RunRegression:
    problem, path = run.problem, run.reference
    innovation = -(operator.acting.T @ cho_solve_banded((operator.factor, True), residual))
    noise = innovation if run.noises is None else lfilter([1.0], run.noises.filter_, innovation)
    try:
        change = smooth(problem.form.tau, problem.angle - run.offset - path.x - noise)
    except DecayError:
        return run
    v = path.v + change.v * (problem.nominal_frequency / run.frequency)
    return replace(run, reference=replace(path, x=path.x + change.x, v=v))
