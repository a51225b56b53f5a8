"""Refined instrumental variables: force columns along the motion of the identified model (Young 2011)."""

from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import SimulationError
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.likelihood.least_squares import ConstraintMap
from sysid_trib.likelihood.regression import (
    RunRegression,
    Runs,
    common_values,
    shifted,
    with_common_values,
)
from sysid_trib.likelihood.rows import Solution, solve, weak_rows
from sysid_trib.simulation.initial_conditions import FittedMotion, fit_start
from sysid_trib.simulation.model import Model

MAX_REFINEMENTS = 25
# Most motions for smooth curves, whose simulation is slow: the remaining change is then far within their
# bands.
MAX_REFINEMENTS_OF_CURVES = 8
# If the residual of a simulated motion exceeds this fraction of the record (RMS), it has lost the phase.
SLIPPED = 0.3
# Largest number of times that a step is halved if the motion loses the phase after it.
MOST_HALVINGS = 8
# Steps below this, in standard errors, have converged.
SETTLED_STEP = 0.02
# The same for the basis functions of a curve, which are nearly collinear; the errors of the curve itself are
# far smaller.
SETTLED_PART = 0.2
# Relative change of a force, over the swing, below which a record without noise has converged.
SETTLED_WITHOUT_NOISE = 1e-10


def refine_columns(runs: Runs, linear_about: Runs, constraints: ConstraintMap) -> Solution | None:
    """Compute the columns along the motion of the identified model and solve again, until convergence.

    Parameters
    ----------
    runs : tuple of RunRegression
        Runs with a first estimate.
    linear_about : tuple of RunRegression
        Runs about whose paths the rows are linear. If this does not converge, the rows are linear about each
        motion itself.
    constraints : ConstraintMap
        Constraints of the forces that are in the model.

    Returns
    -------
    Solution or None
        Solution of the rows about the last motion, whose covariance is that of the final estimate; None
        without convergence.
    """
    begun = _along_motions(runs, constraints)
    if begun is None or any(has_slipped(run) for run in begun):
        # The motion of the first estimate has already lost the phase.
        return None
    return _refined(begun, linear_about, constraints) or _refined(begun, None, constraints)


def refine_from(runs: Runs, start: Model, most: int, constraints: ConstraintMap) -> Solution | None:
    """Compute the first columns along the motion of a nearby model, and refine them a few times.

    Parameters
    ----------
    runs : tuple of RunRegression
        Runs about any paths.
    start : Model
        Identification of nearly the same forces; missing ones are zero.
    most : int
        Largest number of motions; with one, the estimate is a Gauss-Newton step from the start.
    constraints : ConstraintMap
        Constraints of the forces that are in the model.

    Returns
    -------
    Solution or None
        None if no motion follows the records.
    """
    begun = [start.coefficients.get(symbol, 0.0) for symbol in runs[0].library.symbols]
    frequency = start.reference_frequency if runs[0].frequency_free else runs[0].frequency
    near = _along_motions(
        with_common_values(runs, constraints.impose(np.array(begun)), frequency), constraints
    )
    return None if near is None else _refined(near, None, constraints, most)


def _along_motions(runs: Runs, constraints: ConstraintMap) -> Runs | None:
    """Return the runs with the motions of their model as paths; None if one cannot be computed."""
    begun = (replace(run, sensitivity=None) for run in runs)
    try:
        return tuple(simulated(run, constraints) for run in begun)
    except SimulationError:
        return None


