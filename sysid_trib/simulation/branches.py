"""Direction of a motion after a switching or from rest (Filippov 1988)."""

from typing import Any

import numpy as np

from sysid_trib.simulation import under_way as at
from sysid_trib.simulation.compiled import at_once, at_once_live, inner, order
from sysid_trib.simulation.program import FORCING_NUMBERS


@inner
def put(source: Any, target: Any) -> None:
    """Copy a list of numbers."""
    for i in range(len(source)):
        target[i] = source[i]


@inner
def state_at(program, c, J, y, ahead):
    """Write the state at a time `ahead` of the clock into order 0, and the inputs into orders 0 and 1."""
    for i in range(program.states):
        J[i, 0] = y[i]
    J[program.states, 0] = c.v[at.CLOCK, 0] + ahead
    for m in range(program.channels):
        here, slope = c.drive[m, FORCING_NUMBERS], c.drive[m, FORCING_NUMBERS + 1]
        J[program.states + 1 + m, 0], J[program.states + 1 + m, 1] = here + ahead * slope, slope


@inner
def parameters_at(program, J, memory, signs):
    """Write memory and signs into order 0."""
    kept = program.inputs - program.memory
    for m in range(program.memory):
        J[kept + m, 0] = memory[m]
    for m in range(len(program.signs)):
        J[program.signs[m], 0] = signs[m]


@inner
def signs_of(program, J, out):
    """Compute the signs of the surfaces from their values; J holds the state at order 0."""
    at_once_live(program, J, program.main)
    for m in range(len(program.signs)):
        out[m] = J[program.signs[m], 0]


@inner
def rates_of(program, J, signs):
    """Compute the rates of the state in J on the branch of these signs, at order 0, in J."""
    for m in range(len(program.signs)):
        J[program.signs[m], 0] = signs[m]
    at_once(program, J)


@inner
def by_nearness(values, near, far, out):
    """Choose the first sign for each surface that is near, else the second."""
    for m in range(len(out)):
        out[m] = near[m] if abs(values[m]) < at.NEAR_SURFACE else far[m]


@inner
def reverses(program):
    """Return true if v is a surface of the motion; it is then the first surface."""
    return len(program.surfaces) > 0 and program.surfaces[0] == 1


@inner
def signs_and_values(program, c, out):
    """Compute the signs of the surfaces in c.aside[at.TRIAL], and their values."""
    signs_of(program, c.aside[at.TRIAL], out)
    for m in range(len(program.signs)):
        c.v[at.VALUES, m] = c.aside[at.TRIAL][program.surfaces[m], 0]


@inner
def signs_ahead(program, c):
    """Set the signs of a motion that continues: near a surface, those shortly afterwards."""
    J, y, later = c.aside[at.TRIAL], c.v[at.STATE], c.v[at.STATE_LATER]
    state_at(program, c, J, y, 0.0)
    signs_and_values(program, c, c.v[at.SIGNS_FAR])
    if reverses(program):
        # A reversal is a separate event that replaces the memory; before it, v keeps its sign.
        c.v[at.VALUES, 0] = np.inf
    by_nearness(c.v[at.VALUES], c.v[at.SIGNS], c.v[at.SIGNS_FAR], c.v[at.SIGNS])
    rates_of(program, J, c.v[at.SIGNS])
    for i in range(program.states):
        later[i] = y[i] + at.LOOKAHEAD * J[program.rates[i], 0]
    later[0] += 0.5 * at.LOOKAHEAD**2 * J[program.rates[1], 0]
    state_at(program, c, J, later, at.LOOKAHEAD)
    signs_of(program, J, c.v[at.SIGNS_AHEAD])
    by_nearness(c.v[at.VALUES], c.v[at.SIGNS_AHEAD], c.v[at.SIGNS], c.v[at.SIGNS])


