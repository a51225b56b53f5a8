"""What may stand in an effect's place: neighbours however alike, and all of a set."""

from dataclasses import replace

from discovery import EVERY, library, start_model, with_effect

from sysid_trib.discrepancy.exchange import rivals_of
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
