"""Cross-check, residuals and agreement of runs of results with a random force."""

import numpy as np
import pytest
from helpers import density_that_wanders, measured, sentences_of

import sysid_trib as st
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.printing.identification import identification_blocks
from sysid_trib.printing.verdict import runs_json, runs_sentences

W, NOISE = 8.87, 2e-4
FORCES = st.load_library("contact_forces").select(["zeta", "delta"])
MODEL = st.Model(FORCES, {"zeta": 5e-5, "delta": 2e-3}, W)
TIME = np.arange(900) * 2.0 * np.pi / W / 60
# Five noise levels of wander at the end.
DENSITY = density_that_wanders(5.0, NOISE, TIME, W)
AUTO, WHITE = Direct(random_force="estimated"), Direct(random_force="off")


def pushed(seed, angle=0.3, density=DENSITY):
    return measured(MODEL, TIME, angle, noise=NOISE, seed=seed, random_force=density)


@pytest.fixture(scope="module")
def record():
    return pushed(1)


@pytest.fixture(scope="module")
def pair(record):
    return [method.identify(record, FORCES) for method in (WHITE, AUTO)]


@pytest.mark.slow
def test_the_error_of_a_difference_knows_the_random_force(record, pair):
    known = pair[1]
    averaged = Averaging(random_force="estimated").identify(record, FORCES)
    compared = st.cross_check(record, averaged, known)["agreement"]
    assert (compared.attrs["errors"], compared.attrs["verdict"]) == ("influence", "agree")
    # If one method is efficient, the variance of the difference is the difference of the variances (Hausman
    # 1978).
    variances = (result.standard_error.values**2 for result in (averaged, known))
    expected = np.sqrt(np.subtract(*variances))
    np.testing.assert_allclose(compared.standard_error[:-1], expected, rtol=0.35)
    off = averaged.assign(coefficient=averaged.coefficient + 8.0 * known.standard_error)
    assert st.cross_check(record, off, known)["agreement"].attrs["verdict"] == "disagree"


@pytest.mark.in_full
def test_p_values_are_those_of_chance_where_the_motion_is_pushed():
    methods, p_values = (Averaging(random_force="estimated"), AUTO), []
    for seed in range(20):
        record = pushed(100 + seed)
        compared = st.cross_check(record, *(m.identify(record, FORCES) for m in methods))["agreement"]
        assert compared.attrs["errors"] == "influence"
        p_values.append(compared.p_value.item())
    assert min(p_values) > 1e-3
    assert np.mean(np.array(p_values) < 0.5) > 0.15


def test_the_residual_beside_a_random_force_is_the_innovation(record, pair):
    compared = st.cross_check(record, *pair)["judged"]
    free, known = (compared.isel(model=at) for at in range(2))
    innovations = st.validation.innovations(record, pair[1])
    assert known.tested_rms == innovations.innovation_rms
    assert known.tested_over_noise == pytest.approx(1.0, abs=0.1)
    assert known.p_value > 1e-3
    assert np.isnan(known.departure_time)
    # The wander that a free motion leaves.
    assert free.tested_over_noise > 1.2
    assert free.p_value < 1e-3


def test_two_methods_with_a_random_force_agree(record):
    start = {"start": MODEL, "random_force": "estimated"}
    pair = [st.identify(record, FORCES, method) for method in (Trajectory(**start), AUTO)]
    tree = st.cross_check(record, *pair)
    assert tree["agreement"].attrs["verdict"] == "agree"
    assert np.all(tree["judged"].tested_over_noise < 1.1)


def quiet(periods, per_period, seed):
    time = np.arange(periods * per_period) * 2.0 * np.pi / W / per_period
    return measured(MODEL, time, noise=NOISE, seed=seed)


@pytest.mark.slow
def test_runs_of_one_experiment_agree_in_forces_and_in_the_random_force():
    runs = [pushed(seed, angle) for seed, angle in ((2, 0.3), (3, 0.25))]
    together = st.identify(runs, FORCES, AUTO)
    found = st.validation.run_agreement(runs, together)
    assert (found.attrs["verdict"], found.attrs["density_verdict"]) == ("agree", "agree")
    assert found.random_force_density.dims == ("run",)
    assert "random force" in [*runs_sentences(found)][-1]
    assert runs_json(found)["random_force"]["density_verdict"] == "agree"
    # By errors that do not know the random force they disagree.
    unknowing = st.validation.run_agreement(runs, WHITE.identify(runs, FORCES))
    assert "density_verdict" not in unknowing.attrs
    assert unknowing.attrs["verdict"] == "disagree"


@pytest.mark.slow
def test_a_random_force_that_grew_is_said():
    runs = [pushed(2), pushed(3, density=9.0 * DENSITY)]
    found = st.validation.run_agreement(runs, st.identify(runs, FORCES, AUTO))
    assert found.attrs["density_verdict"] == "disagree"
    assert [*runs_sentences(found)][-1].startswith("The size of the random force differs")


@pytest.mark.slow
def test_a_record_too_short_to_tell_the_noises_apart_is_named():
    record = quiet(4, 15, 1)
    pair = [st.identify(record, FORCES, method(random_force="estimated")) for method in (Averaging, Direct)]
    sentences = sentences_of(identification_blocks(st.cross_check(record, *pair)))
    assert any("No random force was found" in text for text in sentences)
    assert any("to separate a random force from the sensor's noise" in text for text in sentences)
