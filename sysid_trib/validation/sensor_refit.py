"""Errors of the sensor in another record: they are those of its own run, and fitted to it."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import SimulationError
from sysid_trib.records.decay import root_mean_square
from sysid_trib.simulation.initial_conditions import (
    BY_START,
    SETTLED_START,
    SINGULAR,
    first_guess,
    first_zero,
    fit_start,
)
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory

# Attribute of a prediction: the sensor terms that were fitted to its record.
REFITTED_SENSORS = "refitted_sensors"
MOST_ROUNDS = 8
# A longer step of the start, in parts of the swing, is a slip of phase.
LONGEST_STEP = 0.5


def with_own_sensor(
    result: xr.Dataset, model: Model, record: xr.Dataset, fitted: Mask
) -> tuple[Model, xr.Dataset]:
    """Fit the sensor terms of a model to another record, as its start and zero are.

    Parameters
    ----------
    result : Dataset
        The identification. Its own records have its own sensor terms, and terms that it holds stay.
    model : Model
        Of the identification, with the inputs of the record.
    record : Dataset
        `angle(time)`.
    fitted : (time,) array of bool
        Samples to which start and zero are fitted.

    Returns
    -------
    tuple of (Model, Dataset)
        The model with the sensor terms of the record, and the record whose attribute `refitted_sensors` names
        them; both as they were where there are none, or where no motion follows the record.
    """
    errors = dict(zip(result.force.values.tolist(), result.standard_error.values.tolist(), strict=True))
    symbols = [force.symbol for force in model.sensors if errors.get(force.symbol, 0.0) > 0.0]
    checksum = str(record.attrs.get("record_checksum", ""))
    if not symbols or (checksum and checksum in np.ravel(result.attrs["record_checksum"]).tolist()):
        return model, record
    time, angle = record.time.values.astype(float)[fitted], record.angle.values.astype(float)[fitted]
    try:
        own = _refitted(model, symbols, time, angle)
    except SimulationError:
        return model, record
    return own, record.assign_attrs({REFITTED_SENSORS: ", ".join(symbols)})


def _refitted(model: Model, symbols: list[str], time: Array, angle: Array) -> Model:
    """Return the model with sensor terms of least squares, by Gauss-Newton with the start and the zero."""
    w, zero = model.reference_frequency, first_zero(model)
    start = fit_start(model, time, angle, first_guess(time, angle, w), offset=zero)
    begin, offset = np.array([start.angle, start.rate]), start.offset
    amplitude = float(np.max(np.abs(angle))) * np.array([1.0, w])
    coefficients = dict(model.coefficients)
    best, smallest = model, root_mean_square(angle - start.x - start.offset)
    for _ in range(MOST_ROUNDS):
        motion = trajectory(model, time, *begin, by=(*BY_START, *symbols))
        residual = angle - offset - motion.angle
        if (size := root_mean_square(residual)) < smallest:
            best, smallest = model, size
        columns = motion.derivatives["angle"]
        columns = columns if zero is None else np.column_stack([columns, np.ones(len(time))])
        scales = np.linalg.norm(columns, axis=0)
        scales[scales == 0.0] = 1.0
        steps, *_ = np.linalg.lstsq(columns / scales, residual, rcond=SINGULAR)
        linear = root_mean_square(residual - (columns / scales) @ steps)
        steps = steps / scales
        longest = float(np.max(np.abs(steps[:2]) / amplitude))
        steps *= min(1.0, LONGEST_STEP / max(longest, 1e-300))
        begin = begin + steps[:2]
        offset += 0.0 if zero is None else float(steps[-1])
        for at, symbol in enumerate(symbols, 2):
            coefficients[symbol] += float(steps[at])
        model = model.with_coefficients(coefficients)
        if longest < SETTLED_START:
            # What is measured is linear in so short a step.
            return model if linear < smallest else best
    return best
