"""A motion by Taylor series: from switching to switching, stuck or free, with its derivatives.

One compiled function follows any program (Jorba and Zou 2005: order, step). Signs are numbers that change where
their surfaces, which are series as well, cross zero. At rest the motion goes on as Filippov (1988) has it;
derivatives jump at a switching by the saltation matrix (Leine and Nijmeijer 2004).
"""

import numpy as np

from sysid_trib.simulation.compiling import compiled, inner
from sysid_trib.simulation.jets import (
    NEAR_SURFACE,
    at_once,
    at_once_live,
    derivative,
    first_crossing,
    of_parameter,
    order,
    rest_of,
    slope,
    value,
)

ORDER = 18
# In tau: as far as a motion without curvature is followed at once.
LONGEST = 16.0
# Near a surface its sign is decided by where the motion is so much later (in tau).
LOOKAHEAD = 1e-5
# rad: a speed below which a motion may come to rest other than by v = 0; one that is rest; what a motion taken
# as at rest may still have had to go.
SLOW, AT_REST, CREEP = 1e-5, 1e-12, 1e-11
# Of the size of the motion: no further from a surface than rounding.
AT_ZERO = 1e-14
# What is left of a series after a step, of a state and of a surface.
ROUNDING_PART, SURFACE_PART = 1e-16, 1e-13
MOVING, ENDED, GROWS, SWITCHES, STEPS, NOT_FINITE = range(6)


@inner
def put(source, target):
    """Copy a list of numbers."""
    for i in range(len(source)):
        target[i] = source[i]


@inner
def state_at(program, J, y, tau):
    """Put a state at an instant into the first orders."""
    for i in range(program.states):
        J[i, 0] = y[i]
    J[program.states, 0] = tau


@inner
def parameters_at(program, J, memory, signs):
    """Put memory and signs into the first orders."""
    at = program.inputs - len(memory)
    for m in range(len(memory)):
        J[at + m, 0] = memory[m]
    for m in range(len(signs)):
        J[program.signs[m], 0] = signs[m]


@inner
def signs_of(program, J, out):
    """Signs of the surfaces by their values, into `out`; J holds the state at order 0."""
    at_once_live(program, J, program.main)
    for m in range(len(program.signs)):
        out[m] = J[program.signs[m], 0]


@inner
def rates_of(program, J, signs):
    """The rates of the state in J on the branch of these signs, at order 0, into J."""
    for m in range(len(signs)):
        J[program.signs[m], 0] = signs[m]
    at_once(program, J)


@inner
def by_nearness(values, near, far, out):
    """Of each surface the first sign if it is near, else the second."""
    for m in range(len(values)):
        out[m] = near[m] if abs(values[m]) < NEAR_SURFACE else far[m]


@inner
def surface_values(program, J, out):
    """Values of the surfaces in J, at order 0."""
    for m in range(len(out)):
        out[m] = J[program.surfaces[m], 0]


@inner
def signs_ahead(program, J, y, tau, signs):
    """Signs of a motion that goes on from here: near a surface, those where it will be a little later."""
    count, size = len(signs), program.states
    values, far, later = np.empty(count), np.empty(count), np.empty(count)
    state_at(program, J, y, tau)
    signs_of(program, J, far)
    surface_values(program, J, values)
    by_nearness(values, signs, far, signs)
    rates_of(program, J, signs)
    moved = np.empty(size)
    for i in range(size):
        moved[i] = y[i] + LOOKAHEAD * J[program.rates[i], 0]
    moved[0] += 0.5 * LOOKAHEAD**2 * J[program.rates[1], 0]
    state_at(program, J, moved, tau + LOOKAHEAD)
    signs_of(program, J, later)
    by_nearness(values, later, signs, signs)


