"""A motion under way: its arrays, and which way it goes on from a switching or from rest (Filippov 1988).

Few arrays, since each costs a compiled call half a dozen numbers.
"""

from typing import Any, NamedTuple

import numpy as np

from sysid_trib.simulation.compiled import at_once, at_once_live, inner, order
from sysid_trib.simulation.program import FORCING_NUMBERS, Instructions

ORDER = 18
# How a motion stands.
MOVING, ENDED, GROWS, SWITCHES, STEPS, IS_NOT_FINITE = range(6)
# Marks of knots: a motion ends there; what is given over time jumps there.
MOTION_ENDS, INPUT_JUMPS = -2, -3
# Rows of `v`: the state and what rounding has left of it; what is held between reversals, and the same before
# it was replaced; sides of the surfaces, and of which order one is known to be zero here; memory and sides of
# a motion that goes upwards or downwards from rest; tau and what rounding has left of it; room for surfaces
# and states, with the largest derivatives so far; how much the surface that holds it moves with v.
STATE, STATE_ROUNDING, MEMORY_NOW, MEMORY_BEFORE, SIGNS, ZEROS = range(6)
MEMORY_UP, SIGNS_UP, MEMORY_DOWN, SIGNS_DOWN = range(6, 10)
CLOCK, VALUES, SIGNS_FAR, SIGNS_AHEAD, STATE_LATER, LARGEST_DERIVATIVES, STATE_AT_REST, GRIP = range(10, 18)
# Tables of `aside`: slots at an instant that is tried; series at rest, were it to go upwards or downwards.
TRIAL, UP, DOWN = range(3)
# What a motion is held by, besides the number of a surface of which v is a part: nothing, rest.
FREE, RESTS = -1, 0
# Nearer than this to a surface, its sign is decided by where the motion is so much later (in tau).
NEAR_SURFACE, LOOKAHEAD = 1e-9, 1e-5
# In tau: as far as a motion is followed at once.
FURTHEST_AT_ONCE = 16.0
# What is left of a series after a step, of a state and of a surface or a derivative.
STATE_PART, SURFACE_PART = 1e-16, 1e-13


@inner
def put(source: Any, target: Any) -> None:
    """Copy a list of numbers."""
    for i in range(len(source)):
        target[i] = source[i]


class EngineState(NamedTuple):
    """A motion under way; its arrays are changed in place.

    Attributes
    ----------
    J, T : (slot, order) and (slot, order, parameter) array of float
        Series of the slots, and their derivatives.
    aside : (table, slot, order) array of float
    v : (row, number) array of float
    dy : (state, parameter) array of float
        Derivatives of the state.
    drive : (channel, FORCING_NUMBERS + 2) array of float
        What is given over time: by powers of tau since the clock, then its value and slope at the instant
        that is looked at.
    of_drive : (channel, parameter) array of float
        Its derivatives over itself.
    work : (5, 64) array of float
        Room for roots.
    """

    J: Any
    T: Any
    aside: Any
    v: Any
    dy: Any
    drive: Any
    of_drive: Any
    work: Any


class Given(NamedTuple):
    """Motions to be followed one after the other, each from a knot to a knot, and where they are written.

    Attributes
    ----------
    knots, drives, increments : (knot,), (knot, channel, degree + 1) and (knot, 2) array of float
        From each knot on, polynomials in tau since it; what is added to x and v there.
    marks : (knot,) array of int
        The motion that starts there, `MOTION_ENDS` or `INPUT_JUMPS`; -1 elsewhere.
    impulses : (knot, parameter) array of float
        What is added there to the derivatives of v.
    starts, slopes : (motion, state + memory) and (state + memory, parameter) array of float
        States and memory with which they start, and their derivatives, the same of each.
    grid : (sample,) array of float
        tau of the samples, those of each motion increasing, the last at its end.
    until : (motion,) array of int
        How many samples are those of a motion and of those before it.
    rows, tangents : (sample, state + memory + 1) and (sample, state + memory + 1, parameter) array of float
        The states, the memory, the acceleration, and their derivatives.
    """

    knots: Any
    drives: Any
    increments: Any
    marks: Any
    impulses: Any
    starts: Any
    slopes: Any
    grid: Any
    until: Any
    rows: Any = None
    tangents: Any = None


