"""Cross-check, residuals and agreement of runs of results with a random force."""

import numpy as np
import pytest
from helpers import density_that_wanders, measured, sentences_of

import sysid_trib as st
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.printing.identification import identification_blocks
from sysid_trib.printing.verdict import runs_json, runs_sentences
from sysid_trib.validation.residuals import FollowedRuns
from sysid_trib.validation.simulated_pairs import PERIODS_PER_STRETCH, compared_part

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
@pytest.mark.simulated_pairs
def test_records_of_a_result_with_a_random_force_are_pushed(record, pair):
    free, known = pair
    compared = st.cross_check(record, free, known, draws=16)["comparison"]
    # Two forces and the frequency: eight records are the fewest, and enough where they leave no doubt.
    assert compared.attrs["simulated_records"] == 8
    assert compared.p_value > 0.1
    off = free.assign(coefficient=free.coefficient + 8.0 * known.standard_error)
    doubtful = st.cross_check(record, off, known, draws=16)["comparison"]
    assert doubtful.attrs["simulated_records"] == 16
    assert doubtful.attrs["verdict"] == "disagree"
    # Records with the sensor's noise alone let the difference scatter far less.
    unknowing = known.drop_vars([n for n in known.data_vars if n.startswith("random_force")])
    quiet = st.cross_check(record, free, unknowing, draws=16)["comparison"]
    drawn, rest = (c.standard_error.sel(quantity="delta").item() for c in (compared, quiet))
    assert compared.attrs["errors"] == "simulated"
    assert drawn > 2.0 * rest


def test_the_residual_beside_a_random_force_is_the_innovation(record, pair):
    compared = st.cross_check(record, *pair, draws=8)["comparison"]
    free, known = (compared.isel(model=at) for at in range(2))
    innovations = st.validation.innovations(record, pair[1])
    assert known.residual_rms == innovations.innovation_rms
    assert known.residual_over_noise == pytest.approx(1.0, abs=0.1)
    assert known.residual_p_value > 1e-3
    assert np.isnan(known.departure_time)
    # The wander that a free motion leaves.
    assert free.residual_over_noise > 1.2
    assert free.residual_p_value < 1e-3


def test_two_methods_with_a_random_force_agree(record):
    start = {"start": MODEL, "random_force": "estimated"}
    pair = [st.identify(record, FORCES, method) for method in (Trajectory(**start), AUTO)]
    compared = st.cross_check(record, *pair, draws=8)["comparison"]
    assert compared.attrs["verdict"] == "agree"
    assert np.all(compared.residual_over_noise < 1.1)


def quiet(periods, per_period, seed):
    time = np.arange(periods * per_period) * 2.0 * np.pi / W / per_period
    return measured(MODEL, time, noise=NOISE, seed=seed)


@pytest.mark.slow
def test_a_long_record_is_compared_on_stretches():
    record = quiet(130, 40, 0)
    pair = [st.identify(record, FORCES, method) for method in (Averaging(), Direct())]
    tree = st.cross_check(record, *pair, draws=8)
    compared = tree["comparison"]
    stretch = PERIODS_PER_STRETCH * 2.0 * np.pi / W
    assert compared.attrs["compared_stretch"] == pytest.approx(stretch, rel=1e-3)
    assert any(
        "compared on stretches of 14.2 s" in text for text in sentences_of(identification_blocks(tree))
    )
    parts, _ = compared_part([FollowedRuns({0: record}, result) for result in pair])
    assert [len(run.time) for run in parts[0].runs.values()] == pytest.approx([800] * 3, abs=1)
    assert parts[0].runs[2].time[-1] == record.time[-1]
    found, other = (part.result.coefficient.values for part in parts)
    assert compared.difference.values[:-1] == pytest.approx(found - other, rel=1e-2)
    # What is left of the record is judged on all of it.
    assert tree["record"].sizes["time"] == record.sizes["time"]


@pytest.mark.slow
def test_runs_of_one_experiment_agree_in_forces_and_in_the_random_force():
    runs = [pushed(seed, angle) for seed, angle in ((2, 0.3), (3, 0.25))]
    together = st.identify(runs, FORCES, AUTO)
    found = st.validation.run_agreement(runs, together)
    assert (found.attrs["verdict"], found.attrs["density_verdict"]) == ("agree", "agree")
    assert found.random_force_density.dims == ("run",)
    assert "random force" in [*runs_sentences(found)][-1]
    assert runs_json(found)["random_force"]["verdict"] == "agree"
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
    sentences = sentences_of(identification_blocks(st.cross_check(record, *pair, draws=3)))
    assert any("No random force is found" in text for text in sentences)
    assert any("to tell a random force from the sensor's noise" in text for text in sentences)
