"""A motion by Taylor series: from switching to switching, stuck or free, with its derivatives.

One compiled function follows any program (Jorba and Zou 2005: order, step). Signs are numbers that change
where their surfaces, which are series as well, cross zero; derivatives jump there by the saltation matrix
(Leine and Nijmeijer 2004).
"""

import numpy as np

from sysid_trib.simulation.branches import branch, parameters_at, put, rates_of, settle, signs_of, state_at
from sysid_trib.simulation.compiling import compiled, inner
from sysid_trib.simulation.course import (
    CLOCK,
    DOWN,
    ERROR,
    MEMORY,
    MEMORY_DOWN,
    MEMORY_UP,
    OF_PUSH,
    ORDER,
    PUSH,
    REPLACED,
    SIGNS,
    SIGNS_DOWN,
    SIGNS_UP,
    STATE,
    TRIAL,
    UP,
    ZEROS,
)
from sysid_trib.simulation.jets import at_once, at_once_live, derivatives_at_once, derivatives_of_order, order
from sysid_trib.simulation.roots import first_crossing, of_parameter, rest_of, slope, value

# In tau: as far as a motion is followed at once, and how far it is held where a surface is crossed at rest.
LONGEST, PASSED = 16.0, 1e-9
# Of the size of the motion: no further from a surface than rounding.
AT_ZERO = 1e-14
# What is left of a series after a step, of a state and of a surface.
ROUNDING_PART, SURFACE_PART = 1e-16, 1e-13
# Rates of states that are less do not change them.
STILL = 1e-14
MOVING, ENDED, GROWS, SWITCHES, STEPS, NOT_FINITE = range(6)


@inner
def series(program, c, h, stuck):
    """Series of all slots from here, to the order that a step of h needs; that order.

    Where it is stuck, x and v stay and the states go on. Derivatives follow where there are any.
    """
    J, T, size, count, degree = c.J, c.T, program.states, c.T.shape[2], program.degree
    state_at(program, J, c.v[STATE], c.v[CLOCK, 0])
    J[size, 1] = 1.0
    for k in range(degree):
        J[size + 1, k] = c.v[PUSH, k]
        for q in range(count):
            T[size + 1, k, q] = c.v[OF_PUSH, q] * c.v[PUSH, k]
    at_once(program, J)
    if count > 0:
        for i in range(size):
            for q in range(count):
                T[i, 0, q] = c.dy[i, q]
        derivatives_at_once(program, J, T, program.main)
    small, power = 0, h
    for k in range(ORDER):
        # At rest what would move it, which only the rates tell, needs all orders.
        ends = k >= degree and not stuck
        for i in range(size):
            held, rate = stuck and i < 2, program.rates[i]
            J[i, k + 1] = 0.0 if held else J[rate, k] / (k + 1)
            for q in range(count):
                T[i, k + 1, q] = 0.0 if held else T[rate, k, q] / (k + 1)
            # Where the step is short for another reason, few orders are enough.
            ends = ends and abs(J[i, k + 1]) * power <= 1e-17 * max(abs(J[i, 0]), abs(J[i, 1]) * h)
        order(program, J, k + 1)
        for s in program.surfaces:
            ends = ends and abs(J[s, k + 1]) * power <= SURFACE_PART * max(abs(J[s, 0]), abs(J[s, 1]) * h)
        if count > 0:
            derivatives_of_order(program, J, T, k + 1)
        small = small + 1 if ends else 0
        power *= h
        if small == 2:
            return k + 1
    return ORDER


@inner
def radius(J, s, other, n, part):
    """A step after which the series of two slots go on by less than this part of their first large term."""
    largest = 0.0
    for m in range(4):
        largest = max(largest, abs(J[s, m]), abs(J[other, m]))
    m = 0
    while m < 3 and max(abs(J[s, m]), abs(J[other, m])) <= 1e-3 * largest:
        m += 1
    first, h = max(abs(J[s, m]), abs(J[other, m])), LONGEST
    for k in range(n - 1, n + 1):
        last = max(abs(J[s, k]), abs(J[other, k]))
        if last > 0.0 and first > 0.0:
            h = min(h, (part * first / last) ** (1.0 / (k - m)))
    return h


