"""Taylor series of a motion: values, first zero crossing, order and length of a step."""

import numpy as np

from sysid_trib.simulation import under_way as at
from sysid_trib.simulation.branches import grip_of, state_at
from sysid_trib.simulation.compiled import at_once, derivatives_at_once, derivatives_of_order, inner, order
from sysid_trib.simulation.program import FORCING_NUMBERS

# A surface whose value is below this fraction of its series is at zero.
ZERO_PART = 1e-13
# Most intervals of a step that are searched for a root, and the shortest one.
MOST_INTERVALS, SHORTEST_INTERVAL = 500, 1e-13


@inner
def value(series, n, h):
    """Return the sum of a series up to order n at h."""
    t = series[n]
    for k in range(n - 1, -1, -1):
        t = t * h + series[k]
    return t


@inner
def of_parameter(T, s, p, n, h):
    """Return the derivative of a slot by a parameter at h."""
    t = T[s, n, p]
    for k in range(n - 1, -1, -1):
        t = t * h + T[s, k, p]
    return t


@inner
def rest_of(series, n, h):
    """Return the sum of a series without order 0."""
    t = series[n]
    for k in range(n - 1, 0, -1):
        t = t * h + series[k]
    return t * h


@inner
def slope(series, n, h):
    """Return the derivative of a series at h."""
    t = n * series[n]
    for k in range(n - 1, 0, -1):
        t = t * h + k * series[k]
    return t


@inner
def _keeps_clear(g, n, low, high):
    """Return true if a series is positive from `low` to `high`, by its quadratic and a bound on the rest."""
    d = g[1] if n > 0 else 0.0
    q = g[2] if n > 1 else 0.0
    least = min(g[0] + low * (d + low * q), g[0] + high * (d + high * q))
    if q > 0.0:
        turn = min(max(-0.5 * d / q, low), high)
        least = g[0] + turn * (d + turn * q)
    size = max(high, -low)
    rest = 0.0
    for k in range(n, 2, -1):
        rest = (rest + abs(g[k])) * size
    return least > rest * size * size


@inner
def first_crossing(series, n, h, side, zero, work):
    """Find the place in (0, h] at which a series leaves its side (+1, -1) of zero; h + 1 if it does not.

    A zero at 0 itself, up to the value or the order in `zero`, is divided out; a wrong side there is a
    crossing at 0. The interval is halved where neither a quadratic with a bound on the rest nor its
    derivative decides.
    """
    g, low = work[0], _reduced(series, n, h, side, zero, work)
    if low < 0:
        return h + 1.0
    n -= low
    start = 0.0
    if g[0] < 0.0:
        # The side after the zero is known. So the series is not on the wrong side just before its zero, nor
        # where it touches the surface and soon returns.
        if n == 0 or not g[1] > 0.0:
            return 0.0
        start = -2.0 * g[0] / g[1]
        if (start * h > at.LOOKAHEAD) if low > 0 else abs(series[0]) > at.NEAR_SURFACE:
            return 0.0
        start = min(1.0, start)
    # Test the whole interval about its beginning first: this decides in most cases.
    if _keeps_clear(g, n, 0.0, 1.0):
        return h + 1.0
    # In units of the step: ends of intervals that remain to be searched, the next one on top.
    shifted, begins, ends = work[1], work[2], work[3]
    begins[0], ends[0], top = start, 1.0, 0
    for _ in range(MOST_INTERVALS):
        if top < 0:
            break
        lo, hi = begins[top], ends[top]
        top -= 1
        middle, half = 0.5 * (lo + hi), 0.5 * (hi - lo)
        for k in range(n + 1):
            shifted[k] = g[k]
        for j in range(n):
            for k in range(n - 1, j - 1, -1):
                shifted[k] += middle * shifted[k + 1]
        if _keeps_clear(shifted, n, -half, half):
            continue
        if half < SHORTEST_INTERVAL or _is_monotonic(shifted, n, half):
            if value(g, n, hi) < 0.0:
                return h * _only_root(g, n, lo, hi)
            continue
        begins[top + 1], ends[top + 1] = middle, hi
        begins[top + 2], ends[top + 2] = lo, middle
        top += 2
    return h + 1.0


@inner
def _reduced(series, n, h, side, zero, work):
    """Return order of the zero at 0, its cofactor in work[0], in units of the step; -1 for a zero series."""
    near, known = zero
    size, scale = 0.0, 1.0
    for k in range(n + 1):
        term = side * series[k] * scale
        work[4, k] = term
        size = max(size, abs(term)) if term == term else np.inf
        scale *= h
    if not 0.0 < size < np.inf:
        return -1
    low = 0
    # `near` is the rounding error of a difference.
    while low < n and (low < known or abs(work[4, low]) <= ZERO_PART * size or abs(series[low]) <= near):
        low += 1
    for k in range(n - low + 1):
        work[0, k] = work[4, low + k]
    return low


@inner
def _is_monotonic(g, n, half):
    """Return true if a series is monotonic up to `half` from 0."""
    rest, power = 0.0, half * half
    for k in range(3, n + 1):
        rest += k * abs(g[k]) * power
        power *= half
    return n > 0 and abs(g[1]) - (2.0 * abs(g[2]) * half if n > 1 else 0.0) > rest


