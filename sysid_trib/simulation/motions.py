"""A model's motion by the compiled engine: its input, its output, and its failures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from sysid_trib.arrays import Mask
from sysid_trib.errors import SimulationError
from sysid_trib.forces.force import channels_of
from sysid_trib.records.unit_tables import ACCELEROMETER, STANDARD_GRAVITY
from sysid_trib.simulation import under_way
from sysid_trib.simulation.model import FREQUENCY, Model, Motion, Vector, motion_of, sensor_error


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion of a model along a grid.

    Attributes
    ----------
    tau : (sample,) array of float
        w t, from the start.
    rows : (sample, number) array of float
        x and v = dx/dtau (rad), states and memory of forces; last dv/dtau.
    hidden : dict of str to (sample,) array of float
        The states and the memory by their names, such as `dahl.z`.
    stop, turns : float and array of float
        tau of the stop, NaN if the motion continues or has a random force; and tau of the zeros of v, if a
        force switches there.
    by : tuple of str
        Parameters of the derivatives.
    tangents : (sample, number, parameter) array of float
        Derivatives of the rows by these parameters, at given times.
    start : float, s
        Time of the start.
    """

    model: Model
    tau: Vector
    rows: Vector
    hidden: dict[str, Vector]
    stop: float
    turns: Vector
    by: tuple[str, ...]
    tangents: Vector
    start: float = 0.0

    @property
    def position(self) -> Vector:
        """The true angle, (sample,), rad."""
        return self.rows[:, 0]

    @cached_property
    def rate(self) -> Vector:
        """Derivative of the true angle, (sample,), rad/s."""
        return self.model.reference_frequency * self.rows[:, 1]

    @property
    def acceleration(self) -> Vector:
        """Second derivative of the true angle, (sample,), rad/s^2."""
        return self.model.reference_frequency**2 * self.rows[:, -1]

    @cached_property
    def angle(self) -> Vector:
        """The angle as measured, with the sensor terms of the model, (sample,), rad."""
        return self.position + self._sensor_error[0]

    @property
    def stop_time(self) -> float:
        """Time at which the motion stops (s); NaN if it continues, or has a random force."""
        return self.start + self.stop / self.model.reference_frequency

    @property
    def reversals(self) -> Vector:
        """Exact times of v = 0 (s), known if a force switches there."""
        return self.start + self.turns / self.model.reference_frequency

    def shown(self, quantity: str, distance: float = 0.0) -> Vector:
        """Return a sensor's reading without its zero: of a quantity above, or of an accelerometer.

        An accelerometer at a distance (m) from the axis of a pendulum measures gravity along its path too.
        """
        if quantity == ACCELEROMETER:
            return distance * self.acceleration + STANDARD_GRAVITY * np.sin(self.position)
        return np.asarray(getattr(self, quantity))

    def shown_derivatives(self, quantity: str, distance: float = 0.0) -> Vector:
        """Return the derivatives of that reading by the parameters, (sample, parameter)."""
        if quantity == ACCELEROMETER:
            gravity = STANDARD_GRAVITY * np.cos(self.position)[:, None] * self.derivatives["position"]
            return distance * self.derivatives["acceleration"] + gravity
        return self.derivatives[quantity]

    @cached_property
    def derivatives(self) -> dict[str, Vector]:
        """Derivatives of `angle`, `position`, `rate` and `acceleration`, (sample, parameter) each, if any."""
        if not self.by:
            return {}
        w, of_w = self.model.reference_frequency, np.array([float(name == FREQUENCY) for name in self.by])
        of_x, of_v, of_bend = self.tangents[:, 0], self.tangents[:, 1], self.tangents[:, -1]
        _, by_motion, by_names = self._sensor_error
        return {
            "angle": of_x + by_motion[:, :1] * of_x + by_motion[:, 1:] * of_v + by_names,
            "position": of_x,
            "rate": w * of_v + self.rows[:, 1:2] * of_w,
            "acceleration": w * (w * of_bend + self.rows[:, -1:] * of_w),
        }

    @property
    def start_by_sensor(self) -> Vector:
        """Derivatives of the start angle by the parameters, (parameter,), for a given sensor reading."""
        _, by_motion, by_names = self._sensor_error
        return np.asarray(-by_names[0] / (1.0 + by_motion[0, 0]))

    @cached_property
    def _sensor_error(self) -> tuple[Vector, Vector, Vector]:
        elapsed = self.tau / self.model.reference_frequency
        return sensor_error(self.model, elapsed, self.rows[:, 0], self.rows[:, 1], self.by)


