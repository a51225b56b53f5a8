"""Motions for records of a measured rate or acceleration, in the quantity of the sensor."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.simulation.initial_conditions import (
    BY_START,
    MAX_ROUNDS,
    NOT_SHORTER,
    SETTLED_START,
    SINGULAR,
    first_zero,
)
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.motions import SimulatedMotion
from sysid_trib.simulation.trajectory import trajectory

MEASURED, MEASURED_TIME = "measured", "measured_time"


def measured_part(decay: xr.Dataset) -> tuple[tuple[str, float], Array, Array]:
    """Return sensor (see `SimulatedMotion.shown`), times (s) and values of the measurement of a decay.

    Parameters
    ----------
    decay : Dataset
        Result of `free_decay`. For a part of it, only the measurement within this part is used.
    """
    time = decay["time"].to_numpy().astype(float)
    if MEASURED not in decay:
        return ("angle", 0.0), time, decay["angle"].to_numpy().astype(float)
    inside = decay[MEASURED].sel({MEASURED_TIME: slice(time[0], time[-1])})
    sensor = str(decay.attrs["measured"]), float(decay.attrs.get("distance", 0.0))
    return sensor, inside[MEASURED_TIME].to_numpy().astype(float), inside.to_numpy().astype(float)


def measured_motion(
    model: Model,
    run: xr.Dataset,
    start: tuple[float, float],
    *,
    fitted: Mask | None = None,
) -> tuple[SimulatedMotion, Array]:
    """Fit the start of a motion, and the sensor's bias, to the measured signal of a run.

    Parameters
    ----------
    model : Model
        Model with its inputs.
    run : Dataset
        See `measured_part`.
    start : (float, float), rad and rad/s
        First estimate of angle and rate at the first sample.
    fitted : (sample,) array of bool, optional
        Samples of the measurement to which the start is fitted; by default all.

    Returns
    -------
    motion : SimulatedMotion
    residual : (sample,) array of float
        Measured signal minus motion and bias, in the unit of the sensor.

    Raises
    ------
    SimulationError
        The motion cannot be computed.
    """
    (quantity, distance), time, values = measured_part(run)
    part = np.ones(len(time), dtype=bool) if fitted is None else fitted
    # The bias of a body that is free in position and speed cannot be determined.
    biased = first_zero(model) is not None
    begin, last = np.array(start, dtype=float), np.inf
    scale = np.array([1.0, model.reference_frequency, model.reference_frequency])[: 2 + biased]
    for _ in range(MAX_ROUNDS):
        motion = trajectory(model, time, *begin, by=BY_START)
        columns = motion.shown_derivatives(quantity, distance)
        columns = np.column_stack([columns, np.ones(len(time))]) if biased else columns
        residual = values - motion.shown(quantity, distance)
        step, *_ = np.linalg.lstsq(columns[part] * scale, residual[part], rcond=SINGULAR)
        step = step * scale
        size = float(np.max(np.abs(columns[part] @ step))) / max(float(np.std(values[part])), 1e-300)
        if biased:
            residual = residual - step[2]
        if size < SETTLED_START or not size < NOT_SHORTER * last:
            break
        begin, last = begin + step[:2], size
    return motion, residual
