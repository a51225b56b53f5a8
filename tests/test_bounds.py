"""The Cramér-Rao bound against a closed solution, and on the paper's run."""

import numpy as np
import pytest
from helpers import FIVE, NOISE, SIX, W, library_of_formulas, paper_run

from sysid_trib import Model
from sysid_trib.errors import UsageError
from sysid_trib.motion_fit.cramer_rao import cramer_rao_bound


@pytest.mark.parametrize(
    ("truth", "duration", "expected"),
    [
        (SIX, 25.0, [4.8e-7, 7.2e-6, 7.7e-5, 9.7e-6, 1.9e-4, 7.5e-4]),
        (SIX | {"lambda": 1e-3}, 14.0, [1.2e-6, 1.5e-5, 1.5e-4, 2.6e-5, 4.3e-4, 1.5e-3]),
    ],
    ids=["paper", "strong dry friction"],
)
def test_on_the_papers_run(truth, duration, expected):
    run = paper_run(truth, duration=duration)
    bound = cramer_rao_bound(run.model, run.time, 0.3, 0.0, NOISE)
    np.testing.assert_allclose(bound.standard_error, expected, rtol=0.03)
    assert bound.reference_frequency_standard_error.item() == 0.0
    np.testing.assert_allclose(np.sqrt(np.diag(bound.covariance)), bound.standard_error, rtol=1e-9)


def test_of_damped_harmonic_motion_in_closed_form():
    # x = exp(-zeta tau) (a cos(q tau) + b sin(q tau)), q = sqrt(1 - zeta^2), unknown zeta, a, b and w.
    zeta, w, noise = 0.02, 6.0, 1e-3
    model = Model(library_of_formulas(zeta="2*v"), {"zeta": zeta}, w)
    time = np.arange(3000) * 0.01
    bound = cramer_rao_bound(model, time, 0.5, 0.0, noise, free=True)

    def motion(zeta, angle, rate, w):
        q, tau = np.sqrt(1.0 - zeta**2), w * time
        b = (rate / w + zeta * angle) / q
        return np.exp(-zeta * tau) * (angle * np.cos(q * tau) + b * np.sin(q * tau))

    at = np.array([zeta, 0.5, 0.0, w])
    steps = 1e-6 * np.eye(4)
    table = np.stack([(motion(*(at + s)) - motion(*(at - s))) / 2e-6 for s in steps], axis=1)
    expected = noise * np.sqrt(np.diag(np.linalg.inv(table.T @ table)))
    names = ("start_angle", "start_rate", "reference_frequency")
    found = [bound.standard_error.item(), *(bound[f"{name}_standard_error"].item() for name in names)]
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_noise_and_number_of_samples_scale_it():
    run, fine = paper_run(FIVE), paper_run(FIVE, sampling_rate=1000.0)
    one = cramer_rao_bound(run.model, run.time, 0.3, 0.0, NOISE).standard_error
    louder = cramer_rao_bound(run.model, run.time, 0.3, 0.0, 10.0 * NOISE).standard_error
    finer = cramer_rao_bound(fine.model, fine.time, 0.3, 0.0, NOISE).standard_error
    np.testing.assert_allclose(louder, 10.0 * one, rtol=1e-9)
    np.testing.assert_allclose(finer, one / np.sqrt(10.0), rtol=0.02)


def test_stiffness_and_frequency_are_one_unknown():
    run = paper_run(SIX)
    with pytest.raises(UsageError, match=r"alpha and .*frequency together"):
        cramer_rao_bound(run.model, run.time, 0.3, 0.0, NOISE, free=True)


def test_a_force_that_does_not_act_is_told():
    library = library_of_formulas(zeta="2*v", wall="max(0, abs(x) - 1)*sign(x)")
    model = Model(library, {"zeta": 0.01, "wall": 0.5}, W)
    with pytest.raises(UsageError, match="Force wall does not act"):
        cramer_rao_bound(model, paper_run().time, 0.3, 0.0, NOISE)
