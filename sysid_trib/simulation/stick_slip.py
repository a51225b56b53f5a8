"""Which way a motion goes on from a switching or from rest (Filippov), from the formulas alone.

The rules `signs_ahead`, `branches_from_rest` and `rates_at_rest` are written for numbers and for expressions
alike: each engine evaluates them in its own way, one of them compiled.
"""

from collections.abc import Callable
from typing import Any, Protocol

from sysid_trib.forces.formulas import Functions
from sysid_trib.simulation.equations import Motion, Values, Vector

NEAR_SURFACE = 1e-9  # nearer than this to a surface, its sign is decided by where the motion is going
LOOKAHEAD = 1e-5  # how far ahead in tau that is
SLOW = 1e-5  # rad; below this speed a motion may come to rest other than by v = 0
AT_REST = 1e-12  # rad; below this speed there is no motion to go on
CREEP = 1e-11  # rad; what a motion taken as at rest may still have had to go

Rule = Callable[[Motion, Values, Values, Any, Functions], list[Any]]


class RuleEngine(Protocol):
    """Evaluates the rules in numbers; each engine has its own way, equally exact."""

    motion: Motion

    def apply(self, rule: Rule, y: Vector, p: Vector, tau: float) -> Vector:
        """Value of a rule, valid until the next call."""
        ...


def settle(engine: RuleEngine, y: Vector, p: Vector, tau: float) -> bool:
    """Set the signs, and at a reversal the memory, in `p` for the motion from here; False if it sticks."""
    motion, speed = engine.motion, abs(y.item(1))
    if speed <= SLOW:
        rest = y.copy()
        rest[1] = 0.0
        branches = engine.apply(branches_from_rest, rest, p, tau).reshape(2, -1)
        up, down = branches.item(0, 0), branches.item(1, 0)
        sticks = up <= 0.0 <= down
        # Detent and friction make ever shorter swings without end: they end where less than CREEP remains.
        if speed <= AT_REST or (sticks and speed**2 < 2.0 * CREEP * min(-up, down)):
            if not sticks:
                # Where both push away (negative friction) it goes towards x = 0.
                rises = up > 0.0 and (down >= 0.0 or y.item(0) < 0.0)
                p[motion.memory_at.start :] = branches[0 if rises else 1, 1:]
            return not sticks
    if motion.switches:
        p[motion.signs_at] = engine.apply(signs_ahead, y, p, tau)
    return True


def signs_ahead(motion: Motion, y: Values, p: Values, tau: Any, functions: Functions) -> list[Any]:
    """Signs of a motion that goes on: near a surface, those where it will be a little later."""
    fixed = p[: motion.signs_at.start]
    values = motion.surfaces(y, p, tau, functions)
    signs = _by_nearness(values, p[motion.signs_at], [functions["sign"](u) for u in values], functions)
    rates = motion.rates(y, [*fixed, *signs], tau, functions)
    later = [a + LOOKAHEAD * rate for a, rate in zip(y, rates, strict=True)]
    later[0] = later[0] + LOOKAHEAD**2 / 2 * rates[1]
    return _by_nearness(values, _signs(motion, later, p, tau + LOOKAHEAD, functions), signs, functions)


def branches_from_rest(motion: Motion, y: Values, p: Values, tau: Any, functions: Functions) -> list[Any]:
    """Upwards, then downwards from rest: acceleration, then memory and signs of that branch."""
    return [*_branch(motion, y, p, tau, functions, 1.0), *_branch(motion, y, p, tau, functions, -1.0)]


def rates_at_rest(motion: Motion, y: Values, p: Values, tau: Any, functions: Functions) -> list[Any]:
    """Accelerations upwards and downwards of a motion at rest, then the rates of its states."""
    up, down = (_branch(motion, y, p, tau, functions, way)[0] for way in (1.0, -1.0))
    here = [*p[: motion.signs_at.start], *_signs(motion, y, p, tau, functions)]
    return [up, down, *motion.rates(y, here, tau, functions)[2:]]


def _branch(motion: Motion, y: Values, p: Values, tau: Any, functions: Functions, way: float) -> list[Any]:
    """Acceleration at rest of a motion about to go `way` (+1, -1), then memory and signs of that branch."""
    fixed, memory = p[: motion.memory_at.start], p[motion.memory_at]
    if len(memory):
        turned = way * p[motion.signs_at.start]
        replaced = motion.replaced(y, p, tau, functions)
        memory = [functions["below"](turned, new, old) for new, old in zip(replaced, memory, strict=True)]
    before = [*fixed, *memory, *p[motion.signs_at]]
    values = motion.surfaces(y, before, tau, functions)
    signs = [functions["sign"](u) for u in values]
    later = [y[0] + way * LOOKAHEAD**2 / 2, y[1] + way * LOOKAHEAD, *y[2:]]
    signs = _by_nearness(values, _signs(motion, later, before, tau + LOOKAHEAD, functions), signs, functions)
    if len(y) > 2:
        rates = motion.rates(later, [*fixed, *memory, *signs], tau, functions)
        later[2:] = [a + LOOKAHEAD / 2 * rate for a, rate in zip(later[2:], rates[2:], strict=True)]
        ahead = _signs(motion, later, before, tau + LOOKAHEAD, functions)
        signs = _by_nearness(values, ahead, signs, functions)
    return [motion.rates(y, [*fixed, *memory, *signs], tau, functions)[1], *memory, *signs]


def _signs(motion: Motion, y: Values, p: Values, tau: Any, functions: Functions) -> list[Any]:
    return [functions["sign"](u) for u in motion.surfaces(y, p, tau, functions)]


def _by_nearness(values: Values, near: Values, far: Values, functions: Functions) -> list[Any]:
    """Of each surface the first sign if it is near, else the second."""
    distances = [functions["abs"](u) - NEAR_SURFACE for u in values]
    return [functions["below"](*choice) for choice in zip(distances, near, far, strict=True)]
