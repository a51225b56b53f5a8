"""Search for the start of a motion from several first estimates."""

from contextlib import suppress

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import SimulationError
from sysid_trib.simulation.initial_conditions import FittedMotion, fit_start
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.trajectory import trajectory

# The start may be in a local minimum if the residual exceeds this fraction of the record (RMS).
LOCAL_MINIMUM = 0.3
# Relative swing sizes and number of phases of the further starts; the nearest ones are fitted.
SWING_SIZES, START_PHASES, FITTED_STARTS = np.linspace(0.6, 1.3, 29), 16, 4


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
    if model.inputs or not _missed(best, angle) > LOCAL_MINIMUM * float(np.std(angle)):
        return best
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


def _missed(motion: FittedMotion, angle: Array) -> float:
    """Return the RMS of a record minus a motion; infinite if it is not a number."""
    rms = float(np.sqrt(np.mean((angle - motion.offset - motion.x) ** 2)))
    return rms if np.isfinite(rms) else float("inf")
