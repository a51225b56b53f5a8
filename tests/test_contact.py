"""Files as laboratories write them: what is read of each, and what is refused by its true cause."""

import json
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_csv

from sysid_trib.errors import SysidTribError, UsageError
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.half_periods import dominant_periods
from sysid_trib.records.read import read_records
from sysid_trib.records.reading import Reading

# Decays of a file, where it holds several.
DECAYS = {"07_gyroscope.csv": 2, "23_five_plucks.csv": 5, "27_gaps.csv": 2, "39_two_runs.csv": 2}
# A potentiometer's volts are a displacement in V: its calibration stands in a comment alone.
QUANTITIES = {"15_potentiometer_volts.txt": "displacement"}


@pytest.fixture(scope="module")
def files(data_folder, tmp_path_factory):
    """The folder of the files, and what is right of each."""
    maker = data_folder.parent / "contact" / "make_files.py"
    if not maker.is_file():
        pytest.skip(f"{maker} is absent: the generator of lab files is not part of the package.")
    folder = tmp_path_factory.mktemp("contact")
    subprocess.run([sys.executable, "-W", "ignore", str(maker), str(folder)], check=True, capture_output=True)
    return folder, json.loads((folder / "expected.json").read_text(encoding="utf-8"))


def read(folder, name, right):
    """The records of a file and their decays, with the options that it needs."""
    words = shlex.split(right["options"])
    options = {
        key.strip("-").replace("-", "_"): value for key, value in zip(words[::2], words[1::2], strict=True)
    }
    records = read_records(folder / name, Reading(**options))
    return records, [decay for record in records for decay in free_decays(record)]


@pytest.mark.slow
def test_what_can_be_read_is_read_as_what_it_is(files):
    folder, expected = files
    wrong = []
    for name, right in expected.items():
        if right["outcome"] != "identify":
            continue
        records, decays = read(folder, name, right)
        attrs = records[0].attrs
        seen = (attrs["signal"], attrs["angle_unit_in_file"], len(decays))
        quantity = QUANTITIES.get(name, right["quantity"])
        if seen != (quantity, right["unit"], DECAYS.get(name, 1)):
            wrong.append(f"{name}: {seen}")
        period = dominant_periods(decays[-1].time.values, decays[-1].angle.values)[0]
        if abs(period / right["period"] - 1.0) > 0.03:
            wrong.append(f"{name}: period {period:.4g} s, not {right['period']:.4g} s")
    assert not wrong


@pytest.mark.slow
def test_what_cannot_is_refused_by_its_cause(files):
    folder, expected = files
    for name, right in expected.items():
        if right["outcome"] == "identify":
            continue
        with pytest.raises(SysidTribError) as refusal:
            read(folder, name, right)
        message = str(refusal.value)
        assert "\n" not in message
        if right["outcome"] == "refuse":
            assert any(word in message.lower() for word in right["keywords"]), message
        else:
            assert sum(column in message for column in right["columns"]) >= 2, message


def test_look_says_what_was_understood_and_what_comes_next(tmp_path):
    time, values = swing()
    path = write_csv(tmp_path / "my swing.csv", time, 24.0 * values, "time (s),Displacement (mm)")
    ending = run("look", path)
    assert ending.status == 0
    assert "displacement in mm from column Displacement (mm); 100 Hz clock." in ending.out
    assert "rate over w is 0.0062" in ending.out
    power = float(re.search("amplitude to the power of (.+?): nearest to viscous friction", ending.out)[1])
    assert abs(power) < 0.1
    assert ending.out.splitlines()[-1].startswith(f"Next: sysid-trib identify '{path}'")
    facts = json.loads(run("look", path, "--json").out)
    (decay,) = facts["decays"]
    assert decay["unit"] == "mm"
    assert decay["period"] == pytest.approx(2.0 * np.pi / 8.0, rel=1e-4)
    assert decay["noise"] == pytest.approx(24.0 * 2e-4, rel=0.1)
    # The one noise of all commands.
    assert f"noise: {decay['noise']:.2g} mm" in run("identify", path, "--quiet", "--forces", "zeta").out


