"""The start of a motion fitted to a record: angle and rate at the first sample, and the sensor's zero."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid_trib.model import Model
from sysid_trib.simulate import trajectory

Array = NDArray[np.float64]

MAX_ROUNDS = 8


@dataclass(frozen=True)
class FittedMotion:
    """A model's motion fitted to a record by its start alone.

    Attributes
    ----------
    angle, rate : start, rad and rad/s; offset : rad, zero of the sensor.
    x, v : (sample,) theta (rad) and theta'/w (rad) at the record's times.
    stop_time : s, nan if the motion does not stop within the record.
    """

    angle: float
    rate: float
    offset: float
    x: Array
    v: Array
    stop_time: float


def fit_start(
    model: Model,
    time: Array,
    angle: Array,
    start: tuple[float, float],
    *,
    offset: float = 0.0,
    fit_offset: bool = True,
) -> FittedMotion:
    """Least squares of a record on the start of a model's motion (Gauss-Newton, differences).

    Parameters
    ----------
    time, angle : (sample,) the record, s and rad.
    start : first guess of angle (rad) and rate (rad/s).
    offset, fit_offset : zero of the sensor (rad), and whether it is fitted too.

    Raises
    ------
    SimulationError
        The model's motion cannot be computed.
    """
    size = float(np.max(np.abs(angle)))
    reach = 1e-6 * size * np.array([1.0, model.reference_frequency])
    begin = np.array(start, dtype=float)
    for _ in range(MAX_ROUNDS):
        x = trajectory(model, time, *begin).angle
        columns = [
            (trajectory(model, time, *(begin + reach * unit)).angle - x) / (reach @ unit) for unit in np.eye(2)
        ]
        if fit_offset:
            columns.append(np.ones_like(x))
        steps, *_ = np.linalg.lstsq(np.stack(columns, axis=1), angle - offset - x, rcond=None)
        # A step beyond the swing itself is a phase slip, not a start.
        longest = np.max(np.abs(steps[:2]) / (reach * 1e6))
        steps = steps * min(1.0, 0.5 / longest) if longest > 0.5 else steps
        begin = begin + steps[:2]
        offset += float(steps[2]) if fit_offset else 0.0
        # The step is second order in the last one: below this it is beyond the noise of any sensor.
        if longest < 1e-5:
            break
    found = trajectory(model, time, *begin)
    v = found.rate / model.reference_frequency
    return FittedMotion(float(begin[0]), float(begin[1]), offset, found.angle, v, found.stop_time)
