"""State of the integration: arrays, motions to simulate, and settings of the compiled engine.

There are few arrays, because each costs a compiled call half a dozen numbers.
"""

from typing import Any, NamedTuple

import numpy as np

from sysid_trib.simulation.program import FORCING_NUMBERS, Instructions

ORDER = 18
# Outcomes of a motion.
MOVING, ENDED, GROWS, SWITCHES, STEPS, IS_NOT_FINITE = range(6)
# Marks of knots: the end of a motion; a jump of a function of time.
MOTION_ENDS, INPUT_JUMPS = -2, -3
# Rows of `v`: the state and its rounding error; the memory between reversals, and the memory before its last
# replacement; sides of the surfaces, and the order to which a surface is known to be zero here; memory and
# sides of a motion that starts upwards or downwards from rest; tau and its rounding error; space for surfaces
# and states, and the largest derivatives so far; derivative by v of the surface that holds the motion; change
# of the switching time with each parameter.
STATE, STATE_ROUNDING, MEMORY_NOW, MEMORY_BEFORE, SIGNS, ZEROS = range(6)
MEMORY_UP, SIGNS_UP, MEMORY_DOWN, SIGNS_DOWN = range(6, 10)
CLOCK, VALUES, SIGNS_FAR, SIGNS_AHEAD, STATE_LATER, LARGEST_DERIVATIVES, STATE_AT_REST, GRIP = range(10, 18)
SWITCHING_MOVES = 18
# Tables of `aside`: slots at a trial time; series at rest for a start upwards or downwards.
TRIAL, UP, DOWN = range(3)
# Causes that hold a motion: nothing, or rest; any other value is the number of a surface of v.
FREE, RESTS = -1, 0
# If the motion is nearer than this to a surface, its sign is determined at a time later by this (in tau).
NEAR_SURFACE, LOOKAHEAD = 1e-9, 1e-5
# Longest time, in tau, over which a motion is integrated at once.
FURTHEST_AT_ONCE = 16.0
# Truncation error of a series after a step: of a state, and of a surface or a derivative.
STATE_PART, SURFACE_PART = 1e-16, 1e-13
# rad: speed below which a motion may come to rest other than at v = 0; speed that counts as rest; remaining
# distance at which a motion counts as at rest.
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
        Inputs over time: powers of tau since the clock, then value and slope at the trial time.
    of_drive : (channel, parameter) array of float
        Derivatives of the inputs, relative to the inputs.
    work : (5, 64) array of float
        Work space for roots.
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
    """Motions to simulate, each from knot to knot, and the arrays of their results.

    Attributes
    ----------
    knots, drives, increments : (knot,), (knot, channel, degree + 1) and (knot, 2) array of float
        Knots; polynomials in tau since each knot; increments of x and v at the knots.
    marks : (knot,) array of int
        The motion that starts at the knot, `MOTION_ENDS` or `INPUT_JUMPS`; -1 elsewhere.
    impulses : (knot, parameter) array of float
        Impulses added to the derivatives of v at the knot.
    starts, slopes : (motion, state + memory) and (state + memory, parameter) array of float
        States and memory at the start of each motion, and their derivatives, common to all motions.
    grid : (sample,) array of float
        tau of the samples, those of each motion increasing, the last at its end.
    until : (motion,) array of int
        Number of samples of a motion and of all motions before it.
    rows, tangents : (sample, state + memory + 1) and (sample, state + memory + 1, parameter) array of float
        The states, the memory, the acceleration, and their derivatives.
    reversals : (reversal,) array of float
        tau of the sign changes of v.
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
    """Return the work space for motions of a program, with this number of derivatives."""
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
