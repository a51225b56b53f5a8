"""Frequency and damping ratio against amplitude, without a model, with bands."""

import json

import numpy as np
import pytest
import xarray as xr
from command_line import run
from hypothesis import given, strategies as some
from scipy.interpolate import PchipInterpolator

import sysid_trib as st
from sysid_trib.cycles.backbone import CURVES
from sysid_trib.forces.library import parse_library
from sysid_trib.printing.verdict import amplitude_range
from sysid_trib.results.backbone_rows import round_rows
from sysid_trib.validation.lack_of_fit import departures, lack_of_fit

W, PER_PERIOD = 2.0 * np.pi, 40


def motion(forces, periods=50, start=0.4, **options):
    """Angle of a model of (formula, coefficient)."""
    rows = [{"symbol": f"f{at}", "formula": formula} for at, (formula, _) in enumerate(forces)]
    coefficients = {f"f{at}": value for at, (_, value) in enumerate(forces)}
    model = st.Model(parse_library({"force": rows}, "test"), coefficients, W)
    time = np.arange(periods * PER_PERIOD) / PER_PERIOD
    return st.simulate(model, time, angle=start, **options)[["angle"]]


def measured(clean, noise=3e-4, seed=0):
    return clean + noise * np.random.default_rng(seed).standard_normal(clean.sizes["time"])


def decay_of(clean, **options):
    return st.free_decay(measured(clean, **options).assign_attrs(source="test"))


def holds(band, curve, name):
    """Return whether the whole curve is in the band of another."""
    inside = (curve.amplitude > band.amplitude[0]) & (curve.amplitude < band.amplitude[-1])
    amplitude, value = curve.amplitude.values[inside], curve[name].values[inside]
    low, high = (
        PchipInterpolator(band.amplitude, band[f"{name}_{end}"])(amplitude) for end in ("low", "high")
    )
    return bool(np.all((value >= low) & (value <= high)))


@pytest.fixture(scope="module")
def viscous():
    return motion([("2*v", 4e-3)])


@pytest.fixture(scope="module")
def curves(viscous):
    return st.backbone(decay_of(viscous))


def test_the_curves_of_viscous_friction_are_straight(curves):
    for name, truth in (("frequency", W), ("damping_ratio", 4e-3)):
        assert np.all((curves[f"{name}_low"] < truth) & (truth < curves[f"{name}_high"]))
    assert curves.damping_ratio.values == pytest.approx(4e-3, rel=0.2)
    assert curves.frequency.values == pytest.approx(W, rel=2e-3)


def test_amplitude_over_time_is_that_of_the_motion(curves):
    truth = 0.4 * np.exp(-4e-3 * W * curves.time)
    inside = (curves.amplitude_over_time_low < truth) & (truth < curves.amplitude_over_time_high)
    assert inside.all()


def test_all_variables_have_unit_and_name_and_come_back(curves, tmp_path):
    for name, variable in curves.variables.items():
        assert {"units", "long_name"} <= set(variable.attrs), name
    st.save(curves, tmp_path / "backbone.nc")
    xr.testing.assert_equal(st.load(tmp_path / "backbone.nc").to_dataset(), curves)
    assert curves.amplitude.attrs["units"] == "rad"
    dissipative = curves.damping_ratio * curves.amplitude
    np.testing.assert_allclose(curves.dissipative_force, dissipative)


FORCES = {
    "softening and drag": [("x**3", -0.15), ("v*abs(v)", 0.02), ("2*v", 2e-3)],
    "stop": [("max(0, abs(x) - 0.15)*sign(x)", 0.3), ("2*v", 4e-3)],
    "even spring": [("x**2", 0.2), ("2*v", 4e-3)],
}


@pytest.mark.slow
@pytest.mark.parametrize("forces", FORCES.values(), ids=FORCES)
def test_bands_contain_the_curves_of_the_motion_without_noise(forces):
    clean = motion(forces)
    truth = st.backbone(st.free_decay(clean))
    found = st.backbone(decay_of(clean, seed=1))
    for name in CURVES:
        assert holds(found, truth, name), name


def test_bands_contain_the_curves_with_a_random_force():
    forces = [("2*v", 4e-3), ("x**3", -0.1)]
    truth = st.backbone(st.free_decay(motion(forces)))
    found = st.backbone(decay_of(motion(forces, random_force=3e-6, seed=3)))
    quiet = st.backbone(decay_of(motion(forces)))
    for name in CURVES:
        assert holds(found, truth, name), name
        width = [float((data[f"{name}_high"] - data[f"{name}_low"]).median()) for data in (found, quiet)]
        assert width[0] > 1.5 * width[1], name


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_five_half_periods_have_wide_bands(noise):
    short = decay_of(motion([("2*v", 2e-3)], periods=4), noise=noise)
    short = short.isel(time=slice(0, round(3.3 * PER_PERIOD)))
    found = st.backbone(short)
    assert all(np.isfinite(found[name]).all() for name in found.data_vars)
    assert np.all((found.damping_ratio_low < 2e-3) & (found.damping_ratio_high > 2e-3))


