"""Series of a motion and their derivatives: order and length of a step (Jorba and Zou 2005)."""

import numpy as np

from sysid_trib.simulation.branches import FREE, RESTS, grip_of, state_at
from sysid_trib.simulation.compiled import ORDER, ROW_CLOCK, ROW_GRIP, ROW_LARGEST, ROW_STATE, inner
from sysid_trib.simulation.jets import at_once, derivatives_at_once, derivatives_of_order, order
from sysid_trib.simulation.program import FORCING_NUMBERS
from sysid_trib.simulation.roots import slope, value

# In tau: as far as a motion is followed at once.
FURTHEST_AT_ONCE = 16.0
# What is left of a series after a step, of a state and of a surface or a derivative.
STATE_PART, SURFACE_PART = 1e-16, 1e-13


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
        for k in range(FORCING_NUMBERS):
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
        c.drive[m, FORCING_NUMBERS] = value(c.drive[m], np.int64(FORCING_NUMBERS - 1), h)
        c.drive[m, FORCING_NUMBERS + 1] = slope(c.drive[m], np.int64(FORCING_NUMBERS - 1), h)
