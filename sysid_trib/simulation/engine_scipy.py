"""Motion by Runge-Kutta (scipy's DOP853), restarted at every switching: slower, and the check."""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import lru_cache, partial
from typing import Any, TypeAlias

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from sysid_trib.forces.force import Force
from sysid_trib.forces.formulas import Functions
from sysid_trib.simulation.equations import SMOOTHED, Motion, Progress, Vector
from sysid_trib.simulation.stick_slip import Rule, branches_from_rest, rates_at_rest, settle, signs_ahead

# Of tau and y: their rates, or what is negative where a step ends.
Field: TypeAlias = Callable[[float, Vector], Vector]
# Where a step is looked at for a switching; close to its start, where the motion just left one.
LOOKS = np.array([0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0])
CROSSED = 1e-14  # a surface just left may seem crossed by this much
TOO_FAR = 1e6  # rad
MAX_STEP = 10.0  # in tau; only at rest would steps grow beyond, and then over what may push


def _power(base: float, exponent: float) -> float:
    if exponent.is_integer():
        return base**exponent
    # A step that reaches over the surface meets a negative base: the branch goes on as an odd function.
    if exponent > 0.0:
        return math.copysign(abs(base) ** exponent, base)
    return base * (base * base + SMOOTHED**2) ** ((exponent - 1.0) / 2.0)


PYTHON_FUNCTIONS: Functions = {
    "sign": lambda u: float(u > 0) - float(u < 0),
    "abs": abs,
    "min": min,
    "max": max,
    "below": lambda u, then, other: then if u < 0.0 else other,
    "power": lambda base, exponent: _power(float(base), float(exponent)),
    "log": lambda u: 0.5 * math.log(u * u + SMOOTHED**2),
    "sqrt": lambda u: math.copysign(math.sqrt(abs(u)), u),
    **{name: getattr(math, name) for name in ("sin", "cos", "tan", "exp", "tanh")},
}


class Interpreted:
    """A motion evaluated formula by formula in Python numbers.

    Parameters
    ----------
    motion : Motion
        The equations.
    tolerance : float
        Relative tolerance of the integrator.
    """

    def __init__(self, motion: Motion, tolerance: float = 1e-12) -> None:
        self.motion = motion
        self.tolerance = tolerance
        self.lock: AbstractContextManager[None] = nullcontext()

    def apply(self, rule: Rule, y: Vector, p: Vector, tau: float) -> Vector:
        """Value of a rule; nan where it has none."""
        motion, branch = self.motion, 1 + len(p) - self.motion.memory_at.start
        counts: dict[Rule, int] = {
            signs_ahead: len(motion.switches),
            branches_from_rest: 2 * branch,
            rates_at_rest: len(y),
        }
        return _numbers(partial(rule, motion), y, p.tolist(), tau, counts[rule])

    def glide(self, progress: Progress, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
        """Move from grid[0] until the motion sticks, fails or the grid ends (see `Compiled.glide`)."""
        rows, done, tau = [], 1, float(grid[0])
        frozen = partial(self.motion.surfaces, frozen=True)
        while tau < grid[-1]:
            branch = progress.p.tolist()
            signs = progress.p[self.motion.signs_at].copy()

            def rates(tau: float, y: Vector, p: list[float] = branch) -> Vector:
                return _numbers(self.motion.rates, y, p, tau, len(y))

            def guards(tau: float, y: Vector, p: list[float] = branch, signs: Vector = signs) -> Vector:
                return signs * _numbers(frozen, y, p, tau, len(signs))

            ahead = np.concatenate([[tau], grid[done:]])
            reached, y, tau, crossed = advance(rates, guards, y, ahead, progress, self.tolerance)
            rows.append(reached)
            done += len(reached)
            if progress.failure or not crossed:
                break
            moves = progress.count() and settle(self, y, progress.p, tau)
            progress.stuck = not (moves or progress.failure)
            progress.note(tau)
            if not moves:
                break
        return _joined(rows, y), y, tau


def advance(
    rates: Field, guards: Field, y: Vector, grid: Vector, progress: Progress, tolerance: float
) -> tuple[Vector, Vector, float, bool]:
    """Integrate from grid[0] until a guard turns negative or the grid ends.

    Returns the states at the grid points after the first, the last state, its tau, and whether a guard
    ended it.
    """
    rows: list[Vector] = []
    if not np.all(np.isfinite(rates(float(grid[0]), y))):
        # With such a start scipy would never return from choosing its first step.
        progress.failure = "is not finite"
        return _joined(rows, y), y, float(grid[0]), False
    solver = DOP853(rates, grid[0], y, grid[-1], rtol=tolerance, atol=tolerance / 100, max_step=MAX_STEP)
    if not np.isfinite(solver.h_abs):
        solver.h_abs = 1e-6
    done = 1
    while solver.status == "running":
        progress.steps -= 1
        solver.step()
        if progress.steps < 0:
            progress.failure = "needs too many steps"
        elif solver.status == "failed" or not np.all(np.isfinite(solver.y)):
            progress.failure = "is not finite or too steep"
        if progress.failure or not abs(solver.y[0]) < TOO_FAR:
            progress.failure = progress.failure or "grows without bound"
            break
        dense = solver.dense_output()
        crossing = _first_crossing(guards, dense, solver.t_old, solver.t)
        if crossing is not None and np.isnan(crossing):
            progress.failure = "is not finite or too steep"
            break
        reached = int(np.searchsorted(grid, solver.t if crossing is None else crossing, side="right"))
        rows += [dense(grid[done:reached]).T] if reached > done else []
        done = max(done, reached)
        if crossing is not None:
            return _joined(rows, y), np.asarray(dense(crossing)), crossing, True
    return _joined(rows, y), solver.y, float(solver.t), False


def _first_crossing(guards: Field, dense: Any, start: float, end: float) -> float | None:
    """Where a guard first turns negative; nan where it is no number on the way there."""
    before, times = start, start + LOOKS * (end - start)
    for tau, y in zip(times.tolist(), dense(times).T, strict=True):
        crossed = np.flatnonzero(guards(tau, y) < -CROSSED)
        if len(crossed):
            return float(np.min([_root(guards, dense, int(i), before, tau) for i in crossed]))
        before = tau
    return None


def _root(guards: Field, dense: Any, i: int, before: float, after: float) -> float:
    def guard(tau: float) -> float:
        return float(guards(tau, dense(tau))[i])

    if guard(before) <= 0.0:
        return before
    try:
        return float(brentq(guard, before, after, xtol=1e-15, rtol=1e-15))
    except ValueError:
        return np.nan


def _joined(rows: list[Vector], y: Vector) -> Vector:
    return np.concatenate(rows) if rows else np.empty((0, len(y)))


def _numbers(
    function: Callable[..., list[float]], y: Vector, p: list[float], tau: float, count: int
) -> Vector:
    try:
        return np.array(function(y.tolist(), p, tau, functions=PYTHON_FUNCTIONS))
    except (ArithmeticError, ValueError):
        # Overflow or a pole, of which Python's math raises: the integrator sees it as such and ends there.
        return np.full(count, np.nan)


@lru_cache(maxsize=128)
def interpreted(forces: tuple[Force, ...], tolerance: float = 1e-12) -> Interpreted:
    """The motion under these forces for scipy."""
    return Interpreted(Motion(forces), tolerance)
