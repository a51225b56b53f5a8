"""A motion by Taylor series: from switching to switching, stuck or free, with its derivatives.

One compiled function follows any program (Jorba and Zou 2005: order, step). Signs are numbers that change
where their surfaces, which are series as well, cross zero; derivatives jump there by the saltation matrix
(Leine and Nijmeijer 2004).
"""

import numpy as np

from sysid_trib.simulation.branches import (
    FREE,
    RESTS,
    branch,
    grip_of,
    held_by,
    parameters_at,
    put,
    rates_of,
    reverses,
    settle,
    signs_of,
    state_at,
)
from sysid_trib.simulation.compiled import (
    DOWN,
    INPUT_JUMPS,
    INTERVAL_ENDS,
    ORDER,
    ROW_CLOCK,
    ROW_ERROR,
    ROW_GRIP,
    ROW_LARGEST,
    ROW_MEMORY,
    ROW_MEMORY_DOWN,
    ROW_MEMORY_UP,
    ROW_REPLACED,
    ROW_SIGNS,
    ROW_SIGNS_DOWN,
    ROW_SIGNS_UP,
    ROW_STATE,
    ROW_ZEROS,
    TRIAL,
    UP,
    compiled,
    inner,
)
from sysid_trib.simulation.jets import at_once, at_once_live, derivatives_at_once, derivatives_of_order, order
from sysid_trib.simulation.program import PUSH_NUMBERS
from sysid_trib.simulation.roots import first_crossing, of_parameter, rest_of, slope, value

# In tau: as far as a motion is followed at once, and how far it is held where a surface is crossed at rest.
FURTHEST_AT_ONCE, PASSED = 16.0, 1e-9
# Of the size of the motion: no further from a surface than rounding.
AT_ZERO = 1e-14
# What is left of a series after a step, of a state and of a surface or a derivative.
STATE_PART, SURFACE_PART = 1e-16, 1e-13
# Rates of states that are less do not change them.
UNCHANGED = 1e-14
MOVING, ENDED, GROWS, SWITCHES, STEPS, IS_NOT_FINITE = range(6)


@inner
def series(program, c, h, held):
    """Series of all slots from here, to the order that a step of h needs; that order.

    At rest x and v stay and the states go on; on another surface v keeps it at zero. Derivatives follow where
    there are any.
    """
    J, T, size, count, degree = c.J, c.T, program.states, c.T.shape[2], 0
    slot = program.surfaces[held] if held > RESTS else 0
    state_at(program, c, J, c.v[ROW_STATE], 0.0)
    J[size, 1] = 1.0
    for m in range(program.channels):
        for k in range(PUSH_NUMBERS):
            J[size + 1 + m, k] = c.drive[m, k]
            degree = max(degree, k) if c.drive[m, k] != 0.0 else degree
            for q in range(count):
                T[size + 1 + m, k, q] = c.of_drive[m, q] * c.drive[m, k]
    at_once(program, J)
    if count > 0:
        for i in range(size):
            for q in range(count):
                T[i, 0, q] = c.dy[i, q]
        derivatives_at_once(program, J, T, program.main)
    small, power = 0, h
    for k in range(ORDER):
        # What would move it where it is held, which only the rates tell, needs all orders.
        ends = k > degree and held == FREE
        for i in range(size):
            stays, rate = held == RESTS and i < 2, program.rates[i]
            J[i, k + 1] = 0.0 if stays else J[rate, k] / (k + 1)
            for q in range(count):
                T[i, k + 1, q] = 0.0 if stays else T[rate, k, q] / (k + 1)
            # Where the step is short for another reason, few orders are enough.
            ends = ends and abs(J[i, k + 1]) * power <= 1e-17 * max(abs(J[i, 0]), abs(J[i, 1]) * h)
        order(program, J, k + 1)
        if held > RESTS:
            if k == 0:
                c.v[ROW_GRIP, 0] = grip_of(program, J, slot)
            J[1, k + 1] -= J[slot, k + 1] / c.v[ROW_GRIP, 0]
            order(program, J, k + 1)
        for s in program.surfaces:
            ends = ends and abs(J[s, k + 1]) * power <= SURFACE_PART * max(abs(J[s, 0]), abs(J[s, 1]) * h)
        if count > 0:
            derivatives_of_order(program, J, T, k + 1)
            if held > RESTS:
                for q in range(count):
                    T[1, k + 1, q] -= T[slot, k + 1, q] / c.v[ROW_GRIP, 0]
                derivatives_of_order(program, J, T, k + 1)
            ends = ends and (size == 2 or part_of_derivatives(program, c, k + 1) * power <= SURFACE_PART)
        small = small + 1 if ends else 0
        power *= h
        if small == 2:
            return k + 1
    if held != FREE:
        # What friction holds is accelerated as its surface is, whatever the rates with these signs say.
        for k in range(ORDER + 1):
            J[program.rates[1], k] = (k + 1) * J[1, k + 1] if k < ORDER else 0.0
            for q in range(count):
                T[program.rates[1], k, q] = (k + 1) * T[1, k + 1, q] if k < ORDER else 0.0
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
    first, h = max(abs(J[s, m]), abs(J[other, m])), FURTHEST_AT_ONCE
    for k in range(n - 1, n + 1):
        last = max(abs(J[s, k]), abs(J[other, k]))
        if last > 0.0 and first > 0.0:
            h = min(h, (part * first / last) ** (1.0 / (k - m)))
    return h