@inner
def _only_root(g, n, lo, hi):
    """Find the only zero of a decreasing series between two points, by Newton's iteration with bisection."""
    u = 0.5 * (lo + hi)
    for _ in range(80):
        f = value(g, n, u)
        if f > 0.0:
            lo = u
        else:
            hi = u
        if f == 0.0 or hi - lo < 1e-16:
            break
        new = u - f / slope(g, n, u)
        if new == u:
            break
        u = new if lo < new < hi else 0.5 * (lo + hi)
    return u


@inner
def series(program, c, h, held):
    """Compute the series of all slots from here, to the order that a step of h needs; return that order.

    At rest x and v are constant and the states continue; on another surface v keeps the surface at zero.
    Derivatives are computed too if there are any.
    """
    J, T, size, count, degree = c.J, c.T, program.states, c.T.shape[2], 0
    slot = program.surfaces[held] if held > at.RESTS else 0
    state_at(program, c, J, c.v[at.STATE], 0.0)
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
    for k in range(at.ORDER):
        # Only the rates contain the acceleration of a held body, and it needs all orders.
        ends = k > degree and held == at.FREE
        for i in range(size):
            stays, rate = held == at.RESTS and i < 2, program.rates[i]
            J[i, k + 1] = 0.0 if stays else J[rate, k] / (k + 1)
            for q in range(count):
                T[i, k + 1, q] = 0.0 if stays else T[rate, k, q] / (k + 1)
            # If the step is short for another reason, a few orders are enough.
            ends = ends and abs(J[i, k + 1]) * power <= 1e-17 * max(abs(J[i, 0]), abs(J[i, 1]) * h)
        order(program, J, k + 1)
        if held > at.RESTS:
            if k == 0:
                c.v[at.GRIP, 0] = grip_of(program, J, slot)
            J[1, k + 1] -= J[slot, k + 1] / c.v[at.GRIP, 0]
            order(program, J, k + 1)
        for s in program.surfaces:
            ends = ends and abs(J[s, k + 1]) * power <= at.SURFACE_PART * max(abs(J[s, 0]), abs(J[s, 1]) * h)
        if count > 0:
            derivatives_of_order(program, J, T, k + 1)
            if held > at.RESTS:
                for q in range(count):
                    T[1, k + 1, q] -= T[slot, k + 1, q] / c.v[at.GRIP, 0]
                derivatives_of_order(program, J, T, k + 1)
            ends = ends and (size == 2 or _part_of_derivatives(program, c, k + 1) * power <= at.SURFACE_PART)
        small = small + 1 if ends else 0
        power *= h
        if small == 2:
            return k + 1
    if held != at.FREE:
        # A body held by friction has the acceleration of its surface, not that of the rates with these signs.
        for k in range(at.ORDER + 1):
            J[program.rates[1], k] = (k + 1) * J[1, k + 1] if k < at.ORDER else 0.0
            for q in range(count):
                T[program.rates[1], k, q] = (k + 1) * T[1, k + 1, q] if k < at.ORDER else 0.0
    return at.ORDER


@inner
def radius(J, s, other, n, part):
    """Return a step after which two series change by less than this fraction of their first large term."""
    largest = 0.0
    for m in range(4):
        largest = max(largest, abs(J[s, m]), abs(J[other, m]))
    m = 0
    while m < 3 and max(abs(J[s, m]), abs(J[other, m])) <= 1e-3 * largest:
        m += 1
    first, h = max(abs(J[s, m]), abs(J[other, m])), at.FURTHEST_AT_ONCE
    for k in range(n - 1, n + 1):
        last = max(abs(J[s, k]), abs(J[other, k]))
        if last > 0.0 and first > 0.0:
            h = min(h, (part * first / last) ** (1.0 / (k - m)))
    return h


@inner
def _part_of_derivatives(program, c, k):
    """Return the largest term of an order of the derivatives, relative to the parameter's effect so far."""
    largest = 0.0
    for q in range(c.T.shape[2]):
        scale, term = max(c.v[at.LARGEST_DERIVATIVES, q], abs(c.T[1, 1, q])), 0.0
        for i in range(program.states):
            scale = max(scale, abs(c.T[i, 0, q]))
            term = max(term, abs(c.T[i, k, q]))
        if scale > 0.0:
            largest = max(largest, term / scale)
    return largest


@inner
def length(program, c, n, part):
    """Return a step with a small truncation error of the states' series, and rounding of the others."""
    J = c.J
    h = radius(J, np.int64(0), np.int64(1), n, part)
    for i in range(2, program.states):
        h = min(h, radius(J, i, i, n, part))
    for s in program.surfaces:
        if s >= program.states:
            h = min(h, radius(J, s, s, n, at.SURFACE_PART))
    for k in range(n - 1, n + 1 if program.states > 2 else n - 1):
        # The derivatives of a stiff state decay, but grow again in steps that are too long for them.
        last = _part_of_derivatives(program, c, k)
        if last > 0.0:
            h = min(h, (at.SURFACE_PART / last) ** (1.0 / k))
    return h


@inner
def look_ahead(c, h):
    """Set value and slope of the inputs at a time after the start of their polynomials."""
    for m in range(len(c.drive)):
        c.drive[m, FORCING_NUMBERS] = value(c.drive[m], np.int64(FORCING_NUMBERS - 1), h)
        c.drive[m, FORCING_NUMBERS + 1] = slope(c.drive[m], np.int64(FORCING_NUMBERS - 1), h)
