"""A record followed by the motion of a model that is given: only its start and the sensor's zero adapt."""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.noise.random_force import RandomForce, random_force_of
from sysid_trib.noise.sensor_noise import sensor_noise_of
from sysid_trib.results.schema import model_of
from sysid_trib.simulation.model import Model
from sysid_trib.state_space.kalman import LinearModel
from sysid_trib.state_space.linearised import Derivatives, linearised_about, spline_path

MAX_SMOOTHINGS = 12
# The path is settled where it moves by less than this part of the sensor's noise.
PATH_SETTLED = 0.01
# Angle and rate at the first sample, zero of the sensor.
NO_PARAMETERS = Derivatives((), frequency=False)


@dataclass(frozen=True)
class TrackedRecord:
    """A record, linear about the smoothed motion of a model.

    Attributes
    ----------
    model : Model
        The identified model.
    time, angle : (sample,) array of float, s and rad
        The record.
    linear : LinearModel
        About the smoothed motion, with columns for angle and rate at the start and for the sensor's zero.
    deviation : (3,) array of float
        Of these three from where it is linear; nearly zero.
    zero : float, rad
        Zero of the sensor.
    noise : float, rad
        Standard deviation of the sensor's noise, of its innovations where it is coloured.
    per_tau : float, rad^2
        Growth of the variance of v in a unit of tau, by the random force.
    """

    model: Model
    time: Array
    angle: Array
    linear: LinearModel
    deviation: Array
    zero: float
    noise: float
    per_tau: float

    @property
    def ratio(self) -> float:
        """The random force's `per_tau` over the variance of the sensor's noise."""
        return self.per_tau / self.noise**2

    def innovations(self) -> tuple[Array, Array]:
        """What is predicted wrongly one sample ahead, and its standard deviation, (sample,) each, rad."""
        innovations, columns, variance = self.linear.innovations(self.ratio)
        return innovations - columns @ self.deviation, self.noise * np.sqrt(variance)


def track(decay: xr.Dataset, result: xr.Dataset, run: int = 0, density: float | None = None) -> TrackedRecord:
    """Follow a record by an identified model with its random force.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        Any identification; one that says nothing of a random force has none.
    run : int
        Which of its runs the decay is, for noise and random force.
    density : float, (rad/s^2)^2/Hz, optional
        Of the random force, in the place of the result's.

    Raises
    ------
    DecayError
        The motion does not settle on the record.
    SimulationError
        The motion between two samples cannot be computed.

    Notes
    -----
    The iterated extended Kalman smoother (Bell 1994): linear about a path, the next path is the smoothed
    motion. Without a random force that is least squares on the start, by multiple shooting.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    model = model_of(result)
    frequency = model.reference_frequency
    force = random_force_of(result, run) if density is None else RandomForce(density)
    per_tau = force.per_tau(frequency)
    # A record without noise is still one of finite digits.
    sensor = sensor_noise_of(result, run)
    noise = max(sensor.innovation, 1e-12 * float(np.max(np.abs(angle))))
    path = spline_path(model, time, angle)
    per_run = np.array([path[0, 0], frequency * path[0, 1], 0.0])
    for _ in range(MAX_SMOOTHINGS):
        linear = linearised_about(model, time, angle, path, per_run, NO_PARAMETERS)
        linear = replace(linear, sensor_filter=sensor.filter_)
        deviation, _ = linear.rows(per_tau / noise**2).solution()
        change = linear.smoothed_motion(per_tau / noise**2, deviation) - linear.path
        if not np.all(np.isfinite(change)):
            break
        if np.max(np.abs(change[:, 0])) <= PATH_SETTLED * noise and abs(deviation[2]) <= PATH_SETTLED * noise:
            return TrackedRecord(model, time, angle, linear, deviation, per_run[2], noise, per_tau)
        path, per_run = linear.path + change, per_run + deviation
    raise DecayError(
        "The motion of this identification does not settle on the record; its forces do not describe it. "
        "Offer others, or a shorter window."
    )
