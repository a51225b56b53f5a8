"""A motion by Taylor series: between switchings, sticking or free, with its derivatives.

One compiled function runs any program. Signs are numbers that change where their surfaces, which are series
too, cross zero.
"""

import numpy as np

from sysid_trib.simulation import under_way as at
from sysid_trib.simulation.branches import parameters_at, reverses, signs_of, state_at
from sysid_trib.simulation.compiled import compiled, inner
from sysid_trib.simulation.surfaces import begun, free_step, held_step, released, stop, switched
from sysid_trib.simulation.taylor import length, look_ahead, of_parameter, rest_of, series, value


@inner
def sampled(program, given, c, done, until, n, reach):
    """Write the samples up to `reach`, in tau since the clock; return how many samples are done."""
    states, held, kept, count = program.states, program.memory, program.inputs - program.memory, c.T.shape[2]
    while done < until:
        s = (given.grid[done] - c.v[at.CLOCK, 0]) - c.v[at.CLOCK, 1]
        if s > reach:
            break
        for i in range(states + 1):
            slot, column = (i, i) if i < states else (program.rates[1], states + held)
            given.rows[done, column] = value(c.J[slot], n, s)
            for q in range(count):
                given.tangents[done, column, q] = of_parameter(c.T, slot, q, n, s)
        for m in range(held):
            given.rows[done, states + m] = c.v[at.MEMORY_NOW, m]
            for q in range(count):
                given.tangents[done, states + m, q] = c.T[kept + m, 0, q]
        done += 1
    return done


@inner
def advance(program, c, n, h, held):
    """Advance the state, its derivatives and the clock by one step; sums are compensated."""
    for i in range(program.states):
        step = rest_of(c.J[i], n, h) + c.v[at.STATE_ROUNDING, i]
        new = c.v[at.STATE, i] + step
        c.v[at.STATE_ROUNDING, i] = step - (new - c.v[at.STATE, i])
        c.v[at.STATE, i] = new
        for q in range(c.T.shape[2]):
            c.dy[i, q] = of_parameter(c.T, i, q, n, h)
    if program.states > 2:
        forgotten(program, c)
    if held == at.RESTS:
        stop(c)
    step = c.v[at.CLOCK, 1] + h
    now = c.v[at.CLOCK, 0] + step
    c.v[at.CLOCK, 1] = step - (now - c.v[at.CLOCK, 0])
    c.v[at.CLOCK, 0] = now
    for m in range(len(program.signs)):
        c.v[at.ZEROS, m] = 0


@inner
def forgotten(program, c):
    """Set decayed derivatives to zero: their rounding errors would make every step short."""
    for q in range(c.dy.shape[1]):
        for i in range(program.states):
            c.v[at.LARGEST_DERIVATIVES, q] = max(c.v[at.LARGEST_DERIVATIVES, q], abs(c.dy[i, q]))
        for i in range(2, program.states):
            if abs(c.dy[i, q]) < at.SURFACE_PART * c.v[at.LARGEST_DERIVATIVES, q]:
                c.dy[i, q] = 0.0


@inner
def begun_anew(program, given, c, start):
    """Restart at a given state and memory, with their derivatives."""
    size, held, kept = program.states, program.memory, program.inputs - program.memory
    for m in range(len(program.signs)):
        c.v[at.SIGNS, m], c.v[at.ZEROS, m] = 0.0, 0.0
    for i in range(size):
        c.v[at.STATE, i], c.v[at.STATE_ROUNDING, i] = given.starts[start, i], 0.0
        for q in range(c.T.shape[2]):
            c.dy[i, q], c.v[at.LARGEST_DERIVATIVES, q] = given.slopes[i, q], 0.0
    for m in range(held):
        c.v[at.MEMORY_NOW, m] = given.starts[start, size + m]
        for q in range(c.T.shape[2]):
            c.T[kept + m, 0, q] = given.slopes[size + m, q]


@inner
def at_knot(program, given, c, piece, held):
    """Apply the events of a knot: start, impulses, impulses of the derivatives; return true for a start."""
    c.v[at.CLOCK, 0], c.v[at.CLOCK, 1] = given.knots[piece], 0.0
    if given.marks[piece] >= 0:
        begun_anew(program, given, c, given.marks[piece])
        return True
    if held == at.FREE:
        for q in range(given.impulses.shape[1]):
            c.dy[1, q] += given.impulses[piece, q]
    c.v[at.STATE, 0] += given.increments[piece, 0]
    c.v[at.STATE, 1] += given.increments[piece, 1]
    incremented = given.increments[piece, 0] != 0.0 or given.increments[piece, 1] != 0.0
    return incremented or given.marks[piece] == at.INPUT_JUMPS


