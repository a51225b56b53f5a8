"""Sensor errors of another record, fitted to that record."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask, root_mean_square
from sysid_trib.errors import SimulationError
from sysid_trib.results.kinds import REFITTED_SENSORS
from sysid_trib.simulation.initial_conditions import BY_START, first_guess, first_zero, fit_start
from sysid_trib.simulation.measured_motion import MEASURED
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.trajectory import trajectory

# Most steps; damping of the first step, its factor after a failed step; least gain for another step.
MOST_REFITS, FIRST_DAMPING, DAMPED_BY, SETTLED_RESIDUAL = 30, 1e-4, 10.0, 1e-5
# Prior: the terms of another run have the size of the identification's, times this factor.
PRIOR_SIZES = 3.0


def with_own_sensor(
    result: xr.Dataset, model: Model, record: xr.Dataset, fitted: Mask
) -> tuple[Model, xr.Dataset]:
    """Fit the sensor terms of a model to another record, like its start and zero.

    Parameters
    ----------
    result : Dataset
        The identification. For its own records, and for held terms, the sensor terms remain unchanged.
    model : Model
        Model of the identification, with the inputs of the record.
    record : Dataset
        `angle(time)`.
    fitted : (time,) array of bool
        Samples to which start and zero are fitted.

    Returns
    -------
    tuple of (Model, Dataset)
        The model with the sensor terms of the record, and the record with the attribute `refitted_sensors`,
        their names. Both are unchanged without sensor terms, or if no motion follows the record.
    """
    errors = dict(zip(result.force.values.tolist(), result.standard_error.values.tolist(), strict=True))
    symbols = [force.symbol for force in model.sensors if errors.get(force.symbol, 0.0) > 0.0]
    checksum = str(record.attrs.get("record_checksum", ""))
    # If a rate or an acceleration was measured, the angle was not.
    if (
        not symbols
        or MEASURED in record
        or (checksum and checksum in np.ravel(result.attrs["record_checksum"]).tolist())
    ):
        return model, record
    time, angle = record.time.values.astype(float)[fitted], record.angle.values.astype(float)[fitted]
    try:
        own = _refitted(model, symbols, errors, time, angle)
    except SimulationError:
        return model, record
    return own, record.assign_attrs({REFITTED_SENSORS: ", ".join(symbols)})


@dataclass(frozen=True)
class _Fit:
    """A motion, zero and sensor terms near a record.

    Attributes
    ----------
    values : (parameter,) array of float
        Start angle (rad), start rate (rad/s), sensor terms, zero of the sensor (rad).
    residual : (sample,) array of float, rad
    columns : (sample, parameter) array of float
        Derivatives of the sensor's reading.
    """

    values: Array
    residual: Array
    columns: Array


def _refitted(model: Model, symbols: list[str], errors: dict[str, float], time: Array, angle: Array) -> Model:
    """Return the model with the sensor terms of the record.

    This is least squares of start, zero and sensor terms (Levenberg 1944). A delay is hardly separable from
    the start: sensor terms are therefore drawn towards those of the identification, relative to their size.
    """
    w, zero = model.reference_frequency, first_zero(model)
    start = fit_start(model, time, angle, first_guess(time, angle, w), offset=zero)
    own = np.array([model.coefficients[symbol] for symbol in symbols])
    sizes = PRIOR_SIZES * np.maximum(np.abs(own), [errors[symbol] for symbol in symbols])
    sensors = slice(2, 2 + len(own))
    noise = root_mean_square(angle - start.x - start.offset)

    def with_values(values: Array) -> Model:
        chosen = dict(zip(symbols, values[sensors].tolist(), strict=True))
        return model.with_coefficients(dict(model.coefficients) | chosen)

    def fit(values: Array) -> _Fit:
        motion = trajectory(with_values(values), time, *values[:2], by=(*BY_START, *symbols))
        of_zero = np.full((len(time), 1), float(zero is not None))
        return _Fit(
            values,
            np.append(angle - values[-1] - motion.angle, noise * (own - values[sensors]) / sizes),
            np.vstack([np.hstack([motion.derivatives["angle"], of_zero]), towards]),
        )

    towards = np.zeros((len(own), len(own) + 3))
    towards[:, sensors] = np.diag(noise / sizes)
    best, damping = fit(np.array([start.angle, start.rate, *own, start.offset])), FIRST_DAMPING
    scales = np.maximum(np.linalg.norm(best.columns, axis=0), 1e-300)
    for _ in range(MOST_REFITS):
        columns = best.columns / scales
        normal = columns.T @ columns + damping * np.eye(len(scales))
        step = np.linalg.solve(normal, columns.T @ best.residual) / scales
        try:
            tried = fit(best.values + step)
        except SimulationError:
            damping *= DAMPED_BY
            continue
        before, after = root_mean_square(best.residual), root_mean_square(tried.residual)
        if not after < before:
            damping *= DAMPED_BY
            continue
        best, damping = tried, damping / DAMPED_BY
        if after > (1.0 - SETTLED_RESIDUAL) * before:
            break
    return with_values(best.values)
