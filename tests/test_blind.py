"""A few of the blind tests of benchmarks/blind, and its integrator against exact motions and ours."""

import sys
from pathlib import Path

import numpy as np
import pytest
from reference_motion import reference_motion

from sysid_trib import Model, load_library, simulate
from sysid_trib.forces import ForceLibrary

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from blind.draws import shapes
from blind.effects import FORCES, SENSORS, make
from blind.first_order import Deviations
from blind.generator import Motion, Oscillator, motion
from blind.plan import Planned
from blind.scoring import hit
from blind.study import run

SIX, CANDIDATES = load_library(), load_library("candidate_effects")
BASE = {"lambda": 2e-4, "zeta": 0.005, "delta": 0.03, "nu": -0.4, "epsilon": 0.3}
W, START, STEP, COUNT = 9.0, 0.4, 2.0 * np.pi / 50.0, 500
TIME = np.arange(COUNT) * STEP / W


def followed(base: dict[str, float], *effects, parts: int | None = None) -> Motion:
    return motion(Oscillator(W, base), effects, START, STEP, COUNT, parts)


def test_dry_friction_takes_twice_its_coefficient_each_half_period():
    angle = followed({"lambda": 1e-3}).x
    # 25 samples a half period: every extremum is a sample.
    size = START - 2e-3 * np.arange(20)
    np.testing.assert_allclose(np.abs(angle[::25]), size, rtol=0, atol=1e-8)


def test_viscous_friction_is_the_closed_form():
    zeta = 0.01
    damped = np.sqrt(1.0 - zeta**2)
    tau = W * TIME
    exact = START * np.exp(-zeta * tau) * (np.cos(damped * tau) + zeta / damped * np.sin(damped * tau))
    np.testing.assert_allclose(followed({"zeta": zeta}, parts=2).x, exact, rtol=0, atol=1e-8)


def test_a_conservative_motion_keeps_its_energy():
    found = followed({"nu": -0.4, "epsilon": 0.3}, parts=2)
    x, v = found.x, found.v
    energy = v**2 / 2 + x**2 / 2 - 0.4 * np.abs(x) ** 3 / 3 + 0.3 * x**4 / 4
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)


def test_five_forces_are_the_reference():
    exact = reference_motion(BASE, W, TIME, (START, 0.0))
    np.testing.assert_allclose(followed(BASE, parts=2).x, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("symbol", [s for s in (*FORCES, *SENSORS) if s not in SIX.symbols])
def test_an_effect_is_the_librarys(symbol):
    """Formulas written by hand against those of the library, each with its own integrator."""
    values = shapes(np.random.default_rng(1), symbol, START, W, TIME[-1])
    found = followed(BASE, *([] if symbol in SENSORS else [(make(symbol, values), 2e-3)]))
    angle = found.x + (2e-3 * SENSORS[symbol](found.x, found.v, TIME) if symbol in SENSORS else 0.0)
    library = ForceLibrary("one more", (*SIX.select(list(BASE)), CANDIDATES[symbol]))
    told = {f"{symbol}.{name}": value for name, value in values.items()}
    ours = simulate(Model(library, BASE | {symbol: 2e-3}, W, told), TIME, START, 0.0)
    np.testing.assert_allclose(angle, ours.angle.values, rtol=0, atol=5e-7)


@pytest.mark.parametrize(
    "symbol", ["van_der_pol", "tilted_friction", "wall", "jenkins", "lugre", "resonator", "masing", "ageing"]
)
def test_the_quick_response_is_a_difference_of_motions(symbol):
    values = shapes(np.random.default_rng(2), symbol, START, W, TIME[-1])
    ends = [followed(BASE, (make(symbol, values), q), parts=4).x for q in (1e-5, -1e-5)]
    found = Deviations(Oscillator(W, BASE), START, STEP, COUNT).by_force(make(symbol, values))
    difference = (ends[0] - ends[1]) / 2e-5
    assert np.linalg.norm(found - difference) < 5e-3 * np.linalg.norm(difference)


def blind(key: str) -> dict:
    """A case of the study, named from its files alone."""
    kind, number = key.split("/")
    row = run(Planned(kind, int(number)))
    assert "error" not in row, row["error"]
    return row


@pytest.mark.parametrize(
    "key",
    [
        "nothing white/0",
        pytest.param("nothing coloured/1", marks=pytest.mark.slow),
        pytest.param("nothing quantised/2", marks=pytest.mark.slow),
    ],
)
def test_nothing_is_found_where_nothing_is_hidden(key):
    assert blind(key)["found"]["verdict"] == "nothing missing"


# Damping, even forces, shaking, sensors; white and coloured noise; one run and two.
HIDDEN = {15: "van_der_pol", 42: "even_drag", 38: "ambient", 43: "sensor_curve", 19: "sensor_cubic"}


@pytest.mark.parametrize("number", HIDDEN, ids=HIDDEN.get)
@pytest.mark.in_full
def test_what_is_hidden_is_named_and_its_gap_closes(number):
    row = blind(f"effect 60-300/{number}")
    assert [one["symbol"] for one in row["hidden"]] == [HIDDEN[number]]
    assert row["found"]["verdict"] == "explained"
    assert hit(row)
    assert abs(row["found"]["gap"]) < 0.02


@pytest.mark.slow
def test_what_no_library_holds_is_said_to_be_unknown():
    assert blind("outside 200/0")["found"]["verdict"] == "unknown effect"