class Forcing(NamedTuple):
    """Inputs and random force of a motion over time.

    Attributes
    ----------
    knots : (knot,) array of float
        tau of the knots, increasing; the first is at the start, and none is at the end.
    polynomials : (knot, channel, power) array of float
        Polynomials in tau since each knot. If there is one more channel than the forces contain, the first is
        an imposed acceleration over w^2 (rad).
    increments : (knot, 2) array of float
        Increments of x and v at the knots except the start.
    """

    knots: Vector
    polynomials: Vector
    increments: Vector


# Most steps per period of a motion: a stiff state takes thousands, and a fit uses the smaller number.
STEPS_A_PERIOD, FEW_STEPS_A_PERIOD = 20_000, 500
# Address space (bytes) that the engine takes when it is loaded.
ENGINE_ROOM = 300_000_000
DIVERGED = 1e3  # rad; no pendulum swings so far


def integrate(
    model: Model,
    tau: Vector,
    at: tuple[float, float],
    *,
    by: Sequence[str] = (),
    forcing: Forcing | None = None,
    most_steps: int = STEPS_A_PERIOD,
    accuracy: float = under_way.STATE_PART,
) -> SimulatedMotion:
    """Integrate the motion of a model along a grid.

    Parameters
    ----------
    model : Model
    tau : (sample,) array of float
        w t, increasing, from the start.
    at : (float, float), rad
        x and v at the start.
    by : sequence of str
        Parameters of the derivatives: symbols, `dahl.s`, `FREQUENCY`, `BY_ANGLE`, `BY_RATE`.
    forcing : Forcing, optional
        Inputs and random force; by default the inputs are zero.
    most_steps : int
        Largest number of steps per period.
    accuracy : float
        Truncation error of a step in the series of x and v, relative to x and v.

    Raises
    ------
    SimulationError
        The motion diverges, switches without end, takes too many steps, or is not finite.
    """
    own = len(channels_of(model.forces))
    knots, polynomials, increments = forcing or Forcing(tau[:1], np.zeros((1, own, 1)), np.zeros((1, 2)))
    motion = motion_of(model.forces, forced=polynomials.shape[1] > own, paced=FREQUENCY in by)
    marks = np.where(_jumps(knots, polynomials[:, int(motion.forced) :]), under_way.INPUT_JUMPS, -1)
    marks[0] = 0
    values, slopes = motion.start(model, *at, by)
    many, size = len(knots), 2 + len(motion.hidden)
    given = under_way.Given(
        knots=np.append(knots, tau[-1]),
        drives=np.concatenate([polynomials, polynomials[-1:]]),
        increments=np.append(increments, np.zeros((1, 2)), axis=0),
        marks=np.append(marks, under_way.MOTION_ENDS),
        impulses=np.zeros((many + 1, len(by))),
        starts=values[None, :size],
        slopes=slopes[:size],
        grid=tau,
        until=np.array([len(tau)]),
    )
    periods, acts = float(tau[-1] - tau[0]) / (2.0 * np.pi), np.any(polynomials) or np.any(increments)
    switchings = 1000 + many + int(periods * (50 + 10 * len(motion.switches)))
    limits = switchings, 5000 + many + int(most_steps * periods), accuracy
    rows, tangents, turns, stop = run(motion, model, by, (values[size:], slopes[size:]), given, limits)
    hidden = dict(zip(motion.hidden, rows.T[2:], strict=False))
    return SimulatedMotion(model, tau, rows, hidden, np.nan if acts else stop, turns, tuple(by), tangents)