@inner
def length(program, J, n):
    """A step for which the rest of the series is below rounding."""
    h = radius(J, np.int64(0), np.int64(1), n, ROUNDING_PART)
    for i in range(2, program.states):
        h = min(h, radius(J, i, i, n, ROUNDING_PART))
    for s in program.surfaces:
        if s >= program.states:
            h = min(h, radius(J, s, s, n, SURFACE_PART))
    return h


@inner
def pushed(given, c, piece):
    """What pushes, about here."""
    degree = given.pushes.shape[1] - 1
    for k in range(degree + 1):
        c.v[PUSH, k] = given.pushes[piece, k] if piece >= 0 else 0.0
    if piece >= 0:
        since = c.v[CLOCK, 0] - given.knots[piece]
        for j in range(degree):
            for k in range(degree - 1, j - 1, -1):
                c.v[PUSH, k] += since * c.v[PUSH, k + 1]


@inner
def free_step(program, c, n, h):
    """Up to where a free motion may go, and the surface that it meets there, or -1."""
    which, near = -1, AT_ZERO * max(abs(c.v[STATE, 0]), abs(c.v[STATE, 1]))
    for m in range(len(program.signs)):
        r = first_crossing(c.J[program.surfaces[m]], n, h, c.v[SIGNS, m], near, c.v[ZEROS, m], c.work)
        if r <= h:
            h, which = r, m
    return h, which


@inner
def held_step(program, c, n, h, ends):
    """Up to where a body may stay at rest, and which way it is let go there (+1, -1), or 0."""
    way, none, acceleration = 0.0, np.int64(0), program.rates[1]
    near = AT_ZERO * abs(c.v[STATE, 0])
    for m in range(len(program.signs)):
        # Of a surface that is zero at rest nothing is known but at the start.
        if c.v[SIGNS_UP, m] != 0.0:
            r = first_crossing(c.J[program.surfaces[m]], n, h, c.v[SIGNS_UP, m], near, none, c.work)
            if r < h:
                h = max(r, PASSED)
    up = branch(program, c, 1.0, c.v[MEMORY_UP], c.v[SIGNS_UP])
    down = branch(program, c, -1.0, c.v[MEMORY_DOWN], c.v[SIGNS_DOWN])
    along(program, c, c.aside[UP], n, c.v[MEMORY_UP], c.v[SIGNS_UP])
    along(program, c, c.aside[DOWN], n, c.v[MEMORY_DOWN], c.v[SIGNS_DOWN])
    if not ends or not is_still(program, c, n):
        h = min(h, radius(c.aside[UP], acceleration, acceleration, n, ROUNDING_PART))
        h = min(h, radius(c.aside[DOWN], acceleration, acceleration, n, ROUNDING_PART))
        r = 0.0 if up > 0.0 else first_crossing(c.aside[UP][acceleration], n, h, -1.0, near, none, c.work)
        if r < h:
            h, way = r, 1.0
        r = 0.0 if down < 0.0 else first_crossing(c.aside[DOWN][acceleration], n, h, 1.0, near, none, c.work)
        if r < h:
            h, way = r, -1.0
    return h, way


@inner
def along(program, c, other, n, memory, signs):
    """Series in `other` of all slots along the states in J, with another memory and other signs."""
    for i in range(program.states + 2):
        for k in range(n + 1):
            other[i, k] = c.J[i, k]
    parameters_at(program, other, memory, signs)
    at_once(program, other)
    for k in range(1, n + 1):
        order(program, other, k)


@inner
def is_still(program, c, n):
    """Whether nothing at rest changes: what would accelerate it, and its states."""
    for i in range(2, program.states):
        if abs(c.J[i, 1]) > STILL:
            return False
    for k in range(1, n + 1):
        if c.aside[UP][program.rates[1], k] != 0.0 or c.aside[DOWN][program.rates[1], k] != 0.0:
            return False
    return True


@inner
def sampled(program, given, c, done, n, reach, stuck):
    """Write what lies up to `reach` in tau since the clock; how much of the grid is done."""
    size, held, count = program.states, program.memory, c.T.shape[2]
    at = program.inputs - held
    while done < len(given.grid):
        s = (given.grid[done] - c.v[CLOCK, 0]) - c.v[CLOCK, 1]
        if s > reach:
            break
        for i in range(size + 1):
            slot = i if i < size else program.rates[1]
            rests = stuck and i == size
            given.rows[done, i] = 0.0 if rests else value(c.J[slot], n, s)
            for q in range(count):
                given.tangents[done, i, q] = 0.0 if rests else of_parameter(c.T, slot, q, n, s)
        for m in range(held):
            given.rows[done, size + 1 + m] = c.v[MEMORY, m]
            for q in range(count):
                given.tangents[done, size + 1 + m, q] = c.T[at + m, 0, q]
        done += 1
    return done


