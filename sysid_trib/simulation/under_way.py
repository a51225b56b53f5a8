"""State of the integration: arrays, motions to simulate, and settings of the compiled engine.

Few arrays, since each costs a compiled call half a dozen numbers.
"""

from typing import Any, NamedTuple

import numpy as np

from sysid_trib.simulation.program import FORCING_NUMBERS, Instructions

ORDER = 18
# States of a motion.
MOVING, ENDED, GROWS, SWITCHES, STEPS, IS_NOT_FINITE = range(6)
# Marks of knots: the end of a motion; a jump of a function of time.
MOTION_ENDS, INPUT_JUMPS = -2, -3
# Rows of `v`: the state and what rounding has left of it; what is held between reversals, and the same before
# it was replaced; sides of the surfaces, and of which order one is known to be zero here; memory and sides of
# a motion that goes upwards or downwards from rest; tau and what rounding has left of it; room for surfaces
# and states, with the largest derivatives so far; how much the surface that holds it moves with v; by how
# much the instant of a switching moves with each parameter.
STATE, STATE_ROUNDING, MEMORY_NOW, MEMORY_BEFORE, SIGNS, ZEROS = range(6)
MEMORY_UP, SIGNS_UP, MEMORY_DOWN, SIGNS_DOWN = range(6, 10)
CLOCK, VALUES, SIGNS_FAR, SIGNS_AHEAD, STATE_LATER, LARGEST_DERIVATIVES, STATE_AT_REST, GRIP = range(10, 18)
SWITCHING_MOVES = 18
# Tables of `aside`: slots at an instant that is tried; series at rest, were it to go upwards or downwards.
TRIAL, UP, DOWN = range(3)
# Causes by which a motion is held, other than the number of a surface of v: nothing, rest.
FREE, RESTS = -1, 0
# Nearer than this to a surface, its sign is decided by where the motion is so much later (in tau).
NEAR_SURFACE, LOOKAHEAD = 1e-9, 1e-5
# In tau: as far as a motion is followed at once.
FURTHEST_AT_ONCE = 16.0
# Truncation error of a series after a step, of a state and of a surface or a derivative.
STATE_PART, SURFACE_PART = 1e-16, 1e-13
# rad: a speed below which a motion may come to rest other than by v = 0; one that is rest; what a motion that
# is taken as at rest may still have had to go.
SLOW, AT_REST, CREEP = 1e-5, 1e-12, 1e-11


class EngineState(NamedTuple):
    """State of the integration; its arrays are changed in place.

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
    """Motions to simulate, each from a knot to a knot, and where they are written.

    Attributes
    ----------
    knots, drives, increments : (knot,), (knot, channel, degree + 1) and (knot, 2) array of float
        From each knot on, polynomials in tau since it; what is added to x and v there.
    marks : (knot,) array of int
        The motion that starts there, `MOTION_ENDS` or `INPUT_JUMPS`; -1 elsewhere.
    impulses : (knot, parameter) array of float
        Impulses added there to the derivatives of v.
    starts, slopes : (motion, state + memory) and (state + memory, parameter) array of float
        States and memory with which they start, and their derivatives, the same of each.
    grid : (sample,) array of float
        tau of the samples, those of each motion increasing, the last at its end.
    until : (motion,) array of int
        How many samples are those of a motion and of those before it.
    rows, tangents : (sample, state + memory + 1) and (sample, state + memory + 1, parameter) array of float
        The states, the memory, the acceleration, and their derivatives.
    reversals : (reversal,) array of float
        Where the sign of v changes, in tau.
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
    reversals: Any = None


def new_state(program: Instructions, parameters: int) -> EngineState:
    """Return the room for motions of a program, with so many derivatives."""
    slots, size = len(program.code), program.states
    width = max(size, program.memory, len(program.signs), parameters, 2)
    return EngineState(
        np.zeros((slots, ORDER + 1)),
        np.zeros((slots, ORDER + 1, parameters)),
        np.zeros((3, slots, ORDER + 1)),
        np.zeros((SWITCHING_MOVES + 1, width)),
        np.zeros((size, parameters)),
        np.zeros((program.channels, FORCING_NUMBERS + 2)),
        np.zeros((program.channels, parameters)),
        np.zeros((5, 64)),
    )
