"""Values of Taylor series, and where one first crosses zero."""

import numpy as np

from sysid_trib.simulation.compiled import inner

# A surface this near to zero, of the size of its series, is at zero.
ZERO_PART = 1e-13
# So many parts of a step are looked at for a root, none shorter than this.
MOST_INTERVALS, SHORTEST_INTERVAL = 500, 1e-13
# Nearer than this to a surface, its sign is decided by where the motion is so much later (in tau).
NEAR_SURFACE, LOOKAHEAD = 1e-9, 1e-5


@inner
def value(series, n, h):
    """Sum of a series up to order n at h."""
    t = series[n]
    for k in range(n - 1, -1, -1):
        t = t * h + series[k]
    return t


@inner
def of_parameter(T, s, p, n, h):
    """Derivative of a slot by a parameter at h."""
    t = T[s, n, p]
    for k in range(n - 1, -1, -1):
        t = t * h + T[s, k, p]
    return t


@inner
def rest_of(series, n, h):
    """The sum of a series without order 0."""
    t = series[n]
    for k in range(n - 1, 0, -1):
        t = t * h + series[k]
    return t * h


@inner
def slope(series, n, h):
    """Derivative of a series at h."""
    t = n * series[n]
    for k in range(n - 1, 0, -1):
        t = t * h + k * series[k]
    return t


@inner
def _keeps_clear(g, n, low, high):
    """True if a series is above zero from `low` to `high`, by its quadratic and a bound on the rest."""
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
    """Where in (0, h] a series leaves the side (+1, -1) of zero on which it is to be; h + 1 if it does not.

    A zero at 0 itself, up to the number or of the order in `zero`, is divided out; a wrong side there is a
    crossing at 0. The interval is halved where neither a quadratic with a bound on the rest, nor its
    derivative, decides.
    """
    g, low = work[0], _reduced(series, n, h, side, zero, work)
    if low < 0:
        return h + 1.0
    n -= low
    start = 0.0
    if g[0] < 0.0:
        # Where it goes is known before it has gone: just before its zero it is no longer on the wrong side,
        # nor where it grazes the surface and is soon back.
        if n == 0 or not g[1] > 0.0:
            return 0.0
        start = -2.0 * g[0] / g[1]
        if (start * h > LOOKAHEAD) if low > 0 else abs(series[0]) > NEAR_SURFACE:
            return 0.0
        start = min(1.0, start)
    # First about the beginning: mostly that decides.
    if _keeps_clear(g, n, 0.0, 1.0):
        return h + 1.0
    # In units of the step: ends of intervals that are still to be looked at, the first on top.
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
    """Order of the zero at 0; what it leaves in work[0], in units of the step. -1: a series of zeros."""
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
    # `near` is what rounding leaves of a difference.
    while low < n and (low < known or abs(work[4, low]) <= ZERO_PART * size or abs(series[low]) <= near):
        low += 1
    for k in range(n - low + 1):
        work[0, k] = work[4, low + k]
    return low


@inner
def _is_monotonic(g, n, half):
    """True if a series only rises, or only falls, as far as `half` from 0."""
    rest, power = 0.0, half * half
    for k in range(3, n + 1):
        rest += k * abs(g[k]) * power
        power *= half
    return n > 0 and abs(g[1]) - (2.0 * abs(g[2]) * half if n > 1 else 0.0) > rest


@inner
def _only_root(g, n, lo, hi):
    """The only zero of a falling series between two points, by Newton's iteration, which halving guards."""
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
