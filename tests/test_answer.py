"""The answer that predicts: one decision on the noise, errors of noise and model, one method to stand by."""

import json

import numpy as np
import pytest
from command_line import run, write_csv
from helpers import measured

import sysid_trib as st
from sysid_trib.printing.exported import csv_text, latex_text
from sysid_trib.printing.identification import identification_json
from sysid_trib.results.judged import error_parts
from sysid_trib.validation.verdict import identifications

NOISE = 3e-4
TIME = np.arange(0.0, 20.0, 0.02)
FORCES = st.load_library().select(["zeta", "delta", "epsilon"])
TRUTH = {"zeta": 0.008, "delta": 0.03, "epsilon": -0.12}
METHODS = [st.methods.Averaging(), st.methods.Direct()]


def record(library=FORCES, values=TRUTH, seed=0, angle=0.5, random_force=0.0):
    model = st.Model(library, values, 7.0)
    return st.free_decay(measured(model, TIME, angle, noise=NOISE, seed=seed, random_force=random_force))


@pytest.fixture(scope="module")
def incomplete():
    """A record with Stribeck friction that is not offered, and its two identifications."""
    hidden = st.load_library("candidate_effects")["stribeck"]
    library = st.forces.ForceLibrary(FORCES.title, (*FORCES, hidden))
    decay = record(library, TRUTH | {"stribeck": 2e-3})
    return decay, identifications(decay, FORCES, METHODS)


@pytest.fixture(scope="module")
def checked(incomplete):
    return st.cross_check(incomplete[0], *incomplete[1])


def test_where_the_model_is_complete_nothing_is_added():
    decay = record()
    decided, alone = st.identify(decay, FORCES, METHODS[1]), METHODS[1].identify(decay, FORCES)
    assert "error_of_model" not in decided
    assert "random_force_density" not in decided
    np.testing.assert_array_equal(decided.standard_error, alone.standard_error)
    np.testing.assert_array_equal(decided.coefficient, alone.coefficient)


@pytest.mark.slow
def test_a_random_force_is_taken_where_there_is_one():
    decay = record(random_force=2e-3, seed=3)
    results = identifications(decay, FORCES, METHODS)
    assert all(json.loads(result.attrs["options"])["random_force"] == "estimated" for result in results)
    assert results[1].random_force_density == pytest.approx(2e-3, rel=0.6)


def test_a_random_force_that_its_test_refuses_is_not_the_answer(incomplete):
    for result in incomplete[1]:
        assert json.loads(result.attrs["options"])["random_force"] == "off"


def test_errors_have_two_parts(incomplete):
    for result in incomplete[1]:
        noise, model = error_parts(result)
        assert (model > 0.0).any()
        np.testing.assert_allclose(result.standard_error, np.hypot(noise, model), rtol=1e-12)
        np.testing.assert_allclose(np.sqrt(np.diag(result["covariance"])), result.standard_error, rtol=1e-9)
        unit = result.standard_error.values
        assert np.linalg.eigvalsh(result["covariance"].values / np.outer(unit, unit)).min() > -1e-9


def test_a_result_contains_its_parts_and_its_verdict(checked):
    data = identification_json(checked)
    assert data["verdict"] == "approximate"
    assert data["answer"] in data["methods"]
    for method in data["methods"].values():
        for force in method["coefficients"].values():
            total = np.hypot(force["error_of_noise"], force["error_of_model"])
            assert force["standard_error"] == pytest.approx(total)
    table = csv_text(checked)
    assert "record,verdict,,,approximate" in table
    assert "record,samples" in table
    assert "Verdict: approximate" in latex_text(checked)


def test_a_model_that_diverges_is_withheld_everywhere(checked):
    tree = checked.copy(deep=True)
    failure = ("model", ["its motion diverges", ""])
    tree["judged"] = tree["judged"].to_dataset().assign(failure=failure)
    tree["judged"].attrs["preferred"] = "direct"
    data = identification_json(tree)
    assert data["methods"]["averaging"]["coefficients"] == {}
    assert data["methods"]["averaging"]["reference_frequency"] is None
    assert "averaging" not in csv_text(tree)
    assert "averaging" not in latex_text(tree).split("%")[0]


def test_a_system_fixes_signs(tmp_path):
    decay = record(values={"zeta": 0.008, "delta": -0.02, "epsilon": -0.15})
    path = write_csv(tmp_path / "swing.csv", decay.time.values, decay.angle.values)
    done = run("identify", path, "--system", "torsion", "--forces", "zeta,delta,epsilon", "--json")
    for method in json.loads(done.out)["methods"].values():
        assert all(method["coefficients"][symbol]["value"] >= 0.0 for symbol in ("zeta", "delta"))
