"""Motion by Taylor series (heyoka) nearly to machine precision, compiled once per set of forces."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cached_property, lru_cache, partial
from threading import RLock
from typing import Any, cast
from weakref import proxy

import heyoka as hy
import numpy as np

from sysid_trib.forces.force import Force
from sysid_trib.simulation.equations import Functions, Motion, Run, Vector, motion_of
from sysid_trib.simulation.stick_slip import ahead, departure, settle, standing

# What heyoka would print on a diverging motion is raised instead.
hy.set_logger_level_critical()
Callback = Callable[[Any, int], bool]
TOLERANCE = 1e-13  # reached to 1e-14 over the run of the paper; machine precision takes a sixth longer
SMALL = 1e-9  # broken powers are smoothed below this


def _power(base: Any, exponent: Any) -> Any:
    """Whole powers as products; broken ones as b (b^2 + e^2)^((p-1)/2), analytic where b changes sign."""
    if isinstance(exponent, float) and exponent.is_integer():
        if exponent < 0:
            return 1.0 / _power(base, -exponent)
        return _product(base, int(exponent))
    return base * _expr(base * base + SMALL**2) ** ((exponent - 1.0) / 2.0)


def _product(base: Any, count: int) -> Any:
    if count == 0:
        return hy.expression(1.0)
    half = _product(base, count // 2) if count > 1 else None
    return base if half is None else half * half * base if count % 2 else half * half


def _sign(u: Any) -> Any:
    # 0 of 0, and what is not a number stays so.
    return hy.select(hy.gt(u, 0.0), 1.0, hy.select(hy.lt(u, 0.0), -1.0, u))


def _analytic(name: str) -> Callable[[Any], Any]:
    function = getattr(hy, name)
    return lambda u: function(_expr(u))


def _expr(value: Any) -> Any:
    return value if isinstance(value, hy.expression) else hy.expression(value)


SMOOTH: Functions = {
    **{name: _analytic(name) for name in ("sin", "cos", "tan", "exp", "tanh")},
    "sqrt": lambda u: _power(u, 0.5),
    "log": lambda u: 0.5 * hy.log(_expr(u * u + SMALL**2)),
    "power": _power,
}
SWITCHED: Functions = {
    **SMOOTH,
    "sign": lambda u: _sign(_expr(u)),
    "abs": lambda u: _sign(_expr(u)) * u,
    "min": lambda a, b: hy.select(hy.lt(_expr(a), _expr(b)), a, b),
    "max": lambda a, b: hy.select(hy.gt(_expr(a), _expr(b)), a, b),
    "below": lambda u, then, other: hy.select(hy.lt(_expr(u), 0.0), then, other),
}


class Compiled:
    """A motion compiled: its integrator, its functions on numbers, and the run under way."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.lock: AbstractContextManager[Any] = RLock()
        self.run = Run(np.zeros(motion.signs_at.stop), budget=0, steps=0)
        y = [_expr(name) for name in motion.variables]
        p = [hy.par[i] for i in range(motion.signs_at.stop)]
        rates = [_expr(rate) for rate in motion.rates(y, p, hy.time, SMOOTH)]
        frozen = [_expr(g) for g in motion.surfaces(y, p, hy.time, SMOOTH, frozen=True)]
        # heyoka's objects are invisible to the garbage collector: a cycle through one would never be freed.
        mine = cast("Compiled", proxy(self))
        callbacks = [_callback(mine)] * len(frozen)
        # heyoka drops the parameters after the last one that its equations hold.
        complete = p[-1] in hy.get_params([*rates, *frozen])
        # The plain case without the general procedure saves a tenth of the time of the paper's run.
        if complete and [s.key for s in motion.switches] in (["x"], ["v", "x"]):
            callbacks[-1] = _callback_at_zero(mine)
        # The automatic cooldown drops real crossings.
        events = [
            hy.t_event(g, callback=callback, cooldown=1e-6)
            for g, callback in zip(frozen, callbacks, strict=True)
        ]
        self.integrator = hy.taylor_adaptive(list(zip(y, rates, strict=True)), t_events=events, tol=TOLERANCE)
        self.state, self.used = self.integrator.state, self.integrator.pars

    @cached_property
    def ahead(self) -> "_Function":
        """Signs of a motion that goes on."""
        return _Function(self.motion, partial(ahead, self.motion))

    @cached_property
    def standing(self) -> "_Function":
        """Accelerations at rest upwards and downwards, and rates of the states."""
        return _Function(self.motion, partial(standing, self.motion))

    def departures(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Upwards and downwards, (2, 1 + memory + signs)."""
        rest = y.copy()
        rest[1] = 0.0
        return self._departures(rest, p, tau).reshape(2, -1)

    @cached_property
    def _departures(self) -> "_Function":
        return _Function(self.motion, *(partial(departure, self.motion, way=way) for way in (1.0, -1.0)))

    def glide(self, run: Run, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
        """Move from grid[0] until the motion sticks, fails or the grid ends.

        Returns the states at the grid points reached after the first, the last state and its tau.
        """
        taylor = self.integrator
        self.run = run
        taylor.time = grid[0]
        self.state[:] = y
        self.used[:] = run.p[: self.used.size]
        if taylor.with_events:
            taylor.reset_cooldowns()
        outcome, *_, rows = taylor.propagate_grid(grid, max_steps=run.steps)
        if outcome == hy.taylor_outcome.step_limit:
            run.failure = "needs too many steps"
        elif outcome == hy.taylor_outcome.err_nf_state:
            run.failure = "is not finite"
        return rows[1:], self.state.copy(), taylor.time


def _callback(compiled: Compiled) -> Callback:
    # A function, since heyoka copies other callables deeply, integrator and all.
    def switch(taylor: Any, _: int) -> bool:
        run, tau, used = compiled.run, taylor.time, compiled.used
        moves = run.count() and settle(compiled, compiled.state, run.p, tau)
        run.stuck = not (moves or run.failure)
        used[:] = run.p[: used.size]
        run.note(tau)
        return moves

    return switch


def _callback_at_zero(compiled: Compiled) -> Callback:
    """`_callback` of x = 0 without any call, where at most v = 0 switches besides."""
    general, place = _callback(compiled), compiled.motion.signs_at.stop - 1

    def switch(taylor: Any, way: int) -> bool:
        v = compiled.state.item(1)
        if -1e-3 < v < 1e-3:
            return general(taylor, way)
        run = compiled.run
        run.p[place] = compiled.used[place] = 1.0 if v > 0.0 else -1.0
        run.note(taylor.time)
        return True

    return switch


class _Function:
    """Expressions of y, p and tau as one function on numbers; a call overwrites what the last returned."""

    def __init__(self, motion: Motion, *parts: Callable[..., list[Any]]) -> None:
        y = [_expr(name) for name in motion.variables]
        p = [_expr(f"p{i}") for i in range(motion.signs_at.stop)]
        tau = _expr("tau")
        outputs = [_expr(found) for part in parts for found in part(y, p, tau, functions=SWITCHED)]
        # heyoka takes one vector three times as fast as variables, parameters and time.
        self._call = hy.cfunc(outputs, [*y, *p, tau])
        self._given, self._found = np.empty(len(y) + len(p) + 1), np.empty(len(outputs))
        self._p_at = slice(len(y), len(y) + len(p))

    def __call__(self, y: Vector, p: Vector, tau: float) -> Vector:
        given = self._given
        given[: len(y)] = y
        given[self._p_at] = p
        given[-1] = tau
        self._call(given, self._found)
        return self._found


@lru_cache(maxsize=128)
def compiled(forces: tuple[Force, ...]) -> Compiled:
    """The compiled motion under these forces; compiling takes 0.1 s, once in a process."""
    return Compiled(motion_of(forces))
