"""Exact motions of x'' + x = -(base forces + effects) in tau = w t, by a Runge-Kutta method of its own.

Plain Python: Butcher's method of order 6 from sample to sample, restarted at every v = 0, x = 0 and kink,
where the step is shortened by the secant method until it ends there.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .effects import Effect

# The end of a shortened step, as part of a step.
EXACT = 1e-13


class NoDecayError(Exception):
    """A motion that cannot be followed, or does not decay."""


@dataclass(frozen=True)
class Oscillator:
    """Reference frequency (rad/s) and coefficients of lambda, zeta, delta, nu, epsilon."""

    w: float
    base: dict[str, float]


@dataclass(frozen=True)
class Motion:
    """Angle (rad) and v = x'/w at the samples."""

    x: np.ndarray
    v: np.ndarray


def _step(slope, tau: float, y: list[float], h: float) -> list[float]:
    """One step of Butcher's seven stages, order 6."""
    a = slope(tau, y)
    b = slope(tau + h / 3, [q + h / 3 * i for q, i in zip(y, a, strict=True)])
    c = slope(tau + h * 2 / 3, [q + h * 2 / 3 * i for q, i in zip(y, b, strict=True)])
    d = slope(tau + h / 3, [q + h / 12 * (i + 4 * j - k) for q, i, j, k in zip(y, a, b, c, strict=True)])
    e = slope(
        tau + h / 2,
        [q + h / 16 * (-i + 18 * j - 3 * k - 6 * m) for q, i, j, k, m in zip(y, a, b, c, d, strict=True)],
    )
    f = slope(
        tau + h / 2,
        [q + h / 8 * (9 * j - 3 * k - 6 * m + 4 * n) for q, j, k, m, n in zip(y, b, c, d, e, strict=True)],
    )
    g = slope(
        tau + h,
        [
            q + h / 44 * (9 * i - 36 * j + 63 * k + 72 * m - 64 * o)
            for q, i, j, k, m, o in zip(y, a, b, c, d, f, strict=True)
        ],
    )
    return [
        q + h / 120 * (11 * (i + u) + 81 * (k + m) - 32 * (n + o))
        for q, i, k, m, n, o, u in zip(y, a, c, d, e, f, g, strict=True)
    ]


class _Follower:
    """A motion under way: state, branches of the signs, time."""

    def __init__(self, oscillator: Oscillator, effects: Sequence[tuple[Effect, float]], start: float) -> None:
        self.effects = list(effects)
        self.y = [start, 0.0]
        for effect, _ in self.effects:
            effect.begin(start)
            self.y += effect.origin(start)
        self.kinks = [g for effect, _ in self.effects for g in effect.kinks]
        self.tau, self.w = 0.0, oscillator.w
        base = oscillator.base
        self.five = tuple(base.get(k, 0.0) for k in ("lambda", "zeta", "delta", "nu", "epsilon"))
        self.c = math.copysign(1.0, start)
        self.s = 0.0
        # Random force at present (rad).
        self.kick = 0.0
        self.released()

    def slope(self, tau: float, y: list[float], s: float | None = None) -> list[float]:
        s, c = self.s if s is None else s, self.c
        x, v = y[0], y[1]
        solid, viscous, drag, nu, epsilon = self.five
        pull = (
            self.kick
            - x
            - solid * s
            - 2.0 * viscous * v
            - drag * s * v * v
            - nu * c * x * x
            - epsilon * x * x * x
        )
        found, at = [v, 0.0], 2
        for effect, coefficient in self.effects:
            z = y[at : at + effect.states]
            pull -= coefficient * effect.push(x, v, s, c, tau / self.w, z)
            if effect.flow:
                found += effect.flow(x, v, s, z)
                at += effect.states
        found[1] = pull
        return found

    def released(self) -> bool:
        """Return whether the motion continues from v = 0, and set its branch (Filippov)."""
        up, down = self.slope(self.tau, self.y, 1.0)[1], self.slope(self.tau, self.y, -1.0)[1]
        if up <= 0.0 <= down:
            self.s = 0.0
        elif up > 0.0 and down < 0.0:
            self.s = -math.copysign(1.0, self.y[0])
        else:
            self.s = 1.0 if up > 0.0 else -1.0
        return self.s != 0.0

    def _surfaces(self, y: list[float]) -> list[float]:
        return [y[1] * self.s, y[0] * self.c, *(y[0] - g for g in self.kinks)]

    def advance(self, h: float) -> None:
        """Go on by h, through whatever switches on the way."""
        end = self.tau + h
        for _ in range(40):
            left = end - self.tau
            if left <= 1e-14:
                return
            if self.s == 0.0 and not self.released():
                self.tau = end
                return
            before, y = self._surfaces(self.y), _step(self.slope, self.tau, self.y, left)
            after = self._surfaces(y)
            crossed = [
                at
                for at, (p, q) in enumerate(zip(before, after, strict=True))
                if (q < 0.0 if at < 2 else p * q < 0.0)
            ]
            if not crossed:
                self.y, self.tau = y, end
                return
            part, y, at = min((*self._crossing(at, before[at], left, after[at]), at) for at in crossed)
            self.y, self.tau = y, self.tau + part
            self._switch(at)
        raise NoDecayError("too many switchings in one sample")

    def _crossing(self, at: int, low_value: float, h: float, high_value: float):
        """Time to a surface and the state there (Illinois)."""
        low, high = 0.0, h
        if low_value == 0.0 or (at < 2 and low_value < 0.0):
            # It starts on the surface and returns to it within the step: nearly at rest.
            low = 1e-3 * h
            low_value = self._surfaces(_step(self.slope, self.tau, self.y, low))[at]
            if low_value * high_value >= 0.0:
                return low, _step(self.slope, self.tau, self.y, low)
        middle, y = h, self.y
        for _ in range(60):
            middle = (low * high_value - high * low_value) / (high_value - low_value)
            y = _step(self.slope, self.tau, self.y, middle)
            value = self._surfaces(y)[at]
            if abs(value) < EXACT or abs(high - low) < EXACT * h:
                break
            if value * high_value < 0.0:
                low, low_value, high, high_value = high, high_value, middle, value
            else:
                low_value, high, high_value = low_value / 2.0, middle, value
        return middle, y

    def _switch(self, at: int) -> None:
        if at == 0:
            self.y[1] = 0.0
            for effect, _ in self.effects:
                effect.reverse(self.y[0])
            self.released()
        elif at == 1:
            self.y[0] = 0.0
            self.c = -self.c
        else:
            self.y[0] = self.kinks[at - 2]


def motion(
    oscillator: Oscillator,
    effects: Sequence[tuple[Effect, float]],
    start: float,
    step: float,
    count: int,
    parts: int | None = None,
    kicks: np.ndarray | None = None,
) -> Motion:
    """The motion from rest at `start` (rad), `count` samples `step` apart in tau.

    `kicks` : (sample, part), a random force (rad) in each of the parts of a step.
    """
    follower = _Follower(oscillator, effects, start)
    parts = parts or max([effect.parts for effect, _ in effects], default=1)
    parts = parts if kicks is None else kicks.shape[1]
    x, v = np.empty(count), np.empty(count)
    x[0], v[0] = start, 0.0
    for i in range(1, count):
        for part in range(parts):
            if kicks is not None:
                follower.kick = float(kicks[i, part])
            follower.advance(step / parts)
        x[i], v[i] = follower.y[0], follower.y[1]
        if not abs(x[i]) < 2.0 * abs(start):
            raise NoDecayError("the motion grows")
    return Motion(x, v)
