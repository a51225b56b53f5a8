"""How a small force moves a motion, to first order: quick, for the search of competing effects.

The deviation obeys the motion's own linear equation; two of its solutions are known from the motion, by its
start angle and its start time, and variation of constants gives the rest.
"""

import math

import numpy as np
from scipy.integrate import cumulative_trapezoid

from .effects import Effect
from .generator import Oscillator, motion

# Points from one sample to the next, at which forces are added up.
FINER = 4
# Part of the start angle by which it is changed.
SMALL = 1e-6


class Deviations:
    """Small deviations of one run from rest at `start` (rad), `count` samples `step` apart in tau."""

    def __init__(self, oscillator: Oscillator, start: float, step: float, count: int) -> None:
        fine, points = step / FINER, FINER * (count - 1) + 1
        found, moved = (motion(oscillator, [], q, fine, points) for q in (start, start * (1.0 + SMALL)))
        self.x, self.v = found.x, found.v
        self.tau = fine * np.arange(points)
        self.w = oscillator.w
        base = {k: oscillator.base.get(k, 0.0) for k in ("lambda", "zeta", "delta", "nu", "epsilon")}
        x, v, s, c = self.x, self.v, np.sign(self.v), np.sign(self.x)
        s[0] = -np.sign(start)
        pull = -x - base["lambda"] * s - 2.0 * base["zeta"] * v - base["delta"] * s * v**2
        pull -= base["nu"] * c * x**2 + base["epsilon"] * x**3
        a, da = (moved.x - x) / (start * SMALL), (moved.v - v) / (start * SMALL)
        wronskian = a * pull - v * da
        self.a, self.b = a, v
        self.weights = np.stack([v / wronskian, a / wronskian])

    def by_force(self, effect: Effect) -> np.ndarray:
        """Derivative of the angle at the samples by an effect's coefficient."""
        tau, force = self._along(effect)
        sums = []
        for weight in self.weights:
            whole = cumulative_trapezoid(np.interp(tau, self.tau, weight) * force, tau, initial=0.0)
            # Of two points at one time, both sides of a jump, the sum is the same.
            sums.append(np.interp(self.tau, tau, whole))
        return (self.a * sums[0] - self.b * sums[1])[::FINER]

    def _along(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """The force on the motion, on both sides of each switching too."""
        x, v = self.x.tolist(), self.v.tolist()
        h, kinks = self.tau[1].item(), (0.0, *effect.kinks)
        effect.begin(x[0])
        s, c = -math.copysign(1.0, x[0]), math.copysign(1.0, x[0])
        z = effect.origin(x[0]) if effect.states else []
        at, found = [0.0], [effect.push(x[0], v[0], s, c, 0.0, z)]

        def add(part: float, i: int) -> None:
            p = part * h
            q = x[i] + v[i] * p + 0.5 * (v[i + 1] - v[i]) * part * p
            at.append(i * h + p)
            speed = v[i] + part * (v[i + 1] - v[i])
            found.append(effect.push(q, speed, s, c, at[-1] / self.w, z))

        for i in range(len(x) - 1):
            parts = [(v[i] / (v[i] - v[i + 1]), None)] if v[i + 1] * s < 0.0 else []
            parts += [((g - x[i]) / (x[i + 1] - x[i]), g) for g in kinks if (x[i] - g) * (x[i + 1] - g) < 0.0]
            for part, kink in sorted(parts, key=lambda one: one[0]):
                add(part, i)
                if kink is None:
                    s = -s
                    effect.reverse(x[i] + 0.5 * v[i] * part * h)
                elif kink == 0.0:
                    c = -c
                add(part, i)
            if effect.flow:
                z = _grown(effect, x, v, s, z, i, h)
            add(1.0, i)
        return np.array(at), np.array(found)


def _grown(effect: Effect, x: list, v: list, s: float, z: list, i: int, h: float) -> list:
    """The states a step later (Runge and Kutta), in parts where they are quick."""
    size = h / effect.parts

    def flow(part: float, z: list) -> list:
        q = x[i] + v[i] * part * h + 0.5 * (v[i + 1] - v[i]) * part * part * h
        return effect.flow(q, v[i] + part * (v[i + 1] - v[i]), s, z)

    for k in range(effect.parts):
        here, middle, there = k / effect.parts, (k + 0.5) / effect.parts, (k + 1) / effect.parts
        one = flow(here, z)
        two = flow(middle, [p + 0.5 * size * q for p, q in zip(z, one, strict=True)])
        three = flow(middle, [p + 0.5 * size * q for p, q in zip(z, two, strict=True)])
        four = flow(there, [p + size * q for p, q in zip(z, three, strict=True)])
        z = [
            p + size / 6.0 * (a + 2.0 * b + 2.0 * c + d)
            for p, a, b, c, d in zip(z, one, two, three, four, strict=True)
        ]
    return z
