"""Which way the motion goes on from a switching or from rest (Filippov), from the formulas alone."""

from typing import Protocol

import numpy as np

from sysid_trib.motion import Motion, Vector

NEAR = 1e-9  # closer than this to a surface, its sign is decided by where the motion is going
LOOK = 1e-5  # how far ahead in tau that is


class Field(Protocol):
    """The functions of a motion on numbers; each engine has its own, equally exact."""

    motion: Motion

    def rates(self, y: Vector, p: Vector, tau: float) -> Vector: ...
    def surfaces(self, y: Vector, p: Vector, tau: float) -> Vector: ...
    def replaced(self, y: Vector, p: Vector, tau: float) -> Vector: ...


def settle(field: Field, y: Vector, p: Vector, tau: float) -> bool:
    """Set signs, and at a reversal the memory, in `p` for the motion from here; False if it sticks.

    The rule of rest: with a+ and a- the accelerations for v -> 0+ and 0-, the motion goes up if a+ > 0 and
    a- >= 0, down if a- < 0 and a+ <= 0, towards x = 0 if both push away, and sticks otherwise.
    """
    if abs(y[1]) > NEAR:
        _look_ahead(field, y, p, tau)
        return True
    (up, above), (down, below) = depart(field, y, p, tau, 1.0), depart(field, y, p, tau, -1.0)
    sticks = up <= 0.0 <= down
    # A slow passage is a rest only if friction, not the spring, would hold it there.
    if abs(y[1]) > 1e-12 and not (sticks and down - up > 1e-6):
        _look_ahead(field, y, p, tau)
        return True
    if sticks:
        return False
    goes_up = up > 0.0 and (down >= 0.0 or y[0] < 0.0)
    p[:] = above if goes_up else below
    return True


def depart(field: Field, y: Vector, p: Vector, tau: float, way: float) -> tuple[float, Vector]:
    """Acceleration at rest when the motion is about to go `way` (+1, -1), and `p` with that branch."""
    motion, p = field.motion, p.copy()
    signs = motion.signs_at
    rest = y.copy()
    rest[1] = 0.0
    if motion.memory and p[signs.start] == -way:
        p[motion.memory_at] = field.replaced(rest, p, tau)
    near = _set_signs(field, rest, p, tau)
    ahead = rest.copy()
    ahead[:2] += way * LOOK**2 / 2, way * LOOK
    if near.any():
        p[signs] = np.where(near, np.sign(field.surfaces(ahead, p, tau + LOOK)), p[signs])
        if len(y) > 2:
            ahead[2:] += LOOK / 2 * field.rates(ahead, p, tau)[2:]
            p[signs] = np.where(near, np.sign(field.surfaces(ahead, p, tau + LOOK)), p[signs])
    return float(field.rates(rest, p, tau)[1]), p


def _look_ahead(field: Field, y: Vector, p: Vector, tau: float) -> None:
    signs = field.motion.signs_at
    before = p[signs].copy()
    near = _set_signs(field, y, p, tau)
    if near.any():
        p[signs] = np.where(near, before, p[signs])
        rates = field.rates(y, p, tau)
        ahead = y + LOOK * rates
        ahead[0] += LOOK**2 / 2 * rates[1]
        p[signs] = np.where(near, np.sign(field.surfaces(ahead, p, tau + LOOK)), p[signs])


def _set_signs(field: Field, y: Vector, p: Vector, tau: float) -> Vector:
    values = field.surfaces(y, p, tau)
    p[field.motion.signs_at] = np.sign(values)
    return np.abs(values) < NEAR
