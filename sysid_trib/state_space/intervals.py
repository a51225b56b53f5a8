"""The motion from each sample to the next, exact and with its derivatives, over all intervals at once.

Each interval starts at a state that is given (multiple shooting, Bock 1981), so that none waits for another.
An explicit Runge-Kutta step advances state, derivatives and diffusion together; where it passes a switching
surface it is cut there, and the derivatives jump by the saltation matrix (Leine and Nijmeijer 2004).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import DOP853, RK45
from scipy.optimize import elementwise

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.errors import SimulationError
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.stick_slip import branches_from_rest, rates_at_rest, signs_ahead
from sysid_trib.state_space.steps import Steps
from sysid_trib.state_space.vector_field import FUNCTIONS, Instants, VectorField

# Longest substep in tau.
SUBSTEP = 0.16
# On the wrong side of a surface by less than this (rad), a motion has not passed it.
PASSED = 1e-13
# By so little it may be on the wrong side of one that it touches, for rounding.
TOUCHED = 1e-14
# In an interval, and in each unit of tau of a long one.
MOST_SWITCHINGS = 60
AT_REST = 1e-12


@dataclass(frozen=True)
class Front:
    """How far the intervals have come.

    Attributes
    ----------
    here : Instants
    derivative : (state, state + parameter, interval) array of float
        Of the state by the state at the beginning and by the parameters.
    diffusion : (state, state, interval) array of float
    """

    here: Instants
    derivative: Array
    diffusion: Array

    def at(self, chosen: Index) -> "Front":
        """Some of the intervals."""
        return Front(self.here.at(chosen), self.derivative[..., chosen], self.diffusion[..., chosen])


def steps_between(
    model: Model, time: Array, states: Array, names: tuple[str, ...] = (), *, frequency: bool = False
) -> Steps:
    """Exact motion over each interval between samples.

    Parameters
    ----------
    model : Model
        Forces with coefficient zero are followed too.
    time : (sample,) array of float, s
        Increasing, with steps of any length.
    states : (sample, state) array of float
        x, v (rad), internal states and memory at each sample, from which the motion starts anew.
    names : tuple of str
        Coefficients and shape parameters by which the end is derived.
    frequency : bool
        Whether it is derived by the reference frequency too, which comes last.

    Returns
    -------
    Steps

    Raises
    ------
    SimulationError
        The motion diverges between two samples, or switches without end.
    """
    w = model.reference_frequency
    field = VectorField(model, names, frequency)
    return steps_over(field, w * (time[:-1] - time[0]), w * np.diff(time), states)


def steps_over(field: VectorField, tau: Array, length: Array, states: Array) -> Steps:
    """Exact motion over any intervals.

    Parameters
    ----------
    field : VectorField
    tau, length : (interval,) array of float
        Beginning and length of each.
    states : (interval, state) array of float
        At the beginnings; one more where the intervals follow each other.

    Returns
    -------
    Steps

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    size, count = field.size, len(tau)
    front = _begin(field, states[:count].T.astype(float), tau)
    remaining = length.copy()
    density = np.maximum(1.0 / SUBSTEP, _stiffness(field, states, count))
    substep = length / np.maximum(1.0, np.ceil(density * length))
    switchings = np.zeros(count, int)
    moving = np.arange(count)
    whole = front
    while len(moving):
        step = np.minimum(substep[moving], remaining[moving])
        part = whole.at(moving) if len(moving) < count else whole
        ahead = _step(field, part, step)
        passed = _passed(field, ahead.here)
        if passed.any():
            at = np.flatnonzero(passed)
            step[at] = _first_crossing(field, part.here.at(at), step[at])
            crossed = _crossed(field, _step(field, part.at(at), step[at]))
            ahead = _with(ahead, at, crossed)
            switchings[moving[at]] += 1
        whole = _with(whole, moving, ahead) if len(moving) < count else ahead
        remaining[moving] -= step
        if not np.all(np.isfinite(ahead.here.y)) or np.any(switchings > MOST_SWITCHINGS * (1.0 + length)):
            raise SimulationError(
                "The motion between two samples diverges or switches without end; mind negative damping and "
                "forces that are singular where it goes."
            )
        moving = moving[remaining[moving] > 1e-14]
    return Steps(
        whole.here.y.T,
        np.moveaxis(whole.derivative[:, :size], -1, 0),
        np.moveaxis(whole.derivative[:, size:], -1, 0),
        np.moveaxis(whole.diffusion, -1, 0),
    )


def _stiffness(field: VectorField, states: Array, count: int) -> Array:
    """Fastest rate at which internal states relax in each interval, per unit of tau.

    By the states at its beginning, and at its end where they are known: that is where the next one begins.
    """
    memory = slice(2, len(field.motion.variables))
    if memory.stop == 2:
        return np.zeros(count)
    at_samples = Instants(states.T.astype(float), np.zeros(len(states)), *_no_side(field, len(states)))
    _, by_state, _ = field.derivatives(_settled(field, at_samples, np.ones(len(states), bool)))
    rates = np.max(np.abs(by_state[memory, memory]), axis=(0, 1))
    return np.maximum(rates[:count], rates[-count:])


