"""The classical methods: decays of their own model, and cases to which they do not apply."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import FIVE, OWN_MODELS, Run, W, paper_run
from hypothesis import given, settings, strategies as st

from sysid_trib import Model, load_library
from sysid_trib.errors import DecayError
from sysid_trib.methods import FeenyLiang, FrequencyShift, WuDecrement, feeny_liang_decrement
from sysid_trib.simulation.trajectory import trajectory

FORCES = load_library()
DAMPED = {"zeta": 0.0097, "delta": 0.037}


@dataclass(frozen=True)
class Case:
    """A method, and the forces of a decay that it describes."""

    method: Any
    truth: dict[str, float]

    @property
    def run(self) -> Run:
        return paper_run(self.truth, duration=6.0)


CASES = [
    *(Case(kind(), own) for kind, own in OWN_MODELS.items()),
    Case(FrequencyShift(), DAMPED | {"nu": -0.4, "epsilon": 0.3}),
    Case(FrequencyShift(W), DAMPED | {"alpha": 0.1, "nu": -0.4, "epsilon": 0.3}),
]


@pytest.fixture(params=CASES, ids=lambda case: type(case.method).__name__)
def case(request) -> Case:
    return request.param


def errors_of(result, truth) -> tuple[np.ndarray, np.ndarray]:
    """Errors of coefficients and frequency, and their standard errors."""
    symbols = result.force.values.tolist()
    found = np.append(result.coefficient.values, result.reference_frequency.item())
    told = np.append(result.standard_error.values, result.reference_frequency_standard_error.item())
    return found - [*(truth[s] for s in symbols), W], told


def test_without_noise_its_own_model_is_found(case):
    result = case.method.identify(case.run.decay(), FORCES)
    gap, told = errors_of(result, case.truth)
    assert result.first_order_bias_removed
    assert np.all(np.abs(gap) <= told + 1e-12 * W)
    assert result.attrs["assumes"] == case.method.scope.assumes


def test_a_steady_amplitude_determines_no_frequency_shift():
    with pytest.raises(DecayError, match="cannot separate these forces"):
        FrequencyShift().identify(paper_run({"nu": -0.1}, duration=6.0).decay(), FORCES)


@settings(deadline=None, max_examples=25)
@given(
    solid=st.floats(1e-5, 5e-3),
    viscous=st.floats(1e-4, 0.1),
    start=st.floats(0.1, 1.5),
    side=st.sampled_from((-1, 1)),
)
def test_feeny_and_liang_are_exact_at_exact_turning_points(solid, viscous, start, side):
    model = Model(FORCES, {"lambda": solid, "zeta": viscous}, W)
    turns = trajectory(model, np.linspace(0.0, 8.0, 40), side * start).reversals
    turns = np.concatenate([[0.0], turns[turns > 1e-6]])
    points = trajectory(model, turns, side * start).angle
    # The last one may be a stop.
    if len(points) < 5:
        return
    found = feeny_liang_decrement(points[:-1])
    np.testing.assert_allclose(found, (solid, viscous), rtol=1e-9, atol=1e-12)


@cache
def envelope_only() -> Any:
    return FeenyLiang().identify(paper_run(FIVE).decay(1), FORCES)


def test_neglected_forces_bias_the_result():
    # Quadratic friction passes for negative solid friction and more viscous friction.
    found = envelope_only()
    assert found.envelope_birge_ratio.item() > 5.0
    assert found.coefficient.sel(force="lambda").item() < -1e-4
    assert found.coefficient.sel(force="zeta").item() > 0.013


@pytest.mark.parametrize("nu", [-0.2, 0.2])
def test_an_elastic_force_passes_for_quadratic_friction_in_wus_decrement(nu):
    run = paper_run(DAMPED | {"lambda": 1e-5, "nu": nu}, duration=15.0)
    found = WuDecrement().identify(run.decay(0), FORCES)
    gap = found.coefficient.sel(force="delta").item() - DAMPED["delta"]
    assert gap == pytest.approx(-2.0 * DAMPED["zeta"] * nu, rel=0.2)
    assert found.envelope_birge_ratio.item() < 2.0
    assert found.frequency_birge_ratio.item() > 50.0
