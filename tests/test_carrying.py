import numpy as np
import pytest
from candidates import candidate, force
from scipy.interpolate import CubicSpline

from sysid_trib.errors import DecayError, LibraryError
from sysid_trib.forces.library import parse_library
from sysid_trib.simulation.internal_states import states_along
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import simulate

W = 9.91


def swing(step=0.01, cycles=6.0, decay=0.02):
    """A damped motion with its exact rate dx/dtau."""
    tau = np.arange(0.0, cycles * 2 * np.pi, step)
    envelope = 0.3 * np.exp(-decay * tau)
    return tau, envelope * np.cos(tau), -envelope * (np.sin(tau) + decay * np.cos(tau))


@pytest.mark.parametrize(
    ("s", "rate", "worst"), [(0.3, 100, 1e-6), (0.01, 100, 1e-4), (0.01, 1000, 1e-8), (1e-3, 1000, 1e-6)]
)
def test_dahl_state_is_the_simulators(s, rate, worst):
    library = parse_library(
        {"force": [{"symbol": "zeta", "formula": "2*v"}, {"symbol": "dahl", **as_data("dahl")}]}, "test"
    )
    shapes = {"dahl.s": s}
    time = np.arange(0.0, 10.0, 1 / rate)
    run = simulate(Model(library, {"zeta": 0.01, "dahl": 0.005}, W, shapes), time)
    carried = states_along(library["dahl"], W * time, run.angle.values, run.rate.values / W, shapes)
    assert np.abs(carried["z"] - run["dahl.z"].values).max() < worst


def as_data(symbol):
    from candidates import CANDIDATES

    return CANDIDATES[symbol]


def test_jenkins_follows_the_rule_of_its_reversals():
    tau, x, v = swing()
    found = candidate("jenkins")
    hidden = states_along(found, tau, x, v)
    h = found.value(x, v, hidden=hidden)
    # Stepping the elastic-sliding rule through the samples knows no reversals, and is exact to a sample.
    stepped = np.zeros_like(x)
    for i in range(1, len(x)):
        stepped[i] = np.clip(stepped[i - 1] + x[i] - x[i - 1], -0.02, 0.02)
    assert np.abs(h - stepped).max() < 2e-5
    turns = np.abs(hidden["xr"][np.flatnonzero(np.diff(hidden["xr"])) + 1])
    np.testing.assert_allclose(
        turns, 0.3 * np.exp(-0.02 * np.pi * np.arange(1, 13)) / np.sqrt(1 + 4e-4), rtol=1e-3
    )


def test_masing_hysteresis_closes_its_loops():
    tau, x, v = swing(decay=0.0)
    found = candidate("masing")
    h = found.value(x, v, hidden=states_along(found, tau, x, v))
    period = CubicSpline(tau, h)
    np.testing.assert_allclose(period(np.pi + tau[:600]), period(3 * np.pi + tau[:600]), atol=2e-5)


def test_stiff_state_costs_no_more_steps():
    tau, x, v = swing(step=0.1)
    z = states_along(candidate("dahl"), tau, x, v, {"dahl.s": 1e-4})["z"]
    sliding = np.abs(v) > 0.1
    np.testing.assert_allclose(z[sliding][5:], np.sign(v)[sliding][5:], atol=1e-9)


def test_state_and_memory_together():
    tau, x, v = swing()
    found = force("z + m", state={"z": "v - (z - x)"}, memory={"m": "z"}, start={"z": "x"})
    hidden = states_along(found, tau, x, v)
    np.testing.assert_allclose(hidden["z"], x, atol=1e-7)
    reference = states_along(force("m", memory={"m": "x"}), tau, x, v)
    np.testing.assert_allclose(hidden["m"], reference["m"], atol=1e-7)


def test_time_reaches_the_states():
    tau, x, v = swing()
    found = force("z", state={"z": "t"})
    z = states_along(found, tau, x, v, time=tau / W)["z"]
    np.testing.assert_allclose(z, tau**2 / (2 * W), atol=1e-9)


def test_a_force_without_past_carries_nothing():
    assert states_along(candidate("magnet"), [0.0], [0.0], [0.0]) == {}


@pytest.mark.parametrize(
    ("tau", "x"),
    [
        ([0, 1, 2], [0, 1, 2]),
        ([0, 1, 1, 2], [0, 1, 2, 3]),
        ([0, 1, 2, 3], [0, 1, 2]),
        ([0, 1, 2, 3], [0, np.nan, 1, 2]),
    ],
)
def test_bad_motions_are_refused(tau, x):
    with pytest.raises(DecayError, match="'dahl' depends on history"):
        states_along(candidate("dahl"), tau, x, x)


def test_exploding_hidden_variables_are_refused():
    tau, x, v = swing(cycles=200.0, step=0.1)
    with pytest.raises(LibraryError, match="Force 'g'"):
        states_along(force("m", memory={"m": "9*m*m + 1"}), tau, x, v)
    with pytest.raises(LibraryError, match="Force 'g'"):
        states_along(force("z", state={"z": "1 + 9*z*z"}), tau, x, v)