@inner
def advance(program, c, n, h, stuck):
    """Go a step on: the state, its derivatives and the clock; sums are compensated."""
    for i in range(program.states):
        step = rest_of(c.J[i], n, h) + c.v[ERROR, i]
        new = c.v[STATE, i] + step
        c.v[ERROR, i] = step - (new - c.v[STATE, i])
        c.v[STATE, i] = new
        for q in range(c.T.shape[2]):
            c.dy[i, q] = of_parameter(c.T, i, q, n, h)
    if stuck:
        stop(c)
    step = c.v[CLOCK, 1] + h
    now = c.v[CLOCK, 0] + step
    c.v[CLOCK, 1] = step - (now - c.v[CLOCK, 0])
    c.v[CLOCK, 0] = now
    for m in range(len(program.signs)):
        c.v[ZEROS, m] = 0


@inner
def stop(c):
    """What friction holds has no speed, whatever it had."""
    c.v[STATE, 1], c.v[ERROR, 1] = 0.0, 0.0
    for q in range(c.dy.shape[1]):
        c.dy[1, q] = 0.0


@inner
def switched(program, c, which, n, h):
    """Go on from a surface, with the jump of the derivatives; whether the motion sticks there."""
    size, count, slot = program.states, c.T.shape[2], program.surfaces[which]
    moves, way = np.zeros(count), c.v[SIGNS, 0]
    if count > 0:
        rate = slope(c.J[slot], n, h)
        for q in range(count):
            # By so much the instant of the switching moves with the parameter.
            moves[q] = -of_parameter(c.T, slot, q, n, h) / rate if rate != 0.0 else 0.0
            for i in range(size):
                c.dy[i, q] += value(c.J[program.rates[i]], n, h) * moves[q]
    if slot < size:
        # The surface is a state: exactly zero here.
        c.v[STATE, slot], c.v[ERROR, slot] = 0.0, 0.0
    c.v[ZEROS, which] = 1
    put(c.v[MEMORY], c.v[REPLACED])
    c.aside[TRIAL][size + 1, 0] = value(c.v[PUSH], program.degree - 1, h)
    sticks = not settle(program, c)
    if sticks:
        stop(c)
    if count > 0:
        after(program, c, moves, way * c.v[SIGNS, 0] < 0.0, sticks)
    return sticks


@inner
def after(program, c, moves, turned, sticks):
    """Derivatives after a switching, whose instant `moves`; of the memory where it was replaced."""
    J, T, size, held, count = c.J, c.T, program.states, program.memory, c.T.shape[2]
    at = program.inputs - held
    state_at(program, J, c.v[STATE], c.v[CLOCK, 0])
    J[size + 1, 0] = c.aside[TRIAL][size + 1, 0]
    if held > 0 and turned:
        parameters_at(program, J, c.v[REPLACED], c.v[SIGNS])
        for i in range(size):
            for q in range(count):
                T[i, 0, q] = c.dy[i, q]
        at_once_live(program, J, len(program.op))
        derivatives_at_once(program, J, T, len(program.op))
        for m in range(held):
            for q in range(count):
                T[at + m, 0, q] = T[program.replaced[m], 0, q]
    parameters_at(program, J, c.v[MEMORY], c.v[SIGNS])
    rates_of(program, J, c.v[SIGNS])
    for i in range(2 if sticks else 0, size):
        for q in range(count):
            c.dy[i, q] -= J[program.rates[i], 0] * moves[q]


@inner
def released(program, c, way):
    """Let a body go from rest: it begins without speed and without acceleration."""
    put(c.v[MEMORY_UP] if way > 0.0 else c.v[MEMORY_DOWN], c.v[MEMORY])
    put(c.v[SIGNS_UP] if way > 0.0 else c.v[SIGNS_DOWN], c.v[SIGNS])
    c.v[ZEROS, 0] = 2