def _jumps(knots: Vector, held: Vector) -> Mask:
    """Return the mask of knots at which inputs, (knot, channel, power), jump."""
    steps = np.diff(knots)[:, None, None] ** np.arange(held.shape[2])
    rises = np.abs(held[1:, :, 0] - np.sum(held[:-1] * steps, axis=2))
    largest = np.abs(held[..., 0]).max(axis=0, initial=0.0)
    # Relative difference of the values before and after a knot above which it is a jump.
    return np.append(False, (rises > 1e-9 * largest).any(axis=1))


def run(
    motion: Motion,
    model: Model,
    by: Sequence[str],
    parameters: tuple[Vector, Vector],
    given: under_way.Given,
    limits: tuple[int, int, float],
) -> tuple[Vector, Vector, Vector, float]:
    """Run motions by the compiled engine.

    Parameters
    ----------
    motion, model, by
        Equations of the model, and parameters of the derivatives (see `integrate`).
    parameters : (parameter,) and (parameter, by) array of float
        Values and derivatives of the constant quantities (see `Motion.names`).
    given : under_way.Given
        The motions, without the output arrays.
    limits : (int, int, float)
        Most switchings and steps of all motions together, and the accuracy of a step (see `integrate`).

    Returns
    -------
    rows, tangents : array of float
        See `under_way.Given`.
    turns, rest : (turn,) array of float, and float
        tau of the sign changes of v, and tau at which the motion comes to rest.

    Raises
    ------
    SimulationError
        A motion diverges, switches without end, takes too many steps, or is not finite.
    """
    program, shape = motion.program, (len(given.grid), len(motion.hidden) + 3)
    rows, tangents = np.empty(shape), np.empty((*shape, len(by)))
    if not len(given.grid):
        return rows, tangents, np.empty(0), np.nan
    # Use one kind of array, so that the engine is compiled once. Its length is the most sign changes and
    # restarts.
    reversals = np.empty(limits[0] + len(given.knots) + 2)
    parts = given._replace(rows=rows, tangents=tangents, reversals=reversals)._asdict()
    given = under_way.Given(
        **{name: np.require(part, part.dtype, ["C", "W"]) for name, part in parts.items()}
    )
    state = under_way.new_state(program, len(by))
    slots = slice(program.states + 1 + program.channels, program.inputs - program.memory)
    state.J[slots, 0] = state.aside[:, slots, 0] = parameters[0]
    state.T[slots, 0] = parameters[1]
    if FREQUENCY in by:
        # A quantity over w^p changes by -p/w of itself per unit of w.
        powers = np.array([channel.power for channel in motion.channels])
        state.of_drive[:, by.index(FREQUENCY)] = -powers / model.reference_frequency
    turns, rest, outcome = _engine()(program, given, state, (DIVERGED, *limits))
    if outcome != under_way.ENDED:
        _raise(outcome, state.v[under_way.CLOCK, 0] / model.reference_frequency)
    return given.rows, given.tangents, given.reversals[:turns].copy(), rest


@cache
def _engine() -> Callable[..., Any]:
    """Import and return the compiled function; the import is slow."""
    # The compiler would end the process if memory is short: allocate here first, which raises an error
    # instead.
    np.empty(ENGINE_ROOM, np.uint8)
    from sysid_trib.simulation.compiled import tell_of_compiling
    from sysid_trib.simulation.engine import run

    tell_of_compiling()
    return run


def _raise(outcome: int, elapsed: float) -> None:
    after = f"{elapsed:.4g} s after the start"
    if outcome == under_way.GROWS:
        raise SimulationError(
            f"The motion diverges: |angle| exceeds {DIVERGED:g} rad {after}; "
            "check for negative damping or stiffness, a start far away, and a strong random force."
        )
    reason = {under_way.SWITCHES: "switches without end", under_way.STEPS: "needs too many steps"}
    raise SimulationError(
        f"The motion {reason.get(outcome, 'is not finite')}, {after}; check for forces that switch or are "
        "singular there."
    )
