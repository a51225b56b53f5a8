"""What a sensor shows of a motion: the angle, its rate, its acceleration, or what an accelerometer feels."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.records.units import STANDARD_GRAVITY
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

    def shown(self, motion: SimulatedMotion) -> Array:
        """What the sensor shows of a motion, (sample,)."""
        if self.quantity == "accelerometer":
            return self.distance * motion.acceleration + STANDARD_GRAVITY * np.sin(motion.position)
        return np.asarray(getattr(motion, self.quantity))

    def derivatives(self, motion: SimulatedMotion) -> Array:
        """Derivatives of that by the parameters of the motion's, (sample, parameter)."""
        if self.quantity == "accelerometer":
            gravity = STANDARD_GRAVITY * np.cos(motion.position)[:, None] * motion.derivatives["position"]
            return np.asarray(self.distance * motion.derivatives["acceleration"] + gravity)
        return motion.derivatives[self.quantity]


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