def _refined(
    begun: Runs, linear_about: Runs | None, constraints: ConstraintMap, most: int | None = None
) -> Solution | None:
    """Return the fixed point of the solution; without `linear_about` rows are linear about each motion.

    `begun` : runs along the motions of the first estimate.

    Over many periods, a small error of an operator attributes the remaining residual to wrong forces. If
    forces are nearly collinear, so that the last steps are slow, the result is the solution with the nearest
    motion.
    """
    followed: Runs | None = None
    nearest: tuple[float, Solution] | None = None
    last, halvings = None, 0
    runs = begun
    of_curves = any(run.library.in_curves.any() for run in begun)
    for done in range(most or (MAX_REFINEMENTS_OF_CURVES if of_curves else MAX_REFINEMENTS)):
        try:
            runs = tuple(simulated(run, constraints) for run in runs) if done else begun
        except SimulationError:
            break
        if any(has_slipped(run) for run in runs):
            # The last motion that follows the record is known: halve the step from it.
            halvings += 1
            if linear_about is not None or halvings > MOST_HALVINGS or followed is None:
                break
            step_back = 0.5 * (common_values(followed) - common_values(runs))
            runs = tuple(replace(run, start=at.start) for run, at in zip(runs, followed, strict=True))
            runs = shifted(runs, step_back, constraints)
            continue
        followed = runs
        solution = solve(weak_rows(runs, linear_about), constraints)
        step = step_in_errors(solution)
        if np.all(np.abs(step) <= 1.0):
            return solution
        missed = max(_missed(run) for run in runs)
        if linear_about is None and (nearest is None or missed < nearest[0]):
            nearest = missed, solution
        ahead = _extrapolation(step, last)
        last = None if ahead else step
        change = common_values(solution.runs) - common_values(runs)
        runs = shifted(solution.runs, ahead * change, constraints)
    return None if nearest is None else nearest[1]


def has_slipped(run: RunRegression) -> bool:
    """Return true if the motion of a run's model has lost the phase of the record."""
    return _missed(run) > SLIPPED


def _missed(run: RunRegression) -> float:
    """Return the RMS of record minus path over that of the record."""
    return float(np.sqrt(np.mean((run.measured - run.x) ** 2) / np.mean(run.angle**2)))


def step_in_errors(solution: Solution) -> Array:
    """Return the change of coefficients and frequency, (force + 1,), over the smallest relevant change."""
    before, after = solution.rows.runs, solution.runs
    # Without noise there are no errors, only rounding: measure forces as fractions of the swing.
    swing = root_mean_square([np.sqrt(np.mean(run.x**2)) for run in after])
    smallest = SETTLED_WITHOUT_NOISE * np.append(swing / solution.rows.rms_forces, after[0].frequency)
    part = np.where(after[0].library.in_curves, SETTLED_PART, SETTLED_STEP)
    counts = np.append(part, SETTLED_STEP) * np.sqrt(np.diag(solution.covariance)) + smallest
    return (common_values(after) - common_values(before)) / counts


def _extrapolation(step: Array, last: Array | None) -> float:
    """Return the number of further steps if steps shrink in one direction (Aitken's delta-squared).

    The operator distributes jumps at v = 0 and therefore converges linearly; slowly if nearly cancelling
    forces have large jumps.
    """
    if last is None:
        return 0.0
    rate = float(step @ last / (last @ last))
    parallel = float(np.linalg.norm(step - rate * last)) < 0.3 * float(np.linalg.norm(step))
    return rate / (1.0 - rate) if parallel and 0.4 < rate < 0.95 else 0.0


def simulated(run: RunRegression, constraints: ConstraintMap) -> RunRegression:
    """Return a run with the motion of its present model as the path, and its start fitted to the record."""
    values = dict(zip(run.library.symbols, run.coefficients.tolist(), strict=True))
    # Without a restoring force, an error of the start grows.
    motion = motion_of_run(run, constraints, near=not is_free_to_move(run.library, values))
    columns = run.columns_along(motion.x, motion.v, known=motion.hidden)
    path = replace(run, x=motion.x, v=motion.v, columns=columns, exact=True, near=None)
    start = motion.angle, motion.rate
    return replace(path, start=start, offset=motion.offset, sensitivity=motion.sensitivity)


def motion_of_run(run: RunRegression, constraints: ConstraintMap, *, near: bool = False) -> FittedMotion:
    """Return the motion of a run's present model, with the best start or, with `near`, a nearby one."""
    pairs = zip(run.library.symbols, run.coefficients.tolist(), constraints.in_model & run.acts, strict=True)
    kept = {s: c for s, c, keep in pairs if keep}
    # The record has no sensor terms here; but formulas may contain their coefficients.
    of_sensor = {force.symbol for force in run.library if force.kind == "sensor"}
    library = run.bound if of_sensor & set(run.library.used) else run.library
    model = Model(library, kept, run.frequency, run.shapes, run.inputs)
    angle = run.measured + run.offset
    offset = None if run.library.has_common_zero else run.offset
    return fit_start(model, run.time, angle, run.start, offset=offset, sensitivity=run.sensitivity, near=near)
