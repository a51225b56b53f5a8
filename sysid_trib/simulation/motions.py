"""A motion at the times asked for, and what a sensor shows of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid_trib.simulation.model import Model, Vector

# What a derivative can be by, besides symbols of forces and names of shape parameters: names with a space.
FREQUENCY, BY_ANGLE, BY_RATE = "reference frequency", "start angle", "start rate"


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion of a model along a grid.

    Attributes
    ----------
    model : Model
    tau : (sample,) array of float
        w t, from the start.
    y : (sample, state) array of float
        x, v = dx/dtau (rad) and states.
    bend : (sample,) array of float, rad
        dv/dtau.
    hidden : dict of str to (sample,) array of float
        States and memory of forces, as `dahl.z`.
    stop, turns : float and array of float
        tau where it stops, NaN if it goes on or is pushed; where v = 0, known where a force switches there.
    by : tuple of str
        Parameters of its derivatives.
    tangents : (sample, state + 1 + memory, parameter) array of float
        Derivatives of `y`, `bend` and the memory by these, at given times.
    start : float, s
        Time of the start.
    """

    model: Model
    tau: Vector
    y: Vector
    bend: Vector
    hidden: dict[str, Vector]
    stop: float
    turns: Vector
    by: tuple[str, ...]
    tangents: Vector
    start: float = 0.0

    @property
    def position(self) -> Vector:
        """The true angle, (sample,), rad."""
        return self.y[:, 0]

    @cached_property
    def rate(self) -> Vector:
        """Its derivative, (sample,), rad/s."""
        return self.model.reference_frequency * self.y[:, 1]

    @property
    def acceleration(self) -> Vector:
        """Its second derivative, (sample,), rad/s^2."""
        return self.model.reference_frequency**2 * self.bend

    @cached_property
    def angle(self) -> Vector:
        """The angle as measured, with the sensor terms of the model, (sample,), rad."""
        return self.position + self._sensor_error[0]

    @property
    def stop_time(self) -> float:
        """When it stops (s); NaN if it goes on, or is pushed."""
        return self.start + self.stop / self.model.reference_frequency

    @property
    def reversals(self) -> Vector:
        """Exact times of v = 0 (s), known where a force switches there."""
        return self.start + self.turns / self.model.reference_frequency

    @cached_property
    def derivatives(self) -> dict[str, Vector]:
        """Derivatives of `angle`, `position`, `rate` and `acceleration`, (sample, parameter) each, if any."""
        if not self.by:
            return {}
        w, size = self.model.reference_frequency, self.y.shape[1]
        of_w = np.array([float(name == FREQUENCY) for name in self.by])
        of_x, of_v, of_bend = self.tangents[:, 0], self.tangents[:, 1], self.tangents[:, size]
        _, by_motion, by_names = self._sensor_error
        return {
            "angle": of_x + by_motion[:, :1] * of_x + by_motion[:, 1:] * of_v + by_names,
            "position": of_x,
            "rate": w * of_v + self.y[:, 1:2] * of_w,
            "acceleration": w * (w * of_bend + self.bend[:, None] * of_w),
        }

    @cached_property
    def _sensor_error(self) -> tuple[Vector, Vector, Vector]:
        elapsed = self.tau / self.model.reference_frequency
        return sensor_error(self.model, elapsed, self.y[:, 0], self.y[:, 1], self.by)


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
