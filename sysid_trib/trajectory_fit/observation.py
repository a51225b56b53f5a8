"""What a sensor shows of a motion: the angle, its rate, its acceleration, or what an accelerometer feels."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.records.units import STANDARD_GRAVITY
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulated_motion import SimulatedMotion

MEASURED, MEASURED_TIME = "measured", "measured_time"


@dataclass(frozen=True)
class Observation:
    """The quantity that a sensor shows, without its zero.

    Parameters
    ----------
    quantity : {"angle", "rate", "acceleration", "accelerometer"}
        Of a displacement likewise. An accelerometer feels, along its path, gravity too.
    distance : float, m
        Of an accelerometer from the axis of the pendulum.
    """

    quantity: str = "angle"
    distance: float = 0.0

    def shown(self, model: Model, motion: SimulatedMotion, time: Array) -> Array:
        """What the sensor shows of a motion, (sample,).

        Parameters
        ----------
        model : Model
            Whose motion it is.
        motion : SimulatedMotion
        time : (sample,) array of float, s
            Its times.
        """
        if self.quantity == "angle":
            return np.asarray(motion.angle)
        if self.quantity == "rate":
            return np.asarray(motion.rate)
        acceleration = acceleration_of(model, motion, time)
        if self.quantity == "acceleration":
            return acceleration
        return self.distance * acceleration + STANDARD_GRAVITY * np.sin(motion.position)


def acceleration_of(model: Model, motion: SimulatedMotion, time: Array) -> Array:
    """Acceleration of a motion by the forces of its model, (sample,) array of float, rad/s^2."""
    w, x = model.reference_frequency, motion.position
    v, since = motion.rate / w, time - time[0]
    push = np.array(x, dtype=float)
    for force in model.forces:
        prefix = f"{force.symbol}."
        hidden = {k.removeprefix(prefix): h for k, h in motion.hidden.items() if k.startswith(prefix)}
        h = force.value(x, v, since, shapes=model.shapes, hidden=hidden)
        push = push + model.coefficients[force.symbol] * h
    # What friction holds does not accelerate.
    return np.where(time > motion.stop_time, 0.0, -(w**2) * push)


def measured_part(decay: xr.Dataset) -> tuple[Observation, Array, Array]:
    """What was measured of a decay, its times (s) and values; the angle where nothing else was.

    Parameters
    ----------
    decay : Dataset
        As `free_decay` returns it. Of a part of one, only what was measured within it counts.
    """
    time = decay["time"].to_numpy().astype(float)
    if MEASURED not in decay:
        return Observation(), time, decay["angle"].to_numpy().astype(float)
    inside = decay[MEASURED].sel({MEASURED_TIME: slice(time[0], time[-1])})
    observation = Observation(str(decay.attrs["measured"]), float(decay.attrs.get("distance", 0.0)))
    return observation, inside[MEASURED_TIME].to_numpy().astype(float), inside.to_numpy().astype(float)
