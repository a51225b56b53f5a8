"""A motion at the times asked for, and what a sensor shows of it."""

from dataclasses import dataclass

from sysid_trib.simulation.equations import Vector
from sysid_trib.simulation.model import Model


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion at the times asked for.

    Attributes
    ----------
    angle : (sample,) array of float, rad
        As measured, with the sensor terms of the model.
    position, rate : (sample,) array of float, rad and rad/s
        The true motion.
    stop_time : float, s
        NaN if the motion goes on.
    reversals : array of float, s
        Exact times of v = 0, known where a force switches there.
    hidden : dict of str to (sample,) array of float
        States and memory of forces, as `dahl.z`.
    engine : str
        What integrated it.
    """

    angle: Vector
    position: Vector
    rate: Vector
    stop_time: float
    reversals: Vector
    hidden: dict[str, Vector]
    engine: str


def shown(model: Model, x: Vector, v: Vector, elapsed: Vector) -> Vector:
    """What the sensor shows of a motion, but for its zero."""
    shown = x.copy()
    for sensor in model.sensors:
        shown += model.coefficients[sensor.symbol] * sensor.value(x, v, elapsed, shapes=model.shapes)
    return shown