@inner
def branch(program, J, y, memory, signs, tau, way, memory_out, signs_out):
    """Acceleration at rest of a motion about to go `way` (+1, -1); memory and signs of that branch."""
    count, size, held = len(signs), program.states, program.memory
    values, far, ahead = np.empty(count), np.empty(count), np.empty(count)
    state_at(program, J, y, tau)
    parameters_at(program, J, memory, signs)
    put(memory, memory_out)
    if held > 0 and way * signs[0] < 0.0:
        at_once_live(program, J, len(program.op))
        for m in range(held):
            memory_out[m] = J[program.replaced[m], 0]
    parameters_at(program, J, memory_out, signs)
    signs_of(program, J, far)
    surface_values(program, J, values)
    later = np.empty(size)
    put(y, later)
    later[0] += way * 0.5 * LOOKAHEAD**2
    later[1] += way * LOOKAHEAD
    state_at(program, J, later, tau + LOOKAHEAD)
    signs_of(program, J, ahead)
    by_nearness(values, ahead, far, signs_out)
    if size > 2:
        rates_of(program, J, signs_out)
        for i in range(2, size):
            later[i] += 0.5 * LOOKAHEAD * J[program.rates[i], 0]
        state_at(program, J, later, tau + LOOKAHEAD)
        signs_of(program, J, ahead)
        by_nearness(values, ahead, signs_out, signs_out)
    state_at(program, J, y, tau)
    rates_of(program, J, signs_out)
    return J[program.rates[1], 0]


@inner
def settle(program, J, y, memory, signs, tau):
    """Set signs, and at a reversal the memory, for the motion from here; False if it sticks."""
    speed = abs(y[1])
    if speed <= SLOW:
        rest = np.empty(len(y))
        put(y, rest)
        rest[1] = 0.0
        count, held = len(signs), len(memory)
        memory_up, memory_down = np.empty(held), np.empty(held)
        signs_up, signs_down = np.empty(count), np.empty(count)
        up = branch(program, J, rest, memory, signs, tau, 1.0, memory_up, signs_up)
        down = branch(program, J, rest, memory, signs, tau, -1.0, memory_down, signs_down)
        sticks = up <= 0.0 and down >= 0.0
        # Detent and friction make ever shorter swings without end: they end where less than CREEP remains.
        if speed <= AT_REST or (sticks and speed * speed < 2.0 * CREEP * min(-up, down)):
            if not sticks:
                # Where both push away (negative friction) it goes towards x = 0.
                rises = up > 0.0 and (down >= 0.0 or y[0] < 0.0)
                put(memory_up if rises else memory_down, memory)
                put(signs_up if rises else signs_down, signs)
            return not sticks
    if len(signs) > 0:
        parameters_at(program, J, memory, signs)
        signs_ahead(program, J, y, tau, signs)
    return True


@inner
def series(program, J, T, y, dy, tau, push, of_push, h, stuck):
    """Series of all slots from here, to the order that a step of h needs; that order.

    Where it is stuck, x and v stay and the states go on. Derivatives follow where there are any.
    """
    size, count = program.states, T.shape[2]
    state_at(program, J, y, tau)
    J[size, 1] = 1.0
    for k in range(len(push)):
        J[size + 1, k] = push[k]
        for p in range(count):
            T[size + 1, k, p] = of_push[p] * push[k]
    at_once(program, J)
    if count > 0:
        for i in range(size):
            for p in range(count):
                T[i, 0, p] = dy[i, p]
        for s in range(program.inputs, program.main):
            derivative(program, J, T, np.int64(0), s)
    n, small, power = ORDER, 0, h
    for k in range(ORDER):
        # At rest what would move it, which only the rates tell, needs all orders.
        ends = k >= len(push) and not stuck
        for i in range(size):
            held = stuck and i < 2
            rate = program.rates[i]
            J[i, k + 1] = 0.0 if held else J[rate, k] / (k + 1)
            for p in range(count):
                T[i, k + 1, p] = 0.0 if held else T[rate, k, p] / (k + 1)
            # Where the step is short for another reason, few orders are enough.
            ends = ends and abs(J[i, k + 1]) * power <= 1e-17 * max(abs(J[i, 0]), abs(J[i, 1]) * h)
        order(program, J, k + 1)
        for s in program.surfaces:
            ends = ends and abs(J[s, k + 1]) * power <= 1e-13 * max(abs(J[s, 0]), abs(J[s, 1]) * h)
        if count > 0:
            for s in program.rows:
                derivative(program, J, T, k + 1, s)
        small = small + 1 if ends else 0
        power *= h
        if small == 2:
            n = k + 1
            break
    return n


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
def advance(program, J, T, n, h, y, error, dy):
    """The state, and its derivatives, a step later; sums are compensated."""
    for i in range(program.states):
        step = rest_of(J[i], n, h) + error[i]
        new = y[i] + step
        error[i] = step - (new - y[i])
        y[i] = new
    for i in range(program.states):
        for p in range(T.shape[2]):
            dy[i, p] = of_parameter(T, i, p, n, h)