def new_state(program: Instructions, parameters: int) -> EngineState:
    """Room for motions of a program, with so many derivatives."""
    slots, size = len(program.code), program.states
    width = max(size, program.memory, len(program.signs), parameters, 2)
    return EngineState(
        np.zeros((slots, ORDER + 1)),
        np.zeros((slots, ORDER + 1, parameters)),
        np.zeros((3, slots, ORDER + 1)),
        np.zeros((GRIP + 1, width)),
        np.zeros((size, parameters)),
        np.zeros((program.channels, FORCING_NUMBERS + 2)),
        np.zeros((program.channels, parameters)),
        np.zeros((5, 64)),
    )


# rad: a speed below which a motion may come to rest other than by v = 0; one that is rest; what a motion that
# is taken as at rest may still have had to go.
SLOW, AT_REST, CREEP = 1e-5, 1e-12, 1e-11


@inner
def state_at(program, c, J, y, ahead):
    """Put a state so much after the clock into the first order, and what is given over time into two."""
    for i in range(program.states):
        J[i, 0] = y[i]
    J[program.states, 0] = c.v[CLOCK, 0] + ahead
    for m in range(program.channels):
        here, slope = c.drive[m, FORCING_NUMBERS], c.drive[m, FORCING_NUMBERS + 1]
        J[program.states + 1 + m, 0], J[program.states + 1 + m, 1] = here + ahead * slope, slope


@inner
def parameters_at(program, J, memory, signs):
    """Put memory and signs into the first orders."""
    kept = program.inputs - program.memory
    for m in range(program.memory):
        J[kept + m, 0] = memory[m]
    for m in range(len(program.signs)):
        J[program.signs[m], 0] = signs[m]


@inner
def signs_of(program, J, out):
    """Signs of the surfaces by their values; J holds the state at order 0."""
    at_once_live(program, J, program.main)
    for m in range(len(program.signs)):
        out[m] = J[program.signs[m], 0]


@inner
def rates_of(program, J, signs):
    """The rates of the state in J on the branch of these signs, at order 0, into J."""
    for m in range(len(program.signs)):
        J[program.signs[m], 0] = signs[m]
    at_once(program, J)


@inner
def by_nearness(values, near, far, out):
    """The first sign for each surface that is near, else the second."""
    for m in range(len(out)):
        out[m] = near[m] if abs(values[m]) < NEAR_SURFACE else far[m]


@inner
def reverses(program):
    """True if v is a surface of the motion: then it is the first of them."""
    return len(program.surfaces) > 0 and program.surfaces[0] == 1


@inner
def signs_and_values(program, c, out):
    """Signs of the surfaces in c.aside[TRIAL], and their values."""
    signs_of(program, c.aside[TRIAL], out)
    for m in range(len(program.signs)):
        c.v[VALUES, m] = c.aside[TRIAL][program.surfaces[m], 0]


@inner
def signs_ahead(program, c):
    """Signs of a motion that goes on from here: near a surface, those where it will be a little later."""
    J, y, later = c.aside[TRIAL], c.v[STATE], c.v[STATE_LATER]
    state_at(program, c, J, y, 0.0)
    signs_and_values(program, c, c.v[SIGNS_FAR])
    if reverses(program):
        # A reversal is an event of its own, at which the memory is replaced: before it v has its sign.
        c.v[VALUES, 0] = np.inf
    by_nearness(c.v[VALUES], c.v[SIGNS], c.v[SIGNS_FAR], c.v[SIGNS])
    rates_of(program, J, c.v[SIGNS])
    for i in range(program.states):
        later[i] = y[i] + LOOKAHEAD * J[program.rates[i], 0]
    later[0] += 0.5 * LOOKAHEAD**2 * J[program.rates[1], 0]
    state_at(program, c, J, later, LOOKAHEAD)
    signs_of(program, J, c.v[SIGNS_AHEAD])
    by_nearness(c.v[VALUES], c.v[SIGNS_AHEAD], c.v[SIGNS], c.v[SIGNS])


