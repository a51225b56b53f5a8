"""Switching of a motion between two samples: sides of the surfaces, sticking, and the jump of derivatives.

The motion goes on from a surface as Filippov (1988) has it; the derivatives jump there by the saltation
matrix (Leine and Nijmeijer 2004).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.simulation.stick_slip import AT_REST, branches_from_rest, rates_at_rest, signs_ahead
from sysid_trib.state_space.vector_field import FUNCTIONS, Instants, VectorField

# On the wrong side of a surface by less than this (rad), a motion has not passed it.
PASSED = 1e-13


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


def settled(field: VectorField, here: Instants, first: Mask) -> Instants:
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


def sides(field: VectorField, here: Instants) -> Array:
    """What stays positive on a branch: the surfaces by their signs; at rest, what still holds."""
    values = here.signs * field.surfaces(here)
    # Of a surface without a sign the motion is on both sides.
    values = np.where((here.signs == 0.0) | here.stuck, 1.0, values)
    if here.stuck.any():
        up, down, *_ = _apply(field, rates_at_rest, here)
        values = np.concatenate([values, np.where(here.stuck, np.stack([-up, down]), 1.0)])
    return values


def passed_surface(field: VectorField, here: Instants) -> Mask:
    """Whether a motion is beyond a surface of its branch, (instant,)."""
    if not field.motion.switches:
        return np.zeros(here.tau.shape, bool)
    return np.asarray(np.any(sides(field, here) < -PASSED, axis=0))


def crossed(field: VectorField, front: Front) -> Front:
    """The motions beyond the surface that they have just reached, with the jump of the derivatives."""
    here, motion, size = front.here, field.motion, field.size
    nearest = np.argmin(sides(field, here), axis=0)
    before = field.rates(here)
    y = here.y.copy()
    at_reversal = (motion.switches[0].key == "v") & (nearest == 0) & ~here.stuck
    y[1, at_reversal] = 0.0
    released = here.stuck
    after = settled(field, replace(here, y=y), np.zeros(len(nearest), bool))
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


def _apply(field: VectorField, rule: Any, here: Instants) -> list[Array]:
    """Value of a rule of stick and slip at the instants."""
    count = len(field.motion.variables)
    values = rule(field.motion, list(here.y[:count]), field.parameters(here), here.tau, FUNCTIONS)
    return [np.broadcast_to(np.asarray(value, dtype=float), here.tau.shape) for value in values]
