"""The free decay is found, whole and centred, in clean, noisy, coarse, filmed and hand-released records."""

import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers import FIVE, paper_run
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records.free_decay import free_decay
from sysid_trib.records.half_periods import find_half_periods, quantisation_step, smooth
from sysid_trib.records.read import read_record

OMEGA = 9.91


def record(time, angle):
    return xr.Dataset(
        {"angle": ("time", angle, {"units": "rad"})}, coords={"time": time}, attrs={"source": "run.csv"}
    )


def linear(time, zeta=0.01, phase=0.0, amplitude=0.3, omega=OMEGA):
    """x'' + 2 zeta w x' + w^2 x = 0, exactly."""
    return amplitude * np.exp(-zeta * omega * time) * np.cos(omega * np.sqrt(1 - zeta**2) * time + phase)


def dry(time, solid=2e-3, amplitude=0.3, omega=OMEGA):
    """Dry friction alone, exactly: half cosines about -+ solid, until within the stick band."""
    half = np.floor(omega * time / np.pi)
    last = np.ceil((amplitude / solid - 1.0) / 2.0)
    number = np.minimum(half, last)
    size = amplitude - (2 * number + 1) * solid
    moving = (-1.0) ** number * (size * np.cos(omega * time - np.pi * number) + solid)
    stuck = (-1.0) ** last * (amplitude - 2 * last * solid)
    return np.where(half < last, moving, stuck), last * np.pi / omega


def whole(decay, original, tolerance):
    assert decay.sizes == original.sizes
    np.testing.assert_array_equal(decay["time"], original["time"])
    assert abs(decay["equilibrium"].item()) < tolerance
    assert "cut nothing" in decay.attrs["free_decay"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, r"equilibrium \S+ ± \S+ rad, subtracted"),
        ({"equilibrium": 0.001}, "0.001 rad as given"),
    ],
)
def test_the_equilibrium_that_was_subtracted_is_stated(options, said):
    time = np.arange(0.0, 8.0, 0.01)
    decay = free_decay(record(time, linear(time)), **options)
    assert re.search(said, decay.attrs["free_decay"])


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    phase=st.floats(-np.pi, np.pi),
    zeta=st.floats(0.002, 0.08),
    rate=st.sampled_from([25.0, 60.0, 100.0, 1000.0]),
    periods=st.floats(6.0, 12.0),
)
def test_clean_record_loses_no_sample(phase, zeta, rate, periods):
    time = np.arange(0.0, periods * 2 * np.pi / OMEGA, 1 / rate)
    original = record(time, linear(time, zeta, phase))
    whole(free_decay(original), original, 1e-3)


@pytest.mark.parametrize("rate", [20.0, 100.0, 1000.0])
@pytest.mark.parametrize("hand", ["holds", "lifts"])
def test_samples_before_the_release_are_cut(hand, rate):
    count = round(0.2 * 2.0 * np.pi / OMEGA * rate)
    before = 1.0 if hand == "holds" else 1.0 - 0.25 * np.linspace(1.0, 0.0, count, endpoint=False) ** 2
    free = linear(np.arange(0.0, 12.0, 1.0 / rate), 0.01)
    angle = np.append(free[0] * np.ones(count) * before, free)
    decay = free_decay(record(np.arange(angle.size) / rate, angle))
    assert decay.time.values[0] * rate >= count - 0.5
    assert "before the first free extremum" in decay.attrs["free_decay"]


@settings(max_examples=8, deadline=None, derandomize=True)
@given(phase=st.floats(-np.pi, np.pi), seed=st.integers(0, 1000), offset=st.floats(-3, 3))
def test_noise_at_1_khz_makes_no_half_periods(phase, seed, offset):
    time = np.arange(0.0, 25.0, 1e-3)
    angle = (
        linear(time, 0.011, phase) + offset + 1e-3 * np.random.default_rng(seed).standard_normal(time.size)
    )
    decay = free_decay(record(time, angle))
    assert decay.sizes["time"] == time.size
    assert abs(decay["equilibrium"].item() - offset) < 5 * max(
        decay["equilibrium_standard_error"].item(), 1e-5
    )
    halves = find_half_periods(smooth(time, decay["angle"].to_numpy(), 2 * np.pi / OMEGA))
    assert abs(halves.sign.size - 25.0 * OMEGA / np.pi) <= 2
    assert np.all(np.diff(halves.sign) != 0)


@pytest.mark.parametrize("step", [0.01, 0.002])
@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_coarse_steps(step, rate):
    time = np.arange(0.0, 25.0, 1 / rate)
    original = record(time, step * np.round((linear(time) + 0.0713) / step))
    decay = free_decay(original)
    assert decay.sizes["time"] == time.size
    assert decay["equilibrium"].item() == pytest.approx(0.0713, abs=0.1 * step)
    assert quantisation_step(original["angle"].to_numpy()) == pytest.approx(step)


