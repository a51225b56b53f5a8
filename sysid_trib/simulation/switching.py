"""What happens where a motion meets a surface: signs, memory, and the jump of the derivatives.

Derivatives jump there by the saltation matrix (Leine and Nijmeijer 2004).
"""

import numpy as np

from sysid_trib.simulation.branches import (
    RESTS,
    grip_of,
    held_by,
    parameters_at,
    put,
    rates_of,
    settle,
    state_at,
)
from sysid_trib.simulation.compiled import (
    ROW_ERROR,
    ROW_MEMORY,
    ROW_REPLACED,
    ROW_SIGNS,
    ROW_STATE,
    ROW_ZEROS,
    inner,
)
from sysid_trib.simulation.jets import at_once, at_once_live, derivatives_at_once, order
from sysid_trib.simulation.roots import of_parameter, slope, value
from sysid_trib.simulation.taylor import look_ahead


@inner
def stop(c):
    """What friction holds has no speed, whatever it had."""
    c.v[ROW_STATE, 1], c.v[ROW_ERROR, 1] = 0.0, 0.0
    for q in range(c.dy.shape[1]):
        c.dy[1, q] = 0.0


@inner
def switched(program, c, which, n, h):
    """Go on from a surface, with the jump of the derivatives; by what the motion is held there."""
    size, count, slot = program.states, c.T.shape[2], program.surfaces[which]
    moves, way = np.zeros(count), c.v[ROW_SIGNS, 0]
    if count > 0:
        rate = slope(c.J[slot], n, h)
        for q in range(count):
            # By so much the instant of the switching moves with the parameter.
            moves[q] = -of_parameter(c.T, slot, q, n, h) / rate if rate != 0.0 else 0.0
            for i in range(size):
                c.dy[i, q] += value(c.J[program.rates[i]], n, h) * moves[q]
    if slot < size:
        # The surface is a state: exactly zero here.
        c.v[ROW_STATE, slot], c.v[ROW_ERROR, slot] = 0.0, 0.0
    c.v[ROW_ZEROS, which] = 1
    put(c.v[ROW_MEMORY], c.v[ROW_REPLACED])
    look_ahead(c, h)
    held = settled(program, c)
    turned = way * c.v[ROW_SIGNS, 0] < 0.0
    if program.memory > 0 and turned and slot >= size:
        # Another memory takes it elsewhere.
        c.v[ROW_ZEROS, which] = 0
    if held == RESTS:
        stop(c)
    if count > 0:
        after(program, c, moves, turned, held)
    if held > RESTS:
        onto(program, c, held)
    return held


@inner
def settled(program, c):
    """Set signs, and at a reversal the memory, for the motion from here; by what it is held."""
    if not settle(program, c):
        return np.int64(RESTS)
    held = held_by(program, c)
    if held > RESTS:
        c.v[ROW_SIGNS, held] = 0.0
    return held


@inner
def onto(program, c, held):
    """Put v, and its derivatives, on the surface by which a motion is held."""
    J, T, slot, count = c.J, c.T, program.surfaces[held], c.T.shape[2]
    state_at(program, c, J, c.v[ROW_STATE], 0.0)
    parameters_at(program, J, c.v[ROW_MEMORY], c.v[ROW_SIGNS])
    at_once(program, J)
    for i in range(program.states + 1):
        J[i, 1] = 0.0
    order(program, J, np.int64(1))
    grip = grip_of(program, J, slot)
    c.v[ROW_STATE, 1] -= J[slot, 0] / grip
    if count > 0:
        for i in range(program.states):
            for q in range(count):
                T[i, 0, q] = c.dy[i, q]
        derivatives_at_once(program, J, T, program.main)
        for q in range(count):
            c.dy[1, q] -= T[slot, 0, q] / grip


@inner
def after(program, c, moves, turned, held):
    """Derivatives after a switching, whose instant `moves`; of the memory where it was replaced."""
    J, T, size, kept, count = c.J, c.T, program.states, program.memory, c.T.shape[2]
    at = program.inputs - kept
    state_at(program, c, J, c.v[ROW_STATE], 0.0)
    if kept > 0 and turned:
        parameters_at(program, J, c.v[ROW_REPLACED], c.v[ROW_SIGNS])
        for i in range(size):
            for q in range(count):
                T[i, 0, q] = c.dy[i, q]
        at_once_live(program, J, len(program.code))
        derivatives_at_once(program, J, T, len(program.code))
        for m in range(kept):
            for q in range(count):
                T[at + m, 0, q] = T[program.replaced[m], 0, q]
    parameters_at(program, J, c.v[ROW_MEMORY], c.v[ROW_SIGNS])
    rates_of(program, J, c.v[ROW_SIGNS])
    for i in range(2 if held == RESTS else 0, size):
        for q in range(count):
            c.dy[i, q] -= J[program.rates[i], 0] * moves[q]


@inner
def begun(program, c):
    """Signs of a motion that begins here, or was kicked; by what it is held, and whether it turned."""
    way = c.v[ROW_SIGNS, 0] if len(program.signs) > 0 else 0.0
    held = settled(program, c)
    if held == RESTS:
        stop(c)
    elif held > RESTS:
        onto(program, c, held)
    return held, held != RESTS and len(program.signs) > 0 and way * c.v[ROW_SIGNS, 0] < 0.0
