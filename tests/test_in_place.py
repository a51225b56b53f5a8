"""What may stand in an effect's place: neighbours however alike, and all of a set."""

from dataclasses import replace

import numpy as np
from discovery import CONTACT, EVERY, library, start_model, with_effect

from sysid_trib.discovery import exchange
from sysid_trib.discovery.exchange import in_place, rivals_of
from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.screen import SAME_EFFECT, screen
from sysid_trib.discovery.search import search
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.trials import TrialEffect


def fitted(run, symbol):
    """The model with an effect, and the fits it comes from."""
    fits = Fits(start_model([run]))
    return fits.of(fits.start, (), [TrialEffect(EVERY[symbol], {})]), fits


def test_a_force_of_which_hardly_more_than_an_effect_is_left_is_its_rival():
    """A magnet beside a cubic force is a quintic one, though 1e-3 of its column is outside of both."""
    model, fits = fitted(with_effect({"quintic": 0.3}, seed=2), "quintic")
    current = screen(model, library("magnet", "bias").forces, ["quintic"])
    assert set(current.reasons) == {"", SAME_EFFECT}
    rivals = rivals_of(current, ("quintic",), "quintic", fits)
    # A magnet has one sign, which is worth 2 ln 2.
    assert abs(rivals["magnet"] + 2.0 * np.log(2.0)) < 1.0
    assert "bias" not in rivals


def test_all_that_are_as_likely_along_the_path_are_fitted():
    settings = replace(DEFAULTS, fitted=1)
    run = with_effect({"quintic": 0.3}, seed=2)
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


def test_what_has_the_frequency_of_an_effect_is_its_rival():
    """A resonator leaves no line of its own, at which an ambient vibration would be tried in its place."""
    shapes = {"resonator.k": 2.1, "resonator.d": 1e-3}
    run = with_effect({"resonator": 3e-3}, seed=3, shapes=shapes)
    fits = Fits(start_model([run]))
    model = fits.of(fits.start, (), [TrialEffect(EVERY["resonator"], shapes)])
    current = screen(model, library("ambient", "cubic_damping").forces, ["resonator"])
    near = [t.shapes["ambient.W"] for t in current.trials if t.force.symbol == "ambient"]
    kept, w = model.trials[-1].shapes["resonator.k"], model.rows[0].path.frequency
    assert min(abs(value / (kept * w) - 1.0) for value in near) < 1e-12


def test_a_fit_that_is_less_likely_than_a_model_it_contains_has_failed():
    run = with_effect({}, seed=2)
    fits = Fits(start_model([run]))
    fits.kept[frozenset()] = fits.start
    trial = [TrialEffect(EVERY["cubic_damping"], {})]
    assert fits.of(fits.start, (), trial) is not None
    likelier = replace(fits.start.likelihood, deviance=fits.start.deviance - 50.0)
    astray = Fits(fits.start, kept={frozenset(): replace(fits.start, likelihood=likelier)})
    assert astray.of(fits.start, (), trial) is None
    assert astray.failed == ["cubic_damping"]


def test_a_search_does_not_come_back_to_what_chance_does_as_well(monkeypatch):
    """An effect was added by what it gains, dropped by its p-value beside the others, and added again."""
    run = with_effect({"cubic_damping": 0.3}, seed=1, base={"zeta": 4e-3})
    start = start_model([run], CONTACT.select(["zeta"]))
    offered = library("cubic_damping", "quintic").forces
    assert search(start, offered).effects == ("cubic_damping",)
    monkeypatch.setattr(exchange, "_p_value", lambda current, symbol, gain=None: 1.0)
    ended = search(start, offered)
    assert ended.converged
    assert not ended.effects
    assert not ended.outstanding


def test_what_is_dropped_alone_leaves_the_better_of_two_optima():
    """A hysteresis fitted first from a slip length of the grid, later, beside another, from a good one."""
    run = with_effect({"dahl": 4e-3}, seed=1, base={"zeta": 4e-3}, shapes={"dahl.s": 0.06})
    fits = Fits(start_model([run], CONTACT.select(["zeta"])))
    added = [TrialEffect(EVERY["dahl"], {"dahl.s": 0.05}), TrialEffect(EVERY["quintic"], {})]
    both = fits.of(fits.start, (), added)
    good = fits.of(both, ("quintic",), ())
    worse = replace(good.likelihood, deviance=good.deviance + 100.0)
    fits.kept[frozenset(["dahl"])] = other = replace(good, likelihood=worse)
    fits.tried.clear()
    assert fits.of(both, ("quintic",), ()) is other
    assert abs(fits.of(both, ("quintic",), (), good.deviance + 1.0).deviance - good.deviance) < 0.1