@pytest.mark.parametrize("hold", [0.2, 30.0])
@pytest.mark.parametrize("rest", [0.0, 40.0])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_hand_release_and_stop_are_found(hold, rest, noise):
    time = np.arange(0.0, rest + 0.8 + hold + 40.0, 1e-3)
    release = rest + 0.8 + hold
    swing, duration = dry(np.maximum(time - release, 0.0))
    lift = np.clip((time - rest) / 0.8, 0.0, 1.0)
    angle = np.where(time < release, 0.3 * (1 - np.cos(np.pi * lift)) / 2, swing) + 1.3
    decay = free_decay(record(time, angle + noise * np.random.default_rng(5).standard_normal(time.size)))
    first = decay["time"][0].item()
    assert release < first < release + 1.2 * np.pi / OMEGA
    assert decay["stop_time"].item() == pytest.approx(release + duration, abs=0.15)
    assert decay["time"][-1].item() <= decay["stop_time"].item()
    assert abs(decay["equilibrium"].item() - 1.3) < max(4 * decay["equilibrium_standard_error"].item(), 2e-5)


def swung(time, brake=lambda instant: 0.0, start=(0.0, 0.8, 0.0)):
    """Angle and rate of a pendulum with solid, viscous and air friction, and a brake of dry friction."""
    omega = 2.0 * np.pi / 1.5

    def acceleration(instant, state):
        angle, rate = state
        speed = rate / omega
        solid = (8e-4 + brake(instant)) * np.tanh(speed / 1e-3)
        return rate, -(omega**2) * (np.sin(angle) + solid + 4e-3 * speed + 3e-3 * speed * abs(speed))

    begin, *state = start
    return solve_ivp(
        acceleration, (begin, time[-1]), state, t_eval=time, max_step=0.02, rtol=1e-8, atol=1e-9
    ).y


PENDULUM = np.arange(0.0, 90.0, 0.005)
CAUGHT = 68.0


@pytest.fixture(scope="module")
def pendulum():
    return swung(PENDULUM)


def stopped_by_hand(pendulum, instant, took, rest):
    """The pendulum, moved smoothly by a hand to the position in which it is held."""
    angle, rate = (np.interp(instant, PENDULUM, values) for values in pendulum)
    share = np.clip((PENDULUM - instant) / took, 0.0, 1.0)
    go = 2 * share**3 - 3 * share**2 + 1
    moved = go * angle + (share**3 - 2 * share**2 + share) * rate * took + (1 - go) * rest
    return np.where(instant > PENDULUM, pendulum[0], moved)


@pytest.mark.parametrize("instant", CAUGHT + np.array([0.0, 0.6]))
@pytest.mark.parametrize(("took", "rest"), [(0.2, 0.1), (0.5, -0.2), (1.0, -0.1)])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_hand_that_stops_the_swing_is_cut_off(pendulum, instant, took, rest, noise):
    angle = stopped_by_hand(pendulum, instant, took, rest)
    angle += noise * np.random.default_rng(2).standard_normal(angle.size)
    decay = free_decay(record(PENDULUM, angle))
    assert instant - 1.6 < decay["time"][-1] < instant + 0.01
    assert "deviates from the decay" in decay.attrs["free_decay"]
    assert "stop_time" not in decay


@pytest.mark.parametrize("end", [67.3, 68.0, 68.4, 89.0])
def test_a_swing_without_a_stop_is_kept_to_its_end(pendulum, end):
    time = PENDULUM[end > PENDULUM]
    original = record(time, pendulum[0, : time.size])
    whole(free_decay(original), original, 1e-4)


@pytest.mark.parametrize("solid", [1e-3, 5e-3, 0.02])
def test_arrest_by_friction_is_not_taken_for_a_hand(solid):
    time = np.arange(0.0, np.ceil(0.5 * 0.3 / solid) * np.pi / OMEGA + 10.0, 2e-3)
    angle, stop = dry(time, solid)
    decay = free_decay(record(time, angle))
    assert "hand" not in decay.attrs["free_decay"]
    assert decay["stop_time"].item() == pytest.approx(stop, abs=0.1)


def test_mains_hum_does_not_mislead_and_a_wild_sample_is_named():
    time = np.arange(0.0, 25.0, 1e-3)
    angle = linear(time, 0.011) + 0.003 * np.sin(2 * np.pi * 50 * time)
    decay = free_decay(record(time, angle))
    assert decay.sizes["time"] == time.size
    assert abs(decay["equilibrium"].item()) < 1e-4
    for leap in (1.0, -9.0):
        wild = angle.copy()
        wild[7000] += leap
        cleaned = free_decay(record(time, wild))
        assert "1 outlier left out" in cleaned.attrs["free_decay"]
        assert "at 7 s" in cleaned.attrs["free_decay"]
        np.testing.assert_allclose(cleaned["angle"], decay["angle"], atol=0.004)
        kept = free_decay(record(time, wild), keep_outliers=True)
        assert "outlier" not in kept.attrs["free_decay"]


@pytest.mark.parametrize("zeta", [0.03, 0.06, 0.1])
def test_equilibrium_of_a_strong_decay_is_not_biased(zeta):
    time = np.arange(0.0, 5 * 2 * np.pi / OMEGA, 0.002)
    decay = free_decay(record(time, 0.5 + linear(time, zeta)))
    assert decay["equilibrium"].item() == pytest.approx(0.5, abs=3e-5)


