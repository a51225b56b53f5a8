"""What may stand in an effect's place: neighbours however alike, all of a set, two for one."""

from dataclasses import replace

import pytest
from discovery import EVERY, library, searched, start_model, with_effect

from sysid_trib.discrepancy.exchange import rivals_of, two_for_one
from sysid_trib.discrepancy.fits import Fits
from sysid_trib.discrepancy.in_place import in_place
from sysid_trib.discrepancy.screening import SAME_EFFECT, screen
from sysid_trib.discrepancy.settings import DEFAULTS
from sysid_trib.discrepancy.trials import TrialEffect


def fitted(run, symbol):
    """The model with an effect, and the fits it comes from."""
    fits = Fits(start_model([run]))
    return fits.of(fits.start, (), [TrialEffect(EVERY[symbol], {})]), fits


def test_a_force_of_which_hardly_more_than_an_effect_is_left_is_its_rival():
    """A magnet beside a cubic force is a quintic one, though 1e-3 of its column is outside of both."""
    model, fits = fitted(with_effect({"quintic": -0.3}, seed=2), "quintic")
    current = screen(model, library("magnet", "bias").forces, ["quintic"])
    assert set(current.reasons) == {"", SAME_EFFECT}
    rivals = rivals_of(current, ("quintic",), "quintic", fits)
    assert abs(rivals["magnet"]) < 1.0
    assert "bias" not in rivals


def test_all_that_are_as_likely_along_the_path_are_fitted():
    settings = replace(DEFAULTS, fitted=1)
    run = with_effect({"quintic": -0.3}, seed=2)
    fits = Fits(start_model([run], settings=settings))
    model = fits.of(fits.start, (), [TrialEffect(EVERY["quintic"], {})])
    others = library("magnet", "gravity", "detent", "bias", "cubic_damping")
    current = screen(model, others.forces, ["quintic"])
    near = {
        current.trials[at[0]].force.symbol
        for score, at in in_place(current, ("quintic",))
        if at and score < settings.outside_of_set
    }
    assert len(near) > 1
    assert near <= rivals_of(current, ("quintic",), "quintic", fits).keys()


def test_two_effects_take_the_place_of_one_that_stands_for_both():
    run = with_effect({"sensor_curve": 4e-3, "equilibrium_drift": -3e-5}, seed=3)
    model, fits = fitted(run, "bilinear")
    current = screen(model, library("sensor_curve", "equilibrium_drift", "detent").forces, ["bilinear"])
    step = two_for_one(current, ("bilinear",), fits)
    assert set(step.effects) == {"sensor_curve", "equilibrium_drift"}
    assert two_for_one(screen(step.model, [EVERY["bilinear"], EVERY["detent"]]), step.effects, fits) is None


@pytest.mark.slow
def test_a_search_ends_with_two_effects_that_one_would_stand_for():
    run = with_effect({"sensor_curve": 4e-3, "equilibrium_drift": -3e-5}, seed=3)
    found = searched([run], library("bilinear", "sensor_curve", "equilibrium_drift", "detent", "wall"))
    assert set(found.effects) == {"sensor_curve", "equilibrium_drift"}