@inner
def part_of_derivatives(program, c, k):
    """The largest term of an order of the derivatives, over what that parameter has moved so far."""
    largest = 0.0
    for q in range(c.T.shape[2]):
        scale, term = max(c.v[ROW_LARGEST, q], abs(c.T[1, 1, q])), 0.0
        for i in range(program.states):
            scale = max(scale, abs(c.T[i, 0, q]))
            term = max(term, abs(c.T[i, k, q]))
        if scale > 0.0:
            largest = max(largest, term / scale)
    return largest


@inner
def length(program, c, n):
    """A step for which the rest of the series is below rounding."""
    J = c.J
    h = radius(J, np.int64(0), np.int64(1), n, STATE_PART)
    for i in range(2, program.states):
        h = min(h, radius(J, i, i, n, STATE_PART))
    for s in program.surfaces:
        if s >= program.states:
            h = min(h, radius(J, s, s, n, SURFACE_PART))
    for k in range(n - 1, n + 1 if program.states > 2 else n - 1):
        # Of a stiff state the derivatives fade, and grow again in steps that are too long for them.
        last = part_of_derivatives(program, c, k)
        if last > 0.0:
            h = min(h, (SURFACE_PART / last) ** (1.0 / k))
    return h


@inner
def driven(given, c, piece):
    """What is given over time, about here."""
    degree = given.drives.shape[2] - 1
    for m in range(len(c.drive)):
        for k in range(degree + 1):
            c.drive[m, k] = given.drives[piece, m, k] if piece >= 0 else 0.0
        if piece >= 0:
            since = c.v[ROW_CLOCK, 0] - given.knots[piece]
            for j in range(degree):
                for k in range(degree - 1, j - 1, -1):
                    c.drive[m, k] += since * c.drive[m, k + 1]
    look_ahead(c, 0.0)


@inner
def look_ahead(c, h):
    """Value and slope of what is given over time, so much after where its polynomials count from."""
    for m in range(len(c.drive)):
        c.drive[m, PUSH_NUMBERS] = value(c.drive[m], np.int64(PUSH_NUMBERS - 1), h)
        c.drive[m, PUSH_NUMBERS + 1] = slope(c.drive[m], np.int64(PUSH_NUMBERS - 1), h)


@inner
def free_step(program, c, n, h):
    """Up to where a free motion may go, and the surface that it meets there, or -1."""
    which, near = -1, AT_ZERO * max(abs(c.v[ROW_STATE, 0]), abs(c.v[ROW_STATE, 1]))
    for m in range(len(program.signs)):
        r = first_crossing(
            c.J[program.surfaces[m]], n, h, c.v[ROW_SIGNS, m], (near, c.v[ROW_ZEROS, m]), c.work
        )
        if r <= h:
            h, which = r, m
    return h, which