def test_a_model_leaves_the_band_where_it_is_wrong():
    decay = decay_of(motion([("2*v", 2e-3), ("v*abs(v)", 0.03)], periods=60))
    library = st.load_library("contact_forces")
    direct = st.methods.Direct()
    results = {
        name: st.identify(decay, library.select(forces), direct)
        for name, forces in (("viscous", ["zeta"]), ("drag", ["zeta", "delta"]))
    }
    lack = lack_of_fit(decay, results)
    assert departures(lack, "drag") == []
    wrong = departures(lack, "viscous")
    assert {departure.curve for departure in wrong} == {"damping_ratio"}
    assert wrong[0].deviation < -2.0
    assert np.isinf(wrong[0].high)
    stored = lack.sel(model="viscous", curve="damping_ratio")
    assert stored.departure.item() == wrong[0].deviation
    assert stored.departure_low.item() == wrong[0].low
    assert amplitude_range(wrong[0].low, wrong[0].high, "rad").startswith("above 0.")
    assert not lack.departure.sel(model="drag").any()


@pytest.mark.slow
def test_the_command_prints_and_writes(tmp_path, viscous):
    record = tmp_path / "record.csv"
    table = measured(viscous).angle.to_dataframe().rename(columns={"angle": "angle (rad)"})
    table.to_csv(record, index_label="time (s)")
    files = ["-o", tmp_path / "b.nc", "--csv", tmp_path / "b.csv", "--plot", tmp_path]
    printed = run("backbone", record, *files)
    assert printed.status == 0, printed.err
    assert "frequency (rad/s)" in printed.out
    assert {"backbone.png", "backbone.pdf"} <= {path.name for path in tmp_path.iterdir()}
    rows = (tmp_path / "b.csv").read_text().splitlines()
    assert rows[0].startswith("run,unit,amplitude,frequency,frequency_standard_error")
    assert len(rows) == 1 + st.load(tmp_path / "b.nc")["backbone"].sizes["amplitude"]
    data = json.loads(run("backbone", record, "--json").out)
    assert data["runs"][0]["unit"] == "rad"
    assert len(data["runs"][0]["frequency_low"]) == len(rows) - 1


@given(low=some.floats(1e-6, 1e3), ratio=some.floats(1.2, 1e5))
def test_printed_amplitudes_are_round_and_few(low, ratio):
    amplitude = np.geomspace(low, low * ratio, 80)
    straight = {name: ("amplitude", np.log(amplitude)) for name in ("frequency", "damping_ratio")}
    bands = {f"{name}_high": ("amplitude", np.log(amplitude) + 0.5) for name in straight}
    rows = round_rows(xr.Dataset(straight | bands, {"amplitude": amplitude}))
    assert [rows[0].amplitude, rows[-1].amplitude] == pytest.approx([amplitude[-1], low])
    assert len(rows) <= 12
    for row in rows:
        assert row.frequency == pytest.approx(np.log(row.amplitude), abs=1e-9)
        assert row.damping_ratio_band == pytest.approx(0.5)
    assert all(float(f"{row.amplitude:.1e}") == pytest.approx(row.amplitude) for row in rows[1:-1])


def test_rows_are_round_in_the_measured_amplitude():
    amplitude = np.geomspace(1e-5, 1e-3, 80)
    straight = dict.fromkeys(("frequency", "damping_ratio"), ("amplitude", amplitude))
    straight |= {f"{name}_high": ("amplitude", 2.0 * amplitude) for name in ("frequency", "damping_ratio")}
    straight["measured_amplitude"] = ("amplitude", 100.0 * amplitude)
    rows = round_rows(xr.Dataset(straight, {"amplitude": amplitude}))
    printed = [float(f"{row.measured_amplitude:.3g}") for row in rows]
    assert printed == [0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001]
    assert [row.amplitude for row in rows] == pytest.approx([value / 100.0 for value in printed])


LOOKED = {
    "dry friction": (
        [("sign(v)", 1e-3), ("2*v", 2e-3)],
        0.4,
        "dry friction plus viscous friction",
        "record.csv",
    ),
    "drag on a pendulum": (
        [("sin(x) - x", 1.0), ("v*abs(v)", 0.02)],
        1.2,
        "that of a pendulum (gravity)",
        "--system pendulum",
    ),
    "hardening": ([("x**3", 0.2), ("2*v", 4e-3)], 0.4, "a cubic spring", "record.csv"),
}


@pytest.mark.parametrize(("forces", "start", "words", "ends"), LOOKED.values(), ids=LOOKED)
def test_look_states_what_the_backbone_indicates(forces, start, words, ends, tmp_path):
    record = tmp_path / "record.csv"
    table = (
        measured(motion(forces, start=start)).angle.to_dataframe().rename(columns={"angle": "angle (rad)"})
    )
    table.to_csv(record, index_label="time (s)")
    ending = run("look", record)
    assert ending.status == 0, ending.err
    following = ending.out.splitlines()[-1]
    assert words in ending.out
    # A long decay determines the usual forces of its system.
    assert following.endswith(ends)
    # The user states the kind of oscillator.
    if "--system" in ends:
        assert run("look", record, "--system", "ship").out.splitlines()[-1].endswith("--system ship")