def test_look_tells_what_it_read_before_a_refusal(tmp_path):
    time, values = swing()
    path = write_csv(tmp_path / "grows.csv", time, values[::-1])
    ending = run("look", path)
    assert ending.status == 1
    assert "angle in rad from column angle (rad)" in ending.out
    assert "grows by" in ending.err


def test_systems_are_data(tmp_path):
    from sysid_trib.errors import LibraryError
    from sysid_trib.forces.selection import load_system

    names = ("pendulum", "torsion", "spring", "ship", "tribometer", "cantilever")
    assert all(load_system(name).forces for name in names)
    assert load_system("pendulum").held == {"gravity": 1.0}
    with pytest.raises(UsageError, match=r"no system 'pendlum'.*Did you mean 'pendulum'"):
        load_system("pendlum")
    path = tmp_path / "mine.toml"
    for text, reason in (
        ("[[system]]\nname = 'swing'\nforces = ['lamda']\n", r"force 'lamda' of no library\. Did you mean"),
        ("[[system]]\nforces = ['zeta']\n", "has a name"),
        ("[[system]]\nname = 'swing'\nheld = {gravity = 'one'}\n", "gives a number"),
        ("no toml", "not a TOML file"),
        ("title = 'none'\n", r"no \[\[system\]\]"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(LibraryError, match=reason):
            load_system(str(path))
    path.write_text("[[system]]\nname = 'swing'\nforces = ['zeta']\n", encoding="utf-8")
    assert load_system(str(path)).symbols == ("zeta",)


def test_a_signal_may_be_a_formula_of_columns(tmp_path):
    time, values = swing()
    path = tmp_path / "film.csv"
    table = zip(time, 3.1 + 0.6 * np.sin(values), -0.6 * np.cos(values), 500 + 87.0 * values, strict=True)
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in table)
    path.write_text(f"t (s),x (m),y (m),pot\n{rows}\n", encoding="utf-8")
    (record,) = read_records(path, Reading(angle="atan2(x - 3.1, -y)"))
    np.testing.assert_allclose(record["angle"], values, atol=1e-6)
    assert record["angle"].attrs["units"] == "rad"
    (record,) = read_records(path, Reading(angle="(pot - 500)/87", units="rad"))
    np.testing.assert_allclose(record["angle"], values, atol=1e-6)
    for text in ("pot - z", "__import__('os')", "atan2(x)", "2*3", "x - (y"):
        with pytest.raises(UsageError):
            read_records(path, Reading(angle=text))


@pytest.mark.parametrize(
    ("head", "columns", "signal"),
    [
        ("time,angle,angular velocity", "xv", "angle"),
        ("time,ax,gy", "av", "rate"),
        ("No.,Time (s),Angle (rad)", "nx", "angle"),
        ("t,drive,response", "0x", "angle"),
    ],
)
def test_columns_as_laboratories_name_them(tmp_path, head, columns, signal):
    time, values = swing()
    kinds = {"x": values, "v": np.gradient(values, time), "a": -64.0 * values, "0": 1e-4 * time % 3e-4}
    table = [time, *(kinds[k] for k in columns)] if columns != "nx" else [np.arange(time.size), time, values]
    path = tmp_path / "lab.csv"
    rows = "\n".join(",".join(f"{value:.6g}" for value in row) for row in zip(*table, strict=True))
    path.write_text(f"{head}\n{rows}\n", encoding="utf-8")
    (record,) = read_records(path)
    assert record.attrs["signal"] == signal
    assert dominant_periods(record.time.values, record.angle.values)[0] == pytest.approx(0.785, rel=0.02)


def swing(samples=2000, seed=3):
    time = np.arange(samples) / 100.0
    angle = 0.4 * np.exp(-0.05 * time) * np.cos(8.0 * time)
    return time, angle + 2e-4 * np.random.default_rng(seed).standard_normal(samples)


def as_record(time, values, unit="rad"):
    angle = ("time", values, {"units": unit, "long_name": "angle"})
    return xr.Dataset({"angle": angle}, {"time": ("time", time, {"units": "s"})}, {"source": "run.csv"})


def test_a_displacement_has_no_force_that_knows_a_radian():
    import sysid_trib as st

    decay = st.free_decay(as_record(*swing(), unit="mm"))
    gravity = st.load_library("candidate_effects").select(["gravity"])
    with pytest.raises(UsageError, match=r"'gravity' is a function of an angle.*--length"):
        st.methods.Direct().identify(decay, gravity)


def test_a_length_makes_an_angle(tmp_path):
    time, values = swing()
    path = write_csv(tmp_path / "swing.csv", time, 1180.0 * values, "time (s),x (mm)")
    (record,) = read_records(path, Reading(length=1.18))
    assert record["angle"].attrs["units"] == "rad"
    np.testing.assert_allclose(record["angle"], values, atol=1e-8)


def test_jitter_is_no_rounding(tmp_path):
    time = np.arange(2000) / 30.0 + np.random.default_rng(0).uniform(-0.004, 0.004, 2000)
    path = tmp_path / "film.csv"
    rows = "\n".join(f"{t:.6f},{0.4 * np.exp(-0.01 * t) * np.cos(4.0 * t):.7f}" for t in time)
    path.write_text(f"time (s),angle (rad)\n{rows}\n", encoding="utf-8")
    (record,) = read_records(path)
    np.testing.assert_allclose(record["time"], time, atol=1e-6)
    assert "jitter" in record.attrs["clock"]
    (decay,) = free_decays(record)
    assert "uneven steps: interpolated to" in decay.attrs["free_decay"]
    exact = 0.4 * np.exp(-0.01 * decay.time) * np.cos(4.0 * decay.time)
    assert np.abs(decay.angle + decay.equilibrium - exact).max() < 1e-5


@pytest.mark.parametrize(("unit", "power"), [("rad/s", 1), ("rad/s^2", 2)])
def test_what_is_integrated_is_the_motion(tmp_path, unit, power):
    time = np.arange(4000) / 100.0
    exponent = -0.05 + 8.0j
    whole = 0.4 * np.exp(exponent * time)
    path = tmp_path / "phone.csv"
    rows = "\n".join(
        f"{t:.2f},{y:.8f}" for t, y in zip(time, (exponent**power * whole).real + 0.3, strict=True)
    )
    path.write_text(f"Time (s),Gyroscope z ({unit})\n{rows}\n", encoding="utf-8")
    (record,) = read_records(path)
    (decay,) = free_decays(record)
    middle = slice(4.0, 36.0)
    inside = decay.angle.sel(time=middle)
    exact = np.interp(inside.time, time, whole.real)
    assert np.abs(inside - exact).max() < 2e-3
    assert "without the drift of its bias" in record.attrs["integration"]


@pytest.mark.parametrize(
    ("unit", "size", "signal"),
    [("mm", 900.0, "displacement"), ("g", 40.0, "acceleration")],
)
def test_what_is_no_angle_is_not_called_degrees_nor_taken_for_rad(tmp_path, unit, size, signal):
    time, values = swing()
    path = write_csv(tmp_path / "lab.csv", time, size * values, "t,channel")
    # "--units mm" once led to "must be scaled first", and a bare file to "if it is in degrees say so".
    said = run("look", path, "--units", unit)
    assert said.status == 0
    assert f"{signal} in {unit}" in said.out
    assert not any(word in said.out + said.err for word in ("degrees", "scaled first", " rad"))
    bare = run("look", path)
    assert "unit not stated" in bare.out + bare.err


def test_a_swing_that_ends_in_the_noise_is_not_said_to_end_by_a_hand(tmp_path):
    time = np.arange(6000) / 100.0
    values = 0.4 * np.exp(-0.2 * time) * np.cos(8.0 * time) + 2e-4 * np.random.default_rng(0).standard_normal(
        6000
    )
    (decay,) = free_decays(as_record(time, values))
    assert "lost in the noise" in decay.attrs["free_decay"]
    assert "hand" not in decay.attrs["free_decay"]


def test_an_angle_that_was_cut_at_a_whole_turn_does_not_grow(tmp_path):
    time, values = swing()
    wrapped = (np.degrees(2.0 * values) + 180.0 + 180.0) % 360.0 - 180.0
    path = write_csv(tmp_path / "upright.csv", time, wrapped, "time (s),angle (deg)")
    said = run("look", path)
    assert said.status == 0
    assert "put together again where it was cut at a whole turn" in said.out
    assert "grows" not in said.out + said.err
