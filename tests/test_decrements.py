"""The classical methods: each on a decay of its own model, what it assumes, and when it does not apply."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import FIVE, Run, W, decay, library_of_formulas, paper_run, rms, rms_range
from hypothesis import given, settings, strategies as st

from sysid_trib import Model, load_library
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.methods import (
    Direct,
    EnergyDecay,
    FeenyLiang,
    FrequencyShift,
    LinearDecrement,
    LogarithmicDecrement,
    QuadraticDecay,
    WindowedERA,
    WuDecrement,
    feeny_liang_decrement,
)
from sysid_trib.simulation.simulate import trajectory

FORCES = load_library()
SEEDS = 30
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
    Case(LogarithmicDecrement(), {"zeta": 0.0097}),
    Case(LinearDecrement(), {"lambda": 2e-3}),
    Case(FeenyLiang(), {"lambda": 1e-3, "zeta": 0.0097}),
    Case(WuDecrement(), {"lambda": 1e-3, "zeta": 0.0097, "delta": 0.037}),
    Case(EnergyDecay(), {"lambda": 1e-3, "zeta": 0.0097}),
    Case(QuadraticDecay(), {"delta": 0.1}),
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
    assert result.attrs["first_order_bias_removed"] == "yes"
    assert np.all(np.abs(gap) <= told + 1e-12 * W)
    assert result.attrs["assumes"] == case.method.scope.assumes


@pytest.mark.in_full
def test_standard_errors_tell_the_scatter(case):
    run, exact = case.run, case.run.angle
    pulls, birge_ratios = [], []
    for seed in range(SEEDS):
        result = case.method.identify(decay(run.time, exact, seed), FORCES)
        gap, told = errors_of(result, case.truth)
        known = told > 0.0
        pulls.append(gap[known] / told[known])
        birge_ratios.append(result.birge_ratio.item())
    low, high = rms_range(SEEDS)
    assert np.all((rms(pulls) > low) & (rms(pulls) < high))
    assert 0.9 < np.mean(birge_ratios) < 1.1


@pytest.mark.slow
def test_symbols_mean_nothing(case):
    renamed = replace(FORCES, forces=tuple(replace(f, symbol=f"f_{f.symbol}") for f in FORCES))
    record = case.run.decay(0)
    one, other = (case.method.identify(record, library) for library in (FORCES, renamed))
    np.testing.assert_array_equal(one.coefficient.values, other.coefficient.values)
    assert other.force.values.tolist() == [f"f_{s}" for s in one.force.values]


def test_several_records_are_refused(case):
    with pytest.raises(UsageError, match="takes one record at a time"):
        case.method.identify([case.run.decay(0)], FORCES)


@pytest.mark.parametrize(
    ("method", "formulas", "sentence"),
    [
        (LogarithmicDecrement(), {"solid": "sign(v)"}, "wants a force of formula 2\\*v, and the library has"),
        (LinearDecrement(), {"viscous": "2*v"}, "wants a force of formula sign\\(v\\)"),
        (FeenyLiang(), {"viscous": "2*v"}, "wants a force of formula sign\\(v\\)"),
        (EnergyDecay(), {"solid": "sign(v)"}, "wants a force of formula 2\\*v"),
        (QuadraticDecay(), {"viscous": "2*v"}, "wants a force of formula v\\*abs\\(v\\)"),
        (WuDecrement(), {"solid": "sign(v)", "mixed": "abs(x)*v"}, "wants a power of the speed beside"),
        (FrequencyShift(), {"viscous": "2*v", "linear": "x"}, "wants a nonlinear conservative force"),
        (WindowedERA(), {"solid": "sign(v)"}, "wants a force of formula 2\\*v"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_does_not_apply_is_told_in_a_sentence(method, formulas, sentence):
    with pytest.raises(DecayError, match=sentence):
        method.identify(paper_run().decay(0), library_of_formulas(**formulas))


def test_a_short_record_is_refused():
    short = paper_run({"zeta": 0.0097}, duration=1.6).decay(0)
    for method in (FeenyLiang(), WuDecrement(), EnergyDecay(), FrequencyShift(), WindowedERA()):
        with pytest.raises(DecayError, match="give a longer record"):
            method.identify(short, FORCES)


def test_a_steady_amplitude_tells_no_shift_of_the_frequency():
    with pytest.raises(DecayError, match="cannot tell these forces apart"):
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


def test_turning_points_that_are_none_are_refused():
    with pytest.raises(DecayError, match="at least three"):
        feeny_liang_decrement([0.3, -0.2])
    with pytest.raises(DecayError, match="do not decay"):
        feeny_liang_decrement([3.0, 1.0, 5.0, 1.0])


@pytest.mark.slow
@settings(deadline=None, max_examples=10)
@given(factor=st.floats(0.1, 4.0), later=st.floats(-100.0, 100.0))
def test_a_larger_swing_scales_what_is_an_angle(factor, later):
    run = paper_run({"lambda": 1e-3, "zeta": 0.0097}, duration=5.0)
    record = run.decay(3)
    scaled = decay(run.time + later, factor * record.angle.values)
    for method in (
        LogarithmicDecrement(correct=False),
        FeenyLiang(correct=False),
        QuadraticDecay(correct=False),
    ):
        one, other = (method.identify(d, FORCES) for d in (record, scaled))
        powers = {"lambda": 1, "zeta": 0, "delta": -1}
        expected = one.coefficient.values * [factor ** powers[s] for s in one.force.values]
        np.testing.assert_allclose(other.coefficient.values, expected, rtol=1e-6, atol=1e-9)


def test_frequency_shift_knows_both_frequencies():
    truth = {"zeta": 0.05, "nu": -0.4, "alpha": 0.1}
    library = FORCES.select(("zeta", "alpha", "nu"))
    found = FrequencyShift(W).identify(paper_run(truth, duration=5.0).decay(), library)
    limit = W * np.sqrt(1.1 - 0.05**2)
    assert found.asymptotic_frequency.item() == pytest.approx(limit, rel=1e-5)
    np.testing.assert_allclose(found.coefficient.values, [0.1, -0.4], rtol=1e-3)
    free = FrequencyShift().identify(paper_run(truth, duration=5.0).decay(), library)
    assert free.asymptotic_frequency.item() == pytest.approx(limit, rel=1e-5)
    # Referred to its own frequency, a conservative force is (w_old/w_new)^2 of what it was.
    assert free.coefficient.item() == pytest.approx(-0.4 / 1.1, rel=1e-3)


def test_wu_takes_any_power_of_the_speed():
    library = library_of_formulas(solid="sign(v)", cubic="v**3", root="sqrt(abs(v))*sign(v)", spring="x**3")
    run = Run(Model(library, {"solid": 5e-4, "cubic": 0.1, "root": 5e-4}, W), paper_run(duration=9.0).time)
    found = WuDecrement().identify(run.decay(), library)
    assert found.force.values.tolist() == ["solid", "cubic", "root"]
    np.testing.assert_allclose(found.coefficient.values, [5e-4, 0.1, 5e-4], rtol=1e-3)


def test_the_correction_takes_off_what_averaging_gets_wrong():
    run = paper_run({"lambda": 2e-3, "zeta": 0.05}, duration=3.0)
    plain, corrected = (EnergyDecay(correct=c).identify(run.decay(), FORCES) for c in (False, True))
    assert plain.attrs["first_order_bias_removed"] == "no"
    gaps = [np.abs(errors_of(r, run.model.coefficients)[0][:2]) for r in (plain, corrected)]
    assert np.all(gaps[1] < 1e-3 * gaps[0])
    np.testing.assert_allclose(
        plain.coefficient.values - corrected.first_order_bias.values, corrected.coefficient.values, rtol=1e-12
    )


def test_the_birge_ratio_of_an_equation_scales_its_own_errors():
    shifted = paper_run({"zeta": 0.0097, "nu": -0.4}, duration=8.0)
    found = LogarithmicDecrement().identify(shifted.decay(0), FORCES)
    assert found.frequency_birge_ratio.item() > 50.0
    assert found.envelope_birge_ratio.item() < 0.1 * found.frequency_birge_ratio.item()
    own = LogarithmicDecrement().identify(paper_run({"zeta": 0.0097}, duration=8.0).decay(0), FORCES)
    assert found.reference_frequency_standard_error > 50.0 * own.reference_frequency_standard_error
    assert found.standard_error.item() < 0.2 * found.frequency_birge_ratio.item() * own.standard_error.item()


@cache
def envelope_only() -> Any:
    return FeenyLiang().identify(paper_run(FIVE).decay(1), FORCES)


def test_what_is_neglected_shows():
    # Quadratic friction passes for negative solid friction and more viscous friction.
    found = envelope_only()
    assert found.envelope_birge_ratio.item() > 5.0
    assert found.coefficient.sel(force="lambda").item() < -1e-4
    assert found.coefficient.sel(force="zeta").item() > 0.013


def test_slow_and_uneven_sampling_do_no_harm():
    random = np.random.default_rng(2)
    time = np.arange(400) / 20.0 + 2e-4 * random.standard_normal(400)
    run = Run(Model(FORCES, {"zeta": 0.0097}, W), np.sort(time))
    found = LogarithmicDecrement().identify(run.decay(4), FORCES)
    direct = Direct(W).identify(run.decay(4), FORCES.select(["zeta"]))
    gap, told = errors_of(found, run.model.coefficients)
    assert np.all(np.abs(gap) < 4.0 * told)
    assert found.standard_error.item() < 1.5 * direct.standard_error.item()


@pytest.mark.parametrize("nu", [-0.2, 0.2])
def test_an_elastic_force_passes_for_quadratic_friction_in_wus_decrement(nu):
    run = paper_run(DAMPED | {"lambda": 1e-5, "nu": nu}, duration=15.0)
    found = WuDecrement().identify(run.decay(0), FORCES)
    gap = found.coefficient.sel(force="delta").item() - DAMPED["delta"]
    assert gap == pytest.approx(-2.0 * DAMPED["zeta"] * nu, rel=0.2)
    assert found.envelope_birge_ratio.item() < 2.0
    assert found.frequency_birge_ratio.item() > 50.0
