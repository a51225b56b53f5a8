"""A pair of candidates that is likelier than an effect of a fitted shape takes its place."""

import numpy as np
import pytest
from discovery import CONTACT, EFFECTS, EVERY, exact, library, model_of, start_model, with_effect
from helpers import decay

from sysid_trib import discover
from sysid_trib.discovery import final_models as pairs
from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.screen import screen
from sysid_trib.forces import ForceLibrary
from sysid_trib.likelihood.settings import Settings
from sysid_trib.results.discoveries import credible_set

FRICTIONS = {"zeta": 0.0105, "delta": 0.012, "epsilon": 0.427, "dahl": 0.0066}


@pytest.mark.parametrize(
    ("excess", "max_effects", "taken"), [(-6.0, 4, True), (-5.0, 4, False), (-6.0, 1, False)]
)
def test_a_pair_is_taken_where_the_effect_is_outside_of_its_set(excess, max_effects, taken, monkeypatch):
    """By 2 ln(0.95 / 0.05) = 5.9, and as far as so many effects were asked for."""
    start = start_model([with_effect({}, seed=1)], settings=Settings(max_effects=max_effects))
    fits, pair = Fits(start), ("bias", "inertia")
    fits.kept[frozenset(pair)] = start
    monkeypatch.setattr(pairs, "pairs_of", lambda *asked: {pair: excess})
    found = pairs.likelier_pair(screen(start, [EVERY["bias"]]), ("lugre",), fits, max_effects)
    assert found == ((start, pair) if taken else None)
    # What chance has been seen to do as well as is not come back to.
    fits.by_chance.add(frozenset(pair))
    assert pairs.likelier_pair(screen(start, [EVERY["bias"]]), ("lugre",), fits, max_effects) is None


@pytest.mark.in_full
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_friction_of_three_kinds_is_told_apart(seed):
    """LuGre friction, of three shapes, stands in their place until a pair is seen to be likelier."""
    time = np.arange(0.0, 13.0, 1.0 / 112.0)
    run = decay(time, exact(model_of(FRICTIONS, {"dahl.s": 0.0075}), time, 0.54), seed, noise=3.8e-4)
    tree = discover(run, library("zeta"), ForceLibrary("every", (*CONTACT, *EFFECTS)))
    steps = tree["steps"].to_dataset()
    sets = [set(credible_set(steps.isel(step=at))) for at in range(steps.attrs["count"])]
    assert tree.attrs["verdict"] == "explained"
    assert len(sets) == 3
    assert all(any(name in of_effect for of_effect in sets) for name in ("delta", "epsilon", "dahl"))