@inner
def driven(given, c, piece):
    """Shift the polynomials of the inputs to the present time."""
    degree, since = given.drives.shape[2] - 1, c.v[at.CLOCK, 0] - given.knots[piece]
    for m in range(len(c.drive)):
        for k in range(degree + 1):
            c.drive[m, k] = given.drives[piece, m, k]
        for j in range(degree):
            for k in range(degree - 1, j - 1, -1):
                c.drive[m, k] += since * c.drive[m, k + 1]
    look_ahead(c, 0.0)


@inner
def on_branch(program, c, held):
    """Put memory and signs into the series; at rest the states continue with the signs of rest."""
    if held == at.RESTS:
        state_at(program, c, c.aside[at.TRIAL], c.v[at.STATE], 0.0)
        parameters_at(program, c.aside[at.TRIAL], c.v[at.MEMORY_NOW], c.v[at.SIGNS])
        signs_of(program, c.aside[at.TRIAL], c.v[at.SIGNS_UP])
    parameters_at(program, c.J, c.v[at.MEMORY_NOW], c.v[at.SIGNS_UP] if held == at.RESTS else c.v[at.SIGNS])


@inner
def outcome_of(c, h, furthest, steps, most_steps):
    """Return the state of the integration: moving, grown, not finite, or out of steps."""
    if abs(c.v[at.STATE, 0]) > furthest:
        return at.GROWS
    if not (np.isfinite(c.v[at.STATE, 0]) and np.isfinite(c.v[at.STATE, 1]) and h >= 0.0):
        return at.IS_NOT_FINITE
    return at.STEPS if steps > most_steps else at.MOVING


@compiled
def run(program, given, c, limits):
    """Run the motions of `given`, one after another, and write its `rows`, `tangents` and `reversals`.

    `limits` : angle (rad) beyond which a motion diverges, most switchings and steps of all motions together,
    and the truncation error of a step for the series of the states. Return the number of sign changes of v,
    the time at which the motion comes to rest for good (or nan), and the outcome at the time of the clock.
    """
    furthest, budget, most_steps, part = limits
    piece, done, steps, held = np.int64(0), np.int64(0), 0, np.int64(at.FREE)
    turns, rest, state = np.int64(0), np.nan, at.MOVING
    fresh, until = at_knot(program, given, c, piece, held), given.until[0]
    while state == at.MOVING:
        driven(given, c, piece)
        turned, begins, fresh = False, fresh, False
        if begins:
            held, turned = begun(program, c)
            rest = c.v[at.CLOCK, 0] if held == at.RESTS else np.nan
        on_branch(program, c, held)
        limit = max(given.knots[piece + 1] - c.v[at.CLOCK, 0] - c.v[at.CLOCK, 1], 0.0)
        ends = given.marks[piece + 1] == at.MOTION_ENDS
        h, which, way = min(limit, at.FURTHEST_AT_ONCE), -1, 0.0
        n = series(program, c, h, held)
        steps += 1
        if held != at.FREE:
            longest = limit if held == at.RESTS else min(limit, length(program, c, n, part))
            h, way, which = held_step(program, c, n, longest, held, held == at.RESTS and ends)
        else:
            h, which = free_step(program, c, n, min(h, length(program, c, n, part)) if n == at.ORDER else h)
        whole = h >= limit and which < 0 and way == 0.0
        done = sampled(program, given, c, done, until, n, np.inf if whole and ends else h)
        if done == len(given.grid):
            state = at.ENDED
            break
        advance(program, c, n, h, held)
        if which >= 0:
            budget -= 1
            before = c.v[at.SIGNS, 0]
            held = switched(program, c, which, n, h)
            rest = c.v[at.CLOCK, 0] if held == at.RESTS else np.nan
            turned = held != at.RESTS and before * c.v[at.SIGNS, 0] < 0.0
        elif way != 0.0:
            budget -= 1
            released(program, c, held, way)
            turned, held, rest = held == at.RESTS, np.int64(at.FREE), np.nan
        elif whole:
            piece += 2 if ends else 1
            fresh = at_knot(program, given, c, piece, held)
            until = given.until[given.marks[piece]] if ends else until
        if turned and reverses(program):
            given.reversals[turns] = c.v[at.CLOCK, 0]
            turns += 1
        state = at.SWITCHES if budget < 0 else outcome_of(c, h, furthest, steps, most_steps)
    return turns, rest, state
