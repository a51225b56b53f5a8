"""Motion by Taylor series to machine precision (heyoka), compiled once per set of forces."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from threading import RLock
from typing import Any

import heyoka as hy
import numpy as np

from sysid_trib.forces import Force
from sysid_trib.motion import Functions, Motion, Run, Vector, motion_of
from sysid_trib.sticking import settle

SMALL = 1e-6  # broken powers are smoothed below this


def _power(base: Any, exponent: Any) -> Any:
    """Whole powers as products; broken ones as b (b^2 + e^2)^((p-1)/2), analytic where b changes sign."""
    if isinstance(exponent, float) and exponent.is_integer():
        if exponent < 0:
            return 1.0 / _power(base, -exponent)
        return _product(base, int(exponent))
    return base * hy.expression(base * base + SMALL**2) ** ((exponent - 1.0) / 2.0)


def _product(base: Any, count: int) -> Any:
    if count == 0:
        return hy.expression(1.0)
    half = _product(base, count // 2) if count > 1 else None
    return base if half is None else half * half * base if count % 2 else half * half


def _sign(u: Any) -> Any:
    return hy.select(hy.gt(u, 0.0), 1.0, hy.select(hy.lt(u, 0.0), -1.0, 0.0))


SMOOTH: Functions = {
    **{k: (lambda u, f=getattr(hy, k): f(hy.expression(u))) for k in ("sin", "cos", "tan", "exp", "tanh")},
    "sqrt": lambda u: _power(hy.expression(u), 0.5),
    "log": lambda u: 0.5 * hy.log(hy.expression(u * u + SMALL**2)),
    "power": _power,
}
SWITCHED: Functions = {
    **SMOOTH,
    "sign": _sign,
    "abs": lambda u: _sign(u) * u,
    "min": lambda a, b: hy.select(hy.lt(hy.expression(a), hy.expression(b)), a, b),
    "max": lambda a, b: hy.select(hy.gt(hy.expression(a), hy.expression(b)), a, b),
}


class Compiled:
    """A motion compiled: its integrator, its functions on numbers, and the run under way."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.lock = RLock()
        y = [hy.expression(f"y{i}") for i in range(len(motion.variables))]
        p = [hy.par[i] for i in range(motion.signs_at.stop)]
        rates = motion.rates(y, p, hy.time, SMOOTH)
        frozen = motion.surfaces(y, p, hy.time, SMOOTH, frozen=True)
        self._rates = _Function(y, p, rates)
        self._surfaces = _Function(y, p, motion.surfaces(y, p, hy.time, SWITCHED))
        self._replaced = _Function(y, p, motion.replaced(y, p, hy.time, SWITCHED))
        # The automatic cooldown drops real crossings.
        events = [
            hy.t_event(hy.expression(g), callback=_callback(self), cooldown=1e-6) for g in map(_expr, frozen)
        ]
        system = [(a, _expr(b)) for a, b in zip(y, rates, strict=True)]
        self.integrator = hy.taylor_adaptive(system, t_events=events)
        self.run = Run(np.zeros(len(p)), budget=0)

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
        taylor.state[:] = y
        taylor.pars[:] = run.p[: len(taylor.pars)]
        if taylor.with_events:
            taylor.reset_cooldowns()
        outcome, *_, rows = taylor.propagate_grid(grid, max_steps=run.steps)
        if outcome == hy.taylor_outcome.step_limit:
            run.failure = "needs too many steps"
        elif outcome == hy.taylor_outcome.err_nf_state:
            run.failure = "is not finite"
        return rows[1:], taylor.state.copy(), taylor.time


def _callback(compiled: Compiled) -> Callable[[Any, int], bool]:
    def switch(taylor: Any, _: int) -> bool:
        # The sign heyoka passes is 0 or wrong at double roots: every sign is found anew.
        run, tau = compiled.run, taylor.time
        moves = run.count() and settle(compiled, taylor.state, run.p, tau)
        run.stuck = not moves
        taylor.pars[:] = run.p[: len(taylor.pars)]
        run.note(tau)
        return moves

    return switch


class _Function:
    """Expressions of y, p and tau as one function on numbers."""

    def __init__(self, y: Sequence[Any], p: Sequence[Any], outputs: Sequence[Any]) -> None:
        self._size = len(outputs)
        # The last parameter as an output keeps the function's parameters as many as there are in p.
        self._call = hy.cfunc([*map(_expr, outputs), p[-1]], list(y))

    def __call__(self, y: Vector, p: Vector, tau: float) -> Vector:
        found: Vector = self._call(y, pars=p, time=tau)[: self._size]
        return found


def _expr(value: Any) -> Any:
    return hy.expression(value)


@lru_cache(maxsize=128)
def compiled(forces: tuple[Force, ...]) -> Compiled:
    """The compiled motion under these forces; compiling takes 0.1 s, once in a process."""
    return Compiled(motion_of(forces))
