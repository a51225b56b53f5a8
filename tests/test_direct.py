"""Direct identification: exact without noise, as precise as any method can be with it."""

import numpy as np
import pytest
from candidates import CANDIDATES
from helpers import FIVE, NOISE, SIX, Run, W, decay, over_seeds, paper_run, rms, values

from sysid_trib import Model
from sysid_trib.forces.library import parse_library
from sysid_trib.methods import Direct
from sysid_trib.motion_fit.least_squares import cramer_rao_bound
from sysid_trib.simulation.trajectory import trajectory

STRONG = SIX | {"lambda": 1e-3}


def bound(run, **options):
    return cramer_rao_bound(run.model, run.time, run.start, 0.0, NOISE, **options).standard_error.values


@pytest.mark.parametrize("sampling_rate", [60.0, 1000.0])
@pytest.mark.parametrize("phase", [0.0, 2.5])
def test_exact_without_noise(sampling_rate, phase):
    run = paper_run(sampling_rate=sampling_rate)
    angle = trajectory(run.model, run.time, 0.3 * np.cos(phase), -0.3 * W * np.sin(phase)).angle
    result = Direct(W).identify(decay(run.time, angle), run.model.library)
    assert result.refined
    np.testing.assert_allclose(values(result, FIVE), list(FIVE.values()), rtol=1e-7)
    assert result.coefficient.sel(force="alpha").item() == pytest.approx(0.0, abs=1e-10)


def test_jittered_times_and_a_shifted_zero_of_the_sensor_cost_nothing():
    even = paper_run()
    jitter = np.random.default_rng(1).uniform(-0.0075, 0.0075, len(even.time)) * 0.01
    run = Run(even.model, even.time + jitter)
    result = Direct(W).identify(decay(run.time, run.angle + 5e-3), run.model.library)
    np.testing.assert_allclose((values(result, SIX) - list(SIX.values())) / bound(run), 0.0, atol=1e-3)
    assert result.offset.item() == pytest.approx(5e-3, abs=1e-9)


def test_reference_frequency_given_or_fitted_is_the_same_physics():
    truth = SIX | {"alpha": 0.1}
    run = paper_run(truth)
    record = run.decay(3)
    given = Direct(W).identify(record, run.model.library)
    fitted = Direct().identify(record, run.model.library)
    assert "alpha" not in fitted.force
    alpha = given.coefficient.sel(force="alpha").item()
    assert fitted.reference_frequency.item() == pytest.approx(W * np.sqrt(1.0 + alpha), rel=1e-6)
    assert fitted.asymptotic_frequency.item() == pytest.approx(given.asymptotic_frequency.item(), rel=1e-6)
    # w^2 c (theta'/w)^q stays the same: c is multiplied by (w_old/w_new)^(2 - q).
    factor = (W / fitted.reference_frequency.item()) ** np.array([2.0, 1.0, 0.0, 2.0, 2.0])
    gap = values(fitted, FIVE) - values(given, FIVE) * factor
    np.testing.assert_allclose(gap / bound(run)[[0, 1, 2, 4, 5]], 0.0, atol=0.02)


def test_strong_form_works_and_is_much_worse():
    run = paper_run()
    method = Direct(W, form="strong")
    errors, reported = over_seeds(run, lambda d: method.identify(d, run.model.library), 8)
    ratio = rms(errors) / bound(run)
    assert np.all(ratio > 30.0)
    assert np.all(rms(errors / reported) < 5.0)


def test_refinement_removes_the_bias_of_smoothed_columns():
    run = paper_run(STRONG, duration=14.0)
    unrefined = Direct(W, refine=False).identify(run.decay(), run.model.library)
    refined = Direct(W).identify(run.decay(), run.model.library)
    bias = [np.abs(values(r, STRONG) - list(STRONG.values())) / bound(run) for r in (unrefined, refined)]
    assert (unrefined.refined.item(), refined.refined.item()) == (False, True)
    assert np.max(bias[0]) > 1.0
    assert np.max(bias[1]) < 0.01


def test_missing_forces_increase_the_errors():
    run = paper_run(SIX | {"nu": -1.5})
    with_all = Direct(W).identify(run.decay(0), run.model.library)
    short = Direct(W).identify(run.decay(0), run.model.library.select(["lambda", "zeta", "delta", "alpha"]))
    assert short.birge_ratio.item() > 3.0 * with_all.birge_ratio.item()
    assert short.attrs["correlation_lags"] > 0 == with_all.attrs["correlation_lags"]
    shared = ["zeta", "delta", "alpha"]
    ratio = short.standard_error.sel(force=shared) / with_all.standard_error.sel(force=shared)
    assert np.all(ratio > 3.0)


PAST = {
    "stribeck": (1e-3, {"stribeck.s": 0.05}),
    "power": (2e-3, {"power.p": 0.5}),
    "jenkins": (0.02, {"jenkins.s": 0.02}),
    "dahl": (1e-3, {"dahl.s": 0.02}),
    "maxwell": (0.02, {"maxwell.s": 1.0}),
    "masing": (0.02, {}),
}


def run_with(symbol):
    """A decay under viscous friction, a cubic force and one that has a shape or a past."""
    coefficient, shapes = PAST[symbol]
    entries = [{"symbol": s, "formula": f} for s, f in (("zeta", "2*v"), ("epsilon", "x**3"))]
    library = parse_library({"force": [*entries, {"symbol": symbol, **CANDIDATES[symbol]}]}, "test")
    truth = {"zeta": 0.0097, "epsilon": 0.30, symbol: coefficient}
    return Run(Model(library, truth, W, shapes), np.arange(1400) / 100.0), Direct(W, shapes=shapes)


@pytest.mark.parametrize("symbol", PAST)
def test_forces_with_a_shape_or_a_past_are_exact_without_noise(symbol):
    run, method = run_with(symbol)
    result = method.identify(run.decay(), run.model.library)
    assert result.refined
    truth = run.model.coefficients
    np.testing.assert_allclose(values(result, truth), list(truth.values()), rtol=1e-7)