@inner
def shift(T, J, program, s, n, h):
    """By how much an instant at which a slot is zero moves with each parameter, (parameter,)."""
    rate = slope(J[s], n, h)
    moves = np.zeros(T.shape[2])
    if rate != 0.0:
        for p in range(len(moves)):
            moves[p] = -of_parameter(T, s, p, n, h) / rate
    return moves


@inner
def _push(knots, pushes, piece, tau, out):
    """The polynomial that pushes, about tau."""
    for k in range(len(out)):
        out[k] = pushes[piece, k] if piece >= 0 else 0.0
    if piece >= 0:
        since = tau - knots[piece]
        for j in range(len(out) - 1):
            for k in range(len(out) - 2, j - 1, -1):
                out[k] += since * out[k + 1]


@inner
def _along(program, J, other, n, memory, signs):
    """Series in `other` of all slots along the states in J, with another memory and other signs."""
    for i in range(program.states + 2):
        for k in range(n + 1):
            other[i, k] = J[i, k]
    parameters_at(program, other, memory, signs)
    at_once(program, other)
    for k in range(1, n + 1):
        order(program, other, k)


@inner
def _is_still(program, up, down, J, n):
    """Whether nothing at rest changes: what would accelerate it, and its states."""
    for i in range(2, program.states):
        if abs(J[i, 1]) > 1e-14:
            return False
    for k in range(1, n + 1):
        if up[program.rates[1], k] != 0.0 or down[program.rates[1], k] != 0.0:
            return False
    return True


@inner
def _noted(times, count, tau):
    """The list of times with one more."""
    if count == len(times):
        longer = np.empty(2 * count)
        put(times, longer)
        times = longer
    times[count] = tau
    return times


@inner
def _after(program, J, T, y, dy, tau, push, old, memory, signs, turned, stuck, moves):
    """Derivatives after a switching, whose instant `moves`; of the memory where it was replaced."""
    size, held, count = program.states, len(memory), T.shape[2]
    at = program.inputs - held
    state_at(program, J, y, tau)
    J[size + 1, 0] = push
    if held > 0 and turned:
        parameters_at(program, J, old, signs)
        for i in range(size):
            for q in range(count):
                T[i, 0, q] = dy[i, q]
        at_once_live(program, J, len(program.op))
        for s in range(program.inputs, len(program.op)):
            derivative(program, J, T, np.int64(0), s)
        for m in range(held):
            for q in range(count):
                T[at + m, 0, q] = T[program.replaced[m], 0, q]
    parameters_at(program, J, memory, signs)
    rates_of(program, J, signs)
    for i in range(2 if stuck else 0, size):
        for q in range(count):
            dy[i, q] -= J[program.rates[i], 0] * moves[q]


