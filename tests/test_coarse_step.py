"""A sensor with coarse steps: its rounding error is neither a force nor white noise."""

import numpy as np
import pytest
import xarray as xr
from helpers import decay as decay_of, scores

import sysid_trib as st
from sysid_trib.records.sensor import coarse_step
from sysid_trib.validation.verdict import identifications

TRUTH = {"zeta": 0.003, "delta": 0.10}
STEP = 0.01


def record(seed: int, coefficients: dict[str, float] = TRUTH) -> xr.Dataset:
    """Ninety seconds of a mass on a spring by a sensor of 1 cm, seven steps at first and one at last."""
    random, time = np.random.default_rng(seed), np.arange(0.0, 90.0, 0.02)
    model = st.Model(st.load_library().select(list(coefficients)), coefficients, 4.955)
    exact = random.uniform() + st.simulate(model, time, 0.075).angle.values
    shown = np.round((exact + 2e-4 * random.standard_normal(time.size)) / STEP) * STEP
    return st.free_decay(decay_of(time, shown))


@pytest.fixture(scope="module")
def decay() -> xr.Dataset:
    return record(1)


def verdict(decay: xr.Dataset, forces: list[str]) -> str:
    methods = st.methods.Averaging(random_force="off"), st.methods.Direct(random_force="off")
    results = identifications(decay, st.load_library().select(forces), methods)
    return st.cross_check(decay, *results)["judged"].attrs["verdict"]


@pytest.mark.slow
def test_rounding_alone_is_explained_and_a_missing_force_is_not(decay):
    assert verdict(decay, ["zeta", "delta"]) == "explained"
    assert verdict(decay, ["zeta"]) != "explained"


def test_errors_are_those_of_the_rounding(decay):
    library = st.load_library().select(list(TRUTH))
    (result,) = identifications(decay, library, [st.methods.Averaging()])
    assert np.abs(scores(result, TRUTH)).max() < 3.0
    alone = st.methods.Averaging(random_force="off").identify(decay, library)
    assert (result.standard_error > 1.2 * alone.standard_error).all()


@pytest.mark.parametrize(
    ("step", "noise", "swing", "coarse"),
    [
        (0.01, 2e-4, 0.07, True),
        (0.01, 2e-4, 0.02, True),
        (0.01, 0.006, 0.07, False),
        (1e-4, 1e-5, 0.3, False),
        (0.0, 1e-4, 0.3, False),
    ],
)
def test_a_step_is_coarse_beside_noise_and_motion(step, noise, swing, coarse):
    signal = swing * np.cos(0.05 * np.arange(2000.0)) + noise * np.random.default_rng(0).standard_normal(2000)
    signal = step * np.round(signal / step) if step else signal
    found = coarse_step(xr.Dataset({"angle": ("time", signal)}), float(np.hypot(noise, step / np.sqrt(12.0))))
    assert found == pytest.approx(step if coarse else 0.0)


def test_rounding_is_no_missing_effect():
    candidates = st.load_library("candidate_effects").select(["ambient", "angle_friction"])
    found = st.discover(record(4, {"zeta": 0.004}), st.load_library().select(["zeta"]), candidates)
    assert found.attrs["search_outcome"] == "nothing missing"
