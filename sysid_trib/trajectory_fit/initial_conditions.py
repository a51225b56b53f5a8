"""The start of a motion fitted to a record: angle and rate at the first sample, and the sensor's zero."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid_trib.noise.smoothing import smooth
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory

Array = NDArray[np.float64]

MAX_ROUNDS = 8


@dataclass(frozen=True)
class FittedMotion:
    """A model's motion fitted to a record by its start alone.

    Attributes
    ----------
    angle, rate : start, rad and rad/s; offset : rad, zero of the sensor.
    x, v : (sample,) theta (rad) and theta'/w (rad) at the record's times.
    hidden : (sample,) each, states and memory of forces as `dahl.z`.
    sensitivity : (sample, 2) of x to the start's angle (1) and rate (s).
    stop_time : s, nan if the motion does not stop within the record.
    """

    angle: float
    rate: float
    offset: float
    x: Array
    v: Array
    stop_time: float
    hidden: Mapping[str, Array]
    sensitivity: Array


def first_guess(time: Array, angle: Array, frequency: float) -> tuple[float, float]:
    """Angle (rad) and rate (rad/s) at the first sample, of the smoothed record."""
    tau = frequency * (time - time[0])
    x, v, _, _ = smooth(tau, angle)
    return float(x[0]), float(v[0] * frequency)


def fit_start(
    model: Model,
    time: Array,
    angle: Array,
    start: tuple[float, float],
    *,
    offset: float | None = 0.0,
    sensitivity: Array | None = None,
) -> FittedMotion:
    """Least squares of a record on the start of a model's motion.

    Parameters
    ----------
    time, angle : (sample,) the record, s and rad.
    start : first guess of angle (rad) and rate (rad/s).
    offset : first guess of the sensor's zero (rad); None holds it at zero.
    sensitivity : of a model nearby, if known; else by differences.

    Raises
    ------
    SimulationError
        The model's motion cannot be computed.

    Notes
    -----
    Gauss-Newton with one set of sensitivities (a chord): the start is nearly linear.
    """
    size = float(np.max(np.abs(angle))) * np.array([1.0, model.reference_frequency])
    begin, zero = np.array(start, dtype=float), offset or 0.0
    motion = trajectory(model, time, *begin)
    for _ in range(MAX_ROUNDS):
        if sensitivity is None:
            sensitivity = _sensitivity(model, time, begin, 1e-6 * size, motion.angle)
        columns = sensitivity if offset is None else np.column_stack([sensitivity, np.ones(len(time))])
        steps, *_ = np.linalg.lstsq(columns, angle - zero - motion.angle, rcond=None)
        longest = np.max(np.abs(steps[:2]) / size)
        # A step as long as the swing itself is a phase slip, not a start.
        begin = begin + steps[:2] * min(1.0, 0.5 / max(longest, 1e-300))
        zero += float(steps[2]) if offset is not None else 0.0
        motion = trajectory(model, time, *begin)
        if longest < 1e-5:
            break
        if longest > 1e-2:
            sensitivity = None
    v = motion.rate / model.reference_frequency
    columns = np.empty((len(time), 2)) if sensitivity is None else sensitivity
    return FittedMotion(
        float(begin[0]), float(begin[1]), zero, motion.angle, v, motion.stop_time, motion.hidden, columns
    )


def _sensitivity(model: Model, time: Array, begin: Array, reach: Array, x: Array) -> Array:
    near = [trajectory(model, time, *(begin + reach * unit)).angle for unit in np.eye(2)]
    return (np.stack(near, axis=1) - x[:, None]) / reach
