"""Moving samples of driven records: forces along them, and a regression as the start of a fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.records.inputs import inputs_of, values_of_inputs
from sysid_trib.records.smoothing import first_frequency, nominal_frequency, smooth

# If the rate is below this fraction of its largest value, the body may be at rest, and friction a reaction.
AT_REST_PART = 0.02
# Largest number of samples that represent a run.
SAMPLES_OF_A_RUN = 1000
# Rounds of the regression if formulas contain coefficients of other forces.
REGRESSION_ROUNDS = 3


@dataclass(frozen=True)
class MovingSamples:
    """Samples of all runs at which the body moves.

    Attributes
    ----------
    names : mapping of str to (sample,) array of float
        Variables of formulas: x, v, t and inputs.
    acceleration : (sample,) array of float, rad
        Second derivative of the angle by tau.
    frequency : float, rad/s
        Frequency that defines tau and v.
    """

    names: Mapping[str, Array]
    acceleration: Array
    frequency: float


class Regression(NamedTuple):
    """Coefficients by symbol, including held ones, and the reference frequency (rad/s)."""

    coefficients: dict[str, float]
    frequency: float


def points_of(runs: Sequence[xr.Dataset], library: ForceLibrary) -> MovingSamples:
    """Return the moving samples of all runs, along the smoothed records."""
    w = nominal_frequency(first_frequency(runs))
    tables, accelerations = list[dict[str, Array]](), list[Array]()
    for run in runs:
        time = run.time.values.astype(float)
        tau = w * (time - time[0])
        x, v, _, _ = smooth(tau, run.angle.values.astype(float))
        moving = np.abs(v) > AT_REST_PART * np.max(np.abs(v))
        moving &= np.arange(len(time)) % max(1, len(time) // SAMPLES_OF_A_RUN) == 0
        given = values_of_inputs(inputs_of(run), library.channels, time - time[0], w)
        every = {"x": x, "v": v, "t": time - time[0], **given}
        tables.append({name: values[moving] for name, values in every.items()})
        accelerations.append(np.gradient(v, tau)[moving])
    names = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    return MovingSamples(names, np.concatenate(accelerations), w)


def columns_of(points: MovingSamples, forces: Sequence[Force]) -> Array:
    """Return the forces at the samples, then the acceleration, (sample, parameter)."""
    return np.stack([*(_along(force, points.names) for force in forces), points.acceleration], axis=1)


def _along(force: Force, names: Mapping[str, Array]) -> Array:
    """Return a force at samples, with internal states at zero."""
    inputs = {channel.name: names[channel.name] for channel in force.channels}
    return force.value(names["x"], names["v"], names["t"], hidden=inputs)


def regressed(points: MovingSamples, library: ForceLibrary, held: Mapping[str, float]) -> Regression:
    """Solve the equation of motion at samples by least squares.

    Parameters
    ----------
    points : MovingSamples
    library : ForceLibrary
        Terms of the sensor are left out. A force whose formula contains coefficients of other forces is added
        in the second round, with the coefficients of the round before.
    held : mapping of str to float
        Coefficients that are known.
    """
    forces = [force for force in library if force.kind == "force"]
    known, frequency = {k: v for k, v in held.items() if k in library.symbols}, points.frequency
    for number in range(REGRESSION_ROUNDS if library.used else 1):
        taken = [force.bound(known) for force in forces if number or not force.uses]
        free = [force for force in taken if force.symbol not in held]
        right = -np.asarray(points.names["x"])
        for force in taken:
            if force.symbol in held:
                right = right - held[force.symbol] * _along(force, points.names)
        *values, of_acceleration = np.linalg.lstsq(columns_of(points, free), right, rcond=1e-6)[0].tolist()
        known |= zip((force.symbol for force in free), values, strict=True)
        # Coefficients of (w0/w)^2 x'' + x + ... = 0, with tau = w0 t.
        if of_acceleration > 0.0:
            frequency = points.frequency / float(np.sqrt(of_acceleration))
    return Regression(known, frequency)
