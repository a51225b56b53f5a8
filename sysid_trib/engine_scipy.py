"""Motion by Runge-Kutta (scipy's DOP853), restarted at every switching: slower, and the check."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from sysid_trib.forces import Force
from sysid_trib.motion import Functions, Motion, Run, Vector, motion_of
from sysid_trib.sticking import settle

# Where a step is looked at for a switching; close to its start, where the motion just left one.
LOOKS = (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
PLAIN: Functions = {
    "sign": lambda u: float((u > 0) - (u < 0)),
    "abs": abs,
    "min": min,
    "max": max,
    "power": lambda base, exponent: _real(base**exponent) if base or exponent > 0 else math.inf,
    "log": lambda u: math.log(u) if u > 0 else -math.inf,
    "sqrt": lambda u: math.sqrt(max(u, 0.0)),
    **{name: getattr(math, name) for name in ("sin", "cos", "tan", "exp", "tanh")},
}


class Interpreted:
    """A motion evaluated formula by formula in Python numbers."""

    def __init__(self, motion: Motion, rtol: float = 1e-12, atol: float = 1e-14) -> None:
        self.motion = motion
        self.rtol, self.atol = rtol, atol

    def rates(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Derivative of `y` on the branch of the signs in `p`."""
        return np.array(self.motion.rates(y.tolist(), p.tolist(), tau, PLAIN))

    def surfaces(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Value of each switching surface."""
        return np.array(self.motion.surfaces(y.tolist(), p.tolist(), tau, PLAIN))

    def replaced(self, y: Vector, p: Vector, tau: float) -> Vector:
        """Memory after a reversal."""
        return np.array(self.motion.replaced(y.tolist(), p.tolist(), tau, PLAIN))

    def glide(self, run: Run, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
        """Move from grid[0] until the motion sticks, fails or the grid ends (see `Compiled.glide`)."""
        tau, rows = float(grid[0]), []
        at = self.motion.signs_at
        while tau < grid[-1]:
            branch = run.p.tolist()

            def rates(tau: float, y: Vector, p: list[float] = branch) -> list[float]:
                return self.motion.rates(y.tolist(), p, tau, PLAIN)

            def guards(tau: float, y: Vector, p: list[float] = branch) -> Vector:
                values = self.motion.surfaces(y.tolist(), p, tau, PLAIN, frozen=True)
                return np.array([s * g for s, g in zip(p[at], values, strict=True)])

            found, y, tau, fired = advance(rates, guards, y, grid[grid > tau], tau, self, run)
            rows.append(found)
            if run.failure or not fired:
                break
            if not (run.count() and settle(self, y, run.p, tau)):
                run.stuck = not run.failure
                break
            run.note(tau)
        return np.concatenate(rows) if rows else np.empty((0, len(y))), y, tau


def advance(
    rates: Callable[[float, Vector], list[float]],
    guards: Callable[[float, Vector], Vector],
    y: Vector,
    grid: Vector,
    tau: float,
    tolerance: Any,
    run: Run,
) -> tuple[Vector, Vector, float, bool]:
    """Integrate until a guard turns negative or the grid ends; states at the grid points on the way."""
    solver = DOP853(rates, tau, y, grid[-1], rtol=tolerance.rtol, atol=tolerance.atol)
    rows: list[Vector] = []
    done = 0
    while solver.status == "running":
        run.steps -= 1
        message = solver.step()
        if solver.status == "failed" or run.steps < 0 or not np.all(np.isfinite(solver.y)):
            run.failure = "needs too many steps" if run.steps < 0 else f"is not finite ({message})"
            break
        dense = solver.dense_output()
        end = _first_crossing(guards, dense, solver.t_old, solver.t)
        upto = int(np.searchsorted(grid, solver.t if end is None else end, side="right"))
        rows += [dense(grid[done:upto]).T] if upto > done else []
        done = upto
        if end is not None:
            return _joined(rows, y), np.asarray(dense(end)), end, True
    return _joined(rows, y), solver.y, float(solver.t), False


def _first_crossing(
    guards: Callable[[float, Vector], Vector], dense: Any, start: float, end: float
) -> float | None:
    before = start
    for part in LOOKS:
        tau = start + part * (end - start)
        values = guards(tau, dense(tau))
        if np.any(values < 0.0):
            roots = []
            for i in np.flatnonzero(values < 0.0):
                if guards(before, dense(before))[i] <= 0.0:
                    roots.append(before)
                else:
                    roots.append(
                        brentq(lambda t, i=i: guards(t, dense(t))[i], before, tau, xtol=1e-15, rtol=1e-15)
                    )
            return float(min(roots))
        before = tau
    return None


def _joined(rows: list[Vector], y: Vector) -> Vector:
    return np.concatenate(rows) if rows else np.empty((0, len(y)))


def _real(value: Any) -> float:
    return value if isinstance(value, float) else math.nan


@lru_cache(maxsize=128)
def interpreted(forces: tuple[Force, ...]) -> Interpreted:
    """The motion under these forces for scipy."""
    return Interpreted(motion_of(forces))