@inner
def held_step(program, c, n, h, held, ends):
    """Up to where a body may stay where it is held; which way it is let go there (+1, -1), or 0.

    Third is the surface that it meets there, or -1.
    """
    way, which, near = 0.0, -1, AT_ZERO * abs(c.v[ROW_STATE, 0])
    if held == RESTS:
        h = rest_lasts(program, c, n, h, near)
        up = branch(program, c, 1.0, c.v[ROW_MEMORY_UP], c.v[ROW_SIGNS_UP])
        down = branch(program, c, -1.0, c.v[ROW_MEMORY_DOWN], c.v[ROW_SIGNS_DOWN])
    else:
        h, which = free_step(program, c, n, h)
        for at, memory in ((ROW_SIGNS_UP, ROW_MEMORY_UP), (ROW_SIGNS_DOWN, ROW_MEMORY_DOWN)):
            put(c.v[ROW_SIGNS], c.v[at])
            put(c.v[ROW_MEMORY], c.v[memory])
        c.v[ROW_SIGNS_UP, held], c.v[ROW_SIGNS_DOWN, held] = 1.0, -1.0
    pulls(program, c, c.aside[UP], n, c.v[ROW_MEMORY_UP], c.v[ROW_SIGNS_UP])
    pulls(program, c, c.aside[DOWN], n, c.v[ROW_MEMORY_DOWN], c.v[ROW_SIGNS_DOWN])
    pull = program.rates[1]
    if held != RESTS:
        # Upwards is where the surface rises.
        for k in range(n + 1):
            c.aside[UP][pull, k] *= c.v[ROW_GRIP, 0]
            c.aside[DOWN][pull, k] *= c.v[ROW_GRIP, 0]
        up, down = c.aside[UP][pull, 0], c.aside[DOWN][pull, 0]
    if not ends or not is_still(program, c, n):
        h = min(h, radius(c.aside[UP], pull, pull, n, STATE_PART))
        h = min(h, radius(c.aside[DOWN], pull, pull, n, STATE_PART))
        r = 0.0 if up > 0.0 else first_crossing(c.aside[UP][pull], n, h, -1.0, (near, 0.0), c.work)
        if r < h:
            h, way = r, 1.0
        r = 0.0 if down < 0.0 else first_crossing(c.aside[DOWN][pull], n, h, 1.0, (near, 0.0), c.work)
        if r < h:
            h, way = r, -1.0
    return h, way, which if way == 0.0 else -1


@inner
def rest_lasts(program, c, n, h, near):
    """Up to where the signs at rest are those of now."""
    for m in range(len(program.signs)):
        # Of a surface that is zero at rest nothing is known but at the start.
        if c.v[ROW_SIGNS_UP, m] != 0.0:
            r = first_crossing(c.J[program.surfaces[m]], n, h, c.v[ROW_SIGNS_UP, m], (near, 0.0), c.work)
            if r < h:
                h = max(r, PASSED)
    return h


@inner
def pulls(program, c, other, n, memory, signs):
    """Series in `other` of what would move a held body to one side of where it is held."""
    along(program, c, other, n, memory, signs)
    pull = program.rates[1]
    for k in range(n + 1):
        other[pull, k] -= c.J[pull, k]


@inner
def along(program, c, other, n, memory, signs):
    """Series in `other` of all slots along the states in J, with another memory and other signs."""
    for i in range(program.states + 1 + program.channels):
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
        if abs(c.J[i, 1]) > UNCHANGED:
            return False
    for k in range(1, n + 1):
        if c.aside[UP][program.rates[1], k] != 0.0 or c.aside[DOWN][program.rates[1], k] != 0.0:
            return False
    return True


@inner
def memory_written(program, given, c, done):
    """Write the memory, with its derivatives."""
    first, at = program.states + 1, program.inputs - program.memory
    for m in range(program.memory):
        given.rows[done, first + m] = c.v[ROW_MEMORY, m]
        for q in range(c.T.shape[2]):
            given.tangents[done, first + m, q] = c.T[at + m, 0, q]


@inner
def sampled(program, given, c, done, n, reach):
    """Write what lies up to `reach` in tau since the clock; how much of the grid is done."""
    size, count = program.states, c.T.shape[2]
    while done < len(given.grid):
        s = (given.grid[done] - c.v[ROW_CLOCK, 0]) - c.v[ROW_CLOCK, 1]
        if s > reach:
            break
        for i in range(size + 1):
            slot = i if i < size else program.rates[1]
            given.rows[done, i] = value(c.J[slot], n, s)
            for q in range(count):
                given.tangents[done, i, q] = of_parameter(c.T, slot, q, n, s)
        memory_written(program, given, c, done)
        done += 1
    return done


