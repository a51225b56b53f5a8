"""Laws that are separate for each run, such as friction under its load."""

import numpy as np
import pytest
from command_line import run

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.library import parse_library
from sysid_trib.forces.systems import load_system
from sysid_trib.printing.laws import laws_blocks, laws_csv
from sysid_trib.reporting.provenance import python_text
from sysid_trib.results.law_curves import OWN_LAWS
from sysid_trib.smooth_laws.fits import explaining_own_laws
from sysid_trib.smooth_laws.model import law_model

W, NOISE = 9.0, 3e-4
LAW = parse_library(
    {"force": [{"symbol": "friction", "formula": "3e-4*sign(v) + 0.004*v + 0.03*v*abs(v)/(1 + abs(v)/0.1)"}]},
    "",
)
LOADS = (1.0, 2.0)


def run_of(load, seed):
    library = parse_library({"force": [*({"symbol": f.symbol, "formula": f.formula.text} for f in LAW)]}, "")
    motion = st.simulate(st.Model(library, {"friction": load}, W), np.arange(0.0, 15.0, 0.02), angle=0.2)
    motion["angle"] += NOISE * np.random.default_rng(seed).standard_normal(motion.sizes["time"])
    return st.free_decay(motion[["angle"]].assign_attrs(source=f"run_{seed}.csv"))


@pytest.fixture(scope="module")
def tree():
    return st.laws([run_of(load, seed) for seed, load in enumerate(LOADS)], own=["friction"])


def test_each_run_has_its_friction_law(tree):
    own = tree[OWN_LAWS].to_dataset()
    for at, load in enumerate(LOADS):
        part = own.isel(run=at)
        part = part.isel(speed=np.flatnonzero(part.speed_visited.values))
        truth = load * W**2 * LAW["friction"].value(0.0 * part.speed.values, part.speed.values / W)
        assert np.mean((part.friction_low <= truth) & (truth <= part.friction_high)) > 0.95
        assert np.median(np.abs(part.friction / truth - 1.0)) < 0.02
    mean = tree["direct"].friction.values
    np.testing.assert_allclose(own.friction.mean("run"), mean, rtol=1e-9)


@pytest.mark.parametrize(
    ("foreign", "explaining"), [(0.0, ("friction",)), (0.02, None)], ids=["laws", "also a foreign motion"]
)
def test_separate_laws_that_explain_runs_are_found(foreign, explaining):
    runs = [run_of(load, seed) for seed, load in enumerate(LOADS)]
    # No law of the second run explains a foreign motion.
    runs[1]["angle"] += foreign * np.sin(3.1 * W * runs[1].time)
    model = law_model(load_system(None), Constraints({}), None)
    assert explaining_own_laws(runs, st.methods.Direct(random_force="off"), model) == explaining


@pytest.mark.slow
def test_runs_that_differ_in_friction_are_told_to_have_own_friction():
    common = st.laws([run_of(load, seed) for seed, load in enumerate(LOADS)])
    (verdict,) = laws_blocks(common)[0].sentences
    assert "the runs differ: with separate friction for each run (--own friction)" in verdict
    assert "memory" not in verdict
    # An additional force of position and speed is not stated where the runs only differ.
    assert "interaction" not in common.children


def test_own_laws_are_printed_written_and_kept(tree, tmp_path):
    titles = [block.title for block in laws_blocks(tree)]
    assert "Friction of each run" in titles
    # The restoring force is shared.
    assert "Restoring force of each run" not in titles
    assert "direct, run 2" in laws_csv(tree)
    st.save(tree, tmp_path / "own.nc")
    assert st.load(tmp_path / "own.nc").identical(tree)


@pytest.mark.parametrize(
    ("runs", "own", "said"),
    [(1, ["friction"], "needs several runs"), (2, ["mu"], "cannot be each run's own")],
)
def test_laws_that_cannot_be_separate_for_each_run_are_refused(runs, own, said):
    with pytest.raises(UsageError, match=said):
        st.laws([run_of(1.0, 0)] * runs, own=own)


def test_the_figure_shows_the_law_of_each_run(tree):
    (panel,) = st.plots.own_laws(tree).axes
    assert panel.get_legend_handles_labels()[1] == ["run 1", "run 2"]
    assert panel.get_ylabel().startswith("friction / inertia ")
    first, second = (line.get_ydata() for line in panel.lines[:2])
    assert np.nanmedian(second / first) == pytest.approx(LOADS[1] / LOADS[0], rel=0.05)


def test_own_coefficients_of_runs_that_no_common_motion_follows():
    """The estimate from the first half of each run has each run's own coefficients as well."""
    zeta = st.load_library().select(["zeta"])
    runs = []
    # The common frequency loses the phase in both runs.
    for frequency in (W, 1.05 * W):
        motion = st.simulate(
            st.Model(zeta, {"zeta": 0.001}, frequency), np.arange(0.0, 40.0, 0.02), angle=0.2
        )
        motion["angle"] += NOISE * np.random.default_rng(0).standard_normal(motion.sizes["time"])
        runs.append(st.free_decay(motion[["angle"]]))
    found = st.methods.Direct(own=("zeta",)).identify(runs, zeta)
    assert not found.refined
    assert found.force.values.tolist() == ["zeta_1", "zeta_2"]


@pytest.mark.slow
def test_python_of_laws_repeats_all_that_was_asked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Too few half periods for a curve, so that the fit is quick.
    for seed in "12":
        made = run("simulate", "-o", f"{seed}.csv", "--noise", "3e-4", "--seed", seed, "--duration", "2")
        assert made.status == 0
    decays = [st.free_decay(st.read_record(f"{seed}.csv")) for seed in "12"]
    tree = st.laws(decays, constraints={"nu": 0.0}, own=["lambda"], passive=True)
    names = {}
    exec(python_text(tree), names)
    again = names["tree"]
    assert again["judged"].attrs["options"] == tree["judged"].attrs["options"]
    np.testing.assert_array_equal(again["direct"].coefficient, tree["direct"].coefficient)
    st.report(tree, "laws.html")
    assert "passive=True" in (tmp_path / "laws.html").read_text(encoding="utf-8")
