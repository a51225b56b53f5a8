"""Advice on driven records: the input, forces that fit, errors, the next command."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_table
from helpers import scores

import sysid_trib as st
from sysid_trib.errors import DecayError
from sysid_trib.forces.library import parse_library
from sysid_trib.records.inputs import KnownInput
from sysid_trib.simulation.trajectory import trajectory

W, TIME = 9.9, np.arange(0.0, 15.0, 0.02)
CONTACT, INPUTS = st.load_library("contact_forces"), st.load_library("inputs")
FORCES = replace(INPUTS, forces=(*INPUTS.select(["gain"]), *CONTACT.select(["lambda", "zeta", "epsilon"])))
TRUTH = {"gain": 0.05, "lambda": 1e-3, "zeta": 0.01, "epsilon": -0.1}


def tones(seed: int) -> np.ndarray:
    frequencies = W * np.linspace(0.1, 2.0, 40)
    phases = np.random.default_rng(seed).uniform(0.0, 6.28, 40)
    return np.cos(np.outer(TIME, frequencies) + phases).sum(axis=1) / 4.5


def driven(seed: int, part: float) -> xr.Dataset:
    """A driven record whose measured force has white noise, as a fraction of its RMS."""
    rng, torque = np.random.default_rng(100 + seed), tones(seed)
    motion = st.simulate(
        st.Model(FORCES, TRUTH, W), TIME, 0.1, inputs={"u": KnownInput(TIME, torque, "smooth")}
    )
    measured = torque + part * torque.std() * rng.standard_normal(TIME.size)
    angle = motion.angle.values + 2e-4 * rng.standard_normal(TIME.size)
    variables = {
        "angle": ("time", angle, {"units": "rad"}),
        "u": ("time", measured, {"role": "input", "units": "N*m", "between": "smooth"}),
    }
    return xr.Dataset(variables, {"time": ("time", TIME, {"units": "s"})})


def answer(tree: xr.DataTree) -> xr.Dataset:
    return tree[tree["judged"].attrs["preferred"]].to_dataset()


def coverage(part: float, seeds: range) -> np.ndarray:
    """Return the fraction of 95 % intervals of each coefficient that contain the true value."""
    z = [scores(answer(st.identify(driven(seed, part), FORCES)), TRUTH) for seed in seeds]
    return np.mean(np.abs(z) < 1.96, axis=0)


@pytest.mark.slow
def test_noise_of_the_measured_force_is_a_random_force_whose_fit_is_the_answer() -> None:
    tree = st.identify(driven(0, 0.03), FORCES)
    judged = tree["judged"].attrs
    assert judged["verdict"] == "explained with a random force"
    assert judged["preferred"] == "direct"
    assert np.abs(scores(answer(tree), TRUTH)).max() < 3.5
    # Both methods know it, and agree.
    assert np.abs(tree["agreement"].z.values).max() < 1.0


def test_a_missing_force_is_no_random_force_and_increases_the_errors() -> None:
    library = FORCES.select(["gain", "lambda", "zeta"])
    tree = st.identify(driven(0, 0.01), library)
    assert tree["judged"].attrs["verdict"] in ("approximate", "not explained")
    assert (answer(tree).error_of_model > 0.0).all()


@pytest.mark.slow
def test_intervals_cover_if_the_force_is_noisy() -> None:
    # Of 24 intervals of 95 %, fewer than 18 contain the true value once in 10^4 sets.
    assert np.mean(coverage(0.1, range(6))) >= 0.75


@pytest.mark.in_full
@pytest.mark.parametrize("part", [0.01, 0.1])
def test_intervals_cover_over_forty_seeds(part: float) -> None:
    held = coverage(part, range(40))
    assert ((held >= 0.85) & (held <= 1.0)).all()
    assert 0.9 <= held.mean() <= 0.99


def test_noise_of_an_input_is_in_the_error_of_its_coefficient_alone() -> None:
    method = st.methods.Direct(random_force="estimated")
    # Attenuation goes with the square of the noise, the error by the random force with the noise.
    some, more = (st.identify(driven(1, part), FORCES, method).standard_error for part in (0.05, 0.2))
    ratio = more / some
    assert ratio.sel(force="gain") > 1.3 * ratio.sel(force="zeta")


def measured(quantity: str, bias: float, tmp_path, noise: float):
    torque = tones(3)
    model = st.Model(FORCES, TRUTH, W, inputs={"u": KnownInput(TIME, torque, "smooth")})
    values = getattr(trajectory(model, TIME, 0.1, 0.0), quantity) + bias
    values = values + noise * np.random.default_rng(0).standard_normal(TIME.size)
    unit = {"rate": "rad/s", "acceleration": "rad/s^2"}[quantity]
    return write_table(tmp_path / "a.csv", f"time (s),torque (N*m),{quantity} ({unit})", TIME, torque, values)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("quantity", "bias", "noise"), [("rate", 0.03, 5e-3), ("rate", 1.0, 5e-3), ("acceleration", 0.1, 5e-2)]
)
def test_a_driven_rate_or_acceleration_is_compared_directly(quantity, bias, noise, tmp_path) -> None:
    record = st.read_record(measured(quantity, bias, tmp_path, noise), input="torque")
    tree = st.identify(record, FORCES)
    result = answer(tree)
    assert tree["judged"].attrs["verdict"] == "explained"
    assert result.attrs["compared_in"] == quantity
    assert np.abs(scores(result, TRUTH)).max() < 3.5
    assert abs(result.bias.item() - bias) < 4.0 * result.bias_standard_error.item()
    assert st.predict(result, record, warm_up=2.0).residual_over_motion < 0.01


STEP = 1e-3


def motor(seconds: float = 4.0, viscous: float = 10.2, dry: float = 463.0):
    """Time, voltage and speed of a motor without a restoring force under a square wave."""
    time = np.arange(0.0, seconds, STEP)
    voltage, speed = np.where(time % 2.0 < 1.0, 1.5, -1.5), np.zeros(time.size)
    for at in range(1, time.size):
        push = 1290.0 * voltage[at - 1] - viscous * speed[at - 1]
        speed[at] = speed[at - 1] + STEP * (push - dry * np.tanh(speed[at - 1] / 0.5))
    return time, voltage, speed + np.random.default_rng(1).normal(0.0, 3.0, time.size)


@pytest.mark.slow
def test_the_speed_of_a_motor_and_its_voltage_give_its_friction(tmp_path) -> None:
    time, voltage, speed = (values[::4] for values in motor())
    path = write_table(tmp_path / "tacho.csv", "t (s),u (V),v (mm/s)", time, voltage, speed)
    asked = ("--angle", "v (mm/s)", "--input", "u (V)", "--between", "held", "--system", "axis")
    ending = run("identify", path, *asked)
    assert ending.status == 0, ending.err
    assert "it is fitted to the rate itself" in ending.out
    assert "In the unit of the input u: mass (7.7" in ending.out
    # A body without a restoring force is searched for nothing: the result is kept.
    assert ending.out.splitlines()[-1].startswith("Next: sysid-trib identify")
    assert "--output result.nc" in ending.out.splitlines()[-1]


@pytest.mark.slow
def test_look_recognises_a_drive_and_suggests_fitting_forces(tmp_path) -> None:
    time, voltage, speed = (values[::4] for values in motor())
    path = write_table(tmp_path / "m.csv", "time (s),u,velocity (mm/s)", time, 2.0 * np.sign(voltage), speed)
    ending = run("look", path)
    assert ending.status == 0, ending.err
    assert "Free decay" not in ending.out
    assert "rate in mm/s from column velocity" in ending.out
    assert "Driven: input u ranges from -2 to 2" in ending.out
    command = ending.out.splitlines()[-1]
    assert "--input u --between held --system axis" in command
    assert run("look", path, "--input", "u").status == 0


def test_a_torque_that_is_zero_in_a_decay_does_not_drive_it(tmp_path) -> None:
    time = np.arange(0.0, 20.0, 0.02)
    swing = 0.3 * np.exp(-0.05 * time) * np.cos(8.0 * time)
    swing += 1e-4 * np.random.default_rng(0).standard_normal(time.size)
    still = write_table(tmp_path / "s.csv", "time (s),angle (rad),torque (N*m)", time, swing, 0.0 * time)
    assert "Free decay: kept" in run("look", still).out
    # A load cell at the spring does not measure a drive either.
    reaction = write_table(tmp_path / "r.csv", "time (s),x (mm),force (N)", time, swing, -4.0 * swing)
    assert "Free decay: kept" in run("look", reaction).out


def test_an_input_that_is_named_acts(tmp_path) -> None:
    record = driven(2, 0.0)
    path = write_table(tmp_path / "d.csv", "time (s),angle (rad),torque", TIME, record.angle, record.u)
    ending = run("identify", path, "--input", "torque", "--quiet")
    assert ending.status == 0, ending.err
    assert "gain" in ending.out
    command = ending.out.splitlines()[-1]
    assert command.startswith("Next: sysid-trib identify")
    kept = run("identify", path, "--input", "torque", "-o", tmp_path / "kept.nc").out.splitlines()
    assert any(line.startswith("Next: sysid-trib report") for line in kept)


OWN = parse_library(
    {
        "inputs": {"u": "", "load": ""},
        "force": [
            {"symbol": "gain", "formula": "-u"},
            {"symbol": "zeta", "formula": "2*v"},
            {"symbol": "mu", "formula": "load*sign(v)"},
        ],
    },
    "own",
)


def test_an_input_that_is_constant_within_a_run_is_a_known_number_of_it() -> None:
    truth, runs = {"gain": 0.05, "zeta": 0.01, "mu": 1e-3}, []
    for seed, load in ((0, 1.0), (1, 3.0)):
        known = {"u": KnownInput(TIME, tones(seed), "smooth"), "load": KnownInput(TIME, 0.0 * TIME + load)}
        motion = st.simulate(st.Model(OWN, truth, W), TIME, 0.1, inputs=known)
        noise = 2e-4 * np.random.default_rng(seed).standard_normal(TIME.size)
        runs.append(motion.assign(angle=motion.angle + noise).drop_vars(["rate", "stop_time"]))
    result = st.identify(runs, OWN, st.methods.Direct(random_force="off"))
    assert np.abs(scores(result, truth)).max() < 4.0
    still = runs[0].assign(u=(0.0 * runs[0].u + 2.0).assign_attrs(runs[0].u.attrs))
    with pytest.raises(DecayError, match="The input u is 2 throughout and drives nothing"):
        st.identify(still, OWN)


def test_a_negative_damping_is_reported(tmp_path) -> None:
    truth = TRUTH | {"zeta": -0.01, "lambda": 0.0}
    known = {"u": KnownInput(TIME[:400], tones(0)[:400], "smooth")}
    motion = st.simulate(st.Model(FORCES, truth, W), TIME[:400], 0.1, inputs=known)
    angle = motion.angle.values + 2e-4 * np.random.default_rng(0).standard_normal(400)
    path = write_table(tmp_path / "n.csv", "time (s),angle (rad),torque", TIME[:400], angle, tones(0)[:400])
    ending = run("identify", path, "--input", "torque", "--forces", "gain,zeta,epsilon", "--quiet")
    assert "The damping is negative: zeta = -0.0" in ending.out
