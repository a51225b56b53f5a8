"""Files from laboratories: the contents read from each, or the true reason for a refusal."""

import json
import re

import numpy as np
import pytest
from command_line import run, write_csv
from helpers import decay

from sysid_trib.errors import UsageError
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.read import read_records
from sysid_trib.records.reading import Reading


def test_look_states_how_a_file_was_read_and_the_next_step(tmp_path):
    time, values = swing()
    path = write_csv(tmp_path / "my swing.csv", time, 24.0 * values, "time (s),Displacement (mm)")
    ending = run("look", path)
    assert ending.status == 0
    assert "displacement in mm from column Displacement (mm); 100 Hz clock." in ending.out
    assert re.search(r"the local damping ratio (?:is|(?:rises|falls) from) 0\.62 %", ending.out)
    power = float(re.search("amplitude to the power (.+?); viscous friction gives", ending.out)[1])
    assert abs(power) < 0.1
    assert ending.out.splitlines()[-1].startswith(f"Next: sysid-trib identify '{path}'")
    facts = json.loads(run("look", path, "--json").out)
    (found,) = facts["decays"]
    assert found["unit"] == "mm"
    assert found["period"] == pytest.approx(2.0 * np.pi / 8.0, rel=1e-4)
    assert found["noise"] == pytest.approx(24.0 * 2e-4, rel=0.1)
    # The one noise of all commands.
    assert f"noise: {found['noise']:.2g} mm" in run("identify", path, "--quiet", "--forces", "zeta").out


def test_look_states_how_a_file_was_read_before_a_refusal(tmp_path):
    time, values = swing()
    path = write_csv(tmp_path / "grows.csv", time, values[::-1])
    ending = run("look", path)
    assert ending.status == 1
    assert "angle in rad from column angle (rad)" in ending.out
    assert "grows by" in ending.err


def test_systems_are_data(tmp_path):
    from sysid_trib.errors import LibraryError
    from sysid_trib.forces.systems import load_system

    names = ("pendulum", "torsion", "spring", "ship", "tribometer", "cantilever")
    assert all(load_system(name).forces for name in names)
    assert load_system("pendulum").held == {"gravity": 1.0}
    with pytest.raises(UsageError, match=r"no system 'pendlum'.*Did you mean 'pendulum'"):
        load_system("pendlum")
    path = tmp_path / "mine.toml"
    for text, reason in (
        ("[[system]]\nname = 'swing'\nforces = ['lamda']\n", r"force 'lamda' of no library\. Did you mean"),
        ("[[system]]\nforces = ['zeta']\n", "lacks its name"),
        ("[[system]]\nname = 'swing'\nheld = {gravity = 'one'}\n", "gives a number"),
        ("no toml", "not a TOML file"),
        ("title = 'none'\n", r"no \[\[system\]\]"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(LibraryError, match=reason):
            load_system(str(path))
    path.write_text("[[system]]\nname = 'swing'\nforces = ['zeta']\n", encoding="utf-8")
    assert load_system(str(path)).symbols == ("zeta",)


def swing(samples=2000, seed=3):
    time = np.arange(samples) / 100.0
    return time, decay(time, 0.4 * np.exp(-0.05 * time) * np.cos(8.0 * time), seed, 2e-4).angle.values


def test_a_displacement_has_no_force_that_knows_a_radian():
    import sysid_trib as st

    record = st.free_decay(decay(*swing(), units="mm"))
    gravity = st.load_library("candidate_effects").select(["gravity"])
    with pytest.raises(UsageError, match=r"'gravity' is a function of an angle.*--length"):
        st.methods.Direct().identify(record, gravity)


def test_a_length_makes_an_angle(tmp_path):
    time, values = swing()
    path = write_csv(tmp_path / "swing.csv", time, 1180.0 * values, "time (s),x (mm)")
    (record,) = read_records(path, Reading(length=1.18))
    assert record["angle"].attrs["units"] == "rad"
    np.testing.assert_allclose(record["angle"], values, atol=1e-8)


@pytest.mark.parametrize(("unit", "power"), [("rad/s", 1), ("rad/s^2", 2)])
def test_an_integrated_signal_is_the_motion(tmp_path, unit, power):
    time = np.arange(4000) / 100.0
    exponent = -0.05 + 8.0j
    whole = 0.4 * np.exp(exponent * time)
    shown = (exponent**power * whole).real + 0.3
    (record,) = read_records(write_csv(tmp_path / "a.csv", time, shown, f"Time (s),Gyroscope z ({unit})"))
    (found,) = free_decays(record)
    inside = found.angle.sel(time=slice(4.0, 36.0))
    assert np.abs(inside - np.interp(inside.time, time, whole.real)).max() < 2e-3
    assert "without the drift of its bias" in record.attrs["integration"]


@pytest.mark.parametrize(
    ("unit", "size", "signal"), [("mm", 900.0, "displacement"), ("g", 40.0, "acceleration")]
)
def test_other_signals_are_not_read_as_angles(tmp_path, unit, size, signal):
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
    (found,) = free_decays(decay(time, 0.4 * np.exp(-0.2 * time) * np.cos(8.0 * time), 0, 2e-4))
    assert "lost in the noise" in found.attrs["free_decay"]
    assert "hand" not in found.attrs["free_decay"]
