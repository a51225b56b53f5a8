"""A record followed by the motion of a model that is given: only its start and the sensor's zero adapt."""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.random_force import RandomForce, random_force_of
from sysid_trib.likelihood.sensor_noise import of_order, sensor_noise_of
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.linearised import linearised_about, spline_path
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.schema import model_of
from sysid_trib.simulation.model import Model

# Of noise as 1/f so many taps: each is a state, and further ones change little at the frequency of a swing.
MOST_TAPS = 49


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
        _, innovations, variance = self.linear.innovations(self.ratio, self.deviation)
        return innovations[:, 0], self.noise * np.sqrt(variance)

    def linear_about(self, path: Array, zero: float, by: tuple[str, ...] = ()) -> LinearModel:
        """The record linear about a path, with a zero of the sensor, and columns for parameters."""
        per_run = np.array([path[0, 0], self.model.reference_frequency * path[0, 1], zero])
        linear = linearised_about(self.model, (self.time, self.angle), path, per_run, by)
        return replace(linear, sensor_filter=self.linear.sensor_filter)

    def with_density(self, density: float) -> "TrackedRecord":
        """The record with another random force ((rad/s^2)^2/Hz), settled anew from where it is.

        Raises
        ------
        DecayError
            The motion does not settle on the record.
        SimulationError
            The motion between two samples cannot be computed.
        """
        per_tau = RandomForce(density).per_tau(self.model.reference_frequency)
        return self if per_tau == self.per_tau else _settled(replace(self, per_tau=per_tau))


def track(decay: xr.Dataset, result: xr.Dataset, run: int = 0, every: int = 1) -> TrackedRecord:
    """Follow a record by an identified model with its random force.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        Any identification; one that says nothing of a random force has none.
    run : int
        Which of its runs the decay is, for noise and random force.
    every : int
        Of so many samples one is taken.

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
    model = replace(model_of(result, run), inputs=inputs_of(decay))
    decay = decay.isel(time=slice(None, None, every))
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    frequency = model.reference_frequency
    per_tau = random_force_of(result, run).per_tau(frequency)
    # A record without noise is still one of finite digits.
    sensor = sensor_noise_of(result, run).of_every(every, len(time))
    noise = max(sensor.innovation, 1e-12 * float(np.max(np.abs(angle))))
    path = spline_path(model, time, angle)
    linear = linearised_about(model, (time, angle), path, np.array([path[0, 0], frequency * path[0, 1], 0.0]))
    colour = sensor.filter_ if len(sensor.filter_) <= MOST_TAPS else of_order(sensor.filter_, MOST_TAPS - 1)
    linear = replace(linear, sensor_filter=colour)
    return _settled(TrackedRecord(model, time, angle, linear, np.zeros(3), 0.0, noise, per_tau))


def _settled(tracked: TrackedRecord) -> TrackedRecord:
    """The record about the motion at which its smoothing comes to rest."""
    # The path is settled where it moves by less than this part of the sensor's noise.
    tolerance = 0.01 * tracked.noise
    changes: list[float] = []
    for _ in range(12):
        linear = tracked.linear
        deviation, _ = linear.rows(tracked.ratio).solution()
        change = linear.smoothed_motion(tracked.ratio, deviation) - linear.path
        if not np.all(np.isfinite(change)):
            break
        if np.max(np.abs(change[:, 0])) <= tolerance and abs(deviation[2]) <= tolerance:
            return replace(tracked, deviation=deviation)
        changes.append(float(np.max(np.abs(change))))
        # Where friction holds and frees the body in turn, changes come back: after so many without a smaller
        # one.
        if np.argmin(changes) < len(changes) - 3:
            break
        zero = float(tracked.zero + deviation[2])
        tracked = replace(tracked, linear=tracked.linear_about(linear.path + change, zero), zero=zero)
    raise DecayError(
        "The motion of this identification does not settle on the record; its forces do not describe it. "
        "Offer others, or a shorter window."
    )
