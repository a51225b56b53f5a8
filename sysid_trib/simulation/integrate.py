"""Following a motion from start to end: gliding, sticking, going on, stopping; and checking what came out."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from sysid_trib.errors import SimulationError
from sysid_trib.forces.formulas import NUMPY
from sysid_trib.simulation.engine_scipy import advance
from sysid_trib.simulation.equations import Motion, Progress, Vector
from sysid_trib.simulation.stick_slip import RuleEngine, rates_at_rest, settle

DIVERGED = 1e3  # rad; no pendulum swings there
ON_SURFACE = 1e-8  # how far on the wrong side of a surface a sample may lie
LEAVE = 1e-7  # in tau: how long after the friction is overcome the motion is let go


class DivergenceError(SimulationError):
    """A motion that grows without bound, by whatever engine."""


class Engine(RuleEngine, Protocol):
    """What carries a motion from one rest to the next."""

    @property
    def lock(self) -> AbstractContextManager[Any]:
        """Held by whoever uses the engine; a compiled one has but one integrator."""
        ...

    def glide(self, progress: Progress, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
        """Move from grid[0]: states at the grid points reached after it, the last state and its tau."""
        ...


@dataclass(frozen=True)
class NormalisedMotion:
    """A motion in tau.

    Attributes
    ----------
    y : (grid, variable) array of float
        x, v and states on the grid.
    hidden : dict of str to (grid,) array of float
        States and memory of forces.
    stop : float
        NaN if the motion goes on.
    reversals : array of float
        Where v = 0 switches a force.
    """

    y: Vector
    hidden: dict[str, Vector]
    stop: float
    reversals: Vector


def integrate(engine: Engine, y: Vector, p: Vector, grid: Vector) -> NormalisedMotion:
    """Integrate the motion along a grid.

    Parameters
    ----------
    engine : Engine
        The equations and what integrates them between two rests.
    y, p : array of float
        Variables at the start, and parameters (see `equations`).
    grid : (grid,) array of float
        tau, increasing; the start is its first.

    Returns
    -------
    NormalisedMotion

    Raises
    ------
    SimulationError
        It diverges, switches without end, or fails the check of its samples.
    """
    motion, tau, stop = engine.motion, float(grid[0]), np.nan
    periods = float(grid[-1] - grid[0]) / (2.0 * np.pi)
    switchings = 1000 + int(periods * (50 + 10 * len(motion.switches)))
    progress = Progress(p, budget=switchings, steps=5000 + int(500 * periods))
    rows, done = np.empty((len(grid), len(y))), 1
    rows[0] = y
    progress.stuck = not settle(engine, y, progress.p, tau)
    progress.note(tau)
    while done < len(grid):
        ahead = np.concatenate([[tau], grid[done:]])
        if not progress.stuck:
            known, stop = len(progress.times) - 1, np.nan
            reached, y, tau = engine.glide(progress, y, ahead)
            _check(motion, progress, known, ahead[1 : 1 + len(reached)], reached)
        else:
            stop = tau if np.isnan(stop) else stop
            reached, y, tau = _rest(engine, progress, y, ahead)
        _raise_failure(motion, progress, reached, ahead, y, tau)
        rows[done : done + len(reached)] = reached
        done += len(reached)
        # A motion that came to rest at a grid point may not have reported it.
        passed = int(np.searchsorted(grid, tau, side="right"))
        rows[done:passed] = y
        done = max(passed, done)
    stop = tau if progress.stuck and np.isnan(stop) else stop
    return NormalisedMotion(
        rows, _hidden(motion, progress, rows, grid), float(stop), _reversals(motion, progress)
    )


def _rest(engine: Engine, progress: Progress, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
    """Stay at rest until something pushes harder than friction holds, or to the end."""
    motion, y = engine.motion, y.copy()
    y[1] = 0.0

    def at(hidden: Vector) -> Vector:
        return np.concatenate([y[:2], hidden[:-2]])

    def guards(tau: float, hidden: Vector) -> Vector:
        up, down, *_ = engine.apply(rates_at_rest, at(hidden), progress.p, tau).tolist()
        return np.array([-up, down])

    def rates(tau: float, hidden: Vector) -> Vector:
        up, down, *moves = engine.apply(rates_at_rest, at(hidden), progress.p, tau).tolist()
        # The guards are integrated along so that the steps resolve them.
        return np.array([*moves, -up, down])

    hidden = np.concatenate([y[2:], [0.0, 0.0]])
    time_matters = any(f.holds_time and c != 0.0 for f, c in zip(motion.forces, progress.p, strict=False))
    if not time_matters and (len(y) == 2 or np.all(np.abs(rates(grid[0], hidden)[:-2]) < 1e-14)):
        return np.repeat(y[None], len(grid) - 1, axis=0), y, float(grid[-1])
    tolerance = 1e-10 if len(y) > 2 else 1e-6
    states, hidden, tau, free = advance(rates, guards, hidden, grid, progress, tolerance)
    if free:
        hidden, tau = hidden + LEAVE * rates(tau, hidden), tau + LEAVE
        progress.stuck = not (progress.count() and settle(engine, at(hidden), progress.p, tau))
        progress.note(tau)
    rows = np.repeat(y[None], len(states), axis=0)
    rows[:, 2:] = states[:, :-2]
    return rows, at(hidden), tau


def _check(motion: Motion, progress: Progress, known: int, grid: Vector, rows: Vector) -> None:
    """Every sample must lie on the side of each switching surface on which it was computed."""
    if not motion.switches or not len(rows) or progress.failure:
        return
    ends = np.append(np.searchsorted(grid, progress.times[known + 1 :]), len(grid))
    ends[1:] -= ends[:-1].copy()
    fixed = motion.memory_at.start
    past = np.repeat(progress.past[known:, fixed:], ends, axis=0)
    with np.errstate(all="ignore"):
        values = motion.surfaces(list(rows.T), [*progress.p[:fixed].tolist(), *past.T], grid, NUMPY)
    signs = past.T[motion.signs_at.start - fixed :]
    if any((value * sign).min() < -ON_SURFACE for value, sign in zip(values, signs, strict=True)):
        progress.failure = "left a branch of its forces unnoticed"


def _raise_failure(
    motion: Motion, progress: Progress, rows: Vector, grid: Vector, y: Vector, tau: float
) -> None:
    widest = max(abs(y[0]), np.abs(rows[:, 0]).max(initial=0.0))
    if widest <= DIVERGED and not progress.failure:
        return
    far = np.flatnonzero(np.abs(rows[:, 0]) > DIVERGED)
    when = grid[1 + far[0]] if len(far) else tau
    after = f"{when * progress.p[motion.memory_at.start - 1]:.4g} s after the start"
    if widest > DIVERGED:
        raise DivergenceError(
            f"The motion diverges: |angle| passes {DIVERGED:g} rad by {after}; "
            "mind negative damping and negative stiffness in the coefficients, a far start, and a strong "
            "random force."
        )
    reason = progress.failure or "is not finite"
    raise SimulationError(f"The motion {reason}, {after}; mind forces that switch or are singular there.")


def _hidden(motion: Motion, progress: Progress, rows: Vector, grid: Vector) -> dict[str, Vector]:
    hidden = dict(zip(motion.variables[2:], rows.T[2:], strict=True))
    if motion.memory:
        past = progress.past[np.searchsorted(progress.times, grid, side="right") - 1, motion.memory_at]
        hidden |= dict(zip(motion.memory, past.T, strict=True))
    return hidden


def _reversals(motion: Motion, progress: Progress) -> Vector:
    # Where something changes at v = 0, the sign of v is the first sign.
    if not motion.switches or motion.switches[0].key != "v":
        return np.empty(0)
    sign = progress.past[:, motion.signs_at.start]
    return progress.times[1:][sign[1:] != sign[:-1]]
