"""What the compiled engine works on: a motion under way, and what it is to follow."""

from typing import Any, NamedTuple

import numpy as np

from sysid_trib.simulation.program import Program

ORDER = 18


class Course(NamedTuple):
    """A motion under way; its arrays are changed in place.

    Attributes
    ----------
    J, T : (slot, order) and (slot, order, parameter) array of float
        Series of the slots, and their derivatives.
    trial : (slot, 1) array of float
        Slots at an instant that is tried.
    up, down : (slot, order) array of float
        Series at rest, were it to go upwards or downwards.
    y, error, dy : (state,), (state,) and (state, parameter) array of float
        The state, what rounding has left of it, and its derivatives.
    memory, replaced : (memory,) array of float
        What is held between reversals; the same before it was replaced.
    signs, zeros : (surface,) array of float and int
        Sides of the surfaces; of which order a surface is known to be zero here.
    memory_up, signs_up, memory_down, signs_down : array of float
        The same of a motion that goes upwards or downwards from rest.
    clock : (2,) array of float
        tau, and what rounding has left of it.
    push, of_push : (degree + 1,) and (parameter,) array of float
        What pushes, about tau; its derivatives over itself.
    room, work : array of float
        Room for values of surfaces and states, and for roots.
    """

    J: Any
    T: Any
    trial: Any
    up: Any
    down: Any
    y: Any
    error: Any
    dy: Any
    memory: Any
    replaced: Any
    signs: Any
    zeros: Any
    memory_up: Any
    signs_up: Any
    memory_down: Any
    signs_down: Any
    clock: Any
    push: Any
    of_push: Any
    room: Any
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


def course_of(program: Program, parameters: int, degree: int) -> Course:
    """Room for motions of a program, with so many derivatives and pushes of this degree."""
    slots, size, held, surfaces = len(program.op), program.states, program.memory, len(program.signs)
    one, all_orders = (slots, 1), (slots, ORDER + 1)
    shapes = (
        *(all_orders, (slots, ORDER + 1, parameters), one, all_orders, all_orders),
        *((size,), (size,), (size, parameters), (held,), (held,), (surfaces,), (surfaces,)),
        *((held,), (surfaces,), (held,), (surfaces,), (2,), (degree + 1,), (parameters,)),
        *((5, max(size, surfaces, 1)), (5, 64)),
    )
    arrays = [np.zeros(shape) for shape in shapes]
    course = Course(*arrays)
    return course._replace(zeros=np.zeros(surfaces, dtype=np.int64))
