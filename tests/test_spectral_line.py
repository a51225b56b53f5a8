"""A line in the residual is found wherever it is, and nothing else is taken for one."""

import numpy as np
import pytest
from helpers import decay

import sysid_trib as st
from sysid_trib.methods import Averaging, Direct
from sysid_trib.printing.verdict import line_sentences, verdict_sentence
from sysid_trib.results.judged import verdict_of
from sysid_trib.validation.cross_check import cross_check
from sysid_trib.validation.lack_of_fit import spectral_line
from sysid_trib.validation.residuals import fitted_motion
from sysid_trib.validation.verdict import identifications

TIME = np.arange(0.0, 30.0, 0.01)
NOISE = 3e-4
FORCES = st.load_library().select(["zeta", "delta"])
MOTION = st.simulate(st.Model(FORCES, {"zeta": 0.005, "delta": 0.02}, 9.0), TIME, angle=0.5).angle.values


def noise(seed=0):
    return NOISE * np.random.default_rng(seed).standard_normal(len(TIME))


def found(residual):
    return spectral_line(TIME, residual, (MOTION, np.gradient(MOTION, TIME) / 9.0))


@pytest.mark.parametrize("frequency", [0.5, 2.13, 4.6, 18.02, 47.3])
def test_a_line_has_its_frequency_and_amplitude(frequency):
    at, amplitude = found(noise() + 3e-3 * np.sin(2.0 * np.pi * frequency * TIME + 1.0))
    assert at / (2.0 * np.pi) == pytest.approx(frequency, abs=0.003)
    assert amplitude == pytest.approx(3e-3, rel=0.03)


@pytest.mark.parametrize("frequency", [0.57, 2.15, 5.01, 7.88, 9.88])
def test_a_line_is_found_in_a_short_record_above_and_below_the_motion(frequency):
    # Ten periods: the harmonics of the motion leak into all of the spectrum.
    short = slice(0, 700, 2)
    residual = (noise() + 3e-3 * np.sin(2.0 * np.pi * frequency * TIME + 1.0))[short]
    motion = MOTION[short], np.gradient(MOTION, TIME)[short] / 9.0
    at, amplitude = spectral_line(TIME[short], residual, motion)
    assert at / (2.0 * np.pi) == pytest.approx(frequency, abs=0.04)
    assert amplitude == pytest.approx(3e-3, rel=0.1)


def test_the_residual_of_a_missing_force_is_no_line():
    forces = st.load_library().select(["zeta", "delta", "nu", "epsilon"])
    model = st.Model(forces, dict(zip(forces.symbols, (0.005, 0.037, -0.4, 0.3), strict=True)), 9.91)
    clean = st.simulate(model, TIME[:2500], angle=0.3)
    record = st.free_decay(clean.assign(angle=clean.angle + 0.5 * noise(11)[:2500]))
    result = st.identify(record, forces.select(["zeta", "delta", "nu"]), Averaging(random_force="off"))
    motion = fitted_motion(record, result)
    residual = record.angle.values - motion.offset - motion.x
    assert np.std(residual) > NOISE
    assert np.isnan(spectral_line(record.time.values, residual, (motion.x, motion.v))[0])


@pytest.mark.parametrize("seed", range(5))
def test_noise_holds_no_line(seed):
    assert np.isnan(found(noise(seed))[0])
    assert np.isnan(found(np.cumsum(noise(seed)))[0])


@pytest.mark.parametrize("samples", range(185, 197))
def test_a_short_record_holds_no_line(samples):
    short = slice(samples)
    motion = MOTION[short], np.gradient(MOTION[short], TIME[short]) / 9.0
    assert np.isnan(spectral_line(TIME[short], noise()[short], motion)[0])


@pytest.mark.parametrize("step", [1e-3, 1e-2, 0.07])
def test_steps_of_the_sensor_are_no_line(step):
    assert np.isnan(found(np.round((MOTION + noise()) / step) * step - MOTION)[0])


def test_harmonics_of_the_motion_are_no_line():
    assert np.isnan(found(noise() + 0.01 * MOTION**3)[0])


@pytest.fixture(scope="module", params=[4.6, 18.02])
def hum(request):
    """A decay with hum of ten times the noise, within and above the band of the motion, and its check."""
    angle = MOTION + noise() + 4.2e-3 * np.sin(2.0 * np.pi * request.param * TIME)
    found = st.free_decay(decay(TIME, angle))
    methods = [Direct(), Direct(refine=False, random_force="off")]
    return request.param, cross_check(found, *identifications(found, FORCES, methods)[::-1])


@pytest.mark.slow
def test_hum_is_reported_but_explains_nothing_at_the_motions_frequency(hum):
    frequency, tree = hum
    assert f"{frequency:.4g} Hz of 4.2" in next(line_sentences(tree))
    if frequency < 9.0:
        assert verdict_of(tree) == "approximate"
    else:
        assert verdict_sentence(tree).endswith("noise and a spectral line.")


def test_intervals_cover_with_hum(hum):
    result = hum[1]["direct_2" if "direct_2" in hum[1] else "direct"].to_dataset()
    z = (result.coefficient - np.array([0.005, 0.02])) / result.standard_error
    assert np.all(np.abs(z.values) < 3.0)


def test_a_fit_of_the_motion_is_preferred_with_hum(hum):
    assert hum[1]["judged"].attrs["preferred"] == hum[1]["agreement"].attrs["second"]
