"""Innovations of an identification, the random force over time, predictions with their bands."""

import numpy as np
import pytest
from helpers import decay, density_that_wanders

import sysid_trib as st
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.results.random_force import RandomForce
from sysid_trib.simulation.initial_conditions import fit_start

W, NOISE = 8.87, 2e-4
FORCES = st.load_library("contact_forces").select(["lambda", "zeta", "delta"])
MODEL = st.Model(FORCES, {"lambda": 3e-4, "zeta": 5e-5, "delta": 2e-3}, W)
TIME = np.arange(700) * 2.0 * np.pi / W / 40
# Five noise levels of wander at the end.
DENSITY = density_that_wanders(5.0, NOISE, TIME, W)


def measured(angle, seed=0):
    return decay(TIME, np.asarray(angle), seed, NOISE)


def identified(decay, random_force, forces=FORCES):
    return st.identify(decay, forces, st.methods.Trajectory(random_force=random_force, start=MODEL))


@pytest.fixture(scope="module")
def pushed():
    motion = st.simulate(MODEL, TIME, 0.3, random_force=DENSITY, seed=2)
    decay = measured(motion.angle)
    return motion, decay, identified(decay, DENSITY)


def test_without_a_random_force_they_are_the_residual_of_a_free_motion():
    decay = measured(st.simulate(MODEL, TIME, 0.3).angle)
    result = identified(decay, "off")
    found = st.validation.innovations(decay, result)
    motion = fit_start(st.physics.model_of(result), TIME, decay.angle.values, (0.3, 0.0))
    residual = decay.angle.values - motion.x - motion.offset
    assert found.innovation.values == pytest.approx(residual, abs=1e-2 * NOISE)
    assert found.smoothed_rate.values == pytest.approx(W * motion.v, abs=1e-4 * W)
    assert (found.random_force == 0.0).all()
    assert found.innovation_standard_deviation.values == pytest.approx(result.noise.item(), rel=1e-12)
    assert found.ljung_box_p_value > 0.001


def test_innovations_of_the_right_model_are_white_and_of_the_stated_size(pushed):
    motion, decay, result = pushed
    found = st.validation.innovations(decay, result)
    assert found.ljung_box_p_value > 0.01
    assert np.abs(found.autocorrelation).max() < 4.0 / np.sqrt(len(TIME))
    normalised = found.innovation / found.innovation_standard_deviation
    assert normalised.std().item() == pytest.approx(1.0, abs=0.1)
    assert found.innovation_rms == pytest.approx(np.sqrt((found.innovation**2).mean()))
    # Nearer to the motion than the sensor is.
    offset = result.offset.item()
    assert np.sqrt(np.mean((found.smoothed_angle + offset - motion.angle) ** 2)) < 0.5 * NOISE
    assert np.sqrt(np.mean((found.smoothed_rate - motion.rate) ** 2)) < 0.02 * 0.3 * W


def test_the_random_force_has_the_variance_that_is_left_to_it(pushed):
    _, decay, result = pushed
    found = st.validation.innovations(decay, result)
    # Of a Gaussian force its estimate has the prior variance but for that of its error.
    known = (found.random_force**2 + found.random_force_standard_error**2).mean().item()
    assert known == pytest.approx(0.5 * DENSITY / found.averaging_time.item(), rel=0.35)


@pytest.mark.parametrize("push", [0.02, -0.05])
def test_a_push_is_seen_when_it_was_and_as_large_as_it_was(push, pushed):
    at, step = 300, float(TIME[1])
    before = st.simulate(MODEL, TIME[: at + 1], 0.3)
    x, rate = before.angle.values[-1], before.rate.values[-1]
    after = st.simulate(MODEL, TIME[at:], x, rate + push)
    decay = measured(np.concatenate([before.angle.values, after.angle.values[1:]]))
    result = pushed[2].copy(deep=True)
    result.coefficient.values[:] = [MODEL.coefficients[s] for s in result.force.values]
    result["reference_frequency"] = result["reference_frequency"] * 0.0 + W
    result = result.assign(refers_to=result.refers_to * 0.0 + W)
    found = st.validation.innovations(decay, result)
    largest = int(np.abs(found.random_force.values).argmax())
    assert abs(largest - at) * step < 2.0 * found.averaging_time.item()
    # The smoother spreads it over a few of its spans.
    width = 2 * round(found.averaging_time.item() / step)
    impulse = found.random_force.isel(time=slice(at - width, at + width)).sum().item() * step
    # A push this rare is taken for less than it is.
    assert 0.5 < impulse / push < 1.1


def test_a_gap_is_a_long_step(pushed):
    _, decay, result = pushed
    gap = decay.isel(time=[*range(300), *range(420, 700)])
    found = st.validation.innovations(gap, result)
    assert found.innovation_standard_deviation.values[300] > 2.0 * NOISE
    assert found.ljung_box_p_value > 0.001


def test_bands_contain_the_measured_values(pushed):
    _, decay, result = pushed
    ahead = np.array([0.5, 1.0, 3.0])
    bands = st.validation.prediction_bands(decay, result, ahead, origins=np.arange(2.0, 9.5, 0.4))
    assert bands.predicted.dims == ("origin", "horizon")
    score = (bands.measured - bands.predicted) / bands.predicted_standard_error
    assert 0.6 < np.sqrt((score**2).mean()) < 1.4
    assert (np.diff(bands.predicted_standard_error.mean("origin")) > 0.0).all()
    # The band includes the random force during the prediction: over tau, its variance of x is per_tau * tau /
    # 2.
    wander = np.sqrt(0.5 * RandomForce(DENSITY).per_tau(W) * 2.0 * np.pi * ahead + NOISE**2)
    assert (bands.predicted_standard_error.mean("origin") > 0.9 * wander).all()


def test_a_prediction_uses_no_sample_after_its_origin(pushed):
    _, decay, result = pushed
    # Linear about the smoothed motion, which knows them all: to first order nothing of it is left.
    other = decay.copy(deep=True)
    other.angle[400:] += 3.0 * NOISE
    origins = [float(TIME[390])]
    first, second = (
        st.validation.prediction_bands(d, result, [1.0], origins=origins) for d in (decay, other)
    )
    assert abs((first.predicted - second.predicted).item()) < 0.02 * NOISE


def test_requests_that_no_record_supports(pushed):
    _, decay, result = pushed
    with pytest.raises(UsageError, match="positive"):
        st.validation.prediction_bands(decay, result, [0.0])
    with pytest.raises(DecayError, match="fewer periods"):
        st.validation.prediction_bands(decay, result, [500.0])
    with pytest.raises(DecayError, match="start between"):
        st.validation.prediction_bands(decay, result, [1.0], origins=[0.0])
