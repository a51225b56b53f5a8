"""Measured records through the command line; the expected results follow from physics."""

import json

import numpy as np
import pytest
from command_line import run


def identified(*arguments: object) -> dict:
    ending = run("identify", *arguments, "--json")
    assert (ending.status, ending.err) == (0, "")
    return json.loads(ending.out)


def coefficients(found: dict, symbol: str) -> list[float]:
    return [method["coefficients"][symbol]["value"] for method in found["methods"].values()]


def centre(found: dict) -> float:
    return float(found["record"]["free_decay"].split("equilibrium ")[1].split()[0])


def refuted(found: dict) -> bool:
    """Return whether the forces do not explain the record, not even with a random force."""
    return found["verdict"] in ("approximate", "not explained") and found["random_force"] is None


@pytest.mark.slow
def test_a_pendulum_that_swings_far(data_folder):
    """The equilibrium is at pi, gravity softens the swing, the bearing rubs, and gravity is not cubic."""
    path = data_folder / "single_pendulum" / "free_swing.csv"
    found = identified(path, "--window", "15:75", "--forces", "lambda,zeta,delta,epsilon")
    assert centre(found) == pytest.approx(np.pi, abs=2e-3)
    # sin(x) = x - x^3/6: -1/6 to leading order, less at the large angles of this record.
    assert all(-0.18 < epsilon < -0.14 for epsilon in coefficients(found, "epsilon"))
    # With gravity instead of its cubic part, lambda is 0.0038 ± 0.0002.
    for method in found["methods"].values():
        friction = method["coefficients"]["lambda"]
        assert friction["value"] == pytest.approx(3.8e-3, abs=4.0 * friction["standard_error"])
        assert friction["standard_error"] < 5e-4
    assert refuted(found)


@pytest.mark.slow
def test_bob_on_a_string(data_folder):
    record = (data_folder / "string_pendulum" / "run_1.txt", "--forces", "zeta,delta,epsilon")
    assert refuted(identified(*record))
    found = identified(*record, "--random-force", "off")
    for epsilon, delta in zip(coefficients(found, "epsilon"), coefficients(found, "delta"), strict=True):
        assert -0.20 < epsilon < -0.15
        assert 0.010 < delta < 0.020
    assert refuted(found)


@pytest.mark.slow
def test_rolling_ship_model(data_folder):
    path = data_folder / "roll_decay" / "model_test_21337.csv"
    found = identified(path, "--angle", "phi", "--window", "25:", "--forces", "lambda,delta,epsilon")
    for epsilon, delta in zip(coefficients(found, "epsilon"), coefficients(found, "delta"), strict=True):
        assert 0.09 < delta < 0.13
        assert epsilon > 0.0
    # The roll axis: a natural frequency near 2.46 rad/s, 24 periods in a minute.
    assert found["methods"]["direct"]["reference_frequency"] == pytest.approx(2.46, abs=0.02)
    assert refuted(found)


@pytest.mark.in_full
def test_far_beyond_weak_nonlinearity_there_is_a_verdict_or_a_reason(data_folder):
    """The whole record, released at 2.4 rad: no model of the six follows it, and this must be said."""
    path = data_folder / "single_pendulum" / "free_swing.csv"
    assert refuted(identified(path))


@pytest.mark.slow
def test_the_same_model_of_the_ship_has_one_verdict_in_identify_and_discover(data_folder):
    """The search ends with a model that `identify` judges to be approximate: so does discover."""
    path = data_folder / "roll_decay" / "model_test_21337.csv"
    ending = run("discover", path, "--system", "ship", "--json")
    assert (ending.status, ending.err) == (0, "")
    searched = json.loads(ending.out)
    for name, of_search in (("before", searched["start_model"]), ("after", searched["model"])):
        forces = ",".join(of_search["coefficients"])
        found = identified(path, "--system", "ship", "--forces", forces)
        direct, judged = found["judged"]["direct"], searched["judged"][name]
        assert judged["verdict"] == direct["verdict"] == "approximate"
        for size in ("residual_rms", "residual_over_noise", "residual_over_motion", "p_value"):
            assert judged[size] == pytest.approx(direct[size], rel=1e-3)
        assert searched["noise"] == pytest.approx(found["noise"], rel=1e-6)
    assert "The model is approximate" in run("discover", path, "--system", "ship").out.splitlines()[0]
