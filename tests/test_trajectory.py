"""The trajectory fit: exact, at the Cramér-Rao bound (against a closed solution), from far starts."""

import numpy as np
import pytest
from candidates import CANDIDATES
from helpers import FIVE, NOISE, SIX, W, decay, library_of_formulas, paper_run, values

from sysid_trib import Model, load_library
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.methods import Trajectory
from sysid_trib.motion_fit.least_squares import cramer_rao_bound
from sysid_trib.simulation.trajectory import trajectory

FORCES = load_library()


@pytest.mark.parametrize("frequency", [W, 9.6, 10.3])
def test_converges_from_zeros(frequency):
    record = paper_run(FIVE).decay(0)
    start = Model(FORCES, dict.fromkeys(FIVE, 0.0), frequency)
    found = Trajectory(start=start).identify(record, FORCES)
    assert found.reference_frequency.item() == pytest.approx(W, abs=3e-4)
    assert found.noise.item() == pytest.approx(NOISE, rel=0.05)


def test_exact_without_noise_and_with_an_offset():
    run = paper_run(FIVE)
    found = Trajectory().identify(decay(run.time, run.angle + 5e-3), FORCES)
    assert values(found, FIVE) == pytest.approx(list(FIVE.values()), rel=1e-7)
    assert found.offset.item() == pytest.approx(5e-3, abs=1e-9)


def test_a_shape_parameter_is_fitted():
    library = parse_library(
        {"force": [{"symbol": "dahl", **CANDIDATES["dahl"]}, *_entries("zeta", "nu")]}, "test"
    )
    truth = Model(library, {"dahl": 3e-3, "zeta": 0.005, "nu": -0.3}, W, {"dahl.s": 0.03})
    time = np.arange(1500) / 100.0
    record = decay(time, trajectory(truth, time, 0.3, 0.0).angle, 1)
    found = Trajectory(W, fit_shapes=("dahl.s",), shapes={"dahl.s": 0.02}).identify(record, library)
    for value, error, true in (
        (found.shape.item(), found.shape_standard_error.item(), 0.03),
        *zip(
            values(found, truth.coefficients),
            found.standard_error.sel(force=list(truth.coefficients)).values,
            truth.coefficients.values(),
            strict=True,
        ),
    ):
        assert abs(value - true) < 4.5 * error
    assert 0.0 < found.shape_standard_error.item() < 0.01


def test_parameters_that_are_not_there_are_refused():
    record = paper_run(FIVE, duration=10.0).decay(0)
    for options, sentence in (
        ({"fit_shapes": ("lambda.s",)}, "shape"),
        ({"constraints": {"gamma": (0.0, 1.0)}}, "gamma"),
    ):
        with pytest.raises(UsageError, match=sentence):
            Trajectory(**options).identify(record, FORCES)


def _entries(*symbols):
    return [{"symbol": s, "formula": FORCES[s].formula.text} for s in symbols]


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


def test_stiffness_and_frequency_are_one_unknown():
    run = paper_run(SIX)
    with pytest.raises(UsageError, match=r"alpha and .*frequency together"):
        cramer_rao_bound(run.model, run.time, 0.3, 0.0, NOISE, free=True)