def _no_side(field: VectorField, count: int) -> tuple[Array, Mask]:
    """Signs and sticking of instants of which nothing is known yet."""
    return np.zeros((len(field.motion.switches), count)), np.zeros(count, bool)


def _begin(field: VectorField, y: Array, tau: Array) -> Front:
    size, count = field.size, len(tau)
    here = _settled(field, Instants(y, tau, *_no_side(field, count)), np.ones(count, bool))
    derivative = np.zeros((size, size + len(field.names) + field.frequency, count))
    derivative[range(size), range(size)] = 1.0
    # What friction holds has no speed, whatever it had.
    derivative[1, 1, here.stuck] = 0.0
    return Front(here, derivative, np.zeros((size, size, count)))


def _apply(field: VectorField, rule: Any, here: Instants) -> list[Array]:
    """Value of a rule of stick and slip at the instants."""
    count = len(field.motion.variables)
    values = rule(field.motion, list(here.y[:count]), field.parameters(here), here.tau, FUNCTIONS)
    return [np.broadcast_to(np.asarray(value, dtype=float), here.tau.shape) for value in values]


def _settled(field: VectorField, here: Instants, first: Mask) -> Instants:
    """Signs, and at rest the branch or the sticking, of motions that go on from here (Filippov 1988)."""
    motion = field.motion
    if not motion.switches:
        return here
    y, signs, stuck = here.y.copy(), here.signs.copy(), here.stuck.copy()
    if first.any():
        # Of the first instants no side is known yet: that of the surfaces themselves.
        for _ in range(2):
            values = field.surfaces(replace(here, signs=signs))
            signs[:, first] = np.sign(values[:, first])
    rest = np.abs(y[1]) <= AT_REST
    going = np.flatnonzero(~rest)
    if len(going):
        part = replace(here, signs=signs).at(going)
        signs[:, going] = np.stack(_apply(field, signs_ahead, part))
        stuck[going] = False
    still = np.flatnonzero(rest)
    if len(still):
        y[1, still] = 0.0
        part = Instants(y[:, still], here.tau[still], signs[:, still], stuck[still])
        branches = np.stack(_apply(field, branches_from_rest, part)).reshape(2, -1, len(still))
        up, down = branches[:, 0]
        rises = (up > 0.0) & ((down >= 0.0) | (y[0, still] < 0.0))
        taken = np.where(rises, branches[0, 1:], branches[1, 1:])
        held = (up <= 0.0) & (down >= 0.0)
        memory = len(motion.memory)
        stuck[still] = held
        signs[:, still] = np.where(held, signs[:, still], taken[memory:])
        if memory:
            places = np.ix_(np.arange(len(motion.variables), field.size), still)
            y[places] = np.where(held, y[places], taken[:memory])
    return Instants(y, here.tau, signs, stuck)


def _step(field: VectorField, front: Front, step: Array) -> Front:
    """One step: of order eight for the state, five for derivatives and diffusion.

    An error of the state, 1e-9 a radian with order five, turns the phase of a long record by more than its
    many samples leave open; of the derivatives it is of no account.
    """
    size, here = field.size, front.here
    start = np.concatenate([here.y[:, None], front.derivative, front.diffusion], axis=1)

    def slopes(table: Array, part: float) -> Array:
        at = replace(here, y=table[:, 0], tau=here.tau + part * step)
        rates, by_state, by_parameter = field.derivatives(at)
        slope = np.empty_like(table)
        slope[:, 0] = rates
        slope[:, 1:] = np.einsum("abn,bcn->acn", by_state, table[:, 1:])
        slope[:, 1 + size : -size] += by_parameter
        slope[:, -size:] += slope[:, -size:].swapaxes(0, 1).copy()
        slope[1, -size + 1] += ~here.stuck
        return slope

    end = _runge_kutta(RK45, slopes, start, step)
    return Front(_stepped_state(field, here, step), end[:, 1:-size], end[:, -size:])


def _stepped_state(field: VectorField, here: Instants, step: Array) -> Instants:
    """The state alone, by the same step."""

    def rates(y: Array, part: float) -> Array:
        return field.rates(replace(here, y=y, tau=here.tau + part * step))

    return replace(here, y=_runge_kutta(DOP853, rates, here.y, step), tau=here.tau + step)


def _runge_kutta(
    method: type[RK45] | type[DOP853], slope: Callable[[Array, float], Array], start: Array, step: Array
) -> Array:
    """One explicit step (Hairer, Norsett and Wanner 1993) of values (..., instant); `slope(values, part)`."""
    stages = method.n_stages
    slopes = np.empty((stages, start.size))
    for i in range(stages):
        ahead = (method.A[i, :i] @ slopes[:i]).reshape(start.shape)
        slopes[i] = slope(start + step * ahead, method.C[i]).ravel()
    return np.asarray(start + step * (method.B @ slopes).reshape(start.shape))


