"""One force whose shape is fitted may follow the sum of two others: these are in its credible set."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from discovery import CONTACT, EFFECTS, library, with_effect

from sysid_trib import discover
from sysid_trib.printing.discovery_json import discovery_json
from sysid_trib.printing.discovery_tables import effect_with_ties
from sysid_trib.results.discoveries import pairs_in_place, tied_name
from sysid_trib.results.files import load, save

FEW = replace(EFFECTS, forces=(*CONTACT.select(["lambda", "delta"]), *EFFECTS.select(["power_damping"])))


@pytest.fixture(scope="module")
def tree() -> xr.DataTree:
    """Dry and quadratic friction, of which one power beside the viscous one is likelier than either."""
    run = with_effect({"lambda": 1e-4, "delta": 0.05}, seed=1, base={"zeta": 4e-3})
    run = run.assign(angle=run.angle + 2e-4 * np.random.default_rng(5).standard_normal(run.time.size))
    return discover(run, library("zeta"), FEW)


def test_a_pair_that_does_as_well_is_said_with_the_name(tree, tmp_path):
    (step,) = (tree["steps"].to_dataset().isel(step=at) for at in range(tree["steps"].attrs["count"]))
    assert step.symbol.item() == "power_damping"
    assert pairs_in_place(step) == ["lambda and delta"]
    assert effect_with_ties(step) == "power_damping (or lambda and delta)"
    assert tied_name(step, 1) == "power_damping or lambda and delta"
    (found,) = discovery_json(tree)["steps"]
    assert found["indistinguishable_pairs"] == [["lambda", "delta"]]
    assert found["pair_odds"] > 1.0 / 19.0
    save(tree, tmp_path / "found.nc")
    again = load(tmp_path / "found.nc")["steps"].to_dataset().isel(step=0)
    assert pairs_in_place(again) == ["lambda and delta"]
    # As an older version has saved it.
    assert pairs_in_place(step.drop_vars(["pairs", "pair_odds"])) == []


def test_an_effect_of_no_shape_has_no_pairs():
    run = with_effect({"delta": 0.05}, seed=1, base={"zeta": 4e-3})
    steps = discover(run, library("zeta"), FEW)["steps"].to_dataset()
    assert steps.symbol.values.tolist() == ["delta"]
    assert pairs_in_place(steps.isel(step=0)) == []
