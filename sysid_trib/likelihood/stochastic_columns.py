"""Regression along the smoothed motion of a record with a random force, with both noises.

The noise of the rows is the operator applied to the sensor's noise, plus integrals of the random force. The
smoothed motion is the record minus the most likely sensor noise (best linear unbiased prediction, Robinson
1991); the columns are computed along it. They are expected values: if v has a standard error, its sign goes
from -1 to 1 gradually over this error, which near rest takes many samples.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy
from scipy.linalg import cho_solve_banded

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.likelihood.least_squares import ConstraintMap
from sysid_trib.likelihood.random_force import (
    RandomForceOption,
    average_over_ratios,
    probability_of_none,
)
from sysid_trib.likelihood.refined_columns import SETTLED_STEP, has_slipped, motion_of_run, step_in_errors
from sysid_trib.likelihood.regression import RunRegression, Runs, common_values, shifted
from sysid_trib.likelihood.rows import Solution, solve, stacked
from sysid_trib.likelihood.two_noises import WeighedRun, with_noises
from sysid_trib.likelihood.variance_ratio import VarianceRatio
from sysid_trib.records.smoothing import least_squares_spline

MAX_SMOOTHED_PATHS = 12
# After this number of rounds, a step of this fraction of an error ends the iteration: paths that alternate
# between branches of a force with jumps come no closer. The step is then included in the errors.
ROUNDS_TO_SETTLE, STEP_AMONG_ERRORS = 4, 0.2
# Round in which the colour of the sensor's noise is estimated, because the motion is then better than a first
# estimate.
COLOUR_ROUND = 1
# Probability of no random force below which the path is the smoothed motion. Otherwise the path stays the
# free motion: at the ends of the record the smoothed rate, and with it the sign of friction, has a large
# error.
IMPROBABLE = 0.5


def regress_stochastic(
    runs: Runs, constraints: ConstraintMap, option: RandomForceOption
) -> tuple[Solution, bool]:
    """Estimate forces, a random force and the sensor's noise, along motions smoothed with them.

    Parameters
    ----------
    runs : tuple of RunRegression
        Runs with a first estimate.
    constraints : ConstraintMap
        Constraints of the forces that are in the model.
    option : "auto" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, which is fixed.

    Returns
    -------
    solution : Solution
        Solution of the rows about smoothed motions, with both noises; about free motions if no random force
        is most likely. It is the mean over the plausible ratios of the two variances. Its covariance includes
        the uncertainty of these ratios and, if the iteration ended early, the last step.
    settled : bool
        Whether the estimate has converged.

    Raises
    ------
    DecayError
        The rows are degenerate.
    """
    for turn in range(MAX_SMOOTHED_PATHS):
        # If a free motion lost the phase after both noises were known, do not try it again.
        tried = [turn <= COLOUR_ROUND or run.near is not None for run in runs]
        runs = tuple(
            _about_free_motion(run, constraints, option) if may_follow else run.along_own_path()
            for run, may_follow in zip(runs, tried, strict=True)
        )
        # With a given density, as in simulated records, the sensor's noise is white. The discrepancy of a
        # driven model is not sensor noise of any colour.
        driven = any(run.inputs for run in runs)
        colour = turn == COLOUR_ROUND and isinstance(option, str) and not driven
        weighed = [with_noises(run, constraints, option, colour=colour) for run in runs]
        solution = solve(stacked([of_run.rows for of_run in weighed]), constraints)
        step = float(np.max(np.abs(step_in_errors(solution))))
        settled = step <= (1.0 if turn < ROUNDS_TO_SETTLE else STEP_AMONG_ERRORS / SETTLED_STEP)
        if (settled and turn >= COLOUR_ROUND) or turn == MAX_SMOOTHED_PATHS - 1:
            break
        pairs = enumerate(zip(solution.runs, weighed, strict=True))
        runs = tuple(_along_smoothed(run, of_run, solution, at) for at, (run, of_run) in pairs)
    covariance, after = solution.covariance, solution.runs
    if isinstance(option, str):
        shift, added = _average_by_ratios(weighed, constraints)
        covariance, after = covariance + added, shifted(after, shift, constraints)
    if step > 1.0:
        change = common_values(solution.runs) - common_values(solution.rows.runs)
        covariance = covariance + np.outer(change, change)
    attenuation = _attenuation_by_noisy_input(weighed, solution)
    covariance = covariance + np.outer(attenuation, attenuation)
    return replace(solution, runs=after, covariance=covariance), settled


# Step of the log ratio for the difference quotient of a determinant.
LOG_RATIO_STEP = 0.05


def _attenuation_by_noisy_input(weighed: Sequence[WeighedRun], solution: Solution) -> Array:
    """Return the bias (force + 1,) of the estimate if the random force is noise of a measured input.

    Parameters
    ----------
    weighed : sequence of WeighedRun
    solution : Solution
        Solution of the rows of these runs.

    Returns
    -------
    (force + 1,) array of float
        Bias of the coefficients and the reference frequency (rad/s); zero without a force of an input alone.

    Notes
    -----
    Errors in variables (Fuller 1987): noise of an input is also in its column and makes the coefficient too
    small. If the whole random force is due to it, white rows r = -theta N have the bias -C E[N' r] = C
    n/theta, with C the covariance of the estimate and n the number of rows dominated by the random force, d
    log det / d log ratio of their covariance. The record does not show whether the random force is noise of
    the input or acts on the body: the bias is added to the errors, and not corrected.
    """
    runs, nothing = solution.runs, np.zeros(len(solution.covariance))
    library, coefficients = runs[0].library, runs[0].coefficients
    # A noisy input has a smaller effect in a force that also contains the motion, and this effect changes
    # with the motion.
    of_input = [bool(force.inputs) and not {"x", "v"} & force.formula.names for force in library]
    size = np.where(of_input, np.abs(coefficients) * solution.rows.rms_forces, 0.0)
    at = int(np.argmax(size))
    if not size[at] > 0.0:
        return nothing
    made_by_force = 0.0
    for of_run in weighed:
        if of_run.run.ratio is not None and of_run.run.ratio.ratio > 0.0:
            rows, ratio = of_run.by_ratio(of_run.run.sensor), of_run.run.ratio.ratio
            ends = [rows(ratio * float(np.exp(side * LOG_RATIO_STEP))) for side in (1.0, -1.0)]
            made_by_force += (ends[0].log_determinant - ends[1].log_determinant) / (2.0 * LOG_RATIO_STEP)
    return np.asarray(solution.covariance[:, at] * made_by_force / coefficients[at])


def _has_random_force(run: RunRegression, option: RandomForceOption) -> bool:
    """Return true if a random force is given, or more probable than none."""
    if run.ratio is None or not isinstance(option, str):
        return run.ratio is not None
    return probability_of_none(run.ratio.gain, len(run.time)) < IMPROBABLE


def _about_free_motion(
    run: RunRegression, constraints: ConstraintMap, option: RandomForceOption
) -> RunRegression:
    """Return a run with a path about a free motion of its present model, if that follows the record."""
    try:
        free = motion_of_run(run, constraints, near=True)
    except SimulationError:
        return run.along_own_path()
    along = run.columns_along(free.x, free.v)
    force = run.stiffness_scale * (free.x + along @ run.acting)
    # The first path is the free motion itself.
    nearby = replace(run, x=free.x, v=free.v, columns=along, exact=False, near=(free.x, force))
    nearby = replace(nearby, start=(free.angle, free.rate), sensitivity=free.sensitivity)
    if has_slipped(nearby):
        return run.along_own_path()
    if run.ratio is not None and _has_random_force(run, option):
        # Friction on a body at rest balances the other forces.
        near = free.x, np.where(free.v == 0.0, run.forcing, force)
        error = _smoothed_rate_error(run.ratio, float(np.median(np.diff(run.form.tau))))
        expected = run.columns_along(run.x, run.v, error)
        nearby = replace(nearby, x=run.x, v=run.v, columns=expected, near=near)
    # Keep the sensor's zero of the rows, which include the random force.
    return nearby


def _along_smoothed(run: RunRegression, weighed: WeighedRun, solution: Solution, at: int) -> RunRegression:
    """Return a run along the next smoothed motion: the record minus the most likely noise of the sensor.

    `at` : index of the run, from 0.
    """
    rows, tau = weighed.rows, run.form.tau
    count = len(solution.steps) - run.frequency_free
    steps = solution.steps[[at, *range(count, len(solution.steps))]]
    residual = rows.target - rows.columns @ solution.coefficients - rows.nuisances @ steps
    innovation = -(weighed.acting.T @ cho_solve_banded((rows.factor, True), residual))
    noise = scipy.signal.lfilter([1.0], run.sensor.filter_, innovation)
    try:
        change = (run.measured - run.x - noise) / run.gain
        spline, x = least_squares_spline(tau, change)
    except DecayError:
        return run
    v = run.v + spline(tau, 1) * (run.nominal_frequency / run.frequency)
    return replace(run, x=run.x + x, v=v)


def _average_by_ratios(weighed: Sequence[WeighedRun], constraints: ConstraintMap) -> tuple[Array, Array]:
    """Average coefficients and reference frequency over the plausible ratios of each run.

    Return the change of the values, and its contribution to their covariance.
    """

    def solved(at: int, ratio: VarianceRatio) -> tuple[Array, Array]:
        """Solve with another ratio of a run; return the common values and their covariance."""
        changed = [*weighed[:at], weighed[at].with_ratio(ratio), *weighed[at + 1 :]]
        other = solve(stacked([of_run.rows for of_run in changed]), constraints)
        return common_values(other.runs), other.covariance

    shifts, covariances = [], []
    for at, of_run in enumerate(weighed):
        run, rows = of_run.run, of_run.by_ratio(of_run.run.sensor)
        assert run.ratio is not None
        shift, added = average_over_ratios(rows, run.ratio, len(run.time), partial(solved, at))
        shifts.append(shift)
        covariances.append(added)
    return np.sum(shifts, axis=0), np.sum(covariances, axis=0)


def _smoothed_rate_error(ratio: VarianceRatio, step: float) -> float:
    """Return the standard error of v = theta'/w of the smoothed motion, away from the ends of the record.

    Parameters
    ----------
    ratio : VarianceRatio
        Growth q of the variance of v per unit of tau, over the variance of the sensor's noise in a sample.
    step : float
        Time between two samples, in tau.

    Returns
    -------
    float, rad
        The standard error; zero without a random force.

    Notes
    -----
    For an oscillator with white acceleration of (two-sided) spectral density q, and white noise of density
    r = variance * step, the error of the best smoother in x has the spectral density 1/((1 - k^2)^2/q + 1/r)
    (Wiener 1949), with k the frequency. The integral of k^2 times this density over dk/(2 pi) is q / (2
    sqrt(2 (sqrt(1 + q/r) - 1))), which is sqrt(q r)/2 for small q.
    """
    by_sample = ratio.ratio / step
    if by_sample == 0.0:
        return 0.0
    # sqrt(1 + z) - 1 without cancellation.
    excess = by_sample / (np.sqrt(1.0 + by_sample) + 1.0)
    return float(np.sqrt(ratio.ratio * ratio.variance / (2.0 * np.sqrt(2.0 * excess))))
