"""Rates and accelerations are compared as they were measured: coefficients are right within their errors."""

import numpy as np
import pytest
from command_line import run, write_table
from helpers import scores

import sysid_trib as st
from sysid_trib.records.read import read_records
from sysid_trib.records.reading import Reading
from sysid_trib.simulation.measured_motion import measured_part
from sysid_trib.simulation.trajectory import trajectory

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
    return motion.shown(quantity)


def decay_of(path, quantity, seed):
    noise, unit = KINDS[quantity]
    values = clean(quantity) + BIAS + noise * np.random.default_rng(seed).standard_normal(TIME.size)
    return st.free_decay(st.read_record(write_table(path, f"Time (s),Sensor ({unit})", TIME, values)))


def excess(result):
    of_w = (result.reference_frequency.item() - W) / result.reference_frequency_standard_error.item()
    return np.append(scores(result, TRUE), of_w)


@pytest.mark.slow
@pytest.mark.parametrize("quantity", KINDS)
def test_the_measured_quantity_is_compared_with_its_bias(tmp_path, quantity):
    decay = decay_of(tmp_path / "phone.csv", quantity, 3)
    (measured, _), time, values = measured_part(decay)
    assert measured == quantity
    assert values.size == time.size >= decay.sizes["time"]
    result = st.methods.Trajectory(random_force="estimated").identify(decay, FORCES)
    assert result.attrs["compared_in"] == quantity
    assert np.abs(excess(result)).max() < 4.0
    # The bias about the mean of the swing, which is itself an estimate of it.
    mean = float(np.mean(values)) - float(np.mean(clean(quantity)[: values.size]))
    assert abs(result.bias.item() - mean) < 4.0 * result.bias_standard_error.item()
    assert result.birge_ratio.item() == pytest.approx(1.0, abs=0.12)
    assert result.residual_rms.attrs["units"] == KINDS[quantity][1]
    # A part of a decay contains the samples measured within it.
    half = decay.isel(time=slice(None, decay.sizes["time"] // 2))
    assert measured_part(half)[1][-1] <= half.time.values[-1]


def test_identify_states_the_compared_quantity(tmp_path):
    decay_of(tmp_path / "phone.csv", "rate", 3)
    ending = run("identify", tmp_path / "phone.csv", "--forces", "zeta,delta")
    assert ending.status == 0, ending.err
    assert "Trajectory is fitted to the rate itself, with a bias of" in ending.out


def test_an_accelerometer_on_a_pendulum_shows_its_angle_and_forces(tmp_path):
    length, distance = 0.613, 0.25
    w = np.sqrt(9.80665 / length)
    forces = st.load_library("candidate_effects").select(["gravity"])
    library = st.Model(forces, {"gravity": 1.0}, w).library
    both = st.load_library().select(["zeta", "delta"])
    library = type(both)(both.title, (*both.forces, *library.forces))
    model = st.Model(library, {**TRUE, "gravity": 1.0}, w)
    motion = trajectory(model, TIME, 0.5, 0.0)
    felt = motion.shown("accelerometer", distance)
    felt += 0.1 + 2e-2 * np.random.default_rng(4).standard_normal(TIME.size)
    path = write_table(tmp_path / "phone.csv", "Time (s),Acceleration y (m/s^2)", TIME, felt)
    (record,) = read_records(path, Reading(signal="accelerometer", distance=distance))
    decay = st.free_decay(record)
    exact = np.interp(decay.time, TIME, motion.position)
    assert np.abs(decay.angle - exact).max() < 0.03
    result = st.methods.Trajectory(constraints={"gravity": 1.0}).identify(decay, library)
    assert np.abs(scores(result, TRUE)).max() < 4.0
    assert abs(result.reference_frequency.item() - w) < 4.0 * result.reference_frequency_standard_error.item()
    assert result.attrs["compared_in"] == "accelerometer"


def test_the_usual_signal_of_a_system_stands_for_one_that_is_not_stated(tmp_path):
    values = 24.0 * np.exp(-0.05 * TIME) * np.cos(W * TIME)
    path = write_table(tmp_path / "swing.csv", "t,strip", TIME, values)
    assert read_records(path)[0].attrs["signal"] == "angle"
    assert read_records(path, Reading(usual="displacement"))[0].attrs["signal"] == "displacement"
    assert "displacement in au" in run("look", path, "--system", "spring").out
