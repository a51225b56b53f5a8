"""Windowed ERA: local frequency and decay without a model, and the linear coefficients it can name."""

import numpy as np
import pytest
from helpers import FIVE, SIX, Run, W, decay, paper_run, rms, rms_range
from hypothesis import given, settings, strategies as st

from sysid_trib import Model, load, load_library, save
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.methods import WindowedERA, windowed_modes
from sysid_trib.simulation.simulate import trajectory

FORCES = load_library()
LINEAR = {"zeta": 0.0097}
SEEDS = 25


def local_truth(run: Run, time):
    """Frequency and decay rate between the exact turning points of the motion, at these times."""
    turns = np.append(run.time[0], trajectory(run.model, run.time, run.start).reversals)
    turns = np.unique(np.round(turns, 12))
    size = np.abs(trajectory(run.model, turns, run.start).angle)
    span = turns[2:] - turns[:-2]
    local = 2.0 * np.pi / span, np.log(size[:-2] / size[2:]) / span
    return [np.interp(time, turns[1:-1], values) for values in local]


@pytest.mark.parametrize("sampling_rate", [25.0, 100.0, 1000.0])
def test_local_values_on_the_papers_run(sampling_rate):
    run = paper_run(SIX, sampling_rate=sampling_rate)
    modes = windowed_modes(run.decay())
    frequency, rate = local_truth(run, modes.window_time.values)
    np.testing.assert_allclose(modes.window_frequency.values, frequency, rtol=1e-3)
    np.testing.assert_allclose(modes.window_decay_rate.values, rate, rtol=2.5e-2)


@settings(deadline=None, max_examples=20)
@given(
    zeta=st.floats(-0.01, 0.15),
    w=st.floats(0.5, 300.0),
    per_period=st.floats(12.0, 400.0),
    start=st.floats(-2.0, 2.0).filter(lambda a: abs(a) > 0.01),
)
def test_a_linear_oscillator_is_found_exactly(zeta, w, per_period, start):
    step = 2.0 * np.pi / w / per_period
    run = Run(Model(FORCES, {"zeta": zeta}, w), step * np.arange(round(6.5 * per_period)), start)
    found = WindowedERA().identify(run.decay(), FORCES)
    assert found.coefficient.item() == pytest.approx(zeta, abs=1e-7)
    assert found.reference_frequency.item() == pytest.approx(w, rel=1e-7)
    assert found.asymptotic_frequency.item() == pytest.approx(w * np.sqrt(1.0 - zeta**2), rel=1e-7)
    exact = abs(start) / np.sqrt(1.0 - zeta**2) * np.exp(-zeta * w * found.window_time.values)
    np.testing.assert_allclose(found.window_amplitude.values, exact, rtol=1e-5)


@pytest.mark.in_full
@pytest.mark.parametrize("sampling_rate", [40.0, 400.0])
def test_standard_errors_tell_the_scatter(sampling_rate):
    run = paper_run(LINEAR, duration=6.0, sampling_rate=sampling_rate)
    exact, whole, single = run.angle, [], []
    amplitude = windowed_modes(run.decay()).window_amplitude.values
    truth = {"frequency": W * np.sqrt(1.0 - 0.0097**2), "decay_rate": W * 0.0097, "amplitude": amplitude}
    for seed in range(SEEDS):
        found = WindowedERA().identify(decay(run.time, exact, seed), FORCES)
        gaps = found.coefficient.item() - 0.0097, found.reference_frequency.item() - W
        told = found.standard_error.item(), found.reference_frequency_standard_error.item()
        whole.append(np.divide(gaps, told))
        # Two windows that share no samples.
        single.append(
            [
                ((found[f"window_{k}"] - v) / found[f"window_{k}_standard_error"]).values[[0, -1]]
                for k, v in truth.items()
            ]
        )
    low, high = rms_range(SEEDS)
    for pulls in (whole, single):
        assert np.all((rms(pulls) > low) & (rms(pulls) < high))


def test_what_is_not_linear_shows_in_the_birge_ratio():
    linear, other = (WindowedERA().identify(paper_run(f).decay(0), FORCES) for f in (LINEAR, FIVE))
    assert linear.birge_ratio.item() == pytest.approx(1.0, abs=0.4)
    assert other.birge_ratio.item() > 50.0
    assert other.standard_error > 20.0 * linear.standard_error
    assert "linear oscillator" in other.attrs["assumes"]


def test_windows_are_kept_in_the_result(tmp_path):
    record = paper_run(FIVE).decay(0)
    found, modes = WindowedERA().identify(record, FORCES), windowed_modes(record)
    for name, values in modes.items():
        assert values.attrs["units"]
        np.testing.assert_array_equal(found[name].values, values.values)
    save(found, tmp_path / "found.nc")
    np.testing.assert_array_equal(load(tmp_path / "found.nc").window_time.values, modes.window_time.values)
    spacing = np.diff(modes.window_time.values)
    np.testing.assert_allclose(spacing, np.pi / W, rtol=0.06)


def test_uneven_times_are_taken_as_they_are():
    even = paper_run(LINEAR, duration=6.0).time
    time = even + 2e-5 * np.random.default_rng(0).standard_normal(len(even))
    found = WindowedERA().identify(Run(Model(FORCES, LINEAR, W), time).decay(), FORCES)
    assert found.coefficient.item() == pytest.approx(0.0097, rel=1e-4)


def test_slow_sampling_is_refused():
    with pytest.raises(DecayError, match="sample faster"):
        windowed_modes(paper_run(LINEAR, sampling_rate=12.0).decay())


def test_several_records_are_refused():
    with pytest.raises(UsageError, match="one record at a time"):
        WindowedERA().identify([paper_run(LINEAR).decay()], FORCES)


def test_noise_without_oscillation_is_refused():
    random = np.random.default_rng(0)
    time = np.arange(1000) / 100.0
    with pytest.raises(DecayError):
        windowed_modes(decay(time, 1e-3 * random.standard_normal(1000)))
