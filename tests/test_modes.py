"""Several modes in one decay: listed, separated, combined over sensors; and the texts of the commands."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_table

import sysid_trib as st
from benchmarks.coupled_modes import random_decay
from benchmarks.modes import (
    LINEAR,
    SHAPES as BEAM_SHAPES,
    W0,
    Z0,
    Law,
    beam,
    close_modes,
    holds,
    linear,
    mode_of_known_forces,
    ringing,
    sensors,
    verdict_on_mode,
)
from sysid_trib.cycles.backbone import half_width
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.likelihood.integrated_noise import integrated_noise
from sysid_trib.likelihood.sensor_noise import whitened
from sysid_trib.records import smoothing
from sysid_trib.records.integration import as_position
from sysid_trib.records.mode_search import find_ringing
from sysid_trib.records.one_mode import decimated

RATE = 4096.0
CLOCK = np.arange(16_384) / RATE - 0.05
SHAPES = np.array([[0.5, 1.0], [1.0, -0.7], [-0.8, 0.4]])


def two_modes(noise=0.01, seed=0, shapes=SHAPES, second=(211.0, 0.004, 30.0), first=None):
    """A nonlinear mode of 80 Hz together with a linear one."""
    own = ringing(CLOCK, Law(), 60.0) if first is None else first
    clean = shapes @ np.array([own, linear(CLOCK, *second)])
    random = np.random.default_rng(seed)
    return sensors(CLOCK + 0.05, clean + noise * random.standard_normal(clean.shape))


def written(folder, record, name="blow.csv"):
    """Sensors as a file."""
    heads = ["time (s)", *(f"{sensor} (m/s^2)" for sensor in record.sensor.values)]
    return write_table(folder / name, ",".join(heads), record.time.values, *record.signal.values)


def linear_beam():
    """A beam without friction in its joints, struck at 0.05 s."""
    source = beam()
    clock = source.time - source.blow
    of_beam = (W0 / (2.0 * np.pi), Z0, 62.0)
    clean = BEAM_SHAPES @ np.array([linear(clock, *of_mode) for of_mode in (of_beam, *LINEAR)])
    return replace(source, clean=clean)


@pytest.fixture(scope="module")
def record():
    return two_modes()


@pytest.fixture(scope="module")
def separate(record):
    return st.one_mode(record, 1)


def test_modes_are_listed_at_small_amplitude(record):
    listed = st.modes(record)
    assert listed.frequency.values == pytest.approx([80.0, 211.0], rel=1e-3)
    assert listed.damping_ratio.values == pytest.approx([0.0015, 0.004], rel=0.03)
    assert listed.first_amplitude.values[1] == pytest.approx([30.0, 21.0, 12.0], rel=0.03)
    assert listed.attrs["influences"] == []


def test_offset_hum_and_a_late_blow_change_nothing():
    source = beam(count=32_000, blow=0.4, hum=0.3, offset=300.0)
    listed = st.modes(source.record(1))
    assert listed.frequency.values == pytest.approx([80.0, *(f for f, *_ in LINEAR)], rel=1e-3)
    assert listed.attrs["lines"] == "50"
    assert listed.attrs["start"] == pytest.approx(0.4, abs=5e-3)


def test_a_drift_of_the_sensors_is_subtracted(record):
    """As of a charge amplifier after a blow."""
    time = record.time.values
    drifting = record.copy(deep=True)
    drifting.signal.values += 0.8 * time + 0.3 * np.sin(2.0 * np.pi * 0.3 * time)
    separate = st.one_mode(drifting, 1)
    assert "a slow drift of acc1 and acc2 and acc3 subtracted" in separate.attrs["separation"]
    assert "exceeds the white noise" not in separate.attrs["separation"]
    assert holds(st.backbone(st.free_decay(separate)), Law(), 0.05) == {
        "frequency": True,
        "damping_ratio": True,
    }


def test_the_shape_is_that_of_the_mode(separate):
    assert separate.shape.values == pytest.approx([0.5, 1.0, -0.8], abs=2e-3)
    assert separate.attrs["angle_column"] == "acc2"
    assert "other mode subtracted" in separate.attrs["separation"]


def test_bands_of_one_of_two_modes_hold_the_truth(separate):
    curves = st.backbone(st.free_decay(separate))
    assert curves.measured_amplitude[-1].item() == pytest.approx(55.0, rel=0.1)
    assert holds(curves, Law(), 0.05) == {"frequency": True, "damping_ratio": True}


@pytest.mark.parametrize("number", [1, 2])
def test_bands_of_modes_ten_percent_apart_hold_the_truth(number):
    source = close_modes(3)
    curves = st.backbone(st.free_decay(st.one_mode(source.record(0), number)))
    assert holds(curves, source.laws[number], source.blow) == {"frequency": True, "damping_ratio": True}


def test_one_sensor_and_a_band_take_the_same_mode(record):
    single = record.isel(sensor=[1])
    by_band = st.one_mode(single, band=(70.0, 90.0))
    assert by_band.attrs["mode"] == 1
    curves = st.backbone(st.free_decay(by_band))
    assert np.interp(5.0, curves.measured_amplitude, curves.damping_ratio) == pytest.approx(0.00187, rel=0.02)


def test_white_noise_stays_white_where_samples_are_left_out():
    noise = np.random.default_rng(0).standard_normal((1, 200_000))
    kept, first = decimated(noise, 5, 0.01)
    spectrum = np.abs(np.fft.rfft(kept[0])) ** 2 / kept.size
    parts = [part.mean() for part in np.array_split(spectrum[1:], 10)]
    assert first == 50
    assert parts == pytest.approx(np.full(10, 0.2), rel=0.08)


def test_a_frequency_that_follows_another_mode_is_reported():
    decay = np.exp(-0.0015 * 2.0 * np.pi * 80.0 * np.maximum(CLOCK, 0.0))
    other = np.exp(-0.004 * 2.0 * np.pi * 211.0 * np.maximum(CLOCK, 0.0))
    frequency = 80.0 * (1.0 - 0.002 * decay + 0.003 * other**2)
    phase = 2.0 * np.pi * np.cumsum(frequency * (CLOCK >= 0.0)) / RATE
    first = np.where(CLOCK >= 0.0, 40.0 * decay * np.sin(phase), 0.0)
    (said,) = st.modes(two_modes(first=first)).attrs["influences"]
    assert "the frequency of mode 1 depends on the amplitude of mode 2" in said
    assert "by +0.2" in said


def test_modes_that_exchange_energy_are_reported():
    after = np.maximum(CLOCK, 0.0)
    beat = 1.0 + 0.4 * np.cos(2.0 * np.pi * 1.1 * after)
    first = np.where(
        CLOCK >= 0.0, 40.0 * np.exp(-0.7 * after) * beat * np.sin(2.0 * np.pi * 80.0 * after), 0.0
    )
    said = " ".join(st.modes(two_modes(first=first)).attrs["influences"])
    assert "the amplitude of mode 1 rises again" in said
    assert "exchange energy" in said


def test_a_shape_that_changes_with_the_amplitude_is_reported():
    own = ringing(CLOCK, Law(), 60.0)
    changing = two_modes()
    size = np.exp(-0.003 * 2.0 * np.pi * 80.0 * np.maximum(CLOCK, 0.0))
    changing.signal[0] += 0.1 * size * own
    assert "the shape changes with the amplitude: acc1" in st.one_mode(changing, 1).attrs["separation"]
    assert "the shape changes" not in st.one_mode(two_modes(), 1).attrs["separation"]


def test_a_second_blow_ends_the_record():
    record = two_modes()
    late = record.signal.values[:, :8192].copy()
    record.signal[:, 8192:] += 0.7 * late
    listed = st.modes(record)
    assert "the signals jump at 2." in listed.attrs["second_blow"]
    assert listed.frequency.values == pytest.approx([80.0, 211.0], rel=1e-3)


EARLIER_LEFT_OUT = "as after a second blow, or at the end of a long one: earlier samples are left out"


def with_another_blow(source, delay, size=1.0):
    """A beam that is struck again after a delay (s)."""
    samples = round(delay / (source.time[1] - source.time[0]))
    again = np.zeros_like(source.clean)
    again[:, samples:] = size * source.clean[:, :-samples]
    return replace(source, clean=source.clean + again).record(0)


@pytest.mark.parametrize(("delay", "size"), [(0.03, 1.0), (0.03, 0.1), (0.01, 1.0), (0.03, 5.0), (0.5, 1.0)])
def test_a_part_before_a_second_blow_soon_after_is_left_out(delay, size):
    record = with_another_blow(linear_beam(), delay, size)
    separate = st.one_mode(record, 1)
    said = separate.attrs["separation"]
    assert EARLIER_LEFT_OUT in said
    assert float(said.split("jump at ")[1].split()[0]) == pytest.approx(0.05 + delay, abs=2e-4)
    assert "exceeds the white noise" not in said
    curves = st.backbone(st.free_decay(separate))
    error = np.abs(curves.frequency.values - W0 * np.sqrt(1.0 - Z0**2))
    assert np.all(error < half_width(curves, "frequency"))


def test_a_weak_second_blow_late_ends_the_record():
    listed = st.modes(with_another_blow(linear_beam(), 2.5, 0.1))
    assert listed.attrs["second_blow"] == (
        "the signals jump at 2.55 s, as after a second blow: later samples are left out"
    )


def test_three_blows_and_a_single_wrong_sample():
    source = linear_beam()
    record = with_another_blow(source, 0.02)
    record.signal[:] += with_another_blow(source, 0.05).signal.values - source.record(0).signal.values
    assert st.modes(record).attrs["second_blow"] == f"the signals jump at 0.1001 s, {EARLIER_LEFT_OUT}"
    wrong = source.record(0)
    wrong.signal[1, 5000] += 20.0
    assert st.modes(wrong).attrs["second_blow"] == ""


def test_a_clipped_sensor_is_omitted_and_reported(record):
    clipped = record.copy(deep=True)
    clipped.signal[1] = np.clip(clipped.signal[1], -20.0, 20.0)
    separate = st.one_mode(clipped, 1)
    assert "sensor acc2 is clipped at 20 m/s^2 until" in separate.attrs["reading"]
    assert separate.sensor.values.tolist() == ["acc1", "acc3"]
    with pytest.raises(DecayError, match=r"acc2 is clipped at 20 m/s\^2 until .*--window"):
        st.one_mode(clipped.isel(sensor=[1]), 1)


def test_missing_modes_and_sensors_are_refused(record):
    with pytest.raises(
        UsageError, match=r"--mode 3 does not exist; the record has 2 modes \(1: 79.* Hz, 2: 211 Hz\)"
    ):
        st.one_mode(record, 3)
    with pytest.raises(UsageError, match="no mode is in --band 100:150 Hz"):
        st.one_mode(record, band=(100.0, 150.0))
    noise = np.random.default_rng(0).standard_normal((2, 4000))
    with pytest.raises(DecayError, match="no mode rings"):
        st.modes(sensors(np.arange(4000) / RATE, noise))


def test_modes_nearer_than_the_record_resolves_are_refused():
    first = linear(CLOCK, 80.0, 0.002, 60.0)
    for apart, duration in ((5.5, 0.45), (0.7, 2.0)):
        both = two_modes(first=first, second=(80.0 + apart, 0.002, 40.0)).isel(
            time=slice(round(duration * RATE))
        )
        with pytest.raises(DecayError, match=r"does not separate (them|the modes near)"):
            st.free_decay(st.one_mode(both, 1))


def test_the_components_explain_the_record(record):
    ringing_ = find_ringing(record.signal.values, 1.0 / RATE)
    assert ringing_.residual / ringing_.noise == pytest.approx(np.ones(3), abs=0.1)


def test_the_response_of_a_mode_is_that_of_its_truth(separate):
    curves, law = st.backbone(st.free_decay(separate)), Law()
    w = 2.0 * np.pi * np.linspace(79.0, 81.0, 41)
    response = st.response_of_mode(curves, 0.4, w, modal_mass=2.0)
    up = response.sel(sweep="up")
    assert response.amplitude.attrs["units"] == "m/s^2"
    assert response.drive.attrs["units"] == "N"
    a = up.amplitude.values / w**2
    # Of the decay's damping ratio that of steady motion differs, as this joint slips.
    part = a / law.scale
    zeta = law.zeta(a) / (1.0 + law.slip * part - 0.25 * law.hardening * part**2)
    force = a * np.hypot(law.w(a) ** 2 - w**2, 2.0 * zeta * law.w(a) * w)
    resonance = np.abs(w / law.w(a) - 1.0) < 3.0 * zeta
    assert force[resonance] == pytest.approx(np.full(resonance.sum(), 0.2), rel=0.02)
    assert np.all((up.amplitude_low <= up.amplitude) & (up.amplitude <= up.amplitude_high))


def test_close_modes_at_one_sensor_are_a_warning():
    close = two_modes(second=(84.0, 0.002, 40.0))
    alone = close.isel(sensor=[1])
    assert st.modes(close).attrs["close_modes"] == []
    assert "differ by 5" in st.modes(alone).attrs["close_modes"][0]
    assert "one sensor does not separate such close modes" in st.one_mode(alone, 1).attrs["separation"]
    assert "one sensor" not in st.one_mode(close, 1).attrs["separation"]
    assert st.modes(two_modes().isel(sensor=[1])).attrs["close_modes"] == []


@pytest.mark.parametrize("apart", [1.04, 1.05])
def test_shapes_separate_close_modes(apart):
    source = close_modes(3, apart)
    for number, law in source.laws.items():
        mode = st.one_mode(source.record(0), number)
        assert "reliably" not in mode.attrs["separation"]
        curves = st.backbone(st.free_decay(mode))
        assert holds(curves, law, source.blow) == {"frequency": True, "damping_ratio": True}


def test_close_modes_of_similar_shapes_are_a_warning():
    similar = two_modes(second=(84.0, 0.002, 40.0), shapes=np.array([[0.5, 0.45], [1.0, 0.9], [-0.8, -0.7]]))
    assert "shapes at these sensors are too similar" in st.modes(similar).attrs["close_modes"][0]
    assert "shapes at these sensors are too similar" in st.one_mode(similar, 1).attrs["separation"]


def test_modes_that_even_shapes_do_not_separate_are_a_warning():
    close = close_modes(3, 1.03).record(0)
    assert "even different shapes do not separate" in st.one_mode(close, 2).attrs["separation"]
    assert "even different shapes do not separate" in st.modes(close).attrs["close_modes"][0]


def test_a_mode_that_beats_with_an_unresolved_one_is_a_warning():
    close = close_modes(1, 1.01).record(0)
    assert "its amplitude rises again from" in st.one_mode(close, 1).attrs["separation"]


def test_a_record_with_one_signal_is_that_of_one_sensor(record):
    acceleration = record.signal.sel(sensor="acc2", drop=True)
    one = xr.Dataset({"angle": acceleration.assign_attrs(units="m")}, attrs={"source": "test"})
    assert st.one_mode(one, 2).attrs["mode"] == 2


def test_the_commands_take_one_mode(tmp_path, record):
    path = written(tmp_path, record)
    looked = run("look", path)
    assert looked.status == 0, looked.err
    assert "2 modes ring" in looked.out
    assert looked.out.splitlines()[-1] == f"Next: sysid-trib backbone {path} --mode 1"
    printed = json.loads(run("backbone", path, "--mode", 1, "--json").out)
    assert printed["runs"][0]["unit"] == "m"
    assert run("backbone", path, "--band", "70:90", "--mode", 1).complaint.endswith("give one.")
    assert "the record has 2 modes" in run("backbone", path, "--mode", 4).complaint
    assert "is for a RECORD" in run("backbone", "--mode", 1).complaint
    steady = json.loads(run("response", path, "--mode", 1, "--drive", 0.2, "--json").out)
    assert steady["drive_units"] == "m/s^2"
    beyond = run("response", path, "--mode", 1, "--drive", 1e9)
    assert "No motion of this drive is within the range of the decay" in beyond.out


def test_the_figure_of_a_mode_has_the_frequency_of_its_table(separate):
    curves = st.backbone(st.free_decay(separate))
    frequency = st.plots.backbone(curves).axes[0]
    assert frequency.get_ylabel() == "frequency (Hz)"
    low, high = frequency.get_ylim()
    assert low < separate.attrs["mode_frequency"] < high
    del curves.attrs["mode_frequency"]
    assert st.plots.backbone(curves).axes[0].get_ylabel() == "frequency (rad/s)"


def test_a_record_of_modes_names_the_option(tmp_path, record):
    path = written(tmp_path, record)
    asked = run("response", path, "--drive", 0.2)
    assert asked.status == 2
    assert "this is a record, no result; give the mode whose response is wanted (1: 80 Hz" in asked.complaint
    weak = written(tmp_path, two_modes(second=(211.0, 0.004, 5.0)), "weak.csv")
    assert "--mode takes one of them" in run("backbone", weak, "--angle", "acc2").out


def test_sensors_that_are_left_out_are_named(tmp_path, record):
    signals = record.signal.values.copy()
    signals[0] = 0.0
    heads = "time (s),acc1 (m/s^2),acc2 (m/s^2),speed (m/s)"
    path = write_table(tmp_path / "mixed.csv", heads, record.time.values, *signals)
    said = run("look", path).out.splitlines()[0]
    assert "speed (m/s) left out, a rate and no acceleration" in said
    assert "acc1 (m/s^2) left out, it does not move" in said
    twice = run("look", path, "--mode", "1", "--angle", "acc2,2")
    assert twice.status == 2
    assert "--angle names column acc2 (m/s^2) twice" in twice.complaint


def test_clipped_sensors_are_refused_by_look(tmp_path, record):
    clipped = record.copy(data={"signal": np.clip(record.signal.values, -15.0, 15.0)})
    refused = run("look", written(tmp_path, clipped))
    assert refused.status == 1
    assert "sensor acc1 is clipped at 15 m/s^2 until" in refused.complaint


def test_a_random_own_law_is_no_coupling():
    for seed in range(3):
        assert st.modes(sensors(*random_decay(seed, 0.0))).attrs["influences"] == []


@pytest.mark.slow
def test_forces_of_one_mode_are_identified(tmp_path, record):
    path = written(tmp_path, record)
    found = json.loads(run("identify", path, "--mode", 1, "--forces", "zeta,delta,nu,epsilon", "--json").out)
    zeta = found["methods"]["averaging"]["coefficients"]["zeta"]["value"]
    assert zeta == pytest.approx(0.0015, rel=0.05)


@pytest.mark.slow
def test_bands_hold_over_seeds():
    source, held = beam(), []
    for seed in range(6):
        curves = st.backbone(st.free_decay(st.one_mode(source.record(seed), 1)))
        held += holds(curves, source.laws[1], source.blow).values()
        assert np.median(half_width(curves, "damping_ratio")) < 2e-5
    assert sum(held) >= 10


@pytest.mark.parametrize("seed", [111, 5])
def test_a_complete_model_of_a_mode_misses_nothing(seed):
    """The noise of the integral is coloured: taken as white, it looks like an ambient vibration."""
    assert verdict_on_mode(seed, ("zeta", "delta", "nu")) == ("nothing missing", ())


@pytest.mark.slow
def test_a_force_that_a_mode_misses_is_found():
    assert verdict_on_mode(0, ("zeta", "nu")) == ("explained", ("delta",))


def test_the_noise_of_an_integrated_mode_is_known():
    run = mode_of_known_forces(0)
    noise = integrated_noise(run)
    time = np.arange(20_000) * float(run.time.values[1] - run.time.values[0])
    measured = 0.01 * np.random.default_rng(1).standard_normal(time.size)
    position = as_position(time, measured, 1.0 / 80.0, run.attrs)
    innovations = whitened(position, noise.filter_)[200:-200]
    of_record = smoothing.sensor_noise(run) * smoothing.swing_frequency(run) ** 2
    assert np.std(innovations) / noise.innovation == pytest.approx(0.01 / of_record, rel=0.05)
    assert integrated_noise(run.drop_attrs()) is None


def test_harmonics_of_a_mode_are_no_drift():
    """The third harmonic of a stiff joint does not move the ends of the integral."""
    w, time = 503.0, np.arange(4000) / 2560.0
    swing = np.exp((-2.0 + 1j * w) * time)
    third = 3e-3 * np.exp((-6.0 + 3j * w) * time)
    measured = (swing + third).real
    truth = (swing / (-2.0 + 1j * w) ** 2 + third / (-6.0 + 3j * w) ** 2).real
    attrs = {"integrations": 2, "white_noise_in": "measured"}
    error = w**2 * (as_position(time, measured, 2.0 * np.pi / w, attrs) - truth)
    assert np.max(np.abs(error)) < 2e-5