def _sides(field: VectorField, here: Instants) -> Array:
    """What stays positive on a branch: the surfaces by their signs; at rest, what still holds."""
    sides = here.signs * field.surfaces(here)
    # Of a surface without a sign the motion is on both sides.
    sides = np.where((here.signs == 0.0) | here.stuck, 1.0, sides)
    if here.stuck.any():
        up, down, *_ = _apply(field, rates_at_rest, here)
        sides = np.concatenate([sides, np.where(here.stuck, np.stack([-up, down]), 1.0)])
    return sides


def _passed(field: VectorField, here: Instants) -> Mask:
    if not field.motion.switches:
        return np.zeros(here.tau.shape, bool)
    return np.asarray(np.any(_sides(field, here) < -PASSED, axis=0))


def _first_crossing(field: VectorField, here: Instants, step: Array) -> Array:
    """Length of the step just beyond the first surface that it passes."""

    def side(part: Array, at: Array) -> Array:
        start = here.at(at.astype(int))
        value = np.min(_sides(field, _stepped_state(field, start, part)), axis=0) + TOUCHED
        # A motion that starts on a surface has not passed it there.
        return np.asarray(np.where(part == 0.0, np.maximum(value, TOUCHED), value))

    numbers = np.arange(len(step), dtype=float)
    crossing = elementwise.find_root(
        side, (np.zeros_like(step), step), args=(numbers,), tolerances={"xatol": 1e-15}
    )
    return np.asarray(crossing.bracket[1])


def _crossed(field: VectorField, front: Front) -> Front:
    """The motions beyond the surface that they have just reached, with the jump of the derivatives."""
    here, motion, size = front.here, field.motion, field.size
    nearest = np.argmin(_sides(field, here), axis=0)
    before = field.rates(here)
    y = here.y.copy()
    at_reversal = (motion.switches[0].key == "v") & (nearest == 0) & ~here.stuck
    y[1, at_reversal] = 0.0
    released = here.stuck
    after = _settled(field, replace(here, y=y), np.zeros(len(nearest), bool))
    # What was passed and is not at rest is on the other side, wherever the look ahead sees it.
    turn = np.flatnonzero(~at_reversal & ~released)
    signs = after.signs.copy()
    signs[nearest[turn], turn] = -here.signs[nearest[turn], turn]
    stuck = np.where(released, False, after.stuck)
    after = replace(after, signs=signs, stuck=stuck)
    after_rates = field.rates(after)
    by_state, by_parameter, by_tau = field.surface_derivatives(here)
    chosen = np.minimum(nearest, len(by_state) - 1), slice(None), np.arange(len(nearest))
    normal, explicit = by_state[chosen].T, by_parameter[chosen].T
    speed = np.sum(normal * before, axis=0) + by_tau[chosen[0], chosen[2]]
    reset, replaced = _reset(field, here, at_reversal, after.stuck)
    derivative = np.einsum("abn,bcn->acn", reset, front.derivative)
    derivative[:, size:] += replaced
    shift = np.einsum("bn,bcn->cn", normal, front.derivative)
    shift[size:] += explicit
    # Where friction lets go, the state does not move yet: there is nothing to shift.
    turning = np.where(released | (np.abs(speed) < 1e-300), np.inf, speed)
    jump = (after_rates - np.einsum("abn,bn->an", reset, before)) / turning
    derivative = derivative + jump[:, None] * shift[None]
    matrix = reset + jump[:, None] * normal[None]
    diffusion = np.einsum("abn,bcn,dcn->adn", matrix, front.diffusion, matrix)
    return Front(after, derivative, diffusion)


def _reset(field: VectorField, here: Instants, at_reversal: Mask, stuck: Mask) -> tuple[Array, Array]:
    """Derivative of the state after a switching by that before it, and by the parameters.

    Memory is replaced at a reversal; a speed that sticks is zero.
    """
    size, count = field.size, len(here.tau)
    by_state = np.zeros((size, size, count))
    by_state[range(size), range(size)] = 1.0
    by_state[1, 1, stuck] = 0.0
    by_parameter = np.zeros((size, len(field.names) + field.frequency, count))
    turned = at_reversal & ~stuck
    if field.motion.memory and turned.any():
        memory = slice(len(field.motion.variables), size)
        for table, replaced in zip((by_state, by_parameter), field.replaced_derivatives(here), strict=True):
            table[memory, ..., turned] = replaced[..., turned]
    return by_state, by_parameter


def _with(front: Front, at: Index, part: Front) -> Front:
    """The front with some intervals replaced."""
    here, new = front.here, part.here
    y, tau, signs, stuck = here.y.copy(), here.tau.copy(), here.signs.copy(), here.stuck.copy()
    y[:, at], tau[at], signs[:, at], stuck[at] = new.y, new.tau, new.signs, new.stuck
    derivative, diffusion = front.derivative.copy(), front.diffusion.copy()
    derivative[..., at], diffusion[..., at] = part.derivative, part.diffusion
    return Front(Instants(y, tau, signs, stuck), derivative, diffusion)
