"""The length of a step in one branch: free up to a surface, or held by friction until that gives way."""

from sysid_trib.simulation.branches import RESTS, branch, parameters_at, put
from sysid_trib.simulation.compiled import (
    DOWN,
    ROW_GRIP,
    ROW_MEMORY,
    ROW_MEMORY_DOWN,
    ROW_MEMORY_UP,
    ROW_SIGNS,
    ROW_SIGNS_DOWN,
    ROW_SIGNS_UP,
    ROW_STATE,
    ROW_ZEROS,
    UP,
    inner,
)
from sysid_trib.simulation.jets import at_once, order
from sysid_trib.simulation.roots import first_crossing
from sysid_trib.simulation.taylor import STATE_PART, radius

# In tau: how far it is held where a surface is crossed at rest.
PASSED = 1e-9
# Of the size of the motion: no further from a surface than rounding.
AT_ZERO = 1e-14
# Rates of states that are less do not change them.
UNCHANGED = 1e-14


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
    """True if nothing at rest changes: what would accelerate it, and its states."""
    for i in range(2, program.states):
        if abs(c.J[i, 1]) > UNCHANGED:
            return False
    for k in range(1, n + 1):
        if c.aside[UP][program.rates[1], k] != 0.0 or c.aside[DOWN][program.rates[1], k] != 0.0:
            return False
    return True


@inner
def released(program, c, held, way):
    """Let a body go from where it is held: from there it begins without speed and without acceleration."""
    put(c.v[ROW_MEMORY_UP] if way > 0.0 else c.v[ROW_MEMORY_DOWN], c.v[ROW_MEMORY])
    put(c.v[ROW_SIGNS_UP] if way > 0.0 else c.v[ROW_SIGNS_DOWN], c.v[ROW_SIGNS])
    c.v[ROW_ZEROS, held] = 2
