"""Which way a motion goes on from a switching or from rest (Filippov), from the formulas alone.

`ahead`, `departure` and `standing` are written for numbers and for expressions alike: each engine computes
them in its own way, one of them compiled.
"""

from collections.abc import Sequence
from typing import Any, Protocol

from sysid_trib.simulation.equations import Functions, Motion, Vector

NEAR = 1e-9  # nearer than this to a surface, its sign is decided by where the motion is going
LOOK = 1e-5  # how far ahead in tau that is
SLOW = 1e-5  # rad; below this speed a motion may come to rest other than by v = 0
CREEP = 1e-11  # rad; what a motion taken as at rest may still have had to go


class Field(Protocol):
    """A motion's ways on, in numbers; each engine has its own, equally exact."""

    motion: Motion

    def ahead(self, y: Vector, p: Vector, tau: float) -> Vector:
        """See `ahead`; like the others, valid until the next call."""
        ...

    def departures(self, y: Vector, p: Vector, tau: float) -> Vector:
        """`departure` upwards and downwards, (2, 1 + memory + signs)."""
        ...

    def standing(self, y: Vector, p: Vector, tau: float) -> Vector:
        """See `standing`."""
        ...


def settle(field: Field, y: Vector, p: Vector, tau: float) -> bool:
    """Set the signs, and at a reversal the memory, in `p` for the motion from here; False if it sticks."""
    motion, speed = field.motion, abs(y.item(1))
    if speed <= SLOW:
        found = field.departures(y, p, tau)
        up, down = found.item(0, 0), found.item(1, 0)
        sticks = up <= 0.0 <= down
        # Detent and friction make ever shorter swings without end: they end where less than CREEP is left.
        if speed <= 1e-12 or (sticks and speed**2 < 2.0 * CREEP * min(-up, down)):
            if not sticks:
                p[motion.memory_at.start :] = found[0 if _rises(up, down, y.item(0)) else 1, 1:]
            return not sticks
    if motion.switches:
        p[motion.signs_at] = field.ahead(y, p, tau)
    return True


def _rises(up: float, down: float, x: float) -> bool:
    """Whether a motion that does not stick leaves upwards, from the accelerations for v -> 0+ and 0-.

    Where both push away (negative friction) it goes towards x = 0.
    """
    return up > 0.0 and (down >= 0.0 or x < 0.0)


def ahead(motion: Motion, y: Sequence[Any], p: Sequence[Any], tau: Any, functions: Functions) -> list[Any]:
    """Signs of a motion that goes on: near a surface, those where it will be a little later."""
    fixed = p[: motion.signs_at.start]
    values = motion.surfaces(y, p, tau, functions)
    signs = _by_nearness(values, p[motion.signs_at], [functions["sign"](u) for u in values], functions)
    rates = motion.rates(y, [*fixed, *signs], tau, functions)
    later = [a + LOOK * rate for a, rate in zip(y, rates, strict=True)]
    later[0] = later[0] + LOOK**2 / 2 * rates[1]
    return _by_nearness(values, _signs(motion, later, p, tau + LOOK, functions), signs, functions)


def departure(
    motion: Motion, y: Sequence[Any], p: Sequence[Any], tau: Any, functions: Functions, way: float
) -> list[Any]:
    """Acceleration at rest of a motion about to go `way` (+1, -1), then memory and signs of that branch.

    `y` : as at rest, with v = 0.
    """
    fixed, memory = p[: motion.memory_at.start], p[motion.memory_at]
    if len(memory):
        turned = way * p[motion.signs_at.start]
        replaced = motion.replaced(y, p, tau, functions)
        memory = [functions["below"](turned, new, old) for new, old in zip(replaced, memory, strict=True)]
    before = [*fixed, *memory, *p[motion.signs_at]]
    values = motion.surfaces(y, before, tau, functions)
    signs = [functions["sign"](u) for u in values]
    later = [y[0] + way * LOOK**2 / 2, y[1] + way * LOOK, *y[2:]]
    signs = _by_nearness(values, _signs(motion, later, before, tau + LOOK, functions), signs, functions)
    if len(y) > 2:
        rates = motion.rates(later, [*fixed, *memory, *signs], tau, functions)
        later[2:] = [a + LOOK / 2 * rate for a, rate in zip(later[2:], rates[2:], strict=True)]
        signs = _by_nearness(values, _signs(motion, later, before, tau + LOOK, functions), signs, functions)
    return [motion.rates(y, [*fixed, *memory, *signs], tau, functions)[1], *memory, *signs]


def standing(motion: Motion, y: Sequence[Any], p: Sequence[Any], tau: Any, functions: Functions) -> list[Any]:
    """Accelerations upwards and downwards of a motion at rest, then the rates of its states."""
    up, down = (departure(motion, y, p, tau, functions, way)[0] for way in (1.0, -1.0))
    here = [*p[: motion.signs_at.start], *_signs(motion, y, p, tau, functions)]
    return [up, down, *motion.rates(y, here, tau, functions)[2:]]


def _signs(motion: Motion, y: Sequence[Any], p: Sequence[Any], tau: Any, functions: Functions) -> list[Any]:
    return [functions["sign"](u) for u in motion.surfaces(y, p, tau, functions)]


def _by_nearness(
    values: Sequence[Any], near: Sequence[Any], far: Sequence[Any], functions: Functions
) -> list[Any]:
    """Of each surface the first sign if it is near, else the second."""
    distances = [functions["abs"](u) - NEAR for u in values]
    return [functions["below"](*each) for each in zip(distances, near, far, strict=True)]
