"""An independent engine for the certified decays: nothing of the package is used.

Runge-Kutta of order 8 (scipy's DOP853), anew from every zero of the rate and of the angle, together with
the variational equations. Where friction changes its sign the acceleration jumps, and the sensitivities jump
by the saltation matrix: S+ = S- + (F- - F+) dt, where dt = -S-[rate] / F-[rate] is the change of the time of
the event.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

RTOL, ATOL = 1e-13, 1e-15
STEPS_PER_PERIOD = 40


@dataclass(frozen=True)
class Motion:
    """Angle at the samples, and its derivatives by the unknowns, (sample, unknown)."""

    angle: np.ndarray
    sensitivity: np.ndarray
    unknowns: list[str]

    def bounds(self) -> dict[str, float]:
        """Return the Cramér-Rao bounds for a noise of 1 rad."""
        size = np.linalg.norm(self.sensitivity, axis=0)
        _, triangle = np.linalg.qr(self.sensitivity / size)
        inverse = np.linalg.inv(triangle)
        errors = np.sqrt(np.sum(inverse**2, axis=1)) / size
        return dict(zip(self.unknowns, errors.tolist(), strict=True))


@dataclass(frozen=True)
class Equation:
    """The equation of a decay between two events, with the signs of rate and angle."""

    w: float
    coefficients: dict[str, float]
    s: float
    w_is_unknown: bool
    sign_of_rate: float
    sign_of_angle: float

    def forces(self, x: float, v: float) -> dict[str, tuple[float, float, float]]:
        """Return value, derivative by x and derivative by v of each force."""
        sv, sx = self.sign_of_rate, self.sign_of_angle
        fall = math.exp(-((v / self.s) ** 2)) if self.s else 0.0
        known = {
            "lambda": (sv, 0.0, 0.0),
            "zeta": (2.0 * v, 0.0, 2.0),
            "delta": (sv * v * v, 0.0, 2.0 * sv * v),
            "alpha": (x, 1.0, 0.0),
            "nu": (sx * x * x, 2.0 * sx * x, 0.0),
            "epsilon": (x**3, 3.0 * x * x, 0.0),
            "gravity": (math.sin(x) - x, math.cos(x) - 1.0, 0.0),
            "stribeck": (sv * fall, 0.0, -2.0 * sv * v * fall / self.s**2 if self.s else 0.0),
        }
        return {symbol: known[symbol] for symbol in self.coefficients}

    def acceleration(self, x: float, rate: float) -> float:
        pull = sum(self.coefficients[k] * h[0] for k, h in self.forces(x, rate / self.w).items())
        return -(self.w**2) * (x + pull)

    def __call__(self, t: float, state: np.ndarray) -> np.ndarray:
        """Return the derivative of (x, rate, sensitivities of x, sensitivities of rate)."""
        x, rate = state[:2]
        of_x, of_rate = state[2:].reshape(2, -1)
        w, c, forces = self.w, self.coefficients, self.forces(x, rate / self.w)
        pull = sum(c[k] * h[0] for k, h in forces.items())
        by_x = sum(c[k] * h[1] for k, h in forces.items())
        by_v = sum(c[k] * h[2] for k, h in forces.items())
        direct = [-(w**2) * h[0] for h in forces.values()]
        if self.w_is_unknown:
            direct.append(-2.0 * w * (x + pull) + by_v * rate)
        changes = -(w**2) * (1.0 + by_x) * of_x - w * by_v * of_rate
        changes[: len(direct)] += direct
        return np.concatenate([[rate, -(w**2) * (x + pull)], of_rate, changes])


def motion_and_sensitivities(decay: Any) -> Motion:
    """Return the motion of a decay (`certified.Decay`) and its derivatives by the unknowns of the bound."""
    grid, count = decay.time, len(decay.unknowns)
    state = np.zeros(2 + 2 * count)
    state[:2] = decay.angle, decay.rate
    # The last two unknowns are angle and rate of the start.
    state[2 + count - 2] = state[2 + 2 * count - 1] = 1.0
    s = next(iter(decay.shapes.values()), 0.0)

    def equation(sign_of_rate: float, sign_of_angle: float) -> Equation:
        free = not decay.w_is_given
        return Equation(decay.w, decay.coefficients, s, free, sign_of_rate, sign_of_angle)

    values, t, at_rest = np.full((len(grid), len(state)), np.nan), 0.0, decay.rate == 0.0
    sign_of_angle, before = float(np.sign(decay.angle)), None
    while t < grid[-1]:
        if at_rest:
            state[1] = 0.0
            up, down = (equation(sign, sign_of_angle).acceleration(state[0], 0.0) for sign in (1.0, -1.0))
            if up <= 0.0 <= down:
                break
            sign_of_rate = 1.0 if up > 0.0 else -1.0
        else:
            sign_of_rate = float(np.sign(state[1]))
        current = equation(sign_of_rate, sign_of_angle)
        if at_rest and before is not None:
            jump = before.acceleration(state[0], 0.0) - current.acceleration(state[0], 0.0)
            later = -state[2 + count :] / before.acceleration(state[0], 0.0)
            state[2 + count :] += jump * later

        def turns(t: float, y: np.ndarray) -> float:
            return y[1]

        def crosses(t: float, y: np.ndarray) -> float:
            return y[0]

        turns.terminal = crosses.terminal = True
        turns.direction, crosses.direction = -sign_of_rate, -sign_of_angle
        found = solve_ivp(
            current, (t, grid[-1]), state, "DOP853", events=[turns, crosses], dense_output=True,
            rtol=RTOL, atol=ATOL, max_step=2.0 * np.pi / decay.w / STEPS_PER_PERIOD,
        )  # fmt: skip
        here = (grid >= t) & (grid <= found.t[-1])
        values[here] = found.sol(grid[here]).T
        state, t, before = found.y[:, -1].copy(), found.t[-1], current
        at_rest = len(found.t_events[0]) > 0
        sign_of_angle = -sign_of_angle if len(found.t_events[1]) else sign_of_angle
    # At rest the angle stays where it was, and so do its derivatives.
    values[grid > t] = state
    return Motion(values[:, 0], values[:, 2 : 2 + count], decay.unknowns)