@inner
def at_knot(given, c, piece, stuck):
    """What happens at a knot: kicks, and impulses to the derivatives; whether it was kicked."""
    c.v[CLOCK, 0], c.v[CLOCK, 1] = given.knots[piece], 0.0
    if not stuck:
        for q in range(given.impulses.shape[1]):
            c.dy[1, q] += given.impulses[piece, q]
    c.v[STATE, 0] += given.kicks[piece, 0]
    c.v[STATE, 1] += given.kicks[piece, 1]
    return given.kicks[piece, 0] != 0.0 or given.kicks[piece, 1] != 0.0


@inner
def outcome_of(c, h, furthest, steps, most_steps):
    """How a motion stands."""
    if abs(c.v[STATE, 0]) > furthest:
        return GROWS
    if not (np.isfinite(c.v[STATE, 0]) and np.isfinite(c.v[STATE, 1]) and h >= 0.0):
        return NOT_FINITE
    return STEPS if steps > most_steps else MOVING


@inner
def noted(times, count, tau):
    """The list of times with one more."""
    if count == len(times):
        longer = np.empty(2 * count)
        put(times, longer)
        times = longer
    times[count] = tau
    return times


@inner
def begun(program, c):
    """Signs of a motion that begins here, or was kicked; whether it sticks, and whether it turned."""
    way = c.v[SIGNS, 0] if len(program.signs) > 0 else 0.0
    sticks = not settle(program, c)
    if sticks:
        stop(c)
    return sticks, not sticks and len(program.signs) > 0 and way * c.v[SIGNS, 0] < 0.0


@compiled
def run(program, given, c, limits):
    """Follow a motion along the grid of `given`, whose `rows` and `tangents` are written.

    `limits`: rad beyond which it diverges, switchings and steps that it may take. Returns where the sign of v
    changes, and how often; where it comes to rest for good, or nan; how it ended, at the clock.
    """
    furthest, budget, most_steps = limits
    end, last, piece, done, steps = given.grid[-1], len(given.knots) - 1, -1, 0, 0
    reversals, turns, rest, state = np.empty(64), np.int64(0), np.nan, MOVING
    while piece < last and given.knots[piece + 1] <= c.v[CLOCK, 0]:
        piece += 1
    fresh, stuck = True, False
    while state == MOVING:
        pushed(given, c, piece)
        c.aside[TRIAL][program.states + 1, 0] = c.v[PUSH, 0]
        turned = False
        if fresh:
            stuck, turned = begun(program, c)
            rest = c.v[CLOCK, 0] if stuck else np.nan
            fresh = False
        if stuck:
            state_at(program, c.aside[TRIAL], c.v[STATE], c.v[CLOCK, 0])
            parameters_at(program, c.aside[TRIAL], c.v[MEMORY], c.v[SIGNS])
            signs_of(program, c.aside[TRIAL], c.v[SIGNS_UP])
        parameters_at(program, c.J, c.v[MEMORY], c.v[SIGNS_UP] if stuck else c.v[SIGNS])
        to_end = max(end - c.v[CLOCK, 0] - c.v[CLOCK, 1], 0.0)
        limit = to_end
        if piece < last:
            limit = min(limit, max(given.knots[piece + 1] - c.v[CLOCK, 0] - c.v[CLOCK, 1], 0.0))
        h, which, way = min(limit, LONGEST), -1, 0.0
        n = series(program, c, h, stuck)
        steps += 1
        if stuck:
            h, way = held_step(program, c, n, limit, piece == last)
        else:
            h, which = free_step(program, c, n, min(h, length(program, c.J, n)) if n == ORDER else h)
        whole = h >= limit and which < 0 and way == 0.0
        done = sampled(program, given, c, done, n, np.inf if whole and limit == to_end else h, stuck)
        if done == len(given.grid):
            state = ENDED
            break
        advance(program, c, n, h, stuck)
        if which >= 0:
            budget -= 1
            before = c.v[SIGNS, 0]
            stuck = switched(program, c, which, n, h)
            rest = c.v[CLOCK, 0] if stuck else np.nan
            turned = not stuck and before * c.v[SIGNS, 0] < 0.0
        elif way != 0.0:
            budget -= 1
            released(program, c, way)
            stuck, rest, turned = False, np.nan, True
        elif whole:
            piece += 1
            fresh = at_knot(given, c, piece, stuck)
        if turned:
            reversals = noted(reversals, turns, c.v[CLOCK, 0])
            turns += 1
        state = SWITCHES if budget < 0 else outcome_of(c, h, furthest, steps, most_steps)
    return reversals, turns, rest, state
