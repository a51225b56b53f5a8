"""Refined instrumental variables: force columns along the motion of the identified model (Young 2011)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import SimulationError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.likelihood.paths import RecordPath
from sysid_trib.likelihood.rows import Regression, Solution
from sysid_trib.likelihood.run_rows import RunRows
from sysid_trib.likelihood.trials import TrialEffect
from sysid_trib.records.decay import root_mean_square
from sysid_trib.simulation.initial_conditions import FittedMotion, fit_start
from sysid_trib.simulation.model import Model

MAX_REFINEMENTS = 25
# A simulated motion this far from the record (RMS, of the record's) has slipped out of phase.
SLIPPED = 0.3
# A step after which it slips is halved, so often at most.
MOST_HALVINGS = 8
# A step this small, in standard errors, does not count.
SETTLED_STEP = 0.02
# Part of the swing by which coefficients of a record without noise may still change.
SETTLED_WITHOUT_NOISE = 1e-10


def along_exact_motions(begun: Regression, first: Solution, active: Mask) -> Regression | None:
    """Take the columns from the motion of the identified model, and solve again, until nothing changes.

    Parameters
    ----------
    begun : Regression
        About whose paths rows are linear at first; about each motion itself where that does not settle.
    first : Solution
        From which the motions begin.
    active : (force,) array of bool
        Forces that are in the model.

    Returns
    -------
    Regression or None
        About the last motion, so that it holds the final estimate's covariance; None if none has settled.
    """
    for operators in (begun.rows, None):
        refined = _refined(begun, first, active, operators)
        if refined is not None:
            return refined
    return None


def _refined(
    begun: Regression, first: Solution, active: Mask, operators: Sequence[RunRows] | None
) -> Regression | None:
    """The regression at which nothing changes; without `operators` by those about each motion.

    Over many periods a small error of an operator turns what the motion still misses into other forces. Where
    forces are nearly the same, so that the last steps are slow, it is then the nearest motion.
    """
    followed: Regression | None = None
    nearest: tuple[float, Regression] | None = None
    last, halvings = None, 0
    # Without noise there are no errors to settle within, but rounding, of forces as parts of the swing.
    swing = root_mean_square([np.sqrt(np.mean(path.at_samples[0] ** 2)) for path in begun.paths])
    smallest = SETTLED_WITHOUT_NOISE * np.append(swing / begun.rms_forces, first.values[-1])
    values, paths, motions = first.values, begun.paths, [first_motion(path) for path in begun.paths]
    motions = [
        replace(motion, offset=zero) for motion, zero in zip(motions, first.zeros.tolist(), strict=True)
    ]
    for _ in range(MAX_REFINEMENTS):
        paths = [path.rescaled(float(values[-1])) for path in paths]
        try:
            motions = [
                free_motion(path, begun.trials, np.where(active, values[:-1], 0.0), active, near)
                for path, near in zip(paths, motions, strict=True)
            ]
        except SimulationError:
            break
        paths = [
            along(path, motion, begun.trials, values[:-1])
            for path, motion in zip(paths, motions, strict=True)
        ]
        missed = max(
            missed_by(path, motion, begun.trials, values[:-1])
            for path, motion in zip(paths, motions, strict=True)
        )
        if missed > SLIPPED:
            # From a motion that follows the record a part of the step is one of less.
            halvings += 1
            if operators is not None or halvings > MOST_HALVINGS or followed is None:
                break
            values, motions = 0.5 * (followed.values + values), list(followed.motions)
            continue
        followed = begun.about(paths, values[:-1], motions, operators)
        solution = followed.solve(active)
        change = solution.values - values
        step = change / (SETTLED_STEP * np.sqrt(np.diag(solution.covariance)) + smallest)
        if np.all(np.abs(step) <= 1.0):
            return followed
        if operators is None and (nearest is None or missed < nearest[0]):
            nearest = missed, followed
        ahead = _extrapolation(step, last)
        last = None if ahead else step
        values = solution.values + ahead * change
        values[:-1] = begun.constraints.impose(values[:-1])
        motions = [
            replace(motion, offset=zero)
            for motion, zero in zip(motions, solution.zeros.tolist(), strict=True)
        ]
    return None if nearest is None else nearest[1]


def first_motion(path: RecordPath) -> FittedMotion:
    """The path as a first guess of a motion."""
    x, v = path.at_samples
    return FittedMotion(float(x[0]), float(v[0]) * path.frequency, 0.0, x, v, np.nan, {}, None)


def missed_by(
    path: RecordPath, motion: FittedMotion, trials: Sequence[TrialEffect], coefficients: Array
) -> float:
    """RMS of record minus motion over that of the record."""
    errors = motion.offset + path.sensor_terms(trials) @ coefficients
    return float(np.sqrt(np.mean((path.angle - errors - motion.x) ** 2) / np.mean(path.angle**2)))


def _extrapolation(step: Array, last: Array | None) -> float:
    """How many times a step is still to come, where steps shrink in one direction (Aitken's delta-squared).

    Jumps at v = 0 are distributed in the operator, so that it converges at a rate: slowly if forces that
    nearly cancel hold large jumps.
    """
    if last is None:
        return 0.0
    rate = float(step @ last / (last @ last))
    parallel = float(np.linalg.norm(step - rate * last)) < 0.3 * float(np.linalg.norm(step))
    return rate / (1.0 - rate) if parallel and 0.4 < rate < 0.95 else 0.0


def along(
    path: RecordPath, motion: FittedMotion, trials: Sequence[TrialEffect], coefficients: Array
) -> RecordPath:
    """A path through a motion at the samples, with what its forces give it between them."""
    # What the forces give depends on where they switch, and so on the path itself.
    for _ in range(2):
        path = path.follow(motion.x, trials, coefficients)
    return path


def free_motion(
    path: RecordPath,
    trials: Sequence[TrialEffect],
    coefficients: Array,
    active: Mask,
    begin: FittedMotion,
    *,
    near: bool = False,
) -> FittedMotion:
    """Motion of a model, its start fitted to the record or, with `near`, next to it.

    Parameters
    ----------
    path : RecordPath
        At the reference frequency; terms of the sensor are those along it.
    trials : sequence of TrialEffect
    coefficients : (force,) array of float
    active : (force,) array of bool
        Which are in the model.
    begin : FittedMotion
        First guess of the start, and the sensitivity to it if that is known.
    near : bool
        See `fit_start`; so it is where nothing pulls a body back and an error of its start grows.
    """
    library = ForceLibrary("", tuple(trial.force for trial in trials))
    kept = {
        trial.force.symbol: c
        for trial, c, keep in zip(trials, coefficients.tolist(), active, strict=True)
        if keep and path.acts(trial) and trial.force.kind == "force"
    }
    shapes = {name: value for trial in trials for name, value in trial.shapes.items()}
    model = Model(library, kept, path.frequency, shapes, path.inputs)
    angle = path.angle - path.sensor_terms(trials) @ coefficients
    near = near or not is_free_to_move(library, kept)
    start = begin.angle, begin.rate
    return fit_start(
        model, path.time, angle, start, offset=begin.offset, sensitivity=begin.sensitivity, near=near
    )