@inner
def advance(program, c, n, h, held):
    """Go a step on: the state, its derivatives and the clock; sums are compensated."""
    for i in range(program.states):
        step = rest_of(c.J[i], n, h) + c.v[ROW_ERROR, i]
        new = c.v[ROW_STATE, i] + step
        c.v[ROW_ERROR, i] = step - (new - c.v[ROW_STATE, i])
        c.v[ROW_STATE, i] = new
        for q in range(c.T.shape[2]):
            c.dy[i, q] = of_parameter(c.T, i, q, n, h)
    if program.states > 2:
        forgotten(program, c)
    if held == RESTS:
        stop(c)
    step = c.v[ROW_CLOCK, 1] + h
    now = c.v[ROW_CLOCK, 0] + step
    c.v[ROW_CLOCK, 1] = step - (now - c.v[ROW_CLOCK, 0])
    c.v[ROW_CLOCK, 0] = now
    for m in range(len(program.signs)):
        c.v[ROW_ZEROS, m] = 0


@inner
def forgotten(program, c):
    """What has faded out of the derivatives is zero: what rounding leaves of it would hold up every step."""
    for q in range(c.dy.shape[1]):
        for i in range(program.states):
            c.v[ROW_LARGEST, q] = max(c.v[ROW_LARGEST, q], abs(c.dy[i, q]))
        for i in range(2, program.states):
            if abs(c.dy[i, q]) < SURFACE_PART * c.v[ROW_LARGEST, q]:
                c.dy[i, q] = 0.0


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
def released(program, c, held, way):
    """Let a body go from where it is held: from there it begins without speed and without acceleration."""
    put(c.v[ROW_MEMORY_UP] if way > 0.0 else c.v[ROW_MEMORY_DOWN], c.v[ROW_MEMORY])
    put(c.v[ROW_SIGNS_UP] if way > 0.0 else c.v[ROW_SIGNS_DOWN], c.v[ROW_SIGNS])
    c.v[ROW_ZEROS, held] = 2


@inner
def written(program, given, c, done):
    """Write the end of an interval, with its derivatives."""
    for i in range(program.states):
        given.rows[done, i] = c.v[ROW_STATE, i]
        for q in range(c.T.shape[2]):
            given.tangents[done, i, q] = c.dy[i, q]
    memory_written(program, given, c, done)


@inner
def begun_anew(program, given, c, start):
    """Begin at a given state and memory, by which the first derivatives are."""
    size, held, at = program.states, program.memory, program.inputs - program.memory
    for m in range(len(program.signs)):
        c.v[ROW_SIGNS, m], c.v[ROW_ZEROS, m] = 0.0, 0.0
    for i in range(size):
        c.v[ROW_STATE, i], c.v[ROW_ERROR, i] = given.starts[start, i], 0.0
        for q in range(c.T.shape[2]):
            c.dy[i, q], c.v[ROW_LARGEST, q] = 1.0 if q == i else 0.0, 0.0
    for m in range(held):
        c.v[ROW_MEMORY, m] = given.starts[start, size + m]
        for q in range(c.T.shape[2]):
            c.T[at + m, 0, q] = 1.0 if q == size + m else 0.0


@inner
def at_knot(program, given, c, piece, done, held):
    """What happens at a knot: the end of an interval, a start, kicks, impulses to the derivatives.

    Returns the knot from which it goes on, how many intervals are done, and whether it begins anew.
    """
    if given.marks[piece] == INTERVAL_ENDS:
        written(program, given, c, done)
        done += 1
        piece += 1
        if piece == len(given.knots):
            return piece, done, False
    c.v[ROW_CLOCK, 0], c.v[ROW_CLOCK, 1] = given.knots[piece], 0.0
    if given.marks[piece] >= 0:
        begun_anew(program, given, c, given.marks[piece])
        return piece, done, True
    if held == FREE:
        for q in range(given.impulses.shape[1]):
            c.dy[1, q] += given.impulses[piece, q]
    c.v[ROW_STATE, 0] += given.kicks[piece, 0]
    c.v[ROW_STATE, 1] += given.kicks[piece, 1]
    kicked = given.kicks[piece, 0] != 0.0 or given.kicks[piece, 1] != 0.0
    return piece, done, kicked or given.marks[piece] == INPUT_JUMPS


@inner
def to_knot(given, c, piece):
    """How far it is to the next knot."""
    if piece + 1 == len(given.knots):
        return np.inf
    return max(given.knots[piece + 1] - c.v[ROW_CLOCK, 0] - c.v[ROW_CLOCK, 1], 0.0)


