"""A few of the blind tests of benchmarks/blind, its integrator against exact motions, random records."""

import numpy as np
import pytest
from helpers import decay
from scipy_motion import reference_motion

from benchmarks.blind.confirmation import run
from benchmarks.blind.confirmation_report import hits_of
from benchmarks.blind.draws import shapes
from benchmarks.blind.effects import FORCES, SENSORS, make
from benchmarks.blind.generator import Motion, Oscillator, motion
from sysid_trib import Model, discover, load_library, simulate
from sysid_trib.discovery.engine.trials import DEFAULTS
from sysid_trib.errors import LibraryError
from sysid_trib.forces import ForceLibrary

SIX, CANDIDATES = load_library(), load_library("candidate_effects")
BASE = {"lambda": 2e-4, "zeta": 0.005, "delta": 0.03, "nu": -0.4, "epsilon": 0.3}
W, START, STEP, COUNT = 9.0, 0.4, 2.0 * np.pi / 50.0, 500
TIME = np.arange(COUNT) * STEP / W


def followed(base: dict[str, float], *effects, parts: int | None = None) -> Motion:
    return motion(Oscillator(W, base), effects, START, STEP, COUNT, parts)


def test_five_forces_are_the_reference():
    exact = reference_motion(BASE, W, TIME, (START, 0.0))
    np.testing.assert_allclose(followed(BASE, parts=2).x, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("symbol", [s for s in (*FORCES, *SENSORS) if s not in SIX.symbols])
def test_an_effect_is_the_librarys(symbol):
    """Formulas written by hand against those of the library, each with its own integrator."""
    values = shapes(np.random.default_rng(1), symbol, START, W, TIME[-1])
    effect = None if symbol in SENSORS else make(symbol, values)
    found = followed(BASE, *([(effect, 2e-3)] if effect else []), parts=2 * effect.parts if effect else 2)
    angle = found.x + (2e-3 * SENSORS[symbol](found.x, found.v, TIME) if symbol in SENSORS else 0.0)
    library = ForceLibrary("one more", (*SIX.select(list(BASE)), CANDIDATES[symbol]))
    told = {f"{symbol}.{name}": value for name, value in values.items()}
    ours = simulate(Model(library, BASE | {symbol: 2e-3}, W, told), TIME, START, 0.0)
    # A corner within a step, and a root at rest, are followed less well by steps of a length.
    bar = {"jenkins": 1e-7, "power_damping": 1e-7}.get(symbol, 2e-9)
    np.testing.assert_allclose(angle, ours.angle.values, rtol=0, atol=bar)


# Of the development set: kind, verdict.
BLIND = {
    85: ("nothing white", "nothing missing"),
    87: ("nothing quantised", "nothing missing"),
    74: ("nothing coloured", "nothing missing"),
    81: ("effect >20", "explained"),
    8: ("effect 8-12", "explained"),
    15: ("left out", "unknown effect"),
}
MARKS = {81: pytest.mark.slow, 8: pytest.mark.in_full, 15: pytest.mark.in_full}


@pytest.mark.parametrize("number", [pytest.param(n, marks=MARKS.get(n, ())) for n in BLIND])
def test_a_blind_record_is_named_from_its_files(number):
    row = run(("development", number, DEFAULTS))
    assert "error" not in row, row.get("error")
    assert (row["kind"], row["found"]["verdict"]) == BLIND[number]
    assert row["left_out"] or all(hits_of(row))


def test_a_slope_by_a_shape_that_is_no_number_is_refused(tmp_path):
    """At p = 1 the force v^p has values, but no slope by p where v is negative."""
    place = tmp_path / "own.toml"
    place.write_text(
        '[[force]]\nsymbol = "own"\nformula = "v**p"\n'
        "[force.shape]\np = { default = 1.0, low = 0.1, high = 4.0 }\n"
    )
    time = np.arange(400) / 20.0
    angle = 0.3 * np.exp(-0.05 * time) * np.cos(6.0 * time)
    with pytest.raises(LibraryError, match=r"\(own\): a force or its slope is not finite"):
        discover(decay(time, angle, 1), load_library(place), load_library())