@inner
def branch(program, c, way, memory, signs):
    """Return acceleration at rest for a start to `way` (+1, -1), with memory and signs of that branch."""
    J, y, later, ahead = c.aside[at.TRIAL], c.v[at.STATE_AT_REST], c.v[at.STATE_LATER], c.v[at.SIGNS_AHEAD]
    put(c.v[at.STATE], y)
    y[1] = 0.0
    state_at(program, c, J, y, 0.0)
    parameters_at(program, J, c.v[at.MEMORY_NOW], c.v[at.SIGNS])
    put(c.v[at.MEMORY_NOW], memory)
    if program.memory > 0 and way * c.v[at.SIGNS, 0] < 0.0:
        at_once_live(program, J, len(program.code))
        for m in range(program.memory):
            memory[m] = J[program.replaced[m], 0]
    parameters_at(program, J, memory, c.v[at.SIGNS])
    signs_and_values(program, c, c.v[at.SIGNS_FAR])
    for i in range(program.states):
        later[i] = y[i]
    later[0] += way * 0.5 * at.LOOKAHEAD**2
    later[1] += way * at.LOOKAHEAD
    state_at(program, c, J, later, at.LOOKAHEAD)
    signs_of(program, J, ahead)
    by_nearness(c.v[at.VALUES], ahead, c.v[at.SIGNS_FAR], signs)
    if program.states > 2:
        rates_of(program, J, signs)
        for i in range(2, program.states):
            later[i] += 0.5 * at.LOOKAHEAD * J[program.rates[i], 0]
        state_at(program, c, J, later, at.LOOKAHEAD)
        signs_of(program, J, ahead)
        by_nearness(c.v[at.VALUES], ahead, signs, signs)
    state_at(program, c, J, y, 0.0)
    rates_of(program, J, signs)
    return J[program.rates[1], 0]


@inner
def settle(program, c):
    """Set signs, and at a reversal the memory, for the motion from here; return False if it sticks."""
    speed = abs(c.v[at.STATE, 1])
    if speed <= at.SLOW:
        up = branch(program, c, 1.0, c.v[at.MEMORY_UP], c.v[at.SIGNS_UP])
        down = branch(program, c, -1.0, c.v[at.MEMORY_DOWN], c.v[at.SIGNS_DOWN])
        sticks = up <= 0.0 and down >= 0.0
        # With detent and friction the swings become shorter without end: stop when less than CREEP remains.
        if speed <= at.AT_REST or (sticks and speed * speed < 2.0 * at.CREEP * min(-up, down)):
            if not sticks:
                # If both sides push away (negative friction), the motion goes towards x = 0.
                rises = up > 0.0 and (down >= 0.0 or c.v[at.STATE, 0] < 0.0)
                put(c.v[at.MEMORY_UP] if rises else c.v[at.MEMORY_DOWN], c.v[at.MEMORY_NOW])
                put(c.v[at.SIGNS_UP] if rises else c.v[at.SIGNS_DOWN], c.v[at.SIGNS])
            return not sticks
    if len(program.signs) > 0:
        parameters_at(program, c.aside[at.TRIAL], c.v[at.MEMORY_NOW], c.v[at.SIGNS])
        signs_ahead(program, c)
    return True


@inner
def grip_of(program, J, slot):
    """Return the derivative of a surface by v; J holds the first two orders."""
    here, still = J[slot, 1], J[1, 1]
    J[1, 1] = still + 1.0
    order(program, J, np.int64(1))
    grip = J[slot, 1] - here
    J[1, 1] = still
    order(program, J, np.int64(1))
    return grip


@inner
def held_by(program, c):
    """Return the surface towards which both sides push, so that the motion stays on it, or `FREE`.

    The surface of v alone is rest, which `settle` handles. Most surfaces are crossed, which already the first
    side shows.
    """
    for m in range(1, len(program.signs)):
        near = abs(c.v[at.VALUES, m]) < at.NEAR_SURFACE
        forcing = near and _rise_on(program, c, m, 1.0) < 0.0 and _rise_on(program, c, m, -1.0) > 0.0
        if forcing and grip_of(program, c.aside[at.TRIAL], program.surfaces[m]) != 0.0:
            return np.int64(m)
    return np.int64(at.FREE)


@inner
def _rise_on(program, c, m, way):
    """Return the rate at which a surface value rises on this side; the trial has its first two orders."""
    J = c.aside[at.TRIAL]
    state_at(program, c, J, c.v[at.STATE], 0.0)
    parameters_at(program, J, c.v[at.MEMORY_NOW], c.v[at.SIGNS])
    J[program.signs[m], 0] = way
    at_once(program, J)
    for i in range(program.states):
        J[i, 1] = J[program.rates[i], 0]
    J[program.states, 1] = 1.0
    order(program, J, np.int64(1))
    return J[program.surfaces[m], 1]
