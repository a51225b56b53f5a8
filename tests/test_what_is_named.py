"""What a discovery may name: what predicts, what physics allows, the plainest of what is tied."""

import numpy as np
import pytest
from discovery import (
    BASE,
    EFFECTS,
    EVERY,
    TIME,
    coefficients_of,
    credible_set,
    library,
    searched,
    start_model,
    with_effect,
)
from helpers import W, decay, library_of_formulas

from sysid_trib import Model
from sysid_trib.discovery.discover import discover
from sysid_trib.discovery.final_models import Growth, final_of_set
from sysid_trib.discovery.fits import Fits, errors_off
from sysid_trib.discovery.parts import names_in_parts
from sysid_trib.discovery.search import search
from sysid_trib.discovery.unseen import Prediction
from sysid_trib.likelihood.trials import TrialEffect
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.printing.json_results import discovery_json
from sysid_trib.simulation.simulate import trajectory

VISCOUS = {"zeta": 3e-3}


def found_in(effects, candidates, *, start=0.3, seed=0, base=VISCOUS):
    run = with_effect(effects, seed=seed, base=base, start=start)
    return searched([run], library(*candidates), library(*base))


@pytest.mark.parametrize("cubic", [0.3, -0.5])
def test_a_cubic_spring_is_no_gravity(cubic):
    """Of gravity the coefficient is 1: its column fits with another one as well."""
    found = found_in({"epsilon": cubic}, ["gravity", "epsilon"])
    assert found.effects == ("epsilon",)
    assert credible_set(found, "epsilon") == {"epsilon"}


def test_a_pendulum_has_gravity_far_from_its_frequency():
    """At 1.5 rad the swing is slower than the frequency to which the coefficient 1 refers by an eighth."""
    found = found_in({"gravity": 1.0}, ["epsilon", "gravity", "inertia"], start=1.5)
    assert found.effects == ("gravity",)
    assert coefficients_of(found.models[-1])["gravity"] == pytest.approx(1.0, abs=0.01)
    assert errors_off(found.models[-1], "gravity") < 4.0
    assert errors_off(found.models[-1], "zeta") == 0.0


def test_a_magnet_softens():
    found = found_in({"epsilon": 0.3}, ["magnet", "stiffness_drift"])
    assert "magnet" not in found.effects
    assert EVERY["magnet"].passive


def test_a_known_coefficient_is_kept_in_the_text_of_a_library():
    assert EVERY["gravity"].coefficient == 1.0
    assert "coefficient = 1.0" in EFFECTS.select(["gravity"]).to_toml()
    assert "coefficient" not in EFFECTS.select(["bias"]).to_toml()


@pytest.mark.parametrize(("excess", "named"), [(1.9, "epsilon"), (2.1, "quintic")])
def test_what_is_tied_has_the_plainest_name(excess, named):
    """One of the user's own forces stands before a usual candidate that is hardly likelier."""
    start = start_model([with_effect({"epsilon": 0.3}, seed=3, base=VISCOUS)], library("zeta"))
    fits = Fits(start)
    trials = {symbol: [TrialEffect(EVERY[symbol], {})] for symbol in ("epsilon", "quintic")}
    models = {symbol: fits.of(start, (), trial) for symbol, trial in trials.items()}
    costs = {"quintic": 0.0, "epsilon": excess, "": 300.0}
    final = final_of_set(models["quintic"], ("quintic",), {"quintic": costs}, fits)
    assert final.effects == (named,)
    if named == "epsilon":
        assert final.rivals["epsilon"]["quintic"] == -excess


@pytest.mark.slow
def test_a_ripple_of_the_angle_is_not_explained_by_what_a_random_force_leaves():
    """Springs stand in its place, and the rest is blamed on a random force, which goes with the angle."""
    ripple = library_of_formulas(zeta="2*v", ripple="sin(40*x)")
    angle = trajectory(Model(ripple, {"zeta": 3e-3, "ripple": 2e-3}, W), TIME, 0.3, 0.0).angle
    tree = discover(decay(TIME, angle, 1), library("zeta"), library("freeplay", "quintic", "epsilon"))
    assert tree.attrs["verdict"] == "unknown effect"
    assert discovery_json(tree)["noise_p_value"] < 0.01
    assert verdict_sentences(tree)[0].startswith("Unknown effect")


@pytest.mark.slow
def test_an_effect_that_the_limit_leaves_out_is_not_unknown():
    run = with_effect({"cubic_damping": 0.2, "even_spring": 1e-2}, seed=8)
    few = EFFECTS.select(["cubic_damping", "even_spring", "bias"])
    tree = discover(run, BASE, few, max_effects=1)
    assert tree.attrs["verdict"] == "explained"
    (named,) = tree["steps"].symbol.values
    assert {named, tree.attrs["closing_effect"]} == {"cubic_damping", "even_spring"}
    assert discovery_json(tree)["closing_effect"] == tree.attrs["closing_effect"]
    assert "1 effect was asked for (--max-effects)" in verdict_sentences(tree)[0]


@pytest.mark.slow
def test_what_the_limit_and_the_library_leave_out_is_unknown():
    run = with_effect({"cubic_damping": 0.2, "even_spring": 1e-2, "inertia": 0.5}, seed=8)
    few = EFFECTS.select(["cubic_damping", "even_spring"])
    tree = discover(run, BASE, few, max_effects=1)
    assert tree.attrs["verdict"] == "unknown effect"
    assert tree.attrs["closing_effect"] == ""


def foretold(*rms):
    """Predictions of such RMS, one after the other."""
    given = iter(rms)
    return lambda model: Prediction((np.zeros(3),), next(given))


@pytest.mark.slow
def test_a_model_grows_while_it_predicts_better(monkeypatch):
    """A spring that imitates an even one is added, and refused: then there is none."""
    monkeypatch.setattr(Growth, "is_complete", lambda growth, model: False)
    monkeypatch.setattr("sysid_trib.discovery.final_models.MOST_REFUSED", 0)
    run = with_effect({"even_spring": 3e-2}, seed=8)
    few, start = EFFECTS.select(["bilinear", "bias"]), start_model([run])
    found = [
        search(start, few.forces, growth=Growth([run], foretold(1.0, rms, 0.5))).effects for rms in (2.0, 0.9)
    ]
    assert found[0] == ()
    assert set(found[1]) == {"bilinear", "bias"}


def test_names_stand_in_parts_of_the_record():
    found = found_in({"cubic_damping": 0.2}, ["cubic_damping", "inertia", "bias", "angle_damping"])
    (named,) = names_in_parts(found).values()
    assert named.stands.tolist() == [True, True, True]
    assert named.likeliest == ["cubic_damping"] * 3
    inside = named.probabilities(found.rivals["cubic_damping"])
    assert inside.sum() == pytest.approx(1.0)
    assert inside[list(found.rivals["cubic_damping"]).index("cubic_damping")] > 0.9
