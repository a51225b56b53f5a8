"""Laws together with named forces: a row of `compare`, and friction at chosen speeds in a campaign."""

import numpy as np
import pytest
from command_line import run, write_csv

import sysid_trib as st
from sysid_trib.campaigns.task import Task
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library

W, NOISE = 9.0, 3e-4
# The viscous part of this friction decreases at high speed.
FRICTION = "3e-4*sign(v) + 0.004*v + 0.01*v/(1 + (v/0.05)**4)"


def record(seed=0, size=1.0):
    library = parse_library({"force": [{"symbol": "friction", "formula": FRICTION}]}, "one")
    model = st.Model(library, {"friction": size}, W)
    motion = st.simulate(model, np.arange(0.0, 30.0, 0.01), angle=0.3)[["angle"]]
    motion["angle"] += NOISE * np.random.default_rng(seed).standard_normal(motion.sizes["time"])
    return st.free_decay(motion)


@pytest.fixture(scope="module")
def compared():
    methods = {"direct": st.methods.Direct(random_force="off"), "laws": st.physics.law_methods()["laws"]}
    return st.compare(record(), st.load_library().select(["zeta", "delta"]), methods)


def test_laws_predict_what_forces_of_another_form_do_not(compared):
    table = compared["comparison"]
    held_out = table.holdout_over_noise.values
    assert held_out[1] < 1.2
    assert held_out[0] > 2.0
    assert table.holdout_p_value.values[1] < 0.01


def test_curves_have_no_numbers_among_named_forces(compared):
    table = compared["comparison"]
    assert table.names_forces.values.tolist() == [True, False]
    assert table.force.values.tolist() == ["zeta", "delta"]
    assert np.all(np.isnan(table.coefficient.values[1]))
    assert table.attrs["best"] == "direct"


@pytest.mark.slow
def test_compare_says_that_laws_predict_better(tmp_path):
    decay = record()
    write_csv(tmp_path / "one.csv", decay.time.values, decay.angle.values)
    ending = run("compare", tmp_path / "one.csv", "--forces", "zeta,delta")
    assert (ending.status, ending.err) == (0, "")
    assert "predict it better than these forces" in ending.out
    assert "\nlaws " in ending.out
    assert "\nlaws (averaging) " in ending.out


@pytest.mark.slow
def test_a_campaign_keeps_friction_and_its_coefficient_at_speeds(tmp_path):
    speeds, inertia, load, arm = (0.3, 1.0, 2.0, 9.0), 1e-3, 2.0, 0.01
    measured = {"inertia": (inertia, 1e-5), "load": (load, 0.0), "radius": (arm, 0.0)}
    task = Task("laws", st.load_library(), speeds=speeds, measured=measured)
    sizes = (1.0, 1.5)
    records = [record(seed, size) for seed, size in enumerate(sizes)]
    store = st.campaign(records, task, output=tmp_path / "laws.zarr", workers=0)
    kept = store.sel(model=store.preferred)
    one = parse_library({"force": [{"symbol": "friction", "formula": FRICTION}]}, "one")["friction"]
    for at, size in enumerate(sizes):
        law = size * W**2 * one.value(0.0 * np.array(speeds), np.array(speeds) / W)
        for quantity, scale in (("friction", inertia), ("mu", inertia / (load * arm))):
            names = [f"{quantity}({speed:g})" for speed in speeds]
            found = kept.isel(record=at).sel(force=names)
            z = (found.coefficient.values - scale * law) / found.standard_error.values
            assert np.all(np.abs(z[:3]) < 4.0)
            # Beyond the visited range there is no number.
            assert np.isnan(found.coefficient.values[3])
    assert kept.unit.values.tolist() == ["N m"] * 4 + ["1"] * 4


def test_laws_of_a_campaign_want_speeds():
    with pytest.raises(UsageError, match="needs at least one"):
        Task("laws", st.load_library())
    with pytest.raises(UsageError, match="numbers above 0"):
        Task("laws", st.load_library(), speeds=(-1.0,))
