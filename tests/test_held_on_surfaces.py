"""Motions held by friction on a surface other than rest: a moving belt."""

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

from sysid_trib import free_decay, simulate
from sysid_trib.errors import SimulationError
from sysid_trib.forces.library import parse_library
from sysid_trib.methods import Direct
from sysid_trib.records.half_sines import envelope
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.motions import integrate
from sysid_trib.validation.residuals import fitted_motion, motion_residual


def shape(**defaults):
    return {
        k: {"default": d, "low": 1e-4, "high": 1.0, "meaning": "of the test"} for k, d in defaults.items()
    }


FORCES = {
    # Dry friction of a belt, friction that falls with the slip, and that of a base that is shaken.
    "mu": {"formula": "sign(v - u)", "shape": shape(u=0.05)},
    "falls": {"formula": "sign(v - u)*exp(-abs(v - u)/s)", "shape": shape(u=0.05, s=0.05)},
    "shaken": {"formula": "sign(v - u*cos(W*t))", "shape": shape(u=0.1, W=0.7)},
    "viscous": {"formula": "v"},
    "gravity": {"formula": "sin(x) - x"},
    # A state that switches against itself.
    "chatters": {"formula": "z", "state": {"z": "v + 0.3 - 5*sign(z)"}},
}
LIBRARY = parse_library({"force": [{"symbol": s, **parts} for s, parts in FORCES.items()]}, "belts.toml")
TAU = np.arange(0.0, 60.0, 0.05)
BELTS = [
    {"falls": 0.1, "viscous": 0.02, "gravity": 1.0},
    {"mu": 0.1, "viscous": 0.02},
    {"shaken": 0.05, "viscous": 0.02},
]


def motion(coefficients, start=(0.3, -0.1), by=(), tau=TAU, **shapes):
    changed = {name.replace("_", ".", 1): value for name, value in shapes.items()}
    return integrate(Model(LIBRARY, coefficients, 1.0, changed), tau, start, by=by)


def belt_speed(coefficients, tau):
    return 0.1 * np.cos(0.7 * tau) if "shaken" in coefficients else 0.05


def by_scipy(coefficients, start=(0.3, -0.1)):
    """The motion by scipy, restarted where it meets the belt, is let go, or turns."""
    c = {**dict.fromkeys(LIBRARY.symbols, 0.0), **coefficients}

    def pull(tau, x, v, way):
        stretch = v - belt_speed(c if c["shaken"] else {}, tau)
        belt = c["mu"] + c["shaken"] + c["falls"] * np.exp(-abs(stretch) / 0.05)
        elastic = -np.sin(x) if c["gravity"] else -x
        return elastic - c["viscous"] * v - way * belt

    def belt(tau):
        if c["shaken"]:
            return 0.1 * np.cos(0.7 * tau), -0.07 * np.sin(0.7 * tau)
        return 0.05, 0.0

    y, tau, way = np.array(start, dtype=float), 0.0, -1.0
    rows = np.full((len(TAU), 2), np.nan)
    while tau < TAU[-1]:
        held = way == 0.0
        rates = (
            (lambda t, y: [belt(t)[0], belt(t)[1]])
            if held
            else (lambda t, y, way=way: [y[1], pull(t, y[0], y[1], way)])
        )
        meets = [lambda t, y, s=s: pull(t, y[0], belt(t)[0], s) - belt(t)[1] for s in (1.0, -1.0)]
        ends = [*meets] if held else [lambda t, y: y[1] - belt(t)[0]]
        for event in ends:
            event.terminal = True
        part = solve_ivp(
            rates, (tau, TAU[-1]), y, "DOP853", rtol=1e-12, atol=1e-13, events=ends, max_step=0.05,
            dense_output=True,
        )  # fmt: skip
        inside = (tau <= TAU) & (part.t[-1] >= TAU)
        rows[inside] = part.sol(TAU[inside]).T
        if part.status == 0:
            break
        assert part.t[-1] > tau
        tau, y = part.t[-1], part.y[:, -1].copy()
        which = next(i for i, times in enumerate(part.t_events) if len(times))
        if held:
            way = (1.0, -1.0)[which]
            y[1] += way * 1e-14
        else:
            y[1] = belt(tau)[0]
            up, down = (pull(tau, y[0], y[1], s) - belt(tau)[1] for s in (1.0, -1.0))
            way = 0.0 if up < 0.0 < down else 1.0 if up > 0.0 else -1.0
            y[1] += way * 1e-14
    return rows


@pytest.mark.parametrize("coefficients", BELTS, ids=str)
def test_a_belt_carries_the_body_and_releases_it(coefficients):
    found = motion(coefficients)
    held = np.abs(found.rows[:, 1] - belt_speed(coefficients, TAU)) < 1e-14
    # Each motion is held for some time and free for some time.
    assert 0.04 < held.mean() < 0.95
    assert np.count_nonzero(np.diff(held.astype(int)) == 1) >= 1
    np.testing.assert_allclose(found.rows[:, :2], by_scipy(coefficients), rtol=0, atol=1e-9)


def test_a_body_on_a_belt_goes_with_it_up_to_the_limit_of_friction():
    found = motion({"mu": 0.2}, (0.0, 0.05), tau=np.linspace(0.0, 3.9, 40))
    np.testing.assert_allclose(found.rows[:, 0], 0.05 * np.linspace(0.0, 3.9, 40), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(found.rows[:, 1], 0.05)
    np.testing.assert_array_equal(found.acceleration, 0.0)


def test_a_state_that_switches_against_itself_is_refused():
    with pytest.raises(SimulationError, match="switches without end"):
        motion({"chatters": 0.1})


def test_friction_of_a_belt_is_identified_about_the_place_to_which_it_pulls():
    """The friction moves the equilibrium by its coefficient; phases count about it."""
    names = {"mu": 0.02, "viscous": 0.02}
    time = np.arange(0.0, 25.0, 0.01)
    angle = simulate(Model(LIBRARY, names, 8.87), time, 0.3).angle.values
    angle += 2e-4 * np.random.default_rng(0).standard_normal(len(time))
    record = free_decay(xr.Dataset({"angle": ("time", angle, {"units": "rad"})}, {"time": time}))
    found = Direct().identify(record, LIBRARY.select(["mu", "viscous"]))
    assert np.all(np.abs(found.coefficient.values - [0.02, 0.02]) < 4.0 * found.standard_error.values)
    left = motion_residual(record, fitted_motion(record, found), envelope(record))
    assert np.sqrt(np.mean(left.residual**2)) == pytest.approx(2e-4, rel=0.1)
    assert left.phase_error < 0.2
