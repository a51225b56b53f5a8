"""Extrema from the analytic signal, in place of half-sines."""

import numpy as np
import pytest
from helpers import FIVE, NOISE, Run, W, decay, over_seeds, paper_run, rms, rms_range, values
from hypothesis import given, settings, strategies as st

from sysid_trib import Model, load_library
from sysid_trib.errors import UsageError
from sysid_trib.methods import Averaging
from sysid_trib.records import envelope

FORCES = load_library()
ZETA = 0.0097


def viscous(zeta: float = ZETA, duration: float = 12.0) -> Run:
    return paper_run({"zeta": zeta}, duration=duration)


def exact_gaps(run: Run, zeta: float, seen) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of the amplitudes, errors of the phases (rad), of C exp(-zeta w t) cos(w_d t - p)."""
    damped = W * np.sqrt(1.0 - zeta**2)
    late = np.arctan(zeta * W / damped)
    time = seen.extremum_time.values
    phase = damped * time - late
    amplitude = run.start / np.cos(late) * np.exp(-zeta * W * time)
    return seen.extremum.values / amplitude - 1.0, phase - np.pi * np.round(phase / np.pi)


@settings(deadline=None, max_examples=15)
@given(zeta=st.floats(0.0, 0.04), turn=st.sampled_from((-1.0, 1.0)), scale=st.floats(0.01, 10.0))
def test_a_damped_oscillation_is_followed(zeta, turn, scale):
    run = viscous(zeta, 8.0)
    seen = envelope(decay(run.time, turn * scale * run.angle), "analytic-signal")
    amplitude, phase = exact_gaps(run, zeta, seen.assign(extremum=seen.extremum / scale))
    assert np.all(np.abs(amplitude) < 2e-3)
    assert np.all(np.abs(phase) < 2e-3)
    # The record's two ends alone are not so well known.
    assert np.all(np.abs(amplitude[2:-2]) < 1e-4)
    assert np.all(np.abs(phase[2:-2]) < 1e-4)
    plain = envelope(decay(run.time, turn * run.angle))
    np.testing.assert_array_equal(seen.sign.values, plain.sign.values)


def test_the_delay_of_half_sines_is_not_there():
    run = viscous()
    half_sines, analytic = (
        exact_gaps(run, ZETA, envelope(run.decay(), c))[1] for c in ("half-sines", "analytic-signal")
    )
    assert np.mean(half_sines) == pytest.approx(-ZETA / 2.0, rel=0.01)
    assert np.abs(np.mean(analytic)) < 0.01 * ZETA / 2.0


def test_variables_are_those_of_half_sines():
    record = paper_run(FIVE).decay(0)
    plain, other = envelope(record), envelope(record, "analytic-signal")
    assert list(plain.variables) == list(other.variables)
    assert plain.sizes == other.sizes
    for name in plain.data_vars:
        assert plain[name].attrs == other[name].attrs
    np.testing.assert_allclose(other.extremum, plain.extremum, rtol=5e-3)
    np.testing.assert_allclose(other.amplitude_standard_error, plain.amplitude_standard_error, rtol=0.02)


def test_standard_errors_tell_the_scatter_of_slow_variations():
    run, seeds, width = viscous(), 60, 6
    exact, quiet = run.angle, envelope(run.decay(), "analytic-signal")
    pulls = {"extremum": [], "extremum_time": []}
    for seed in range(seeds):
        seen = envelope(decay(run.time, exact, seed), "analytic-signal")
        for name, found in pulls.items():
            found.append(((seen[name] - quiet[name]) / seen[f"{name}_standard_error"]).values[: 5 * width])
    low, high = rms_range(5 * seeds)
    for found in pulls.values():
        # Means of six in turn: the error of one extremum alone is a little less than told.
        means = np.array(found).reshape(seeds, 5, width).mean(axis=2) * np.sqrt(width)
        assert low < rms(means, axis=None) < high


@pytest.mark.in_full
def test_averaging_is_unbiased_and_calibrated():
    run, method, seeds = paper_run(FIVE), Averaging(curve="analytic-signal"), 30
    quiet = method.identify(run.decay(), FORCES)
    assert quiet.attrs["first_order_bias_removed"] == "yes"
    errors, reported = over_seeds(run, lambda d: method.identify(d, FORCES), seeds)
    gap = values(quiet, FIVE) - list(FIVE.values())
    assert np.all(np.abs(gap) < 0.5 * reported[0])
    low, high = rms_range(seeds)
    pulls = rms(errors / reported)
    assert np.all((pulls > low) & (pulls < high))


def test_dry_friction_and_a_stop():
    run = paper_run({"lambda": 2e-3, "zeta": 0.002})
    result = Averaging(curve="analytic-signal").identify(
        run.decay(7).isel(time=slice(0, 1500)), FORCES.select(("lambda", "zeta"))
    )
    gap = result.coefficient.values - [2e-3, 0.002]
    assert np.all(np.abs(gap) < 5.0 * result.standard_error.values)


def test_slow_and_uneven_sampling():
    time = np.arange(200) / 25.0
    time = time + 1e-4 * np.random.default_rng(1).standard_normal(len(time))
    run = Run(Model(FORCES, {"zeta": ZETA}, W), time)
    amplitude, phase = exact_gaps(run, ZETA, envelope(run.decay(0), "analytic-signal"))
    assert rms(amplitude) < 10.0 * NOISE
    assert rms(phase) < 10.0 * NOISE


def test_another_curve_is_refused():
    with pytest.raises(UsageError, match="neither 'half-sines' nor 'analytic-signal'"):
        envelope(viscous().decay(), "parabola")
