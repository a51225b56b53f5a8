"""Motion by Runge-Kutta (scipy's DOP853), restarted at every switching: the check of the compiled engine.

It evaluates the same formulas in Python's numbers, one by one, and shares no line of integration with it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeAlias

import numpy as np
from scipy.integrate import DOP853, solve_ivp
from scipy.optimize import brentq

from sysid_trib.errors import SimulationError
from sysid_trib.forces.formulas import Functions
from sysid_trib.simulation.model import SMOOTHED, Model, Motion, Values, Vector

LEAVE = 1e-7  # in tau: how long after the friction is overcome the motion is let go


class Progress:
    """A simulation under way: its parameters, when they changed, and how it ended.

    Parameters
    ----------
    p : array of float
        The parameters of the motion, changed in place.
    budget : int
        Switchings it may still take.
    steps : int
        Steps of the integrator it may still take.
    """

    def __init__(self, p: Vector, *, budget: int, steps: int) -> None:
        self.p = p
        self.budget = budget
        self.steps = steps
        self.stuck = False
        self.failure = ""
        self._times: list[float] = []
        self._past: list[bytes] = []

    @property
    def times(self) -> Vector:
        """When the parameters changed, in tau."""
        return np.array(self._times)

    @property
    def past(self) -> Vector:
        """The parameters from each of `times` on."""
        return np.frombuffer(b"".join(self._past)).reshape(-1, len(self.p))

    def note(self, tau: float) -> None:
        """Note the parameters from `tau` on."""
        self._times.append(tau)
        self._past.append(self.p.tobytes())

    def count(self) -> bool:
        """Take one switching from the budget; False if it is spent."""
        self.budget -= 1
        if self.budget < 0:
            self.failure = "switches without end"
        return self.budget >= 0


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


def surfaces(
    motion: Motion, y: Values, p: Values, tau: Any, functions: Functions, *, frozen: bool = False
) -> list[Any]:
    """Value of each switching surface."""
    return [motion.surface(s, y, p, tau, functions, frozen=frozen) for s in motion.switches]


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
    values = surfaces(motion, y, p, tau, functions)
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
    values = surfaces(motion, y, before, tau, functions)
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
    return [functions["sign"](u) for u in surfaces(motion, y, p, tau, functions)]


def _by_nearness(values: Values, near: Values, far: Values, functions: Functions) -> list[Any]:
    """Of each surface the first sign if it is near, else the second."""
    distances = [functions["abs"](u) - NEAR_SURFACE for u in values]
    return [functions["below"](*choice) for choice in zip(distances, near, far, strict=True)]


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
        frozen = partial(surfaces, self.motion, frozen=True)
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


def integrate(engine: Interpreted, y: Vector, p: Vector, grid: Vector) -> NormalisedMotion:
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
            stop = np.nan
            reached, y, tau = engine.glide(progress, y, ahead)
        else:
            stop = tau if np.isnan(stop) else stop
            reached, y, tau = _rest(engine, progress, y, ahead)
        if progress.failure:
            raise SimulationError(f"The motion {progress.failure}.")
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


def _rest(engine: Interpreted, progress: Progress, y: Vector, grid: Vector) -> tuple[Vector, Vector, float]:
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


def scipy_motion(model: Model, time: Vector, angle: float = 0.3, rate: float = 0.0) -> NormalisedMotion:
    """Motion of a model at times (s) from an angle (rad) and a rate (rad/s); `stop`, `reversals` in s."""
    w, engine = model.reference_frequency, Interpreted(Motion(model.forces))
    y, p = engine.motion.start(model, angle, rate / w)
    found = integrate(engine, y, p, w * (time - time[0]))
    stop, reversals = time[0] + found.stop / w, time[0] + found.reversals / w
    return NormalisedMotion(found.y * np.where(np.arange(len(y)) == 1, w, 1.0), found.hidden, stop, reversals)


# Further from the package still: the six forces written by hand, and no formula of its own.
def reference_motion(coefficients, w, time, start=(0.3, 0.0), rtol=1e-12):
    """Angle (rad) at `time` (s, from 0), integrated anew from every zero of v and of x."""
    c = {k: coefficients.get(k, 0.0) for k in ("lambda", "zeta", "delta", "alpha", "nu", "epsilon")}

    def push(x, v, sv, sx):
        friction = c["lambda"] * sv + 2 * c["zeta"] * v + c["delta"] * sv * v * v
        return -x - friction - c["alpha"] * x - c["nu"] * sx * x * x - c["epsilon"] * x**3

    grid, y, tau = w * np.asarray(time), np.array([start[0], start[1] / w]), 0.0
    angle = np.full(len(grid), np.nan)
    fired = "v" if y[1] == 0.0 else ""
    while tau < grid[-1]:
        if fired == "v":
            y[1] = 0.0
            up, down = push(y[0], 0, 1, np.sign(y[0])), push(y[0], 0, -1, np.sign(y[0]))
            if up <= 0 <= down:
                break
            sv = 1.0 if up > 0 and (down >= 0 or y[0] < 0) else -1.0
        else:
            sv = np.sign(y[1])
        sx = sv if fired == "x" else np.sign(y[0])

        def slows(t, y):
            return y[1]

        def centre(t, y):
            return y[0]

        slows.terminal = centre.terminal = True
        slows.direction, centre.direction = -sv, -sx
        found = solve_ivp(
            lambda t, y, sv=sv, sx=sx: (y[1], push(y[0], y[1], sv, sx)),
            (tau, grid[-1]),
            y,
            "DOP853",
            events=[slows, centre],
            rtol=rtol,
            atol=rtol / 100,
            dense_output=True,
        )
        here = (grid >= tau) & (grid <= found.t[-1])
        angle[here] = found.sol(grid[here])[0]
        y, tau = found.y[:, -1].copy(), found.t[-1]
        fired = "v" if len(found.t_events[0]) else "x"
    angle[grid > tau] = y[0]
    return angle