@inner
def branch(program, c, way, memory, signs):
    """Acceleration at rest of a motion about to go `way` (+1, -1); memory and signs of that branch."""
    J, y, later, ahead = c.aside[TRIAL], c.v[STATE_AT_REST], c.v[STATE_LATER], c.v[SIGNS_AHEAD]
    put(c.v[STATE], y)
    y[1] = 0.0
    state_at(program, c, J, y, 0.0)
    parameters_at(program, J, c.v[MEMORY_NOW], c.v[SIGNS])
    put(c.v[MEMORY_NOW], memory)
    if program.memory > 0 and way * c.v[SIGNS, 0] < 0.0:
        at_once_live(program, J, len(program.code))
        for m in range(program.memory):
            memory[m] = J[program.replaced[m], 0]
    parameters_at(program, J, memory, c.v[SIGNS])
    signs_and_values(program, c, c.v[SIGNS_FAR])
    for i in range(program.states):
        later[i] = y[i]
    later[0] += way * 0.5 * LOOKAHEAD**2
    later[1] += way * LOOKAHEAD
    state_at(program, c, J, later, LOOKAHEAD)
    signs_of(program, J, ahead)
    by_nearness(c.v[VALUES], ahead, c.v[SIGNS_FAR], signs)
    if program.states > 2:
        rates_of(program, J, signs)
        for i in range(2, program.states):
            later[i] += 0.5 * LOOKAHEAD * J[program.rates[i], 0]
        state_at(program, c, J, later, LOOKAHEAD)
        signs_of(program, J, ahead)
        by_nearness(c.v[VALUES], ahead, signs, signs)
    state_at(program, c, J, y, 0.0)
    rates_of(program, J, signs)
    return J[program.rates[1], 0]


@inner
def settle(program, c):
    """Set signs, and at a reversal the memory, for the motion from here; False if it sticks."""
    speed = abs(c.v[STATE, 1])
    if speed <= SLOW:
        up = branch(program, c, 1.0, c.v[MEMORY_UP], c.v[SIGNS_UP])
        down = branch(program, c, -1.0, c.v[MEMORY_DOWN], c.v[SIGNS_DOWN])
        sticks = up <= 0.0 and down >= 0.0
        # Detent and friction make ever shorter swings without end: they end where less than CREEP remains.
        if speed <= AT_REST or (sticks and speed * speed < 2.0 * CREEP * min(-up, down)):
            if not sticks:
                # Where both push away (negative friction) it goes towards x = 0.
                rises = up > 0.0 and (down >= 0.0 or c.v[STATE, 0] < 0.0)
                put(c.v[MEMORY_UP] if rises else c.v[MEMORY_DOWN], c.v[MEMORY_NOW])
                put(c.v[SIGNS_UP] if rises else c.v[SIGNS_DOWN], c.v[SIGNS])
            return not sticks
    if len(program.signs) > 0:
        parameters_at(program, c.aside[TRIAL], c.v[MEMORY_NOW], c.v[SIGNS])
        signs_ahead(program, c)
    return True


@inner
def grip_of(program, J, slot):
    """By how much a surface moves with v; J holds the first two orders."""
    here, still = J[slot, 1], J[1, 1]
    J[1, 1] = still + 1.0
    order(program, J, np.int64(1))
    grip = J[slot, 1] - here
    J[1, 1] = still
    order(program, J, np.int64(1))
    return grip


@inner
def held_by(program, c):
    """The surface near which both sides push towards it, so that a motion stays there, or `FREE`.

    That of v alone is rest, of which `settle` decides. Most are crossed, which the first side tells.
    """
    for m in range(1, len(program.signs)):
        near = abs(c.v[VALUES, m]) < NEAR_SURFACE
        forcing = near and _rise_on(program, c, m, 1.0) < 0.0 and _rise_on(program, c, m, -1.0) > 0.0
        if forcing and grip_of(program, c.aside[TRIAL], program.surfaces[m]) != 0.0:
            return np.int64(m)
    return np.int64(FREE)


@inner
def _rise_on(program, c, m, way):
    """How fast a surface rises on this side of it; the trial holds the first two orders there."""
    J = c.aside[TRIAL]
    state_at(program, c, J, c.v[STATE], 0.0)
    parameters_at(program, J, c.v[MEMORY_NOW], c.v[SIGNS])
    J[program.signs[m], 0] = way
    at_once(program, J)
    for i in range(program.states):
        J[i, 1] = J[program.rates[i], 0]
    J[program.states, 1] = 1.0
    order(program, J, np.int64(1))
    return J[program.surfaces[m], 1]
