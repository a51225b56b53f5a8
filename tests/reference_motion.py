"""A reference for the simulator that shares nothing with it: the six forces, DOP853, restarts."""

import numpy as np
from scipy.integrate import solve_ivp


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
