"""Search for the start of a motion from several first estimates."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import SimulationError
from sysid_trib.simulation.initial_conditions import BY_START, FittedMotion, fit_start
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.motions import STEPS_A_PERIOD, SimulatedMotion
from sysid_trib.simulation.stand_in import accuracy_of, has_curves, most_steps_of, without_curves
from sysid_trib.simulation.trajectory import trajectory

# The start may be in a local minimum if the residual exceeds this fraction of the record (RMS).
LOCAL_MINIMUM = 0.3
# Relative swing sizes and number of phases of the further starts; the nearest ones are fitted.
SWING_SIZES, START_PHASES, FITTED_STARTS = np.linspace(0.6, 1.3, 29), 16, 4
# Most motions of a fit that is continued because it has not converged.
MOST_MOTIONS = 40


def fit_start_of_several(
    model: Model,
    time: Array,
    angle: Array,
    start: tuple[float, float],
    *,
    offset: float | None = 0.0,
) -> FittedMotion:
    """Return `fit_start` from more first estimates if the motion from the first does not follow the record.

    If the frequency of a model is slightly wrong, its motion loses the phase in a long record, and the sum of
    squares has one minimum per phase slip. A better motion may start at another phase, or with another
    amplitude, which changes the frequency. A driven motion forgets its start and is fitted once.

    Raises
    ------
    SimulationError
        The model's motion cannot be computed from the first start.
    """
    best = fit_start(model, time, angle, start, offset=offset)
    misses = _missed(best, angle) > LOCAL_MINIMUM * float(np.std(angle))
    if misses and not model.inputs:
        best = _best_of_several(model, time, angle, start, offset, best)
    return best if best.settled else _continued(model, time, angle, offset, best)


def _best_of_several(
    model: Model,
    time: Array,
    angle: Array,
    start: tuple[float, float],
    offset: float | None,
    best: FittedMotion,
) -> FittedMotion:
    """Return the best fit from starts of other sizes and phases, and from the given one."""
    step, lead = float(np.median(np.diff(time))), 2.0 * np.pi / model.reference_frequency
    longer = np.append(time, time[-1] + step * np.arange(1.0, 2.0 + lead / step))
    nearest: list[tuple[float, tuple[float, float]]] = []
    for size in SWING_SIZES:
        with suppress(SimulationError):
            motion = trajectory(model, longer, size * start[0], size * start[1])
            # Later parts of the same motion provide the other phases.
            for later in lead * np.arange(START_PHASES) / START_PHASES:
                x = np.interp(time + later, longer, motion.angle)
                begin = [float(np.interp(time[0] + later, longer, of)) for of in (motion.angle, motion.rate)]
                nearest.append((float(np.sum((angle - best.offset - x) ** 2)), (begin[0], begin[1])))
    for _, guess in sorted(nearest)[:FITTED_STARTS]:
        with suppress(SimulationError):
            tried = fit_start(model, time, angle, guess, offset=offset)
            best = min(best, tried, key=lambda motion: _missed(motion, angle))
    return best


def _continued(
    model: Model, time: Array, angle: Array, offset: float | None, begun: FittedMotion
) -> FittedMotion:
    """Continue a fit that has not converged by least squares with a trust region; return the better one."""
    from scipy.optimize import least_squares

    smooth = without_curves(model, float(np.ptp(angle))) if has_curves(model) else model
    accuracy, most_steps = accuracy_of(model), most_steps_of(model, STEPS_A_PERIOD)
    scale = np.array([1.0, model.reference_frequency, 1.0])[: 2 + (offset is not None)]

    def motion_from(start: Array) -> SimulatedMotion:
        return trajectory(model, time, *start[:2], most_steps=most_steps, accuracy=accuracy)

    # The third unknown is the zero of the sensor, if it is fitted.
    def residual(start: Array) -> Array:
        try:
            return motion_from(start).angle + np.sum(start[2:]) - angle
        except SimulationError:
            # The trust region shrinks at a step without a motion.
            return np.full(len(time), np.nan)

    def slopes(start: Array) -> Array:
        motion = trajectory(smooth, time, *start[:2], by=BY_START, most_steps=most_steps)
        return np.column_stack([motion.derivatives["angle"], np.ones(len(time))])[:, : len(start)]

    first = np.array([begun.angle, begun.rate, begun.offset])[: len(scale)]
    try:
        solution = least_squares(residual, first, slopes, x_scale=scale, max_nfev=MOST_MOTIONS)
        motion = motion_from(solution.x)
    except (SimulationError, ValueError, np.linalg.LinAlgError):
        return begun
    better = replace(
        begun,
        angle=float(solution.x[0]),
        rate=float(solution.x[1]),
        offset=float(np.sum(solution.x[2:])),
        x=motion.angle,
        v=motion.rate / model.reference_frequency,
        stop_time=motion.stop_time,
        hidden=motion.hidden,
        settled=bool(solution.success),
    )
    return min(better, begun, key=lambda of: _missed(of, angle))


def _missed(motion: FittedMotion, angle: Array) -> float:
    """Return the RMS of a record minus a motion; infinite if it is not a number."""
    rms = root_mean_square(angle - motion.offset - motion.x)
    return rms if np.isfinite(rms) else float("inf")