@compiled
def run(program, grid, y, dy, p, dp, of_push, signs, knots, pushes, kicks, furthest, budget, most_steps):
    """A motion on a grid.

    Parameters
    ----------
    program : Program
    grid : (grid,) array of float
        tau, increasing; the motion starts at the first.
    y, dy : (state,) and (state, parameter) array of float
        The start and its derivatives, changed in place.
    p, dp : (slot,) and (slot, parameter) array of float
        Parameters of the program and their derivatives, the memory among them, changed in place.
    of_push : (parameter,) array of float
        Derivatives of what pushes, over itself.
    signs : (surface,) array of float
        0 where none is known; changed in place.
    knots, pushes, kicks : (knot,), (knot, degree) and (knot, 2) array of float
        From each knot on, a polynomial in tau since it that pushes; what is added to x and v there.
    furthest : float, rad
        Beyond it the motion diverges.
    budget, most_steps : int
        Switchings and steps that it may take.

    Returns
    -------
    rows : (grid, state + 1 + memory) array of float
        The states, the acceleration, the memory.
    tangents : (grid, state + 1, parameter) array of float
        Of the states and the acceleration.
    reversals, turns : array of float and int
        Where the first sign changes, and how often.
    stop : float
        Where it comes to rest for good; nan if it does not.
    outcome, tau : int and float
        How and where it ended.
    """
    size, held, count = program.states, program.memory, dy.shape[1]
    slots = len(program.op)
    J, T = np.zeros((slots, ORDER + 1)), np.zeros((slots, ORDER + 1, count))
    trial, work = np.zeros((slots, 1)), np.empty((5, 64))
    up_series, down_series = np.zeros((slots, ORDER + 1)), np.zeros((slots, ORDER + 1))
    first = size + 2
    at = program.inputs - held
    for k in range(first, program.inputs):
        J[k, 0] = trial[k, 0] = up_series[k, 0] = down_series[k, 0] = p[k - first]
        for q in range(count):
            T[k, 0, q] = dp[k - first, q]
    memory = np.empty(held)
    for m in range(held):
        memory[m] = p[at - first + m]
    signs_up, signs_down = np.empty(len(signs)), np.empty(len(signs))
    memory_up, memory_down, old = np.empty(held), np.empty(held), np.empty(held)
    rows, tangents = np.empty((len(grid), size + 1 + held)), np.empty((len(grid), size + 1, count))
    reversals, turns = np.empty(64), np.int64(0)
    tau, late, end = grid[0], 0.0, grid[-1]
    error = np.zeros(size)
    piece, push = -1, np.zeros(pushes.shape[1])
    stop, outcome, steps, done = np.nan, MOVING, 0, 0
    while piece + 1 < len(knots) and knots[piece + 1] <= tau:
        piece += 1
    fresh, stuck = True, False
    # Of which order a surface is known to be zero where the motion goes on.
    zeros = np.zeros(len(signs), dtype=np.int64)
    while outcome == MOVING:
        _push(knots, pushes, piece, tau, push)
        trial[size + 1, 0] = push[0]
        if fresh:
            way = signs[0] if len(signs) > 0 else 0.0
            stuck = not settle(program, trial, y, memory, signs, tau)
            stop = tau if stuck else np.nan
            if stuck:
                y[1] = 0.0
                error[1] = 0.0
                for q in range(count):
                    dy[1, q] = 0.0
            elif len(signs) > 0 and program.surfaces[0] == 1 and way * signs[0] < 0.0:
                reversals = _noted(reversals, turns, tau)
                turns += 1
            fresh = False
        if stuck:
            # The states go on with the signs of rest.
            state_at(program, trial, y, tau)
            parameters_at(program, trial, memory, signs)
            signs_of(program, trial, signs_up)
        parameters_at(program, J, memory, signs_up if stuck else signs)
        to_end = max(end - tau - late, 0.0)
        limit = to_end
        if piece + 1 < len(knots):
            limit = min(limit, max(knots[piece + 1] - tau - late, 0.0))
        n = series(program, J, T, y, dy, tau, push, of_push, min(limit, LONGEST), stuck)
        steps += 1
        h = min(limit, LONGEST)
        if n == ORDER:
            h = min(h, length(program, J, n))
        whole, which, release = h >= limit, -1, 0.0
        near = AT_ZERO * max(abs(y[0]), abs(y[1]))
        if not stuck:
            for m in range(len(signs)):
                r = first_crossing(J[program.surfaces[m]], n, h, signs[m], near, zeros[m], work)
                if r <= h:
                    h, which, whole = r, m, False
        else:
            for m in range(len(signs)):
                # Of a surface that is zero at rest nothing is known but at the start.
                if signs_up[m] != 0.0:
                    r = first_crossing(J[program.surfaces[m]], n, h, signs_up[m], near, np.int64(0), work)
                    if r < h:
                        h, whole = max(r, 1e-9), False
            up = branch(program, trial, y, memory, signs, tau, 1.0, memory_up, signs_up)
            down = branch(program, trial, y, memory, signs, tau, -1.0, memory_down, signs_down)
            _along(program, J, up_series, n, memory_up, signs_up)
            _along(program, J, down_series, n, memory_down, signs_down)
            if _is_still(program, up_series, down_series, J, n) and piece + 1 >= len(knots):
                h, whole = limit, True
            else:
                acceleration = program.rates[1]
                for one in (up_series, down_series):
                    reach = radius(one, acceleration, acceleration, n, ROUNDING_PART)
                    if reach < h:
                        h, whole = reach, False
                r = 0.0 if up > 0.0 else first_crossing(up_series[acceleration], n, h, -1.0, near, np.int64(0), work)
                if r < h:
                    h, release, whole = r, 1.0, False
                r = 0.0 if down < 0.0 else first_crossing(down_series[acceleration], n, h, 1.0, near, np.int64(0), work)
                if r < h:
                    h, release, whole = r, -1.0, False
        reach = tau + (late + h)
        while done < len(grid) and (grid[done] <= reach or (whole and limit == to_end)):
            s = (grid[done] - tau) - late
            for i in range(size + 1):
                slot = i if i < size else program.rates[1]
                rows[done, i] = value(J[slot], n, s)
                for q in range(count):
                    tangents[done, i, q] = of_parameter(T, slot, q, n, s)
            if stuck:
                rows[done, size] = 0.0
                for q in range(count):
                    tangents[done, size, q] = 0.0
            for m in range(held):
                rows[done, size + 1 + m] = memory[m]
            done += 1
        if done == len(grid):
            outcome = ENDED
        moves, before = np.zeros(count), np.zeros(size)
        if which >= 0 and count > 0:
            moves = shift(T, J, program, program.surfaces[which], n, h)
            for i in range(size):
                before[i] = value(J[program.rates[i]], n, h)
        advance(program, J, T, n, h, y, error, dy)
        for m in range(len(signs)):
            zeros[m] = 0
        if stuck:
            y[1] = 0.0
        # The clock, compensated.
        step = late + h
        now = tau + step
        late = step - (now - tau)
        tau = now
        if whole and piece + 1 < len(knots) and outcome == MOVING:
            piece += 1
            tau, late = knots[piece], 0.0
            if kicks[piece, 0] != 0.0 or kicks[piece, 1] != 0.0:
                y[0] += kicks[piece, 0]
                y[1] += kicks[piece, 1]
                fresh = True
        if not abs(y[0]) <= furthest:
            outcome = GROWS if abs(y[0]) > furthest else NOT_FINITE
        elif not np.isfinite(y[1]) or not h >= 0.0:
            outcome = NOT_FINITE
        elif steps > most_steps and outcome == MOVING:
            outcome = STEPS
        if outcome != MOVING:
            continue
        if which >= 0:
            budget -= 1
            zeros[which] = 1
            slot = program.surfaces[which]
            if slot < size:
                # The surface is a state: exactly zero here.
                y[slot], error[slot] = 0.0, 0.0
            for i in range(size):
                for q in range(count):
                    dy[i, q] += before[i] * moves[q]
            put(memory, old)
            way, here = signs[0], value(push, len(push) - 1, h)
            trial[size + 1, 0] = here
            stuck = not settle(program, trial, y, memory, signs, tau)
            stop = tau if stuck else np.nan
            if stuck:
                y[1] = 0.0
                for q in range(count):
                    dy[1, q] = 0.0
            turned = program.surfaces[0] == 1 and way * signs[0] < 0.0
            if turned and not stuck:
                reversals = _noted(reversals, turns, tau)
                turns += 1
            if count > 0:
                _after(program, J, T, y, dy, tau, here, old, memory, signs, turned, stuck, moves)
        elif release != 0.0:
            budget -= 1
            stuck, stop = False, np.nan
            # It begins without speed and without acceleration.
            zeros[0] = 2
            put(memory_up if release > 0.0 else memory_down, memory)
            put(signs_up if release > 0.0 else signs_down, signs)
            reversals = _noted(reversals, turns, tau)
            turns += 1
        if budget < 0:
            outcome = SWITCHES
    if outcome == ENDED and stuck and np.isnan(stop):
        stop = tau
    return rows, tangents, reversals, turns, stop, outcome, tau
