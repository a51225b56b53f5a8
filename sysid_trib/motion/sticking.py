"""Which way a motion goes on from a switching or from rest (Filippov), from the formulas alone."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sysid_trib.motion.equations import Motion, Vector

NEAR = 1e-9  # nearer than this to a surface, its sign is decided by where the motion is going
LOOK = 1e-5  # how far ahead in tau that is
SLOW = 1e-5  # rad; below this speed a motion may come to rest other than by v = 0
CREEP = 1e-11  # rad; what a motion taken as at rest may still have had to go


class Field(Protocol):
    """The functions of a motion on numbers; each engine has its own, equally exact."""

    motion: Motion

    def rates(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Derivative of `y` on the branch of the signs in `p`."""
        ...

    def surfaces(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Value of each switching surface."""
        ...

    def replaced(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Memory after a reversal."""
        ...


def settle(field: Field, y: Vector, p: Vector, tau: float) -> bool:
    """Set the signs, and at a reversal the memory, in `p` for the motion from here; False if it sticks."""
    speed = abs(y[1])
    if speed > SLOW:
        _look_ahead(field, y, p, tau)
        return True
    (up, above), (down, below) = depart(field, y, p, tau, 1.0), depart(field, y, p, tau, -1.0)
    sticks = up <= 0.0 <= down
    # Detent and friction make ever shorter swings without end: they end where less than CREEP is left.
    if speed > 1e-12 and not (sticks and speed**2 < 2.0 * CREEP * min(-up, down)):
        _look_ahead(field, y, p, tau)
        return True
    if not sticks:
        p[:] = above if rises(up, down, y[0]) else below
    return not sticks


def rises(up: float, down: float, x: float) -> bool:
    """Whether a motion that does not stick leaves upwards, from the accelerations for v -> 0+ and 0-.

    Where both push away (negative friction) it goes towards x = 0.
    """
    return up > 0.0 and (down >= 0.0 or x < 0.0)


def depart(field: Field, y: Vector, p: Vector, tau: float, way: float) -> tuple[float, Vector]:
    """Acceleration at rest when the motion is about to go `way` (+1, -1), and `p` with that branch."""
    motion, p = field.motion, p.copy()
    signs = motion.signs_at
    rest = y.copy()
    rest[1] = 0.0
    if motion.memory and p[signs.start] == -way:
        p[motion.memory_at] = field.replaced(rest, p, tau)
    near = _set_signs(field, rest, p, tau)
    if near.any():
        ahead = rest.copy()
        ahead[:2] += way * LOOK**2 / 2, way * LOOK
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


def _set_signs(field: Field, y: Vector, p: Vector, tau: float) -> NDArray[np.bool_]:
    values = field.surfaces(y, p, tau)
    p[field.motion.signs_at] = np.sign(values)
    near: NDArray[np.bool_] = np.abs(values) < NEAR
    return near
