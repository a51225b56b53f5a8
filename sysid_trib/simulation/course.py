"""What the compiled engine works on: a motion under way, and what it is to follow.

Few arrays, since each costs a compiled call half a dozen numbers.
"""

from typing import Any, NamedTuple

import numpy as np

from sysid_trib.simulation.program import Program

ORDER = 18
# Rows of `v`: the state and what rounding has left of it; what is held between reversals, and the same before
# it was replaced; sides of the surfaces, and of which order one is known to be zero here; memory and sides of
# a motion that goes upwards or downwards from rest; tau and what rounding has left of it; what pushes, about
# tau, and its derivatives over itself; room for surfaces and states.
(STATE, ERROR, MEMORY, REPLACED, SIGNS, ZEROS, MEMORY_UP, SIGNS_UP, MEMORY_DOWN, SIGNS_DOWN) = range(10)
(CLOCK, PUSH, OF_PUSH, VALUES, FAR, AHEAD, LATER, REST) = range(10, 18)
# Tables of `aside`: slots at an instant that is tried; series at rest, were it to go upwards or downwards.
TRIAL, UP, DOWN = range(3)


class Course(NamedTuple):
    """A motion under way; its arrays are changed in place.

    Attributes
    ----------
    J, T : (slot, order) and (slot, order, parameter) array of float
        Series of the slots, and their derivatives.
    aside : (table, slot, order) array of float
    v : (row, number) array of float
    dy : (state, parameter) array of float
        Derivatives of the state.
    work : (5, 64) array of float
        Room for roots.
    """

    J: Any
    T: Any
    aside: Any
    v: Any
    dy: Any
    work: Any


class Given(NamedTuple):
    """What a motion is to follow, and where it is written.

    Attributes
    ----------
    grid : (grid,) array of float
        tau, increasing; the motion starts at the first.
    knots, pushes, kicks : (knot,), (knot, degree + 1) and (knot, 2) array of float
        From each knot on, a polynomial in tau since it that pushes; what is added to x and v there.
    impulses : (knot, parameter) array of float
        What is added there to the derivatives of v.
    rows : (grid, state + 1 + memory) array of float
        The states, the acceleration, the memory.
    tangents : (grid, state + 1 + memory, parameter) array of float
        Their derivatives.
    """

    grid: Any
    knots: Any
    pushes: Any
    kicks: Any
    impulses: Any
    rows: Any
    tangents: Any


def course_of(program: Program, parameters: int) -> Course:
    """Room for motions of a program, with so many derivatives."""
    slots, size = len(program.op), program.states
    width = max(size, program.memory, len(program.signs), program.degree, parameters, 2)
    return Course(
        np.zeros((slots, ORDER + 1)),
        np.zeros((slots, ORDER + 1, parameters)),
        np.zeros((3, slots, ORDER + 1)),
        np.zeros((REST + 1, width)),
        np.zeros((size, parameters)),
        np.zeros((5, 64)),
    )
