"""Taylor series of all slots of a program, and of their derivatives, order by order; roots of what they tell.

J[slot, k] is the k-th Taylor coefficient, T[slot, k, parameter] its derivative. The recurrences are those of
automatic differentiation (Jorba and Zou 2005, Table 2); their derivatives are the same recurrences, linearised.
"""

import math

import numpy as np

from sysid_trib.simulation.compiling import inner
from sysid_trib.simulation.program import (
    ADD,
    CONST,
    DIV,
    EXP,
    LINEAR,
    LOG,
    MUL,
    NEG,
    PARTNER,
    POWER,
    SCALE,
    SIGN,
    SIN,
    SUB,
    TANH,
)

# A surface this near to zero, of the size of its series, is at zero.
ROUNDING = 1e-13
# So many parts of a step are looked at for a root.
MOST_INTERVALS = 500
# Nearer than this to a surface, its sign is decided by where the motion is a little later.
NEAR_SURFACE = 1e-9


@inner
def row(program, J, s):
    """A slot at order 0; of a sign what it was."""
    op, a, b, c, d = program.op, program.a, program.b, program.c, program.d
    o, p, q = op[s], a[s], b[s]
    if o == ADD:
        J[s, 0] = J[p, 0] + J[q, 0]
    elif o == SUB:
        J[s, 0] = J[p, 0] - J[q, 0]
    elif o == LINEAR:
        # What is off does not act even where it is singular.
        factor = c[s] * J[d[s], 0]
        J[s, 0] = J[p, 0] + factor * J[q, 0] if factor != 0.0 else J[p, 0]
    elif o == SCALE:
        J[s, 0] = J[p, 0] * J[q, 0] if J[p, 0] != 0.0 else 0.0
    elif o == MUL:
        J[s, 0] = J[p, 0] * J[q, 0]
    elif o == DIV:
        J[s, 0] = J[p, 0] / J[q, 0] if J[q, 0] != 0.0 else np.nan
    elif o == NEG:
        J[s, 0] = -J[p, 0]
    elif o == CONST:
        J[s, 0] = c[s]
    elif o == SIN:
        J[s, 0] = math.sin(J[p, 0])
    elif o == PARTNER:
        J[s, 0] = math.cos(J[p, 0])
    elif o == EXP:
        J[s, 0] = math.exp(min(J[p, 0], 709.0))
    elif o == LOG:
        J[s, 0] = math.log(J[p, 0]) if J[p, 0] > 0.0 else np.nan
    elif o == POWER:
        J[s, 0] = J[p, 0] ** c[s]
    elif o == TANH:
        J[s, 0] = math.tanh(J[p, 0])


@inner
def at_once(program, J):
    """All slots of a motion at order 0, on the branch of the signs in J."""
    for s in range(program.inputs, program.main):
        row(program, J, s)


@inner
def at_once_live(program, J, last):
    """Slots up to `last` at order 0; signs follow their surfaces."""
    for s in range(program.inputs, last):
        row(program, J, s)
        if program.op[s] == SIGN:
            u = J[program.a[s], 0]
            J[s, 0] = 1.0 if u > 0.0 else -1.0 if u < 0.0 else u


