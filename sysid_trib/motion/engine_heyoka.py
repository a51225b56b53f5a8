"""Motion by Taylor series (heyoka) nearly to machine precision, compiled once per set of forces."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import lru_cache
from threading import RLock
from typing import Any

import heyoka as hy
import numpy as np

from sysid_trib.forces import Force
from sysid_trib.motion.equations import Functions, Motion, Run, Vector, motion_of
from sysid_trib.motion.sticking import NEAR, rises, settle

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
    return hy.select(hy.gt(u, 0.0), 1.0, hy.select(hy.lt(u, 0.0), -1.0, 0.0))


def _analytic(name: str) -> Callable[[Any], Any]:
    function = getattr(hy, name)
    return lambda u: function(_expr(u))


def _expr(value: Any) -> Any:
    return hy.expression(value)


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
        true = motion.surfaces(y, p, hy.time, SWITCHED)
        self._rates = _Function(y, p, rates)
        self._surfaces = _Function(y, p, true)
        self._replaced = _Function(y, p, motion.replaced(y, p, hy.time, SWITCHED))
        callbacks = [_callback(self)] * len(frozen)
        # heyoka drops the parameters after the last one that its equations hold.
        complete = p[-1] in hy.get_params([*rates, *frozen])
        # The plain cases without the general procedure halve the time of the paper's run.
        if complete and [s.key for s in motion.switches] in (["x"], ["v", "x"]):
            callbacks[-1] = _callback_at_zero(self)
        if complete and motion.reverses and not motion.memory:
            up, down = (hy.subs(rates[1], {p[motion.signs_at.start]: _expr(way)}) for way in (1.0, -1.0))
            callbacks[0] = _callback_at_rest(self, _Function(y, p, [*true, up, down]))
        # The automatic cooldown drops real crossings.
        events = [
            hy.t_event(g, callback=callback, cooldown=1e-6)
            for g, callback in zip(frozen, callbacks, strict=True)
        ]
        self.integrator = hy.taylor_adaptive(list(zip(y, rates, strict=True)), t_events=events, tol=TOLERANCE)
        self.state, self.used = self.integrator.state, self.integrator.pars

    def rates(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Derivative of `y` on the branch of the signs in `p`."""
        return self._rates(y, p, tau)

    def surfaces(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Value of each switching surface."""
        return self._surfaces(y, p, tau)

    def replaced(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Memory after a reversal."""
        return self._replaced(y, p, tau)

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


def _callback_at_rest(compiled: Compiled, instant: "_Function") -> Callback:
    """`_callback` of v = 0 in one call, where it happens away from all other surfaces and without memory."""
    general, first = _callback(compiled), compiled.motion.signs_at.start
    others = range(1, len(compiled.motion.switches))

    def switch(taylor: Any, way: int) -> bool:
        run, tau = compiled.run, taylor.time
        p, y, used = run.p, compiled.state, compiled.used
        found = instant.values(y, p, tau)
        for j in others:
            if found[j] * p[first + j] < NEAR:
                return general(taylor, way)
        up, down = found[-2], found[-1]
        if up <= 0.0 <= down or not -1e-12 < found[0] < 1e-12:
            return general(taylor, way)
        p[first] = used[first] = 1.0 if rises(up, down, y[0]) else -1.0
        run.note(tau)
        return True

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
    """Expressions of y, p and tau as one function on numbers."""

    def __init__(self, y: Sequence[Any], p: Sequence[Any], outputs: Sequence[Any]) -> None:
        # The last parameter as an output keeps the function's parameters as many as there are in p.
        self._call = hy.cfunc([*map(_expr, outputs), p[-1]], list(y))
        self._found = np.empty(len(outputs) + 1)

    def __call__(self, y: Vector, p: Vector, tau: float) -> Vector:
        self._call(y, self._found, p, time=tau)
        return self._found[:-1].copy()

    def values(self, y: Vector, p: Vector, tau: float) -> list[float]:
        """The same as a list, quicker."""
        self._call(y, self._found, p, time=tau)
        found: list[float] = self._found[:-1].tolist()
        return found


@lru_cache(maxsize=128)
def compiled(forces: tuple[Force, ...]) -> Compiled:
    """The compiled motion under these forces; compiling takes 0.1 s, once in a process."""
    return Compiled(motion_of(forces))
