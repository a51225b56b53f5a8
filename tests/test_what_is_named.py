"""Names of a discovery: prediction, physics, probability, held coefficients."""

import json

import pytest
from command_line import run, write_csv
from discovery import (
    BASE,
    EFFECTS,
    TIME,
    coefficients_of,
    credible_set,
    exact,
    library,
    model_of,
    searched,
    with_effect,
)
from helpers import W, decay, library_of_formulas
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from sysid_trib import Model, identify, methods
from sysid_trib.discovery.discover import discover
from sysid_trib.discovery.engine.trials import DEFAULTS
from sysid_trib.discovery.fits import credible, errors_off, probabilities
from sysid_trib.errors import UsageError
from sysid_trib.printing.discovery import discovery_json
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.simulation.trajectory import trajectory

VISCOUS = {"zeta": 3e-3}


def found_in(effects, candidates, *, start=0.3, seed=0, base=VISCOUS):
    run = with_effect(effects, seed=seed, base=base, start=start)
    return searched([run], library(*candidates), library(*base))


@pytest.mark.parametrize("cubic", [0.3, -0.5])
def test_a_cubic_spring_is_no_gravity(cubic):
    """Gravity has the coefficient 1; its column fits with another one as well."""
    found = found_in({"epsilon": cubic}, ["gravity", "epsilon"])
    assert found.effects == ("epsilon",)
    assert credible_set(found, "epsilon") == {"epsilon"}


def test_a_pendulum_has_gravity_far_from_its_frequency():
    """A swing of 1.5 rad is slower by an eighth than the frequency to which the coefficient 1 refers."""
    found = found_in({"gravity": 1.0}, ["epsilon", "gravity", "inertia"], start=1.5)
    assert found.effects == ("gravity",)
    assert coefficients_of(found.models[-1])["gravity"] == pytest.approx(1.0, abs=0.01)
    assert errors_off(found.models[-1], "gravity") < 4.0
    assert errors_off(found.models[-1], "zeta") == 0.0


@pytest.mark.slow
def test_a_ripple_of_the_angle_is_not_explained_by_the_residual_of_a_random_force():
    """Springs stand in its place, and the rest is blamed on a random force, which goes with the angle."""
    ripple = library_of_formulas(zeta="2*v", ripple="sin(40*x)")
    angle = trajectory(Model(ripple, {"zeta": 3e-3, "ripple": 2e-3}, W), TIME, 0.3, 0.0).angle
    tree = discover(decay(TIME, angle, 1), library("zeta"), library("freeplay", "quintic", "epsilon"))
    assert tree.attrs["search_outcome"] == "unknown effect"
    assert discovery_json(tree)["noise_p_value"] < 0.01
    assert verdict_sentences(tree)[0].startswith("Unknown effect")


@pytest.mark.slow
def test_an_effect_that_the_limit_leaves_out_is_not_unknown():
    run = with_effect({"cubic_damping": 0.2, "even_spring": 1e-2}, seed=8)
    few = EFFECTS.select(["cubic_damping", "even_spring", "bias"])
    tree = discover(run, BASE, few, max_effects=1)
    assert tree.attrs["search_outcome"] == "explained"
    (named,) = tree["steps"].symbol.values
    assert {named, tree.attrs["closing_effect"]} == {"cubic_damping", "even_spring"}
    assert discovery_json(tree)["closing_effect"] == tree.attrs["closing_effect"]
    assert "1 effect was asked for (--max-effects)" in verdict_sentences(tree)[0]


@pytest.mark.slow
def test_effects_excluded_by_the_limit_and_the_library_are_unknown():
    run = with_effect({"cubic_damping": 0.2, "even_spring": 1e-2, "inertia": 0.5}, seed=8)
    few = EFFECTS.select(["cubic_damping", "even_spring"])
    tree = discover(run, BASE, few, max_effects=1)
    assert tree.attrs["search_outcome"] == "unknown effect"
    assert tree.attrs["closing_effect"] == ""


@given(arrays(float, st.integers(1, 30), elements=st.floats(-50.0, 50.0)))
def test_a_credible_set_is_the_smallest_that_is_probable_enough(costs):
    each = probabilities(costs)
    inside = credible(each, DEFAULTS.credible)
    assert each.sum() == pytest.approx(1.0)
    assert each[inside].sum() >= DEFAULTS.credible - 1e-12
    # Without its least probable member it is not.
    assert each[inside].sum() - each[inside].min() < DEFAULTS.credible
    assert each[inside].min() >= each[~inside].max(initial=0.0)


def test_a_likely_rival_is_in_the_set():
    """Gravity and a cubic force are the same at small amplitude."""
    base = {"zeta": 3e-3}
    run = with_effect({"gravity": 1.0}, seed=0, base=base)
    found = searched([run], library("epsilon", "gravity", "nu", "cubic_damping"), library(*base))
    (name,) = found.effects
    assert credible_set(found, name) == {"epsilon", "gravity"}


@pytest.mark.slow
def test_two_effects_do_not_replace_each_other_endlessly():
    base = {"lambda": 1.7e-4, "zeta": 0.005, "nu": 0.22}
    run = with_effect({"dahl": 3e-4}, seed=0, base=base, shapes={"dahl.s": 0.042})
    found = searched([run], EFFECTS.select(["dahl", "lugre"]), library(*base))
    (name,) = found.effects
    assert "dahl" in credible_set(found, name)
    assert found.converged
    # One before the effect, one after it, and no more than one exchange.
    assert len(found.screenings) <= 3


FORCES = {"zeta": 4e-3, "gravity": 1.0, "lambda": 2e-3}


@pytest.fixture(scope="module")
def pendulum():
    return decay(TIME, exact(model_of(FORCES), start=1.2), 1)


@pytest.fixture(scope="module")
def found(pendulum):
    start, offered = library("zeta", "gravity"), library("lambda", "delta")
    return discover(pendulum, start, offered, constraints={"gravity": 1.0}, refit=True)


def test_a_fixed_force_stays_and_the_others_are_found(found):
    after = found["after"].to_dataset()
    values = dict(zip(after.force.values, after.coefficient.values, strict=True))
    errors = dict(zip(after.force.values, after.standard_error.values, strict=True))
    assert found["steps"].symbol.values.tolist() == ["lambda"]
    assert found.attrs["search_outcome"] == "explained"
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


def test_only_forces_of_the_model_are_fixed(pendulum):
    with pytest.raises(UsageError, match="No force 'gravity' of the model can be held"):
        discover(pendulum, library("zeta"), library("lambda"), constraints={"gravity": 1.0})
    with pytest.raises(UsageError, match="Every force of the start model is fixed"):
        discover(pendulum, library("zeta"), library("lambda"), constraints={"zeta": 0.01})


@pytest.mark.slow
def test_the_command_fixes_the_forces_of_the_system(pendulum, tmp_path):
    path = write_csv(tmp_path / "swing.csv", pendulum.time.values, pendulum.angle.values)
    asked = ("--system", "pendulum", "--forces", "lambda,zeta", "--max-effects", "0", "--json")
    model = json.loads(run("discover", path, *asked).out)["model"]
    assert model["coefficients"]["gravity"] == {"value": 1.0, "standard_error": 0.0, "constraint": "fixed"}
    assert list(model["coefficients"]) == ["lambda", "zeta", "gravity"]