T = np.arange(0.0, 20.0, 0.01)
GENERATOR = np.random.default_rng(7)
REFUSED = {
    "flat": (T, np.full(T.size, 0.1), "flat"),
    "only noise": (T, 1e-3 * GENERATOR.standard_normal(T.size), "noise"),
    "growing": (T, linear(T, zeta=-0.005, amplitude=0.01), r"grows by 3\.\d % a period"),
    "no decay": (T, linear(T, zeta=0.0), "does not decay"),
    "clipped": (T, np.clip(linear(T), -0.02, 0.02), r"clipped at -0\.02 or 0\.02, to the end"),
    "clipped on one side": (T, np.clip(linear(T), -1, 0.015), "at least five are needed"),
    "pulses": (T, 90.0 - 70.0 * np.exp(-((linear(T) / 0.03) ** 4)), "pulses, like that of a light barrier"),
    "missing value": (
        T,
        np.where(np.arange(T.size) == 700, np.nan, linear(T)),
        "at 7 s is not a finite number",
    ),
    "pushed": (T, linear(T, 0.02) + 0.15 * (T > 9) * linear(np.maximum(T - 9, 0), 0.02), "rises again at 9"),
    "beats": (T, linear(T, 0.002) + linear(T, 0.002, omega=10.6, amplitude=0.2), "two modes beat"),
    "coarse": (T, linear(T, omega=220.0, zeta=0.0005), "samples in a half period; sample faster"),
    "few samples": (T[:15], linear(T[:15]), "only 15 samples"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_records_other_than_free_decays_are_refused(name):
    time, angle, reason = REFUSED[name]
    with pytest.raises(DecayError, match=reason) as refusal:
        free_decay(record(time, angle))
    assert re.fullmatch(r"run\.csv: .*", str(refusal.value))


@pytest.mark.parametrize("options", [{"window": (5, 5)}, {"window": (9, 1)}, {"equilibrium": "middle"}])
def test_wrong_options(options):
    with pytest.raises(UsageError):
        free_decay(record(T, linear(T)), **options)


PHI = {"angle": "phi"}


@pytest.mark.parametrize(
    ("file", "options", "window", "equilibrium", "ends", "count"),
    [
        ("single_pendulum/free_swing.csv", {}, (None, None), (3.1423, 3e-4), (5.2, 5.9, 89.3, 89.6), None),
        ("single_pendulum/free_swing.csv", {}, (15, 75), (3.1423, 3e-4), (15, 15, 75, 75), 60001),
        ("string_pendulum/run_1.txt", {}, (None, None), (0.0113, 0.004), (0, 0, 116.4, 116.41), 2330),
        ("roll_decay/model_test_21337.csv", PHI, (25, None), (2.05e-4, 3e-5), (25, 25.02, 91.6, 91.7), 6665),
    ],
)
def test_measured(data_folder, file, options, window, equilibrium, ends, count):
    decay = free_decay(read_record(data_folder / file, **options), window=window)
    assert decay["equilibrium"].item() == pytest.approx(equilibrium[0], abs=equilibrium[1])
    assert ends[0] <= decay["time"][0] <= ends[1]
    assert ends[2] <= decay["time"][-1] <= ends[3]
    assert ("stop_time" in decay) == (window == (None, None) and "free_swing" in file)
    assert count is None or decay.sizes["time"] == count


@pytest.mark.parametrize("kind", ["frame", "column", "series", "dates", "array", "data_array", "old"])
def test_data_in_memory_are_a_record(kind):
    """pandas, NumPy, and times that are dates: the same decay as from a Dataset."""
    decay = paper_run(FIVE, duration=10.0).decay(1)
    time, angle = decay.time.values, decay.angle.values
    dates = pd.Timestamp("2026-11-27 09:00") + pd.to_timedelta(time, "s")
    made = {
        "frame": pd.DataFrame({"time": time, "angle": angle, "load": 1.0}),
        "column": pd.DataFrame({"phi": angle}, index=time),
        "series": pd.Series(angle, index=pd.to_timedelta(time, "s")),
        "dates": pd.Series(angle, index=dates),
        "array": np.column_stack([time, angle]),
        "data_array": xr.DataArray(angle, {"t": time}, "t"),
        "old": decay.assign_coords(time=dates.to_numpy()),
    }[kind]
    expected, found = free_decay(decay), free_decay(made)
    assert found.angle.values == pytest.approx(expected.angle.values)
    assert np.diff(found.time.values) == pytest.approx(np.diff(expected.time.values))


@pytest.mark.parametrize(
    "unclear",
    [np.zeros((5, 3)), pd.DataFrame({"a": [1.0], "b": [2.0]}), xr.DataArray(np.zeros((2, 2))), [1.0, 2.0]],
    ids=str,
)
def test_records_without_a_clear_signal_are_refused(unclear):
    with pytest.raises(UsageError):
        free_decay(unclear)
