"""Switching surfaces of a motion: the step to a surface, and signs, memory and derivatives after it."""

import numpy as np

from sysid_trib.simulation import under_way as at
from sysid_trib.simulation.branches import (
    branch,
    grip_of,
    held_by,
    parameters_at,
    put,
    rates_of,
    settle,
    state_at,
)
from sysid_trib.simulation.compiled import at_once, at_once_live, derivatives_at_once, inner, order
from sysid_trib.simulation.taylor import first_crossing, look_ahead, of_parameter, radius, slope, value

# Least step, in tau, beyond a surface that is crossed at rest.
PASSED = 1e-9
# Distance from a surface, relative to the size of the motion, that is rounding.
AT_ZERO = 1e-14
# For held bodies, upwards and downwards: table, direction, memory and signs.
HELD_SIDES = ((at.UP, 1.0, at.MEMORY_UP, at.SIGNS_UP), (at.DOWN, -1.0, at.MEMORY_DOWN, at.SIGNS_DOWN))
# Rates of states below this count as zero.
UNCHANGED = 1e-14


@inner
def free_step(program, c, n, h):
    """Return the largest step of a free motion, and the surface that ends it, or -1."""
    which, near = -1, AT_ZERO * max(abs(c.v[at.STATE, 0]), abs(c.v[at.STATE, 1]))
    for m in range(len(program.signs)):
        r = first_crossing(c.J[program.surfaces[m]], n, h, c.v[at.SIGNS, m], (near, c.v[at.ZEROS, m]), c.work)
        if r <= h:
            h, which = r, m
    return h, which


@inner
def held_step(program, c, n, h, held, ends):
    """Return the largest step of a held body, and the side to which it is released (+1, -1), or 0.

    The third value is the surface that the body meets there, or -1.
    """
    way, which, near, pull = 0.0, -1, AT_ZERO * abs(c.v[at.STATE, 0]), program.rates[1]
    if held == at.RESTS:
        h = _rest_lasts(program, c, n, h, near)
        branch(program, c, 1.0, c.v[at.MEMORY_UP], c.v[at.SIGNS_UP])
        branch(program, c, -1.0, c.v[at.MEMORY_DOWN], c.v[at.SIGNS_DOWN])
    else:
        h, which = free_step(program, c, n, h)
    for side, rises, memory, signs in HELD_SIDES:
        if held != at.RESTS:
            put(c.v[at.SIGNS], c.v[signs])
            put(c.v[at.MEMORY_NOW], c.v[memory])
            c.v[signs, held] = rises
        # Upwards is the direction in which the surface value rises.
        grip = 1.0 if held == at.RESTS else c.v[at.GRIP, 0]
        _pulls(program, c, c.aside[side], n, c.v[memory], c.v[signs], grip)
    if not ends or not _is_still(program, c, n):
        for side, _, _, _ in HELD_SIDES:
            h = min(h, radius(c.aside[side], pull, pull, n, at.STATE_PART))
        for side, rises, _, _ in HELD_SIDES:
            series, r = c.aside[side][pull], 0.0
            if not rises * series[0] > 0.0:
                r = first_crossing(series, n, h, -rises, (near, 0.0), c.work)
            if r < h:
                h, way = r, rises
    return h, way, which if way == 0.0 else -1


@inner
def _rest_lasts(program, c, n, h, near):
    """Return the largest step over which the signs at rest stay the same."""
    for m in range(len(program.signs)):
        # The sign of a surface that is zero at rest is known only at the start.
        if c.v[at.SIGNS_UP, m] != 0.0:
            r = first_crossing(c.J[program.surfaces[m]], n, h, c.v[at.SIGNS_UP, m], (near, 0.0), c.work)
            if r < h:
                h = max(r, PASSED)
    return h


@inner
def _pulls(program, c, other, n, memory, signs, grip):
    """Write the series of the force that moves a held body to one side into `other`.

    Its slots are those along the states in J, with another memory and other signs.
    """
    for i in range(program.states + 1 + program.channels):
        for k in range(n + 1):
            other[i, k] = c.J[i, k]
    parameters_at(program, other, memory, signs)
    at_once(program, other)
    for k in range(1, n + 1):
        order(program, other, k)
    pull = program.rates[1]
    for k in range(n + 1):
        other[pull, k] = (other[pull, k] - c.J[pull, k]) * grip


@inner
def _is_still(program, c, n):
    """Return true if nothing changes at rest: neither the force on the held body, nor its states."""
    for i in range(2, program.states):
        if abs(c.J[i, 1]) > UNCHANGED:
            return False
    for k in range(1, n + 1):
        if c.aside[at.UP][program.rates[1], k] != 0.0 or c.aside[at.DOWN][program.rates[1], k] != 0.0:
            return False
    return True


