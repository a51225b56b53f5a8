"""The envelope and frequency equations of Le Bot et al. 2019 with the numbers of its experiment (Sec. 3)."""

import numpy as np
import pytest

from sysid_trib import Model, load_library
from sysid_trib.cycles.envelope_prediction import predict_envelope

# PDMS sphere on glass, referred to the printed w_inf.
PDMS = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
W = 9.91


def predicted(coefficients, start=0.3, end=25.0):
    return predict_envelope(Model(load_library(), coefficients, W), np.linspace(0.0, end, 2501), start)


def test_envelope_equation():
    found = predicted(PDMS)
    a = found.amplitude.values
    slope = (
        -2 / np.pi * W * PDMS["lambda"] - a * W * PDMS["zeta"] - 4 * a**2 / (3 * np.pi) * W * PDMS["delta"]
    )
    np.testing.assert_allclose(np.gradient(a, 0.01)[1:-1], slope[1:-1], rtol=1e-5)


def test_the_run_goes_from_0_3_to_0_02_rad_in_78_half_periods():
    found = predicted(PDMS)
    assert found.amplitude[-1].item() == pytest.approx(0.02, abs=5e-4)
    assert found.phase[-1].item() / np.pi == pytest.approx(78, abs=2)


def test_frequency_rises_to_its_limit_as_the_amplitude_falls():
    # nu < 0 lowers the frequency at large amplitude, epsilon > 0 raises it, less.
    found = predicted(PDMS, end=60.0)
    assert found.frequency[0].item() == pytest.approx(
        W * (1 - 0.16 * 0.3 / np.pi * 10 / 3 + 0.9 * 0.09 / 8), rel=1e-12
    )
    assert np.all(np.diff(found.frequency) > 0)
    assert found.frequency[-1].item() == pytest.approx(W, rel=2e-3)


@pytest.mark.parametrize(("solid", "start"), [(0.03, 1.0), (1e-3, 0.3)])
def test_solid_friction_stops_the_motion_in_finite_time(solid, start):
    found = predicted({"lambda": solid}, start)
    assert found.arrest_time.item() == pytest.approx(start * np.pi / (2 * solid * W), rel=1e-12)


def test_the_remaining_time_estimate_is_that_of_solid_friction_alone():
    # From a = lambda/(2 zeta) the paper estimates pi/(4 zeta w); the viscous part shortens it by a quarter.
    solid, viscous = 1e-3, 0.01
    found = predicted({"lambda": solid, "zeta": viscous}, solid / (2 * viscous))
    estimate = np.pi / (4 * viscous * W)
    assert found.arrest_time.item() == pytest.approx(np.log(1 + np.pi / 4) / (viscous * W), rel=1e-8)
    assert found.arrest_time.item() / estimate == pytest.approx(0.738, abs=1e-3)
