"""Laws of driven records: they end after bounded work, and follow records as well as named forces do."""

import numpy as np
import pytest
from helpers import emps_record

import sysid_trib as st
from sysid_trib.errors import SimulationError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.simulation import trajectory
from sysid_trib.simulation.initial_conditions import fit_start
from sysid_trib.smooth_laws import curves
from sysid_trib.validation.model_error import fitted_parts

W, NOISE, LOADS = 9.0, 3e-4, (250, 350, 550)
# Motions that the laws compute at most, a third more than they did.
MOTIONS_OF_FRAME, MOTIONS_OF_AXIS = 2100, 710


@pytest.fixture
def motions(monkeypatch):
    """Lengths of the motions that are computed, in periods."""
    computed, integrate = [], trajectory.integrate

    def counted(model, tau, *args, **options):
        computed.append(float(tau[-1] - tau[0]) / (2.0 * np.pi))
        return integrate(model, tau, *args, **options)

    monkeypatch.setattr(trajectory, "integrate", counted)
    return computed


def test_a_steep_curve_ends_a_fit_of_its_start():
    """A poor fit makes curves steep: the motion along them is possible, and not worth its many steps."""
    none = ForceLibrary("none", ())
    library = curves.with_curves(none, ["friction"], {"x": 0.3, "v": 0.3}).select(["friction_1"])
    steep = st.Model(library, {"friction_1": 1e12}, 1.0)
    time = np.arange(0.0, 2.0 * np.pi, 0.02)
    angle = trajectory.trajectory(steep, time, 0.3, 0.0).angle
    with pytest.raises(SimulationError, match="needs too many steps"):
        fit_start(steep, time, angle, (0.3, 0.0))


def test_parts_with_own_forces_of_each_run_predict_the_rest():
    library = load_library().select(["lambda", "zeta"])
    time = np.arange(0.0, 10.0, 0.02)
    runs = []
    for seed, friction in enumerate((1e-3, 3e-3)):
        motion = st.simulate(st.Model(library, {"lambda": friction, "zeta": 0.005}, W), time, 0.3)
        noise = NOISE * np.random.default_rng(seed).standard_normal(len(time))
        runs.append(st.free_decay(motion[["angle"]] + noise))
    method = st.methods.Direct(own=("lambda",), random_force="off")
    parts = fitted_parts(runs, method, library, method.identify(runs, library), later_only=True)
    assert parts.results
    # By the friction of the other run it would be fifty times the noise.
    assert parts.held_out_rms < 1.5 * NOISE


@pytest.mark.slow
def test_laws_of_a_frame_end_with_the_friction_of_each_load(data_folder, motions):
    folder, runs = data_folder / "friction_frame", []
    for load in LOADS:
        base = {"base": f"{folder / f's_b_{load}g_y.mat'}:y"}
        runs.append(st.read_record(folder / f"s_b_{load}g_x.mat", time="t", units="mm", input=base))
    tree = st.laws(runs, constraints={"base_spring": 1.0}, own=["friction"])
    assert tree["own_laws"].sizes["run"] == len(LOADS)
    assert len(motions) < MOTIONS_OF_FRAME
    missed = float(tree["judged"].residual_rms.sel(model=tree["judged"].attrs["preferred"]))
    assert missed < 0.06


@pytest.mark.slow
def test_laws_of_a_motor_axis_follow_it_as_well_as_named_forces(data_folder, motions):
    record = emps_record(data_folder, "35.15065*vir")
    tree = st.laws(record, "axis")
    assert len(motions) < MOTIONS_OF_AXIS
    result = st.best(tree)
    assert float(st.predict(result, record).residual_rms) < 1.6e-3
    assert np.all(result.friction_high >= result.friction_low)
