"""Motion by Taylor series (heyoka) nearly to machine precision, compiled once per set of forces."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import lru_cache
from threading import RLock
from typing import Any, cast
from weakref import proxy

import heyoka as hy
import numpy as np

from sysid_trib.forces.force import Force
from sysid_trib.forces.formulas import Functions, divided
from sysid_trib.simulation.equations import SMOOTHED, Motion, Progress, Vector
from sysid_trib.simulation.stick_slip import AT_REST, Rule, branches_from_rest, settle

# It would log to standard output: motions that diverge, and that it found no place to keep what it compiled.
hy.set_logger_level_critical()

Callback = Callable[[Any, int], bool]
# Reached to 1e-14 over the run of the paper; machine precision takes a sixth longer.
TAYLOR_TOLERANCE = 1e-13


def _power(base: Any, exponent: Any) -> Any:
    """Whole powers as products; broken ones as b (b^2 + e^2)^((p-1)/2), analytic where b changes sign."""
    if isinstance(exponent, float) and exponent.is_integer():
        if exponent < 0:
            return divided(1.0, _power(base, -exponent))
        return _product(base, int(exponent))
    return base * _expr(base * base + SMOOTHED**2) ** ((exponent - 1.0) / 2.0)


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


BRANCH_FUNCTIONS: Functions = {
    **{name: _analytic(name) for name in ("sin", "cos", "tan", "exp", "tanh")},
    "sqrt": lambda u: _power(u, 0.5),
    "log": lambda u: 0.5 * hy.log(_expr(u * u + SMOOTHED**2)),
    "power": _power,
}
TAYLOR_FUNCTIONS: Functions = {
    **BRANCH_FUNCTIONS,
    "sign": lambda u: _sign(_expr(u)),
    "abs": lambda u: _sign(_expr(u)) * u,
    "min": lambda a, b: hy.select(hy.lt(_expr(a), _expr(b)), a, b),
    "max": lambda a, b: hy.select(hy.gt(_expr(a), _expr(b)), a, b),
    "below": lambda u, then, other: hy.select(hy.lt(_expr(u), 0.0), then, other),
}


def _moves(surface: Any) -> bool:
    """Whether a surface can change: what is the same at all times is not crossed, and heyoka refuses it."""
    still = not hy.get_variables([surface]) and hy.subs(surface, {hy.time: _expr(0.0)}) == surface
    return not still


class Compiled:
    """A motion compiled: its integrator, its rules, and the simulation under way.

    Parameters
    ----------
    motion : Motion
        The equations.
    """

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.lock: AbstractContextManager[Any] = RLock()
        self.progress = Progress(np.zeros(motion.signs_at.stop), budget=0, steps=0)
        self._rules: dict[Rule, CompiledRule] = {}
        y = [_expr(name) for name in motion.variables]
        p = [hy.par[i] for i in range(motion.signs_at.stop)]
        rates = [_expr(rate) for rate in motion.rates(y, p, hy.time, BRANCH_FUNCTIONS)]
        frozen = [_expr(g) for g in motion.surfaces(y, p, hy.time, BRANCH_FUNCTIONS, frozen=True)]
        # heyoka's objects are invisible to the garbage collector: a cycle through one would never be freed.
        mine = cast("Compiled", proxy(self))
        callbacks = [_callback(mine)] * len(frozen)
        # heyoka drops the parameters after the last one that its equations hold.
        complete = p[-1] in hy.get_params([*rates, *frozen])
        # Plain cases without the general procedure save a quarter of the time of the paper's run.
        keys = [s.key for s in motion.switches]
        if complete and keys in (["x"], ["v", "x"]):
            callbacks[-1] = _callback_at_zero(mine)
        self.turning: CompiledRule | None = None
        if complete and not motion.memory and keys[:1] == ["v"]:
            self.turning = self.rule(branches_from_rest)
            callbacks[0] = _callback_at_reversal(mine)
        # The automatic cooldown drops real crossings.
        pairs = zip(frozen, callbacks, strict=True)
        events = [hy.t_event(g, callback=callback, cooldown=1e-6) for g, callback in pairs if _moves(g)]
        self.integrator = hy.taylor_adaptive(
            list(zip(y, rates, strict=True)), t_events=events, tol=TAYLOR_TOLERANCE
        )
        self.state, self.used = self.integrator.state, self.integrator.pars

    def apply(self, rule: Rule, y: Vector, p: Vector, tau: float) -> Vector:
        """Value of a rule, compiled when it is first needed; the next call overwrites it."""
        return self.rule(rule)(y, p, tau)

    def rule(self, rule: Rule) -> "CompiledRule":
        """A rule as a function on numbers, compiled when it is first needed."""
        if rule not in self._rules:
            self._rules[rule] = CompiledRule(self.motion, rule)
        return self._rules[rule]

    def glide(self, progress: Progress, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
        """Move from grid[0] until the motion sticks, fails or the grid ends.

        Returns the states at the grid points reached after the first, the last state and its tau.
        """
        taylor = self.integrator
        self.progress = progress
        taylor.time = grid[0]
        self.state[:] = y
        self.used[:] = progress.p[: self.used.size]
        progress.turns.clear()
        if taylor.with_events:
            taylor.reset_cooldowns()
        outcome, *_, rows = taylor.propagate_grid(grid, max_steps=progress.steps)
        wrong = self._wrong_turn(progress)
        if wrong is not None:
            y, tau = wrong
            return rows[1 : max(1, np.searchsorted(grid, tau))], y, tau
        if outcome == hy.taylor_outcome.step_limit:
            progress.failure = "needs too many steps"
        elif outcome == hy.taylor_outcome.err_nf_state:
            progress.failure = "is not finite"
        return rows[1:], self.state.copy(), taylor.time

    def _wrong_turn(self, progress: Progress) -> tuple[Vector, float] | None:
        """Where the motion first did not turn as it was taken to, and how it goes on from there."""
        if not progress.turns or self.turning is None:
            return None
        at = [note for note, _ in progress.turns]
        taken = np.frombuffer(b"".join([state for _, state in progress.turns])).reshape(len(at), -1)
        up, down = self.turning.at_rest(taken, progress.p, progress.times[at])
        rises, falls = up[0] > 0.0, down[0] < 0.0
        signs = progress.past[at].T[self.motion.signs_at]
        right = (rises != falls) & (np.where(rises, up[1:], down[1:]) == signs).all(axis=0)
        if right.all():
            return None
        first = int(right.argmin())
        y, tau = taken[first].copy(), progress.back_to(at[first])
        progress.stuck = not (progress.count() and settle(self, y, progress.p, tau))
        progress.note(tau)
        return y, tau


def _callback(compiled: Compiled) -> Callback:
    # A function, since heyoka copies other callables deeply, integrator and all.
    def switch(taylor: Any, _: int) -> bool:
        progress, tau, used = compiled.progress, taylor.time, compiled.used
        moves = progress.count() and settle(compiled, compiled.state, progress.p, tau)
        progress.stuck = not (moves or progress.failure)
        used[:] = progress.p[: used.size]
        progress.note(tau)
        return moves

    return switch


def _callback_at_zero(compiled: Compiled) -> Callback:
    """`_callback` of x = 0 without any call, where at most v = 0 switches besides."""
    general, last = _callback(compiled), compiled.motion.signs_at.stop - 1

    def switch(taylor: Any, way: int) -> bool:
        v = compiled.state.item(1)
        if -1e-3 < v < 1e-3:
            return general(taylor, way)
        progress = compiled.progress
        progress.p[last] = compiled.used[last] = 1.0 if v > 0.0 else -1.0
        progress.note(taylor.time)
        return True

    return switch


def _callback_at_reversal(compiled: Compiled) -> Callback:
    """`_callback` of v = 0 of forces without memory: taken to turn there, `_wrong_turn` asks afterwards."""
    general, sign = _callback(compiled), compiled.motion.signs_at.start

    def switch(taylor: Any, way: int) -> bool:
        state, progress = compiled.state, compiled.progress
        p = progress.p
        turns = p.item(sign) != way
        if not (-AT_REST <= state.item(1) <= AT_REST and (turns or progress.turns)):
            return general(taylor, way)
        # Twice the same way it did not turn the last time: no sign, so that it is found here at the latest.
        p[sign] = compiled.used[sign] = way if turns else 0.0
        return progress.turn(taylor.time, state.tobytes()) and turns

    return switch


class CompiledRule:
    """A rule as a function on numbers; a call overwrites what the last returned.

    Parameters
    ----------
    motion : Motion
        The equations.
    rule : Rule
        What is compiled.
    """

    def __init__(self, motion: Motion, rule: Rule) -> None:
        names = [*motion.variables, *(f"p{i}" for i in range(motion.signs_at.stop)), "tau"]
        inputs, self._count = [_expr(name) for name in names], len(motion.variables)
        count = self._count
        values = rule(motion, inputs[:count], inputs[count:-1], inputs[-1], TAYLOR_FUNCTIONS)
        # heyoka takes one vector three times as fast as variables, parameters and time.
        self._function = hy.cfunc([_expr(value) for value in values], inputs)
        self._given, self._values = np.zeros(len(inputs)), np.empty(len(values))

    def __call__(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Value of the rule."""
        given, count = self._given, self._count
        given[:count], given[count:-1], given[-1] = y, p, tau
        self._function(given, self._values)
        return self._values

    def at_rest(self, y: Vector, p: Vector, tau: Vector) -> Vector:
        """Both halves of the rule, (2, value, instant), at instants with v = 0 and the same parameters."""
        given = np.empty((len(self._given), len(tau)))
        given[: self._count], given[1], given[self._count : -1], given[-1] = y.T, 0.0, p[:, None], tau
        return np.asarray(self._function(given)).reshape(2, -1, len(tau))


@lru_cache(maxsize=128)
def compiled(forces: tuple[Force, ...]) -> Compiled:
    """The compiled motion under these forces; compiling takes 0.1 s, once in a process."""
    return Compiled(Motion(forces))
