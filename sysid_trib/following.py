"""Following a motion from start to end: gliding, sticking, going on, stopping; and checking what came out."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from sysid_trib.engine_scipy import advance
from sysid_trib.errors import SimulationError
from sysid_trib.formulas import NUMPY
from sysid_trib.motion import Motion, Run, Vector
from sysid_trib.sticking import Field, depart, settle

FAR = 1e3  # rad; no pendulum swings there
ON_SURFACE = 1e-8  # how far on the wrong side of a surface a sample may lie
LEAVE = 1e-7  # in tau: how long after the friction is overcome the motion is let go


class DivergenceError(SimulationError):
    """A motion that grows without bound, by whatever engine."""


class Engine(Field, Protocol):
    """What carries a motion from one rest to the next."""

    @property
    def lock(self) -> AbstractContextManager[Any]:
        """Held by whoever uses the engine; a compiled one has but one integrator."""
        ...

    def glide(self, run: Run, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
        """Move from grid[0]: states at the grid points reached after it, the last state and its tau."""
        ...


@dataclass(frozen=True)
class Path:
    """A motion in tau: `y` and what forces remember on the grid, the stop (NaN if none), the reversals."""

    y: Vector
    hidden: dict[str, Vector]
    stop: float
    reversals: Vector


def follow(engine: Engine, y: Vector, p: Vector, grid: Vector) -> Path:
    """Follow the motion along `grid`, which increases from 0.

    Raises
    ------
    SimulationError
        It diverges, switches without end, or fails the check of its samples.
    """
    motion, tau, end, stop = engine.motion, 0.0, float(grid[-1]), np.nan
    run = _new_run(motion, p, end)
    rows, done = np.empty((len(grid), len(y))), 1
    rows[0] = y
    run.stuck = not settle(engine, y, run.p, tau)
    run.note(tau)
    while tau < end:
        ahead = np.concatenate([[tau], grid[done:]])
        if not run.stuck:
            known, stop = len(run.history) - 1, np.nan
            found, y, tau = engine.glide(run, y, ahead)
            _check(motion, run, known, ahead[1 : 1 + len(found)], found)
        else:
            stop = tau if np.isnan(stop) else stop
            found, y, tau = _rest(engine, run, y, ahead)
        _raise_failure(motion, run, y, tau)
        rows[done : done + len(found)] = found
        # A motion that came to rest at a grid point may not have reported it.
        reached = int(np.searchsorted(grid, tau, side="right"))
        rows[done + len(found) : reached] = y
        done = max(reached, done + len(found))
    stop = tau if run.stuck and np.isnan(stop) else stop
    return Path(rows, _hidden(motion, run, rows, grid), float(stop), _reversals(motion, run))


def _new_run(motion: Motion, p: Vector, end: float) -> Run:
    periods = end / (2.0 * np.pi)
    switchings = 1000 + int(periods * (50 + 10 * len(motion.switches)))
    return Run(p, budget=switchings, steps=5000 + int(500 * periods))


def _rest(engine: Engine, run: Run, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
    """Stay at rest until something pushes harder than friction holds, or to the end."""
    motion, y, signs = engine.motion, y.copy(), engine.motion.signs_at
    y[1] = 0.0

    def at(hidden: Vector) -> Vector:
        return np.concatenate([y[:2], hidden[: len(y) - 2]])

    def guards(tau: float, hidden: Vector) -> Vector:
        here = at(hidden)
        up, down = (depart(engine, here, run.p, tau, way)[0] for way in (1.0, -1.0))
        return np.array([-up, down])

    def rates(tau: float, hidden: Vector) -> Vector:
        here, p = at(hidden), run.p.copy()
        p[signs] = np.sign(engine.surfaces(here, p, tau))
        # The guards are integrated along so that the steps resolve them.
        return np.concatenate([engine.rates(here, p, tau)[2:], guards(tau, hidden)])

    hidden = np.concatenate([y[2:], [0.0, 0.0]])
    time_matters = any(f.holds_time and c != 0.0 for f, c in zip(motion.forces, run.p, strict=False))
    if not time_matters and np.all(np.abs(rates(grid[0], hidden)[:-2]) < 1e-14):
        return np.repeat(y[None], len(grid) - 1, axis=0), y, float(grid[-1])
    found, hidden, tau, free = advance(rates, guards, hidden, grid, run, 1e-10 if len(y) > 2 else 1e-6)
    if free:
        hidden, tau = hidden + LEAVE * rates(tau, hidden), tau + LEAVE
        run.stuck = not (run.count() and settle(engine, at(hidden), run.p, tau))
        run.note(tau)
    return np.array([at(row) for row in found]).reshape(-1, len(y)), at(hidden), tau


def _check(motion: Motion, run: Run, known: int, grid: Vector, rows: Vector) -> None:
    """Every sample must lie on the side of each switching surface on which it was computed."""
    if not motion.switches or not len(rows) or run.failure:
        return
    times = np.array([time for time, _ in run.history[known:]])
    counts = np.diff(np.searchsorted(grid, times[1:]), prepend=0, append=len(grid))
    past = np.array([p[motion.memory_at.start :] for _, p in run.history[known:]])
    columns = [*run.p[: motion.memory_at.start], *(np.repeat(column, counts) for column in past.T)]
    with np.errstate(all="ignore"):
        values = motion.surfaces(list(rows.T), columns, grid, NUMPY)
    for value, sign in zip(values, columns[motion.signs_at.start :], strict=True):
        if np.any(value * sign < -ON_SURFACE):
            run.failure = "left a branch of its forces unnoticed"


def _raise_failure(motion: Motion, run: Run, y: Vector, tau: float) -> None:
    when = f"{tau * run.p[motion.memory_at.start - 1]:.4g} s after the start"
    if not abs(y[0]) < FAR:
        raise DivergenceError(
            f"The motion diverges: |angle| is beyond {FAR:g} rad {when}; "
            "mind negative damping and negative stiffness in the coefficients."
        )
    if run.failure or not np.all(np.isfinite(y)):
        reason = run.failure or "is not finite"
        raise SimulationError(f"The motion {reason}, {when}; mind forces that switch or are singular there.")


def _hidden(motion: Motion, run: Run, rows: Vector, grid: Vector) -> dict[str, Vector]:
    hidden = dict(zip(motion.variables[2:], rows.T[2:], strict=True))
    if motion.memory:
        at = np.searchsorted([time for time, _ in run.history], grid, side="right") - 1
        past = np.array([p[motion.memory_at] for _, p in run.history])[at]
        hidden |= dict(zip(motion.memory, past.T, strict=True))
    return hidden


def _reversals(motion: Motion, run: Run) -> Vector:
    if not motion.reverses:
        return np.empty(0)
    signs = np.array([p[motion.signs_at.start] for _, p in run.history])
    return np.array([time for time, _ in run.history])[1:][np.diff(signs) != 0.0]
