"""Motions with few samples or swings, heavy damping or growth: commands can do what methods can do."""

import numpy as np
import pytest
from command_line import run, write_csv
from helpers import decay
from scipy.signal import lfilter

import sysid_trib as st
from sysid_trib.campaigns.task import rows_of
from sysid_trib.errors import DecayError
from sysid_trib.records.free_decay import free_decay, free_decays
from sysid_trib.results.store import Status

FREQUENCY = 9.0


def swing(time, zeta, start=0.4, middle=0.05, noise=1e-3):
    """A viscous decay from rest about a middle, with noise."""
    w = FREQUENCY * np.sqrt(1.0 - zeta**2)
    fall = start * np.exp(-zeta * FREQUENCY * time)
    angle = fall * (np.cos(w * time) + zeta * FREQUENCY / w * np.sin(w * time))
    return decay(time, middle + angle, 0, noise)


SHORT = {
    "heavily damped": (np.arange(0.0, 2.0, 0.002), 0.3, 0.4),
    "two periods": (np.arange(0.0, 1.396, 0.005), 0.03, 0.4),
    "growing": (np.arange(0.0, 14.0, 0.01), -0.01, 0.05),
}


@pytest.mark.parametrize("name", SHORT)
def test_a_doubtful_decay_is_used_if_its_forces_are_named(name):
    time, zeta, start = SHORT[name]
    record = swing(time, zeta, start)
    with pytest.raises(DecayError, match="--forces"):
        free_decay(record)
    (kept,) = free_decays(record, as_it_is=True)
    assert kept.equilibrium.item() == pytest.approx(0.05, abs=4.0 * kept.equilibrium_standard_error.item())
    assert "used uncut" in kept.attrs["free_decay"]
    result = st.identify(kept, st.load_library("contact_forces").select(["zeta"]), st.methods.Direct())
    assert result.coefficient.item() == pytest.approx(zeta, abs=4.0 * result.standard_error.item())


@pytest.mark.parametrize("name", SHORT)
def test_a_campaign_takes_it_by_the_fit_of_the_motion(tmp_path, name):
    time, zeta, start = SHORT[name]
    decays = free_decays(swing(time, zeta, start), as_it_is=True)
    task = st.campaigns.Task("identify", st.load_library().select(["zeta"]), read=lambda path: decays)
    (row,) = rows_of(task, ["r.csv"])
    assert row["status"] == Status.DONE
    assert np.isnan(row["coefficient"][task.labels.index("averaging")]).all()
    at = task.labels.index("direct")
    assert row["verdict"].tolist() == ["", "explained", "explained"]
    error = 4.0 * row["standard_error"][at].item()
    assert row["coefficient"][at].item() == pytest.approx(zeta, abs=error)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["heavily damped", "growing"])
def test_other_commands_take_it(tmp_path, name):
    time, zeta, start = SHORT[name]
    write_csv(tmp_path / "r.csv", time, swing(time, zeta, start).angle.values)
    for command in (["identify"], ["compare"], ["discover", "--max-effects", "1", "--time-limit", "5"]):
        ending = run(*command, tmp_path / "r.csv", "--forces", "zeta")
        assert ending.status == 0, ending.err
        assert "used uncut" in ending.out


def test_noise_is_no_short_decay():
    time = np.arange(0.0, 5.0, 0.01)
    with pytest.raises(DecayError, match="noise"):
        free_decays(decay(time, 0.0 * time, 0, 1.0), as_it_is=True)


@pytest.mark.parametrize("samples", [9.0, 5.3])
def test_few_samples_a_period_are_enough(samples):
    time = np.arange(0.0, 28.0, 2.0 * np.pi / FREQUENCY / samples)
    found = free_decay(swing(time, 0.005))
    library = st.load_library("contact_forces").select(["zeta"])
    for method in (st.methods.Averaging(), st.methods.Direct()):
        result = st.identify(found, library, method)
        assert result.coefficient.item() == pytest.approx(0.005, abs=4.0 * result.standard_error.item())


def test_shaking_after_the_decay_is_cut():
    time = np.arange(0.0, 60.0, 0.01)
    angle = 0.3 * np.exp(-0.01 * FREQUENCY * time) * np.cos(FREQUENCY * time)
    # The same mode, pushed at random throughout.
    pole = np.exp((-0.01 + 1j) * FREQUENCY * 0.01)
    pushes, noise = np.random.default_rng(0).standard_normal((2, time.size))
    shaking = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], pushes)
    shaking *= 0.003 / shaking.std()
    (kept,) = free_decays(decay(time, angle + shaking + 3e-4 * noise))
    assert kept.time.values[-1] < 40.0
