"""The forced response of identified models against exact curves, folds, simulations and units of records."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from command_line import run

import sysid_trib as st
from sysid_trib.errors import DecayError, UsageError

W, NOISE = 9.9, 1e-4
CONTACT, INPUTS = st.load_library("contact_forces"), st.load_library("inputs")


def identified(truth: dict[str, float], seconds: float = 40.0, scale: float = 1.0) -> xr.Dataset:
    """A decay from 0.3 rad, or from 0.3 units of a displacement `scale` times as large, as Direct has it."""
    time, rng = np.arange(0.0, seconds, 0.03), np.random.default_rng(0)
    library = CONTACT.select(list(truth))
    motion = st.simulate(st.Model(library, truth, W), time, 0.3)
    angle = scale * (motion.angle.values + NOISE * rng.standard_normal(len(time)))
    units = {"units": "rad" if scale == 1.0 else "m"}
    decay = st.free_decay(xr.Dataset({"angle": ("time", angle, units)}, {"time": time}))
    return st.identify(decay, library, st.methods.Direct(random_force="off"))


@pytest.fixture(scope="module")
def linear() -> xr.Dataset:
    return identified({"zeta": 0.01})


@pytest.fixture(scope="module")
def duffing() -> xr.Dataset:
    return identified({"zeta": 0.005, "epsilon": 0.5})


def around(result: xr.Dataset, low: float, high: float, count: int = 101) -> np.ndarray:
    return result.reference_frequency.item() * np.linspace(low, high, count)


@pytest.mark.parametrize("base", [False, True])
def test_a_linear_oscillator_has_its_exact_curve_and_an_honest_band(linear, base):
    w, zeta = around(linear, 0.7, 1.3), linear.coefficient.item()
    found = st.forced_response(linear, 0.002, w, base=base)
    ratio = w / linear.reference_frequency.item()
    exact = 0.002 * (ratio**2 if base else 1.0) / (1.0 - ratio**2 + 2j * zeta * ratio)
    for sweep in ("up", "down"):
        curve = found.sel(sweep=sweep)
        assert curve.amplitude.values == pytest.approx(np.abs(exact), rel=1e-9)
        assert curve.phase.values == pytest.approx(np.angle(exact), abs=1e-9)
        assert np.all((curve.amplitude_low < curve.amplitude) & (curve.amplitude < curve.amplitude_high))
    assert found.sel(sweep="unstable").amplitude.isnull().all()
    assert found.left_open.item() < 1e-6
    # At the resonance the error of the amplitude is that of the damping.
    top = found.sel(sweep="up").isel(frequency=50)
    width = 0.5 * (top.amplitude_high - top.amplitude_low).item() / top.amplitude.item()
    assert width == pytest.approx(1.96 * linear.standard_error.item() / zeta, rel=0.25)


@pytest.mark.slow
def test_duffing_has_its_backbone_and_both_folds(duffing):
    (zeta, epsilon), force = duffing.coefficient.values, 0.003
    w = around(duffing, 0.97, 1.03, 241)
    found, ratio = st.forced_response(duffing, force, w), w / duffing.reference_frequency.item()
    up, down = (found.amplitude.sel(sweep=sweep).values for sweep in ("up", "down"))

    def both(a):
        """Ratios at which an amplitude balances: the roots of the harmonic balance in r^2."""
        middle = 1.0 + 0.75 * epsilon * a**2 - 2.0 * zeta**2
        root = np.sqrt(np.maximum(0.0, middle**2 - (1.0 + 0.75 * epsilon * a**2) ** 2 + (force / a) ** 2))
        return np.sqrt(middle - root), np.sqrt(middle + root)

    amplitude = np.linspace(0.02, 1.2 * force / (2.0 * zeta), 200001)
    rising, falling = both(amplitude)
    there = (force / amplitude) ** 2 > (1.0 + 0.75 * epsilon * amplitude**2) ** 2 - (
        1.0 + 0.75 * epsilon * amplitude**2 - 2.0 * zeta**2
    ) ** 2
    last = rising[there].max()
    first = falling[there & (amplitude < 0.25)].min()
    step = ratio[1] - ratio[0]
    jump_up, jump_down = (ratio[int(np.argmax(np.abs(np.diff(curve))))] for curve in (up, down))
    assert jump_up == pytest.approx(last, abs=1.01 * step)
    assert jump_down == pytest.approx(first, abs=1.01 * step)
    peak = int(np.argmax(up))
    assert ratio[peak] == pytest.approx(np.sqrt(1.0 + 0.75 * epsilon * up[peak] ** 2), abs=2.0 * step)
    between = (ratio > first + step) & (ratio < last - step)
    unstable = found.amplitude.sel(sweep="unstable").values
    assert np.all((down < unstable)[between] & (unstable < up)[between])
    assert found.left_open.item() < 5e-3


def test_a_model_is_driven_by_its_own_input():
    time, rng = np.arange(0.0, 20.0, 0.03), np.random.default_rng(1)
    library = replace(INPUTS, forces=(*INPUTS.select(["gain"]), *CONTACT.select(["zeta"])))
    tones = np.outer(time, W * np.linspace(0.1, 2.0, 40)) + rng.uniform(0.0, 6.28, 40)
    force = np.cos(tones).sum(axis=1) / 4.5
    motion = st.simulate(st.Model(library, {"gain": 0.05, "zeta": 0.02}, W), time, 0.0, inputs={"u": force})
    record = motion.assign(angle=motion.angle + NOISE * rng.standard_normal(len(time)))
    result = st.identify(record, library, st.methods.Direct(random_force="off"))
    found = st.forced_response(result, 0.1, around(result, 0.9, 1.1, 11))
    gain, zeta = result.coefficient.values
    assert found.amplitude.sel(sweep="up").values[5] == pytest.approx(0.1 * gain / (2.0 * zeta), rel=1e-9)
    with pytest.raises(UsageError, match="has the inputs u"):
        st.forced_response(result, 0.1, [9.0], driven_by="base")


def test_dry_friction_prevents_motion_under_a_small_drive():
    rubbed = identified({"lambda": 1e-3, "zeta": 0.005}, 20.0)
    w, friction = around(rubbed, 0.9, 1.1, 21), rubbed.coefficient.sel(force="lambda").item()
    held = st.forced_response(rubbed, friction, w)
    assert held.amplitude.isnull().all()
    moved = st.forced_response(rubbed, 4.0 * friction, w)
    # 4 lambda / pi of the drive goes into friction.
    zeta = rubbed.coefficient.sel(force="zeta").item()
    top = (4.0 - 4.0 / np.pi) * friction / (2.0 * zeta)
    assert moved.amplitude.sel(sweep="up").values[10] == pytest.approx(top, rel=1e-6)


@pytest.mark.parametrize(
    ("drive", "frequencies", "said"),
    [
        (-1.0, [9.0, 10.0], "A drive must be"),
        (np.nan, [9.0], "A drive must be"),
        (0.1, [10.0, 9.0], "that increase"),
        (0.1, [], "that increase"),
    ],
)
def test_invalid_drives_are_refused(linear, drive, frequencies, said):
    with pytest.raises(UsageError, match=said):
        st.forced_response(linear, drive, frequencies)


def test_a_response_that_nothing_bounds_is_refused(linear):
    undamped = linear.assign(coefficient=0.0 * linear.coefficient)
    with pytest.raises(DecayError, match="Without damping"):
        st.forced_response(undamped, 0.1, around(linear, 1.0, 1.0 + 1e-9, 2))


@pytest.mark.slow
def test_the_command_writes_a_table_a_figure_and_the_curves(duffing, tmp_path):
    st.save(duffing, tmp_path / "decay.nc")
    words = ["response", str(tmp_path / "decay.nc"), "--drive", "0.003", "--points", "41"]
    ending = run(*words, "--csv", str(tmp_path / "r.csv"), "--plot", str(tmp_path / "figures"))
    assert ending.status == 0, ending.err
    assert "simulated motions have the computed amplitude" in ending.out
    assert (tmp_path / "figures" / "response.pdf").is_file()
    rows = (tmp_path / "r.csv").read_text().splitlines()
    assert rows[0].split(",")[:5] == ["sweep", "frequency_rad_s", "frequency_ratio", "unit", "amplitude"]
    assert {row.partition(",")[0] for row in rows[1:]} >= {"up", "down"}
    refused = run(*words[:4], "--frequencies", "1.1:0.9")
    assert refused.status == 2
    assert "LOW:HIGH" in refused.err
