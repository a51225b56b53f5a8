"""Motions by Runge-Kutta (scipy's DOP853), anew from every zero of v and of x: the check of the engine.

The six forces are written by hand; nothing of the package is used.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

# Steps in tau in which a motion at rest is looked at.
LOOK = 1e-3


def reference_motion(coefficients, w, time, start=(0.3, 0.0), rtol=1e-12, more=None):
    """Angle (rad) at `time` (s, from 0); `more(x, v, sign of v, sign of x, t)` is added to the six forces."""
    return motion_and_stop(coefficients, w, time, start, rtol, more)[0]


def motion_and_stop(coefficients, w, time, start=(0.3, 0.0), rtol=1e-12, more=None):
    """Return the motion, and its stop time (s)."""
    c = {k: coefficients.get(k, 0.0) for k in ("lambda", "zeta", "delta", "alpha", "nu", "epsilon")}

    def push(tau, x, v, sv, sx):
        friction = c["lambda"] * sv + 2 * c["zeta"] * v + c["delta"] * sv * v * v
        further = more(x, v, sv, sx, tau / w) if more else 0.0
        return -x - friction - c["alpha"] * x - c["nu"] * sx * x * x - c["epsilon"] * x**3 - further

    def held(tau, x):
        """Positive while friction holds it, up and down."""
        up, down = (push(tau, x, 0.0, way, np.sign(x)) for way in (1, -1))
        return min(-up, down)

    grid, y, tau = w * np.asarray(time), np.array([start[0], start[1] / w]), 0.0
    angle = np.full(len(grid), np.nan)
    fired = "v" if y[1] == 0.0 else ""
    while tau < grid[-1]:
        if fired == "v":
            y[1] = 0.0
            if held(tau, y[0]) >= 0.0:
                ahead = np.arange(tau, grid[-1], LOOK) if more else np.empty(0)
                free = np.flatnonzero([held(at, y[0]) < 0.0 for at in ahead])
                if not len(free):
                    break
                rest, tau = tau, brentq(held, ahead[free[0] - 1], ahead[free[0]], (y[0],), xtol=1e-15) + 1e-9
                angle[(grid >= rest) & (grid <= tau)] = y[0]
            up, down = (push(tau, y[0], 0.0, way, np.sign(y[0])) for way in (1, -1))
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
            lambda t, y, sv=sv, sx=sx: (y[1], push(t, y[0], y[1], sv, sx)),
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
    return angle, tau / w if tau < grid[-1] else np.nan