@inner
def released(program, c, held, way):
    """Release a body that was held: its motion starts without speed and without acceleration."""
    put(c.v[at.MEMORY_UP] if way > 0.0 else c.v[at.MEMORY_DOWN], c.v[at.MEMORY_NOW])
    put(c.v[at.SIGNS_UP] if way > 0.0 else c.v[at.SIGNS_DOWN], c.v[at.SIGNS])
    c.v[at.ZEROS, held] = 2


@inner
def stop(c):
    """Set the speed, and its derivatives, of a body at rest to zero."""
    c.v[at.STATE, 1], c.v[at.STATE_ROUNDING, 1] = 0.0, 0.0
    for q in range(c.dy.shape[1]):
        c.dy[1, q] = 0.0


@inner
def switched(program, c, which, n, h):
    """Continue from a surface with the jump of the derivatives; return what holds the motion there."""
    size, count, slot = program.states, c.T.shape[2], program.surfaces[which]
    moves, way = c.v[at.SWITCHING_MOVES], c.v[at.SIGNS, 0]
    if count > 0:
        rate = slope(c.J[slot], n, h)
        for q in range(count):
            # Change of the switching time with the parameter.
            moves[q] = -of_parameter(c.T, slot, q, n, h) / rate if rate != 0.0 else 0.0
            for i in range(size):
                c.dy[i, q] += value(c.J[program.rates[i]], n, h) * moves[q]
    if slot < size:
        # The surface is a state: set it to exactly zero here.
        c.v[at.STATE, slot], c.v[at.STATE_ROUNDING, slot] = 0.0, 0.0
    c.v[at.ZEROS, which] = 1
    put(c.v[at.MEMORY_NOW], c.v[at.MEMORY_BEFORE])
    look_ahead(c, h)
    held = _settled(program, c)
    turned = way * c.v[at.SIGNS, 0] < 0.0
    if program.memory > 0 and turned and slot >= size:
        # A new memory changes the value of the surface.
        c.v[at.ZEROS, which] = 0
    if count > 0:
        after(program, c, moves, turned, held)
    if held > at.RESTS:
        _onto(program, c, held)
    return held


@inner
def _settled(program, c):
    """Set the signs, and at a reversal the memory, of the motion from here; return what holds it."""
    if not settle(program, c):
        stop(c)
        return np.int64(at.RESTS)
    held = held_by(program, c)
    if held > at.RESTS:
        c.v[at.SIGNS, held] = 0.0
    return held


@inner
def _onto(program, c, held):
    """Put v, and its derivatives, on the surface that holds a motion."""
    J, T, slot, count = c.J, c.T, program.surfaces[held], c.T.shape[2]
    state_at(program, c, J, c.v[at.STATE], 0.0)
    parameters_at(program, J, c.v[at.MEMORY_NOW], c.v[at.SIGNS])
    at_once(program, J)
    for i in range(program.states + 1):
        J[i, 1] = 0.0
    order(program, J, np.int64(1))
    grip = grip_of(program, J, slot)
    c.v[at.STATE, 1] -= J[slot, 0] / grip
    if count > 0:
        for i in range(program.states):
            for q in range(count):
                T[i, 0, q] = c.dy[i, q]
        derivatives_at_once(program, J, T, program.main)
        for q in range(count):
            c.dy[1, q] -= T[slot, 0, q] / grip


@inner
def after(program, c, moves, turned, held):
    """Compute the derivatives after a switching whose time `moves`; of the memory if it was replaced."""
    J, T, size, kept, count = c.J, c.T, program.states, program.memory, c.T.shape[2]
    first = program.inputs - kept
    state_at(program, c, J, c.v[at.STATE], 0.0)
    if kept > 0 and turned:
        parameters_at(program, J, c.v[at.MEMORY_BEFORE], c.v[at.SIGNS])
        for i in range(size):
            for q in range(count):
                T[i, 0, q] = c.dy[i, q]
        at_once_live(program, J, len(program.code))
        derivatives_at_once(program, J, T, len(program.code))
        for m in range(kept):
            for q in range(count):
                T[first + m, 0, q] = T[program.replaced[m], 0, q]
    parameters_at(program, J, c.v[at.MEMORY_NOW], c.v[at.SIGNS])
    rates_of(program, J, c.v[at.SIGNS])
    for i in range(2 if held == at.RESTS else 0, size):
        for q in range(count):
            c.dy[i, q] -= J[program.rates[i], 0] * moves[q]


@inner
def begun(program, c):
    """Return the signs of a motion after a start or impulse, what holds it, and whether it reversed."""
    way = c.v[at.SIGNS, 0] if len(program.signs) > 0 else 0.0
    held = _settled(program, c)
    if held > at.RESTS:
        _onto(program, c, held)
    return held, held != at.RESTS and len(program.signs) > 0 and way * c.v[at.SIGNS, 0] < 0.0
