"""One force whose shape is fitted may follow the sum of two others: these are in its credible set."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from discovery import CONTACT, EFFECTS, exact, library, model_of, with_effect
from helpers import decay

from sysid_trib import discover
from sysid_trib.forces import ForceLibrary
from sysid_trib.printing.discovery import discovery_json
from sysid_trib.printing.discovery_tables import effect_with_ties
from sysid_trib.results.effects import credible_set, replacing_pairs, tied_name
from sysid_trib.results.files import load, save

FEW = replace(EFFECTS, forces=(*CONTACT.select(["lambda", "delta"]), *EFFECTS.select(["power_damping"])))


@pytest.fixture(scope="module")
def tree() -> xr.DataTree:
    """Dry and quadratic friction: one power besides the viscous force is more likely than either alone."""
    run = with_effect({"lambda": 1e-4, "delta": 0.05}, seed=1, base={"zeta": 4e-3})
    run = run.assign(angle=run.angle + 2e-4 * np.random.default_rng(5).standard_normal(run.time.size))
    return discover(run, library("zeta"), FEW)


@pytest.mark.slow
def test_an_equally_good_pair_is_named_with_the_effect(tree, tmp_path):
    (step,) = (tree["steps"].to_dataset().isel(step=at) for at in range(tree["steps"].attrs["count"]))
    assert step.symbol.item() == "power_damping"
    assert replacing_pairs(step) == [["lambda", "delta"]]
    assert effect_with_ties(step) == "power_damping (or lambda and delta)"
    assert tied_name(step, 1) == "power_damping or lambda and delta"
    (found,) = discovery_json(tree)["steps"]
    assert found["pairs"] == [["lambda", "delta"]]
    assert found["pair_odds"] > 1.0 / 19.0
    save(tree, tmp_path / "found.nc")
    again = load(tmp_path / "found.nc")["steps"].to_dataset().isel(step=0)
    assert replacing_pairs(again) == [["lambda", "delta"]]


def test_an_effect_of_no_shape_has_no_pairs():
    run = with_effect({"delta": 0.05}, seed=1, base={"zeta": 4e-3})
    steps = discover(run, library("zeta"), FEW)["steps"].to_dataset()
    assert steps.symbol.values.tolist() == ["delta"]
    assert replacing_pairs(steps.isel(step=0)) == []


FRICTIONS = {"zeta": 0.0105, "delta": 0.012, "epsilon": 0.427, "dahl": 0.0066}


@pytest.mark.in_full
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_friction_of_three_kinds_is_separated(seed):
    """LuGre friction, of three shapes, stands in their place until a pair is seen to be likelier."""
    time = np.arange(0.0, 13.0, 1.0 / 112.0)
    run = decay(time, exact(model_of(FRICTIONS, {"dahl.s": 0.0075}), time, 0.54), seed, noise=3.8e-4)
    tree = discover(run, library("zeta"), ForceLibrary("every", (*CONTACT, *EFFECTS)))
    steps = tree["steps"].to_dataset()
    sets = [set(credible_set(steps.isel(step=at))) for at in range(steps.attrs["count"])]
    assert tree.attrs["search_outcome"] == "explained"
    assert len(sets) == 3
    assert all(any(name in of_effect for of_effect in sets) for name in ("delta", "epsilon", "dahl"))
