"""A few of the blind tests of benchmarks/blind, its integrator against exact motions, random records."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy_motion import reference_motion

from sysid_trib import Model, load_library, simulate
from sysid_trib.forces import ForceLibrary

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
import xarray as xr
from blind.cases import HIDDEN
from blind.confirmation import run
from blind.confirmation_report import hits_of
from blind.draws import Experiment, draw_experiment, shapes
from blind.effects import FORCES, SENSORS, STRANGERS, make
from blind.generator import Motion, NoDecayError, Oscillator, motion
from blind.seen import CONTACT, offered
from helpers import decay

from sysid_trib import discover, free_decay
from sysid_trib.errors import LibraryError, SysidTribError

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
    row = run(("development", number, None))
    assert "error" not in row, row.get("error")
    assert (row["kind"], row["found"]["verdict"]) == BLIND[number]
    assert row["left_out"] or all(hits_of(row))


VERDICTS = ("nothing missing", "explained", "unknown effect")
# Samples of all runs together, so that a search takes seconds.
FEW = 900
QUICK, MANY = 4, 16


def random_record(seed: int) -> tuple[Experiment, list[np.ndarray]]:
    """A short experiment of any oscillator with any two effects, weak or strong, in any noise."""
    rng = np.random.default_rng([seed, 17])
    while True:
        experiment = draw_experiment(rng, str(rng.choice(["white", "ar1", "ar2", "pink", "quantised"])))
        if experiment.count * len(experiment.starts) > FEW:
            continue
        start, w, last = experiment.starts[0], experiment.oscillator.w, float(experiment.time[-1])
        chosen = [str(s) for s in rng.choice([*HIDDEN, *STRANGERS], rng.integers(3), replace=False)]
        effects = [(s, p := shapes(rng, s, start, w, last), scale(rng, s, p, start, last)) for s in chosen]
        try:
            return experiment, experiment.measured(effects)
        except (NoDecayError, OverflowError):
            continue


def scale(
    rng: np.random.Generator, symbol: str, values: dict[str, float], start: float, last: float
) -> float:
    """A coefficient with which the effect is between a thousandth and a third of the restoring force."""
    if symbol in SENSORS:
        largest = abs(SENSORS[symbol](start, start, last))
    else:
        push = make(symbol, values).push
        points = ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7))
        largest = max(abs(push(q * start, r * start, 1.0, 1.0, last, [start, start])) for q, r in points)
    return float(np.exp(rng.uniform(np.log(1e-3), np.log(1.0 / 3.0)))) * start / max(largest, 1e-9)


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=[pytest.mark.in_full] * (seed >= QUICK)) for seed in range(MANY)]
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_random_record_has_a_verdict_or_a_reason(seed):
    experiment, angles = random_record(seed)
    base = list(experiment.oscillator.base)
    records = [xr.Dataset({"angle": ("time", angle)}, {"time": experiment.time}) for angle in angles]
    try:
        runs = [free_decay(record) for record in records]
        found = discover(runs, CONTACT.select(base), offered(base, []), max_effects=2)
    except SysidTribError:
        # It says why; anything else that is raised fails.
        return
    assert found.attrs["verdict"] in VERDICTS
    assert np.all(np.isfinite(found["after"].standard_error.values))


def test_a_slope_by_a_shape_that_is_no_number_is_refused(tmp_path):
    """Of v^p at p = 1 the force has values, and its slope by p has none where v is negative."""
    place = tmp_path / "own.toml"
    place.write_text(
        '[[force]]\nsymbol = "own"\nformula = "v**p"\n'
        "[force.shape]\np = { default = 1.0, low = 0.1, high = 4.0 }\n"
    )
    time = np.arange(400) / 20.0
    angle = 0.3 * np.exp(-0.05 * time) * np.cos(6.0 * time)
    with pytest.raises(LibraryError, match=r"\(own\): a force or its slope is not finite"):
        discover(decay(time, angle, 1), load_library(place), load_library())
