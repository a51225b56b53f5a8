"""Rates and accelerations are compared as they were measured: coefficients are right within their errors."""

import numpy as np
import pytest
from command_line import run

import sysid_trib as st
from sysid_trib.records.read import read_records
from sysid_trib.records.reading import Reading
from sysid_trib.simulation.initial_conditions import Observation, measured_part
from sysid_trib.simulation.simulate import trajectory

FORCES = st.load_library().select(["zeta", "delta"])
TRUE = {"zeta": 6e-3, "delta": 0.03}
W = 8.0
TIME = np.arange(1200) / 50.0
BIAS = 0.02
# Noise, and the unit.
KINDS = {"rate": (5e-3, "rad/s"), "acceleration": (4e-2, "rad/s^2")}


def clean(quantity):
    model = st.Model(FORCES, TRUE, W)
    motion = trajectory(model, TIME, 0.4, 0.0)
    return Observation(quantity).shown(motion)


def decay_of(path, quantity, seed):
    noise, unit = KINDS[quantity]
    values = clean(quantity) + BIAS + noise * np.random.default_rng(seed).standard_normal(TIME.size)
    rows = "\n".join(f"{t:.3f},{y:.8g}" for t, y in zip(TIME, values, strict=True))
    path.write_text(f"Time (s),Sensor ({unit})\n{rows}\n", encoding="utf-8")
    return st.free_decay(st.read_record(path))


def excess(result):
    errors = [*result.standard_error.values, result.reference_frequency_standard_error.item()]
    values = [*result.coefficient.values, result.reference_frequency.item()]
    return (np.array(values) - [*TRUE.values(), W]) / errors


@pytest.mark.slow
@pytest.mark.parametrize("quantity", KINDS)
def test_what_was_measured_is_compared_with_its_bias(tmp_path, quantity):
    decay = decay_of(tmp_path / "phone.csv", quantity, 3)
    observation, time, values = measured_part(decay)
    assert observation.quantity == quantity
    assert values.size == time.size >= decay.sizes["time"]
    result = st.methods.Trajectory(random_force="estimated").identify(decay, FORCES)
    assert result.attrs["compared_in"] == quantity
    assert np.abs(excess(result)).max() < 4.0
    # The bias about the mean of the swing, which is itself an estimate of it.
    mean = float(np.mean(values)) - float(np.mean(clean(quantity)[: values.size]))
    assert abs(result.bias.item() - mean) < 4.0 * result.bias_standard_error.item()
    assert result.birge_ratio.item() == pytest.approx(1.0, abs=0.12)
    assert result.residual_rms.attrs["units"] == KINDS[quantity][1]
    # A part of a decay holds what was measured within it.
    half = decay.isel(time=slice(None, decay.sizes["time"] // 2))
    assert measured_part(half)[1][-1] <= half.time.values[-1]


@pytest.mark.in_full
@pytest.mark.parametrize("quantity", KINDS)
def test_errors_of_what_was_measured_cover_the_truth(tmp_path, quantity):
    z = [
        excess(st.methods.Trajectory().identify(decay_of(tmp_path / "a.csv", quantity, seed), FORCES))
        for seed in range(20)
    ]
    assert np.mean(np.abs(z) < 1.96) > 0.88
    assert np.sqrt(np.mean(np.square(z), axis=0)) == pytest.approx(1.0, abs=0.35)


def test_identify_says_in_what_it_compares(tmp_path):
    decay_of(tmp_path / "phone.csv", "rate", 3)
    ending = run("identify", tmp_path / "phone.csv", "--forces", "zeta,delta")
    assert ending.status == 0, ending.err
    assert "Trajectory compares the rate itself, with a bias of" in ending.out


def test_an_accelerometer_on_a_pendulum_shows_its_angle_and_forces(tmp_path):
    length, distance = 0.613, 0.25
    w = np.sqrt(9.80665 / length)
    forces = st.load_library("candidate_effects").select(["gravity"])
    library = st.Model(forces, {"gravity": 1.0}, w).library
    both = st.load_library().select(["zeta", "delta"])
    library = type(both)(both.title, (*both.forces, *library.forces))
    model = st.Model(library, {**TRUE, "gravity": 1.0}, w)
    motion = trajectory(model, TIME, 0.5, 0.0)
    felt = Observation("accelerometer", distance).shown(motion)
    felt += 0.1 + 2e-2 * np.random.default_rng(4).standard_normal(TIME.size)
    path = tmp_path / "phone.csv"
    rows = "\n".join(f"{t:.3f},{y:.8g}" for t, y in zip(TIME, felt, strict=True))
    path.write_text(f"Time (s),Acceleration y (m/s^2)\n{rows}\n", encoding="utf-8")
    (record,) = read_records(path, Reading(signal="accelerometer", distance=distance))
    decay = st.free_decay(record)
    exact = np.interp(decay.time, TIME, motion.position)
    assert np.abs(decay.angle - exact).max() < 0.03
    result = st.methods.Trajectory(constraints={"gravity": 1.0}).identify(decay, library)
    z = (result.coefficient.values[:2] - [*TRUE.values()]) / result.standard_error.values[:2]
    assert np.abs(z).max() < 4.0
    assert abs(result.reference_frequency.item() - w) < 4.0 * result.reference_frequency_standard_error.item()
    assert result.attrs["compared_in"] == "accelerometer"
    assert run("look", path, "--signal", "accelerometer").status == 2


def test_the_usual_signal_of_a_system_stands_for_one_that_is_not_stated(tmp_path):
    path = tmp_path / "swing.csv"
    values = 24.0 * np.exp(-0.05 * TIME) * np.cos(W * TIME)
    rows = "\n".join(f"{t:.3f},{y:.5f}" for t, y in zip(TIME, values, strict=True))
    path.write_text(f"t,strip\n{rows}\n", encoding="utf-8")
    assert read_records(path)[0].attrs["signal"] == "angle"
    assert read_records(path, Reading(usual="displacement"))[0].attrs["signal"] == "displacement"
    assert "displacement in au" in run("look", path, "--system", "spring").out
