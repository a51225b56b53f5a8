"""Any random record comes to a verdict of discover, or to an error of the package that says why not."""

import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from helpers import decay

from sysid_trib import discover, free_decay, load_library
from sysid_trib.errors import LibraryError, SysidTribError
from sysid_trib.likelihood.trials import is_resonance

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from blind.cases import HIDDEN
from blind.draws import shapes
from blind.effects import SENSORS, STRANGERS, make
from blind.generator import NoDecayError
from blind.seen import CONTACT, offered
from blind.wide_draws import Experiment, draw_experiment

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


def test_states_whose_equations_are_no_number_have_no_frequency(tmp_path):
    place = tmp_path / "own.toml"
    place.write_text(
        '[[force]]\nsymbol = "own"\nformula = "z"\n'
        'state = { z = "min(z, exp(1e99) + (z**2 - 1)*max(v/v*(1e-99 + z), min(0, x)*1e99))" }\n'
        "[force.shape]\np = { default = 1.0, low = 0.1, high = 4.0 }\n"
    )
    (force,) = load_library(place)
    assert not is_resonance(force, "p")