@inner
def order(program, J, k):
    """Order k >= 1 of the slots that change, from the orders below it."""
    op, a, b, c, d = program.op, program.a, program.b, program.c, program.d
    for s in program.rows:
        o, p, q = op[s], a[s], b[s]
        t = 0.0
        if o == ADD:
            t = J[p, k] + J[q, k]
        elif o == SUB:
            t = J[p, k] - J[q, k]
        elif o == LINEAR:
            factor = c[s] * J[d[s], 0]
            t = J[p, k] + factor * J[q, k] if factor != 0.0 else J[p, k]
        elif o == SCALE:
            t = J[p, 0] * J[q, k] if J[p, 0] != 0.0 else 0.0
        elif o == MUL:
            if p == q:
                for j in range((k + 1) // 2):
                    t += J[p, j] * J[p, k - j]
                t *= 2.0
                if k % 2 == 0:
                    t += J[p, k // 2] * J[p, k // 2]
            else:
                for j in range(k + 1):
                    t += J[p, j] * J[q, k - j]
        elif o == DIV:
            t = J[p, k]
            for j in range(1, k + 1):
                t -= J[q, j] * J[s, k - j]
            t /= J[q, 0]
        elif o == NEG:
            t = -J[p, k]
        elif o == SIN:
            for j in range(1, k + 1):
                t += j * J[p, j] * J[q, k - j]
            t /= k
        elif o == PARTNER:
            for j in range(1, k + 1):
                t -= j * J[p, j] * J[q, k - j]
            t /= k
        elif o == EXP:
            for j in range(1, k + 1):
                t += j * J[p, j] * J[s, k - j]
            t /= k
        elif o == LOG:
            for j in range(1, k):
                t += j * J[s, j] * J[p, k - j]
            t = (J[p, k] - t / k) / J[p, 0]
        elif o == POWER:
            for j in range(1, k + 1):
                t += (c[s] * j - (k - j)) * J[p, j] * J[s, k - j]
            t /= k * J[p, 0]
        elif o == TANH:
            for j in range(1, k + 1):
                t += j * J[p, j] * J[q, k - j]
            t /= k
        J[s, k] = t


@inner
def derivative(program, J, T, k, s):
    """Order k of the derivatives of a slot, from the series and the orders below it."""
    count, c = T.shape[2], program.c
    o, p, q = program.op[s], program.a[s], program.b[s]
    here = T[s, k]
    if o == ADD:
        for i in range(count):
            here[i] = T[p, k, i] + T[q, k, i]
    elif o == SUB:
        for i in range(count):
            here[i] = T[p, k, i] - T[q, k, i]
    elif o == LINEAR:
        r = program.d[s]
        for i in range(count):
            here[i] = T[p, k, i] + c[s] * (T[r, 0, i] * J[q, k] + J[r, 0] * T[q, k, i])
    elif o == NEG:
        for i in range(count):
            here[i] = -T[p, k, i]
    elif o == SCALE:
        for i in range(count):
            here[i] = T[p, 0, i] * J[q, k] + J[p, 0] * T[q, k, i]
    elif o == CONST or o == SIGN:
        for i in range(count):
            here[i] = 0.0
    else:
        for i in range(count):
            here[i] = 0.0
        if o == MUL:
            for m in range(k + 1):
                u, w = J[q, k - m], J[p, k - m]
                for i in range(count):
                    here[i] += T[p, m, i] * u + w * T[q, m, i]
        elif o == DIV:
            for m in range(k + 1):
                u, w = J[s, k - m], J[q, k - m] if m < k else 0.0
                for i in range(count):
                    here[i] -= u * T[q, m, i] + w * T[s, m, i]
            for i in range(count):
                here[i] = (here[i] + T[p, k, i]) / J[q, 0]
        elif o == LOG:
            for m in range(k):
                w = J[p, k - m]
                for i in range(count):
                    here[i] -= w * T[s, m, i]
            for i in range(count):
                here[i] = (here[i] + T[p, k, i]) / J[p, 0]
        elif o == POWER:
            for m in range(k + 1):
                u, w = c[s] * J[s, k - m], J[p, k - m] if m < k else 0.0
                for i in range(count):
                    here[i] += u * T[p, m, i] - w * T[s, m, i]
            for i in range(count):
                here[i] /= J[p, 0]
        else:
            # d sin u = cos u du, d cos u = -sin u du, d exp u = exp u du, d tanh u = (1 - tanh^2 u) du
            factor, way = (s, 1.0) if o == EXP else (q, -1.0 if o == PARTNER else 1.0)
            for m in range(k + 1):
                u = way * J[factor, k - m]
                for i in range(count):
                    here[i] += u * T[p, m, i]


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
    """The same without order 0."""
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
    """Whether a series is above zero from `low` to `high`, by its quadratic and a bound on the rest."""
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
def first_crossing(series, n, h, side, near, known, work):
    """Where in (0, h] a series leaves the side (+1, -1) of zero on which it is to be; h + 1 if it does not.

    A zero at 0 itself, up to `near` or of `known` order, also a double one, is divided out; a wrong side there is a crossing at 0. The interval is
    halved where neither a quadratic about its middle with a bound on the rest, nor its derivative, decides.
    """
    none, size, scale = h + 1.0, 0.0, 1.0
    for k in range(n + 1):
        work[0, k] = side * series[k] * scale
        size = max(size, abs(work[0, k])) if work[0, k] == work[0, k] else np.inf
        scale *= h
    if not 0.0 < size < np.inf:
        return none
    low = 0
    # `near` is what rounding leaves of a difference.
    while low < n and (low < known or abs(work[0, low]) <= ROUNDING * size or abs(series[low]) <= near):
        low += 1
    n -= low
    g, about = work[4], work[1]
    for k in range(n + 1):
        g[k] = work[0, low + k]
    enters = 0.0
    if g[0] < 0.0:
        # Where it goes is known before it has gone: just before its zero it is no longer on the wrong side.
        if low > 0 or n == 0 or abs(series[0]) > NEAR_SURFACE or not g[1] > 0.0:
            return 0.0
        enters = min(1.0, -2.0 * g[0] / g[1])
    # First about the beginning: mostly that decides.
    if _keeps_clear(g, n, 0.0, 1.0):
        return none
    # In units of the step; `left` and `right` of intervals that are still to be looked at, the first on top.
    left, right = work[2], work[3]
    left[0], right[0], top = enters, 1.0, 0
    for _ in range(MOST_INTERVALS):
        if top < 0:
            break
        lo, hi = left[top], right[top]
        top -= 1
        middle, radius = 0.5 * (lo + hi), 0.5 * (hi - lo)
        for k in range(n + 1):
            about[k] = g[k]
        for j in range(n):
            for k in range(n - 1, j - 1, -1):
                about[k] += middle * about[k + 1]
        if _keeps_clear(about, n, -radius, radius):
            continue
        steeper, power = 0.0, radius * radius
        for k in range(3, n + 1):
            steeper += k * abs(about[k]) * power
            power *= radius
        d = about[1] if n > 0 else 0.0
        q = about[2] if n > 1 else 0.0
        if abs(d) - 2.0 * abs(q) * radius > steeper or radius < 1e-13:
            # It only rises, or only falls.
            if value(g, n, hi) >= 0.0:
                continue
            x, y = lo, hi
            u = middle
            for _ in range(80):
                f = value(g, n, u)
                if f > 0.0:
                    x = u
                else:
                    y = u
                if f == 0.0 or y - x < 1e-16:
                    break
                f = u - f / slope(g, n, u)
                if f == u:
                    break
                u = f if x < f < y else 0.5 * (x + y)
            return u * h
        top += 1
        left[top], right[top] = middle, hi
        top += 1
        left[top], right[top] = lo, middle
    return none
