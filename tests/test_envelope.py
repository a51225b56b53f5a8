"""Half-sines and the analytic signal give the envelope and the frequency, with true standard errors."""

import numpy as np
import pytest
import xarray as xr
from helpers import Run, W, decay, paper_run
from hypothesis import given, settings, strategies as st

from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records import envelope
from sysid_trib.records.free_decay import free_decay
from sysid_trib.records.read import read_record

OMEGA = 9.91


def decay_of(time, angle):
    return xr.Dataset(
        {"angle": ("time", angle, {"units": "rad"})}, coords={"time": time}, attrs={"source": "run.csv"}
    )


def damped(time, zeta=0.01, amplitude=0.3, phase=0.0):
    return amplitude * np.exp(-zeta * OMEGA * time) * np.cos(OMEGA * time + phase)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    phase=st.floats(-np.pi, np.pi),
    zeta=st.floats(0.001, 0.05),
    rate=st.sampled_from([60.0, 100.0, 1000.0]),
    periods=st.floats(5.0, 40.0),
)
def test_viscous_decay(phase, zeta, rate, periods):
    time = np.arange(0.0, periods * 2 * np.pi / OMEGA, 1 / rate)
    result = envelope(decay_of(time, damped(time, zeta, phase=phase)))
    # The fit depends slightly on the position of the samples; a decrement and a frequency must not.
    np.testing.assert_allclose(result["frequency"], OMEGA, rtol=2e-4)
    decrement = -result["amplitude_rate"] / result["amplitude"] / OMEGA
    np.testing.assert_allclose(decrement, np.tanh(np.pi * zeta) / np.pi, rtol=0.02)
    true = 0.3 * np.exp(-zeta * OMEGA * result["extremum_time"])
    np.testing.assert_allclose(result["extremum"], true, rtol=0.01)


@pytest.mark.parametrize(("rate", "noise"), [(100.0, 1e-4), (1000.0, 1e-3)])
def test_standard_errors_are_true(rate, noise):
    time = np.arange(0.0, 18.0, 1 / rate)
    clean = damped(time, 0.012, phase=1.0)
    reference = envelope(decay_of(time, clean))
    generator = np.random.default_rng(11)
    squares = {name: [] for name in ("extremum", "extremum_time", "amplitude", "amplitude_rate", "frequency")}
    levels = []
    for _ in range(60):
        result = envelope(decay_of(time, clean + noise * generator.standard_normal(time.size)))
        levels.append(result["white_noise"].item())
        for name, into in squares.items():
            into.append(
                (((result[name] - reference[name]) / result[f"{name}_standard_error"]) ** 2).to_numpy()
            )
    assert np.mean(levels) == pytest.approx(noise, rel=0.02)
    for name, found in squares.items():
        assert np.sqrt(np.mean(found)) == pytest.approx(1.0, abs=0.15), name


@pytest.mark.parametrize("zeta", [0.003, 0.05])
@pytest.mark.parametrize("periods", [8, 12])
def test_clean_records_keep_their_errors(zeta, periods):
    time = np.arange(0.0, periods * 2 * np.pi / OMEGA, 0.01)
    generator = np.random.default_rng(periods)
    for _ in range(40):
        found = envelope(decay_of(time, damped(time, zeta) + 1e-4 * generator.standard_normal(time.size)))
        assert (found.attrs["scatter_of_extrema"], found.attrs["scatter_of_times"]) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("angle", "reason"),
    [
        (np.zeros(500), "noise"),
        (np.random.default_rng(0).standard_normal(500), "noise"),
        (damped(np.arange(500) * 0.001), "half periods|noise"),
        (damped(np.arange(500) * 0.25), "two samples"),
    ],
)
def test_refused(angle, reason):
    step = 0.25 if reason == "two samples" else 0.001
    with pytest.raises(DecayError, match=reason):
        envelope(decay_of(np.arange(angle.size) * step, angle))


@pytest.mark.parametrize(
    ("file", "angle", "window", "count", "first", "last"),
    [
        ("single_pendulum/free_swing.csv", None, (15, 75), 145, (1.640, 6.741), (0.179, 7.997)),
        ("string_pendulum/run_1.txt", None, (None, None), 140, (0.68, 3.734), (0.185, 3.84)),
        ("roll_decay/model_test_21337.csv", "phi", (25, None), 52, (0.161, 2.4835), (0.0658, 2.4655)),
    ],
)
def test_measured(data_folder, file, angle, window, count, first, last):
    result = envelope(free_decay(read_record(data_folder / file, angle=angle), window=window))
    assert result.sizes["half_period"] == pytest.approx(count, abs=1)
    for index, (extremum, frequency) in ((0, first), (-1, last)):
        assert result["extremum"][index].item() == pytest.approx(extremum, rel=0.02)
        assert result["frequency"][index].item() == pytest.approx(frequency, rel=0.01)


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


def test_another_curve_is_refused():
    with pytest.raises(UsageError, match="neither 'half-sines' nor 'analytic-signal'"):
        envelope(viscous().decay(), "parabola")
