"""Indications of a backbone: systems ranked by prediction, forces that improve it, columns, and a scale."""

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_table
from scipy.special import ellipk

import sysid_trib as st
from sysid_trib.cycles.pointing import free_swings, held_frequency, pointed_to
from sysid_trib.forces import ForceLibrary
from sysid_trib.simulation.trajectory import trajectory

OFFERED = {
    force.symbol: force for name in ("candidate_effects", "contact_forces") for force in st.load_library(name)
}


def record(coefficients, start, duration, *, w=6.1, shapes=None, noise=1e-3, rate=50.0):
    """A simulated decay with white noise."""
    library = ForceLibrary("made", tuple(OFFERED[symbol] for symbol in coefficients))
    time = np.arange(0.0, duration, 1.0 / rate)
    angle = trajectory(st.Model(library, coefficients, w, shapes or {}), time, start, 0.0).angle
    angle = angle + noise * np.random.default_rng(3).standard_normal(time.size)
    return time, angle


def pointed(time, angle, **attrs):
    data = {"angle": ("time", angle, {"units": "rad"})}
    return pointed_to(st.free_decay(_dataset(data, time).assign_attrs(attrs)))


def _dataset(data, time):
    return xr.Dataset(data, {"time": time})


PRESLIDING = {"dahl": 1.4e-3, "zeta": 5e-4, "delta": 2.1e-3, "gravity": 1.0}


@pytest.mark.parametrize(("start", "give"), [(1.46, 0.02), (1.0, 0.02), (1.3, 0.05), (0.7, 0.01)])
def test_friction_that_gives_way_hides_no_pendulum(start, give):
    found = pointed(*record(PRESLIDING, start, 100.0, shapes={"dahl.s": give}))
    assert found.system == "pendulum"
    gravity = found.ranking[0]
    assert gravity.systems == ("pendulum",)
    assert gravity.remains < 0.05
    cubic = next(model for model in found.ranking if "torsion" in model.systems)
    assert cubic.remains > 2.0 * gravity.remains


@pytest.mark.parametrize("epsilon", [0.3, -0.35, -0.08])
def test_a_cubic_stiffness_is_no_pendulum(epsilon):
    found = pointed(*record({"zeta": 5e-3, "epsilon": epsilon}, 0.5, 40.0, noise=3e-4))
    assert (found.system, found.forces) == ("", ("zeta", "epsilon"))


def test_no_angle_is_no_pendulum():
    time, angle = record({"zeta": 2e-3, "gravity": 1.0}, 1.0, 40.0)
    decay = st.free_decay(_dataset({"angle": ("time", 10.0 * angle, {"units": "mm"})}, time))
    assert pointed_to(decay).system == ""


@pytest.mark.parametrize(
    "coefficients",
    [
        {"zeta": 1e-2},
        {"zeta": 3e-3, "delta": 0.04},
        {"lambda": 1e-3, "zeta": 3e-3},
        {"lambda": 1e-3, "zeta": 2e-3, "delta": 0.05},
    ],
    ids=",".join,
)
def test_a_force_is_offered_if_it_improves_the_prediction(coefficients):
    found = pointed(*record(coefficients, 0.4, 25.0, noise=1e-4))
    assert set(found.forces) == set(coefficients)


def test_the_ship_model_has_no_dry_friction(data_folder):
    ship = run("look", data_folder / "roll_decay" / "model_test_21337.csv")
    assert ship.status == 0, ship.err
    assert ship.out.splitlines()[-1].endswith(" --system ship")
    assert "The columns phi and theta suggest a ship." in ship.out


@pytest.mark.parametrize(
    ("heads", "is_ship"),
    [
        (("phi", "theta"), True),
        (("Phi [rad]", "Psi [rad]"), True),
        (("φ (rad)", "θ (rad)"), True),
        (("roll (rad)", "heave (m)"), True),
        (("roll (rad)", "yaw (rad)"), False),
        (("theta (rad)", "x (m)"), False),
    ],
)
def test_columns_say_a_ship(heads, is_ship, tmp_path):
    time, angle = record({"zeta": 2e-3, "delta": 0.05}, 0.2, 30.0, noise=1e-4)
    still = 1e-5 * np.random.default_rng(0).standard_normal(time.size)
    path = write_table(tmp_path / "roll.csv", ",".join(("time (s)", *heads)), time, angle, still)
    ending = run("look", path, "--angle", "1")
    assert ending.status == 0, ending.err
    assert ending.out.splitlines()[-1].endswith("--system ship") == is_ship


@pytest.mark.parametrize("scale", [0.93, 1.06])
def test_a_scale_that_is_off_is_the_plain_reading_of_a_pendulum(scale, tmp_path):
    time, angle = record({"zeta": 1e-3, "delta": 0.01, "gravity": 1.0}, 1.2, 60.0)
    of_film = pointed(time, scale * angle)
    assert of_film.system == "pendulum"
    assert abs(of_film.scale.factor - 1.0 / scale) < 3.0 * of_film.scale.error
    assert of_film.scale.error < 0.02
    assert pointed(time, angle).scale is None
    path = write_table(tmp_path / "film.csv", "time (s),angle (rad)", time, scale * angle)
    assert f"(--scale {of_film.scale.factor:.3g})" in run("look", path).out


def test_forces_suggested_for_a_short_record_can_be_determined(tmp_path):
    time, angle = record({"zeta": 5e-3}, 0.5, 3.4)
    path = write_table(tmp_path / "short.csv", "time (s),angle (rad)", time, angle)
    assert run("look", path).out.splitlines()[-1].endswith("--forces zeta")
    # The usual forces of a system are as many as before.
    assert run("look", path, "--system", "ship").out.splitlines()[-1].endswith("--forces zeta")


def test_the_frequency_of_a_pendulum_is_exact():
    a = np.array([1e-3, 0.3, 1.0, 2.0, 2.8])
    exact = 0.5 * np.pi / ellipk(np.sin(0.5 * a) ** 2)
    gravity = [(OFFERED["gravity"], 1.0)]
    frequency, harmonic = free_swings(gravity, a)
    assert frequency == pytest.approx(exact, rel=2e-3)
    assert harmonic[:2] == pytest.approx(a[:2], rel=3e-3)
    # A half-sine is larger than a motion that is flat at its ends.
    assert np.interp(harmonic, a, a)[3] > 1.02 * a[3]
    assert held_frequency(gravity, harmonic[:4]) == pytest.approx(exact[:4], rel=2e-3)
    assert held_frequency([], a) == pytest.approx(np.ones(5), rel=2e-3)
    assert np.isnan(held_frequency(gravity, np.array([1.0, 4.2]))[-1])


@pytest.mark.parametrize("start", [2.2, 2.6])
def test_a_large_swing_has_no_error_of_its_scale(start):
    found = pointed(*record({"lambda": 7e-4, "zeta": 1e-3, "delta": 2e-3, "gravity": 1.0}, start, 80.0))
    assert (found.system, found.scale) == ("pendulum", None)
    assert found.ranking[0].remains < 0.03