@inner
def on_branch(program, c, held):
    """Put memory and signs into the series; at rest the states go on with the signs of rest."""
    if held == RESTS:
        state_at(program, c, c.aside[TRIAL], c.v[ROW_STATE], 0.0)
        parameters_at(program, c.aside[TRIAL], c.v[ROW_MEMORY], c.v[ROW_SIGNS])
        signs_of(program, c.aside[TRIAL], c.v[ROW_SIGNS_UP])
    parameters_at(program, c.J, c.v[ROW_MEMORY], c.v[ROW_SIGNS_UP] if held == RESTS else c.v[ROW_SIGNS])


@inner
def outcome_of(c, h, furthest, steps, most_steps):
    """How a motion stands."""
    if abs(c.v[ROW_STATE, 0]) > furthest:
        return GROWS
    if not (np.isfinite(c.v[ROW_STATE, 0]) and np.isfinite(c.v[ROW_STATE, 1]) and h >= 0.0):
        return IS_NOT_FINITE
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
    """Signs of a motion that begins here, or was kicked; by what it is held, and whether it turned."""
    way = c.v[ROW_SIGNS, 0] if len(program.signs) > 0 else 0.0
    held = settled(program, c)
    if held == RESTS:
        stop(c)
    elif held > RESTS:
        onto(program, c, held)
    return held, held != RESTS and len(program.signs) > 0 and way * c.v[ROW_SIGNS, 0] < 0.0


@compiled
def run(program, given, c, limits):
    """Follow a motion along the grid of `given`, whose `rows` and `tangents` are written.

    `limits`: rad beyond which it diverges, switchings and steps that it may take. Returns where the sign of v
    changes, and how often; where it comes to rest for good, or nan; how it ended, at the clock.
    """
    furthest, budget, most_steps = limits
    last, piece, done, steps, shooting = len(given.knots) - 1, -1, np.int64(0), 0, len(given.starts) > 0
    end, fresh, held = np.inf if shooting else given.grid[-1], True, np.int64(FREE)
    reversals, turns, rest, state = np.empty(64), np.int64(0), np.nan, MOVING
    if shooting:
        piece, done, _ = at_knot(program, given, c, np.int64(0), done, held)
    else:
        while piece < last and given.knots[piece + 1] <= c.v[ROW_CLOCK, 0]:
            piece += 1
    while state == MOVING:
        driven(given, c, piece)
        turned, begins, fresh = False, fresh, False
        if begins:
            held, turned = begun(program, c)
            rest = c.v[ROW_CLOCK, 0] if held == RESTS else np.nan
        on_branch(program, c, held)
        to_end = max(end - c.v[ROW_CLOCK, 0] - c.v[ROW_CLOCK, 1], 0.0)
        limit = min(to_end, to_knot(given, c, piece))
        h, which, way = min(limit, FURTHEST_AT_ONCE), -1, 0.0
        n = series(program, c, h, held)
        steps += 1
        if held != FREE:
            longest = limit if held == RESTS else min(limit, length(program, c, n))
            ends = held == RESTS and piece == last and not shooting
            h, way, which = held_step(program, c, n, longest, held, ends)
        else:
            h, which = free_step(program, c, n, min(h, length(program, c, n)) if n == ORDER else h)
        whole = h >= limit and which < 0 and way == 0.0
        if not shooting:
            done = sampled(program, given, c, done, n, np.inf if whole and limit == to_end else h)
        if not shooting and done == len(given.grid):
            state = ENDED
            break
        advance(program, c, n, h, held)
        if which >= 0:
            budget -= 1
            before = c.v[ROW_SIGNS, 0]
            held = switched(program, c, which, n, h)
            rest = c.v[ROW_CLOCK, 0] if held == RESTS else np.nan
            turned = held != RESTS and before * c.v[ROW_SIGNS, 0] < 0.0
        elif way != 0.0:
            budget -= 1
            released(program, c, held, way)
            turned, held, rest = held == RESTS, np.int64(FREE), np.nan
        elif whole:
            piece, done, fresh = at_knot(program, given, c, piece + 1, done, held)
            if piece > last:
                state = ENDED
                break
        if turned and reverses(program):
            reversals = noted(reversals, turns, c.v[ROW_CLOCK, 0])
            turns += 1
        state = SWITCHES if budget < 0 else outcome_of(c, h, furthest, steps, most_steps)
    return reversals, turns, rest, state
