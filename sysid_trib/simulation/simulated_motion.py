"""A motion at the times asked for, and what a sensor shows of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_trib.simulation.equations import Vector
from sysid_trib.simulation.integrate import FREQUENCY, NormalisedMotion
from sysid_trib.simulation.model import Model


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion at the times asked for.

    Attributes
    ----------
    angle : (sample,) array of float, rad
        As measured, with the sensor terms of the model.
    position, rate, acceleration : (sample,) array of float, rad, rad/s and rad/s^2
        The true motion.
    stop_time : float, s
        NaN if the motion goes on, or is pushed.
    reversals : array of float, s
        Exact times of v = 0, known where a force switches there.
    hidden : dict of str to (sample,) array of float
        States and memory of forces, as `dahl.z`.
    derivatives : dict of str to (sample, parameter) array of float
        Of `angle`, `position`, `rate` and `acceleration`, where they were asked for.
    """

    angle: Vector
    position: Vector
    rate: Vector
    acceleration: Vector
    stop_time: float
    reversals: Vector
    hidden: dict[str, Vector]
    derivatives: dict[str, Vector]


def simulated_motion(
    model: Model, elapsed: Vector, start: float, path: NormalisedMotion, by: Sequence[str], *, pushed: bool
) -> SimulatedMotion:
    """A motion in tau as one in time, as the sensor shows it.

    Parameters
    ----------
    model : Model
    elapsed : (sample,) array of float, s
        Times since the start.
    start : float, s
    path : NormalisedMotion
    by : sequence of str
        Parameters of its derivatives.
    pushed : bool
        Whether it may go on at any time.
    """
    w, x, v = model.reference_frequency, path.y[:, 0], path.y[:, 1]
    of_w = np.array([float(name == FREQUENCY) for name in by])
    of_x, of_v = path.derivative[:, 0], path.derivative[:, 1]
    of_bend = path.derivative[:, path.y.shape[1]]
    error, by_motion, by_names = sensor_error(model, elapsed, x, v, by)
    of_angle = of_x + by_motion[:, :1] * of_x + by_motion[:, 1:] * of_v + by_names
    derivatives = {
        "angle": of_angle,
        "position": of_x,
        "rate": w * of_v + v[:, None] * of_w,
        "acceleration": w * (w * of_bend + path.acceleration[:, None] * of_w),
    }
    return SimulatedMotion(
        x + error,
        x,
        w * v,
        w**2 * path.acceleration,
        float("nan") if pushed else start + path.stop / w,
        start + path.reversals / w,
        path.hidden,
        derivatives if by else {},
    )


def sensor_error(
    model: Model, elapsed: Vector, x: Vector, v: Vector, by: Sequence[str]
) -> tuple[Vector, Vector, Vector]:
    """What the sensor adds to the angle (sample,), and its derivatives by x and v, and by `by`."""
    error, by_motion = np.zeros_like(x), np.zeros((len(x), 2))
    by_names = np.zeros((len(x), len(by)))
    for sensor in model.sensors:
        coefficient, shapes = model.coefficients[sensor.symbol], sensor.shape_values(model.shapes)
        names = {"x": x, "v": v, "t": elapsed, **shapes}
        value = sensor.value(x, v, elapsed, shapes=model.shapes)
        error += coefficient * value
        for at, name in enumerate("xv"):
            by_motion[:, at] += coefficient * sensor.formula.derivative(names, name)
        for at, name in enumerate(by):
            symbol, _, shape = name.partition(".")
            if name == sensor.symbol:
                by_names[:, at] = value
            elif symbol == sensor.symbol:
                by_names[:, at] = coefficient * sensor.formula.derivative(names, shape)
    return error, by_motion, by_names
