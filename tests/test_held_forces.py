"""Forces that are always there, as a pendulum's gravity: held in the search, by function and by command."""

import json

import numpy as np
import pytest
from command_line import run
from discovery import TIME, exact, library, model_of
from helpers import W, decay

from sysid_trib import discover, identify, methods
from sysid_trib.errors import UsageError

FORCES = {"zeta": 4e-3, "gravity": 1.0, "lambda": 2e-3}


@pytest.fixture(scope="module")
def pendulum():
    return decay(TIME, exact(model_of(FORCES), start=1.2), 1)


@pytest.fixture(scope="module")
def found(pendulum):
    start, offered = library("zeta", "gravity"), library("lambda", "delta")
    return discover(pendulum, start, offered, constraints={"gravity": 1.0}, refit=True)


def test_a_held_force_stays_and_the_rest_is_found(found):
    after = found["after"].to_dataset()
    values = dict(zip(after.force.values, after.coefficient.values, strict=True))
    errors = dict(zip(after.force.values, after.standard_error.values, strict=True))
    assert found["steps"].symbol.values.tolist() == ["lambda"]
    assert found.attrs["verdict"] == "explained"
    assert (values["gravity"], errors["gravity"]) == (1.0, 0.0)
    assert after.constraint.sel(force="gravity").item() == "fixed"
    assert abs(values["lambda"] - FORCES["lambda"]) < 3.0 * errors["lambda"]
    assert abs(values["zeta"] - FORCES["zeta"]) < 3.0 * errors["zeta"]


def test_its_frequency_is_as_well_known_as_by_direct_identification(pendulum, found):
    direct = identify(pendulum, library(*FORCES), methods.Direct(constraints={"gravity": 1.0}))
    after = found["after"].to_dataset()
    error = float(after.reference_frequency_standard_error)
    assert error == pytest.approx(float(direct.reference_frequency_standard_error), rel=0.1)
    assert abs(float(after.reference_frequency) - W) < 3.0 * error


def test_what_is_no_force_of_the_model_is_not_held(pendulum):
    with pytest.raises(UsageError, match="No force 'gravity' of the model can be held"):
        discover(pendulum, library("zeta"), library("lambda"), constraints={"gravity": 1.0})
    with pytest.raises(UsageError, match="Every force of the start model is held"):
        discover(pendulum, library("zeta"), library("lambda"), constraints={"zeta": 0.01})


@pytest.mark.slow
def test_the_command_holds_what_the_system_has(pendulum, tmp_path):
    path = tmp_path / "swing.csv"
    np.savetxt(path, np.stack([pendulum.time, pendulum.angle], axis=1), "%.9g", ",", header="t,angle (rad)")
    asked = ("--system", "pendulum", "--forces", "lambda,zeta", "--max-effects", "0", "--json")
    model = json.loads(run("discover", path, *asked).out)["model"]
    assert model["coefficients"]["gravity"] == {"value": 1.0, "standard_error": 0.0, "constraint": "fixed"}
    assert list(model["coefficients"]) == ["lambda", "zeta", "gravity"]
