"""Taylor series of all slots of a program, and of their derivatives, order by order.

J[slot, k] is the k-th Taylor coefficient, T[slot, k, parameter] its derivative. The recurrences are those of
automatic differentiation (Jorba and Zou 2005, Table 2); their derivatives are the same, linearised.
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


@inner
def row(J, s, code, c):
    """A slot at order 0; of a sign what it was."""
    o, p, q, d = code[s, 0], code[s, 1], code[s, 2], code[s, 3]
    if o == ADD:
        J[s, 0] = J[p, 0] + J[q, 0]
    elif o == SUB:
        J[s, 0] = J[p, 0] - J[q, 0]
    elif o == LINEAR:
        # What is off does not act even where it is singular.
        factor = c[s] * J[d, 0]
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
        row(J, s, program.code, program.c)


@inner
def at_once_live(program, J, last):
    """Slots up to `last` at order 0; signs follow their surfaces."""
    for s in range(program.inputs, last):
        row(J, s, program.code, program.c)
        if program.code[s, 0] == SIGN:
            u = J[program.code[s, 1], 0]
            J[s, 0] = 1.0 if u > 0.0 else -1.0 if u < 0.0 else u


@inner
def order(program, J, k):
    """Order k >= 1 of the slots that change, from the orders below it."""
    code, c = program.code, program.c
    for s in program.rows:
        o, p, q, d = code[s, 0], code[s, 1], code[s, 2], code[s, 3]
        t = 0.0
        if o == ADD:
            t = J[p, k] + J[q, k]
        elif o == SUB:
            t = J[p, k] - J[q, k]
        elif o == LINEAR:
            factor = c[s] * J[d, 0]
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
def derivative(J, T, k, s, code, c):
    """Order k of the derivatives of a slot, from the series and the orders below it."""
    o, p, q, r = code[s, 0], code[s, 1], code[s, 2], code[s, 3]
    count = T.shape[2]
    here = T[s, k]
    if o == ADD:
        for i in range(count):
            here[i] = T[p, k, i] + T[q, k, i]
    elif o == SUB:
        for i in range(count):
            here[i] = T[p, k, i] - T[q, k, i]
    elif o == LINEAR:
        for i in range(count):
            here[i] = T[p, k, i] + c[s] * (T[r, 0, i] * J[q, k] + J[r, 0] * T[q, k, i])
    elif o == NEG:
        for i in range(count):
            here[i] = -T[p, k, i]
    elif o == SCALE:
        for i in range(count):
            here[i] = T[p, 0, i] * J[q, k] + J[p, 0] * T[q, k, i]
    elif o in (CONST, SIGN):
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
def derivatives_at_once(program, J, T, last):
    """Derivatives of the slots up to `last` at order 0."""
    for s in range(program.inputs, last):
        derivative(J, T, np.int64(0), s, program.code, program.c)


@inner
def derivatives_of_order(program, J, T, k):
    """Order k >= 1 of the derivatives of the slots that change."""
    for s in program.rows:
        derivative(J, T, k, s, program.code, program.c)
