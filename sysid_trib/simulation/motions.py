"""Motions at the times asked for, of one start or of many, and what a sensor shows of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_trib.arrays import Array, Index
from sysid_trib.records.inputs import INPUT
from sysid_trib.simulation.compiled import INTERVAL_ENDS, Given
from sysid_trib.simulation.forcing import bends_of, polynomials_of
from sysid_trib.simulation.integrate import DIVERGED, FREQUENCY, NormalisedMotion, begun, run
from sysid_trib.simulation.model import Model, Vector
from sysid_trib.simulation.program import program_of


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
    model: Model, elapsed: Vector, start: float, path: NormalisedMotion, by: Sequence[str], *, forced: bool
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
    forced : bool
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
        float("nan") if forced else start + path.stop / w,
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


# In an interval, and in each unit of tau of it.
SWITCHINGS_ALLOWED, STEPS_ALLOWED = 60, 3000
GAUSS_POINTS, GAUSS_WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(3))
GAUSS_POINTS = GAUSS_POINTS + 0.5


@dataclass(frozen=True)
class Steps:
    """Exact motion over intervals, from states that are given at their beginnings.

    The state is x, v (rad), then the internal states of the forces, then their memory (`Motion.variables`,
    `Motion.memory`).

    Attributes
    ----------
    end : (step, state) array of float
        State at the end of each interval.
    transition : (step, state, start) array of float
        Derivative of the end by the beginning.
    sensitivity : (step, state, parameter) array of float
        Derivative of the end by the parameters that were asked for, the beginning (x, v, ...) held.
    diffusion : (step, state, state) array of float
        Covariance of the end by a white acceleration that makes the variance of v grow by one a unit of tau;
        zero where it was not asked for.
    """

    end: Array
    transition: Array
    sensitivity: Array
    diffusion: Array

    def then(self, further: "Steps") -> "Steps":
        """Both one after the other."""
        onward = further.transition
        return Steps(
            further.end,
            onward @ self.transition,
            onward @ self.sensitivity + further.sensitivity,
            onward @ self.diffusion @ onward.swapaxes(1, 2) + further.diffusion,
        )


def steps_of(
    model: Model,
    spans: tuple[Array, Array],
    states: Array,
    by: tuple[str, ...] = (),
    *,
    diffuses: bool = False,
    by_start: int | None = None,
) -> Steps:
    """Follow a motion over intervals, each from a state that is given.

    Parameters
    ----------
    model : Model
        Forces with coefficient zero are followed too.
    spans : two (interval,) arrays of float
        Beginning and length of each in tau.
    states : (interval, state) array of float
        At the beginnings.
    by : tuple of str
        Parameters by which the ends are derived, as in `integrate`.
    diffuses : bool
        Whether the diffusion is asked for: that of impulses within the interval, carried to its end by the
        same derivatives, at Gauss's points.
    by_start : int, optional
        By so many of the first numbers of the beginnings the ends are derived; by all where left out.

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    tau, length = spans
    places = GAUSS_POINTS if diffuses else np.empty(0)
    w = model.reference_frequency
    motion, program = program_of(model.forces, forced=INPUT in model.inputs, paced=FREQUENCY in by)
    size, count = program.states + program.memory, len(tau)
    starts = size if by_start is None else by_start
    first = starts + len(by)
    columns = first + len(places)
    knots, marks, points = _knots(tau, length, w * bends_of(model), places)
    impulses = np.zeros((len(knots), columns))
    inside = np.flatnonzero(points >= 0)
    impulses[inside, first + points[inside]] = np.sqrt(GAUSS_WEIGHTS)[points[inside]]
    polynomials = polynomials_of(model, knots)
    # Where each interval begins is given, and so are the derivatives there.
    state = begun((motion, program), model, (0.0, 0.0), by, places=(starts, columns))
    rows = np.empty((count, size + 1))
    tangents = np.empty((count, size + 1, columns))
    increments = np.zeros((len(knots), 2))
    given = Given(tau, knots, polynomials, increments, impulses, marks, states.astype(float), rows, tangents)
    budget = int(SWITCHINGS_ALLOWED * np.sum(1.0 + length)), int(STEPS_ALLOWED * np.sum(1.0 + length))
    if count:
        run(program, given, state, (DIVERGED, *budget), w)
    kept = np.delete(np.arange(size + 1), program.states)
    by_begin, by_names, by_impulses = np.split(tangents[:, kept], [starts, first], axis=2)
    random = by_impulses * np.sqrt(length)[:, None, None]
    diffusion = random @ random.swapaxes(1, 2)
    return Steps(rows[:, kept], by_begin.copy(), by_names.copy(), diffusion)


def _knots(tau: Array, length: Array, bends: Array, places: Array) -> tuple[Array, Index, Index]:
    """For each knot its tau, its mark, and which of the places in an interval it is, or -1.

    A knot begins and ends each interval; between are the places, and where an input bends.
    """
    count, many = len(tau), len(places)
    fractions = np.concatenate([[0.0], places, [1.0]])
    marks = np.full((count, many + 2), -1)
    marks[:, 0], marks[:, -1] = np.arange(count), INTERVAL_ENDS
    points = np.tile([-1, *range(many), -1], (count, 1))
    at = np.repeat(np.arange(count), many + 2)
    knots = (tau[:, None] + length[:, None] * fractions).ravel()
    first, last = np.searchsorted(bends, tau, "right"), np.searchsorted(bends, tau + length, "left")
    bent = np.maximum(last - first, 0)
    within = np.arange(bent.sum()) - np.repeat(np.cumsum(bent) - bent, bent)
    of_bend = np.repeat(np.arange(count), bent)
    at, none = np.concatenate([at, of_bend]), np.full(len(of_bend), -1)
    knots = np.concatenate([knots, bends[first[of_bend] + within]])
    marks, points = np.concatenate([marks.ravel(), none]), np.concatenate([points.ravel(), none])
    order = np.lexsort((marks == INTERVAL_ENDS, marks < 0, knots, at))
    return knots[order], marks[order], points[order]
