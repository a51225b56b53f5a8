"""A motion at the times asked for: what is given to it, what it is, and what a sensor shows of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid_trib.arrays import Mask
from sysid_trib.errors import SimulationError
from sysid_trib.records.inputs import INPUT
from sysid_trib.simulation.model import Model, Vector
from sysid_trib.simulation.program import FORCING_NUMBERS

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


# Impulses a period of a motion with a random force: their law is then right to a percent.
INCREMENTS_PER_PERIOD = 40


@dataclass(frozen=True)
class Forcing:
    """What is given to a model over time, in tau.

    Attributes
    ----------
    knots : (knot,) array of float
        Increasing, the first at the start.
    polynomials : (knot, channel, power) array of float
        From each knot on, what is given, by powers of tau since it.
    increments : (knot, 2) array of float
        What is added to x and v there, but at the start.
    forced : bool
        Whether the first channel is an acceleration over w^2 (rad) that pushes.
    """

    knots: Vector
    polynomials: Vector
    increments: Vector
    forced: bool = False

    @property
    def acts(self) -> bool:
        """True if anything is given."""
        return bool(np.any(self.polynomials) or np.any(self.increments))


UNFORCED = Forcing(np.empty(0), np.zeros((0, 0, 1)), np.zeros((0, 2)))


def forcing_of(model: Model, tau: Vector, random_force: float = 0.0, seed: int = 0) -> Forcing:
    """What is given to a model: its inputs, exact between their samples, and a random force.

    Parameters
    ----------
    model : Model
    tau : (sample,) array of float
        w t from 0.
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of the acceleration; at least `INCREMENTS_PER_PERIOD` a period make it.
    seed : int

    Notes
    -----
    Over an interval h of tau a white acceleration adds to (x, v) a Gaussian vector of covariance
    per_tau [[h^3/3, h^2/2], [h^2/2, h]] to lowest order in h; per_tau = density/(2 w^3).
    """
    w = model.reference_frequency
    if not random_force and not any(channel.input in model.inputs for channel in model.driven):
        # Inputs that are not given are zero.
        return replace(UNFORCED, polynomials=np.zeros((0, len(model.driven), 1)))
    if len(tau) < 2:
        raise SimulationError("A motion that is pushed wants two or more times that increase.")
    knots = _instants(tau, INCREMENTS_PER_PERIOD) if random_force else tau[[0, -1]]
    increments = np.zeros((len(knots), 2))
    if random_force:
        increments[1:] = _increments(np.diff(knots), 0.5 * random_force / w**3, seed)
    bends = w * bends_of(model)
    instants = np.union1d(knots, bends[(bends > tau[0]) & (bends < tau[-1])])
    all_increments = np.zeros((len(instants), 2))
    all_increments[np.searchsorted(instants, knots)] = increments
    return Forcing(instants, polynomials_of(model, instants), all_increments, INPUT in model.inputs)


def bends_of(model: Model) -> Vector:
    """Times at which what is given begins another polynomial, (knot,), s."""
    names = {channel.input for channel in model.driven} & {*model.inputs}
    return np.unique(np.concatenate([*(model.inputs[name].bends for name in names), []]))


def polynomials_of(model: Model, knots: Vector) -> Vector:
    """What is given from each knot (tau) on, by powers of tau since it, (knot, channel, power)."""
    w, channels = model.reference_frequency, model.driven
    polynomials = np.zeros((len(knots), len(channels), FORCING_NUMBERS))
    for at, channel in enumerate(channels):
        if channel.input in model.inputs:
            given = model.inputs[channel.input].polynomials(knots, w, channel.order)
            polynomials[:, at, : given.shape[1]] = given / w**channel.power
    powers = np.flatnonzero(polynomials.any(axis=(0, 1)))
    return polynomials[:, :, : powers.max(initial=0) + 1]


def jumps_of(forcing: Forcing) -> Mask:
    """At which knots what forces hold of inputs jumps, (knot,)."""
    held = forcing.polynomials[:, int(forcing.forced) :]
    steps = np.diff(forcing.knots)[:, None, None] ** np.arange(held.shape[2])
    rises = np.abs(held[1:, :, 0] - np.sum(held[:-1] * steps, axis=2))
    largest = np.abs(held[..., 0]).max(axis=0, initial=0.0)
    jumps = np.zeros(len(forcing.knots), bool)
    # Of what is given before and behind a knot: a larger difference is a jump.
    jumps[1:] = (rises > 1e-9 * largest).any(axis=1)
    return jumps


def _instants(tau: Vector, per_period: int) -> Vector:
    """Where a step ends: at the samples, and between them at so many a period."""
    parts = np.maximum(1, np.ceil(np.diff(tau) * per_period / (2.0 * np.pi))).astype(int)
    fractions = np.concatenate([np.arange(count) / count for count in parts])
    return np.append(tau[:-1].repeat(parts) + fractions * np.diff(tau).repeat(parts), tau[-1])


def _increments(h: Vector, per_tau: float, seed: int) -> Vector:
    """What a random force adds to x and v by the end of each step, (step, 2)."""
    # A stream of its own: noise that is added with the same seed is independent of it.
    random = np.random.default_rng([seed, 1]).standard_normal((2, len(h)))
    increment_v = np.sqrt(per_tau * h) * random[0]
    # Of the variance h^3/3 of x three quarters are by what v gains, a quarter is its own.
    increment_x = 0.5 * h * increment_v + np.sqrt(per_tau * h**3 / 12.0) * random[1]
    return np.stack([increment_x, increment_v], axis=1)
