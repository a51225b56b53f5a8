"""Driven records with bad samples and gaps: reported, filled, split, or left unchanged."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from command_line import run
from helpers import scores

import sysid_trib as st
from sysid_trib.commands import fits
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.records.driven_parts import driven_parts
from sysid_trib.validation.driven import identified_driven

W, NOISE = 9.0, 1e-4
TIME = np.arange(0.0, 12.0, 0.02)
FORCES = parse_library(
    {"force": [{"symbol": "gain", "formula": "-u"}, {"symbol": "zeta", "formula": "2*v"}]}, "driven"
)
TRUTH = {"gain": 0.02, "zeta": 0.02}
TONES = np.linspace(0.1, 2.0, 25) * W
DIRECT = st.methods.Direct(random_force="off")


def torque(time: np.ndarray) -> np.ndarray:
    return np.cos(np.outer(time, TONES) + np.arange(25.0) ** 2).sum(axis=1)


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    model = st.Model(FORCES, TRUTH, W)
    record = st.simulate(model, TIME, 0.1, inputs={"u": torque(TIME)}).drop_vars(["rate", "stop_time"])
    angle = record.angle.values + NOISE * np.random.default_rng(0).standard_normal(TIME.size)
    record["angle"] = ("time", angle, {"units": "rad"})
    record["u"].attrs["units"] = "N*m"
    return record


def with_leap(record: xr.Dataset, name: str, at: int, leap: float) -> xr.Dataset:
    spoiled = record.copy(deep=True)
    spoiled[name].values[at] += leap
    return spoiled


def without(record: xr.Dataset, low: float, high: float) -> xr.Dataset:
    return record.isel(time=(record.time.values < low) | (record.time.values > high))


def test_a_record_without_faults_is_unchanged(whole: xr.Dataset) -> None:
    (part,) = driven_parts(whole)
    assert part.angle.identical(whole.angle)
    assert part.u.identical(whole.u)
    assert part.attrs["free_decay"] == (
        "Driven record: 0 s to 11.98 s (600 samples, 0.02 s apart); inputs u (N*m), smooth between samples."
    )
    assert driven_parts(part)[0] is part


@pytest.mark.parametrize(("name", "leap"), [("angle", 1.0), ("angle", -0.004), ("u", 20.0), ("u", -3.0)])
def test_one_sample_that_leaps_is_named_and_left_out(whole: xr.Dataset, name: str, leap: float) -> None:
    spoiled = with_leap(whole, name, 300, leap)
    tree = identified_driven(spoiled, FORCES, DIRECT, st.methods.Trajectory(random_force="off"))
    assert f"1 outlier of {name} left out" in tree["record"].attrs["free_decay"]
    assert " at 6 s" in tree["record"].attrs["free_decay"]
    assert tree["judged"].attrs["verdict"] == "explained"
    clean = st.identify(whole, FORCES, DIRECT)
    result = tree["direct"].to_dataset()
    assert np.abs(scores(result, TRUTH)).max() < 4.0
    assert (result.standard_error < 1.2 * clean.standard_error).all()
    (kept,) = driven_parts(spoiled, keep_outliers=True)
    assert kept[name].values[300] == spoiled[name].values[300]


@pytest.mark.parametrize("at", [0, 2, TIME.size - 1])
def test_a_bad_sample_at_an_end_is_cut_off(whole: xr.Dataset, at: int) -> None:
    (part,) = driven_parts(with_leap(whole, "angle", at, 1.0))
    assert part.sizes["time"] == TIME.size - 4
    assert f"the {'first' if at < 4 else 'last'} 4 samples cut off" in part.attrs["free_decay"]


@pytest.mark.parametrize(
    "values",
    [
        np.where(np.arange(TIME.size) == 200, 50.0, 0.0),
        np.sign(np.sin(2.0 * TIME + 0.1)),
        np.random.default_rng(3).standard_normal(TIME.size),
        np.interp(TIME, TIME[::10], np.random.default_rng(4).standard_normal(TIME[::10].size)),
        np.cumsum(np.sin(3.0 * TIME**2)),
    ],
    ids=["blow of a hammer", "square wave", "noise", "kinks", "chirp"],
)
def test_intended_jumps_of_an_input_are_no_outliers(whole: xr.Dataset, values: np.ndarray) -> None:
    (part,) = driven_parts(whole.assign(u=("time", values, whole.u.attrs)))
    np.testing.assert_array_equal(part.u, values)
    assert "outlier" not in part.attrs["free_decay"]


def test_a_gap_parts_a_record_into_runs(whole: xr.Dataset) -> None:
    parted = without(whole, 5.0, 5.7)
    parts = driven_parts(parted)
    assert [part.time.values[[0, -1]].round(6).tolist() for part in parts] == [[0.0, 4.98], [5.72, 11.98]]
    assert "parted by a gap (4.98 to 5.72 s) into 2 parts, all used as runs" in parts[0].attrs["free_decay"]
    for method in (DIRECT, st.methods.Trajectory(random_force="off")):
        assert np.abs(scores(st.identify(parted, FORCES, method), TRUTH)).max() < 4.0


def test_few_missing_samples_are_filled_and_counted(whole: xr.Dataset) -> None:
    (part,) = driven_parts(without(whole, 5.01, 5.07))
    np.testing.assert_allclose(part.time, TIME, atol=1e-9)
    np.testing.assert_allclose(part.angle, whole.angle, atol=20.0 * NOISE)
    np.testing.assert_allclose(part.u, whole.u, atol=1e-3)
    assert "3 missing samples filled" in part.attrs["free_decay"]


def test_across_a_gap_a_record_is_predicted_where_its_input_is_known(whole: xr.Dataset) -> None:
    result = st.identify(whole, FORCES, DIRECT)
    parted = without(whole, 5.0, 5.7)
    with pytest.raises(UsageError, match=r"input u is missing in a gap of the record \(4\.98 to 5\.72 s\)"):
        st.predict(result, parted)
    apart = parted.drop_vars("u").assign(u=("u_time", whole.u.values, whole.u.attrs))
    apart = apart.assign_coords(u_time=("u_time", TIME, {"units": "s"}))
    assert st.predict(result, apart).residual_rms == pytest.approx(NOISE, rel=0.15)


def test_a_record_of_short_parts_alone_is_refused_with_its_gaps(whole: xr.Dataset) -> None:
    kept = np.mod(TIME, 1.5) < 0.9
    with pytest.raises(
        DecayError, match=r"Gaps divide this record \(0\.88 to 1\.5 s, .* lasts for two periods"
    ):
        st.identify(whole.isel(time=kept), FORCES, DIRECT)


def test_the_command_uses_the_parts_of_a_file(whole: xr.Dataset, tmp_path) -> None:
    parted = without(whole, 5.0, 5.7)
    table = {"time (s)": parted.time, "torque (N*m)": parted.u, "angle (rad)": parted.angle}
    pd.DataFrame({name: values.values for name, values in table.items()}).to_csv(tmp_path / "gap.csv")
    asked = ("--angle", "angle", "--input", "torque", "--forces", "gain,zeta")
    ending = run("identify", tmp_path / "gap.csv", *asked)
    assert ending.status == 0, ending.err
    assert "2 decays" not in ending.out or "parted by a gap" in ending.out
    assert ending.out.count("Driven record:") == 2


def rate_file(tmp_path, *, leap: float = 0.0, gap: tuple[float, float] | None = None):
    """Write a driven record with a measured rate."""
    model = st.Model(FORCES, TRUTH, W)
    record = st.simulate(model, TIME, 0.1, inputs={"u": torque(TIME)})
    rate = record.rate.values + 1e-3 * np.random.default_rng(3).standard_normal(TIME.size)
    rate[300] += leap
    table = pd.DataFrame({"time (s)": TIME, "u (N*m)": torque(TIME), "omega (rad/s)": rate})
    if gap:
        table = table[~((gap[0] <= TIME) & (gap[1] >= TIME))]
    path = tmp_path / "rate.csv"
    table.to_csv(path, index=False, float_format="%.9g")
    return path


def test_a_measured_rate_that_leaps_is_filled_before_it_is_integrated(tmp_path) -> None:
    record = st.read_record(rate_file(tmp_path, leap=5.0), angle="omega", input={"u": "u"})
    (part,) = driven_parts(record)
    assert "1 outlier of rate left out" in part.attrs["free_decay"]
    clean = st.read_record(rate_file(tmp_path), angle="omega", input={"u": "u"})
    assert part.measured.dims == ("measured_time",)
    np.testing.assert_array_equal(part.measured_time.values, part.time.values)
    assert abs(part.measured.values - clean.measured.values).max() < 0.05
    assert abs(part.angle.values - clean.angle.values).max() < 0.01


def test_a_gap_of_a_measured_rate_parts_it(tmp_path) -> None:
    record = st.read_record(rate_file(tmp_path, gap=(5.0, 6.5)), angle="omega", input={"u": "u"})
    parts = driven_parts(record)
    assert [round(float(part.measured_time[0]), 2) for part in parts] == [0.0, 6.52]
    tree = identified_driven(record, FORCES, DIRECT, st.methods.Trajectory(random_force="off"))
    result = tree["trajectory"].to_dataset()
    assert np.abs(scores(result, TRUTH)).max() < 4.0


def test_a_flat_signal_is_refused(whole: xr.Dataset) -> None:
    flat = whole.copy(deep=True)
    flat["angle"].values[:] = 0.3
    with pytest.raises(DecayError, match="angle is flat at"):
        driven_parts(flat)


LATER = np.random.default_rng(7).standard_normal(TIME.size)


@pytest.mark.parametrize("at", [1, 40])
@pytest.mark.parametrize("later", [LATER, 1e3 * LATER, 0.0 * LATER, np.where(LATER > 2.0, 50.0, 0.0)])
def test_samples_that_are_predicted_do_not_change_those_before(whole, at, later):
    known_until = 3.0
    spoiled = with_leap(whole, "angle", at, 1.0)
    known = spoiled.time.values < known_until
    other = spoiled.assign(angle=spoiled.angle.copy(data=np.where(known, spoiled.angle.values, later)))
    (one,), (two,) = (driven_parts(of, known_until=known_until) for of in (spoiled, other))
    assert one.time.identical(two.time)
    assert one.u.identical(two.u)
    before = one.time.values < known_until
    np.testing.assert_array_equal(one.angle.values[before], two.angle.values[before])
    # The outlier itself is left out.
    assert np.abs(one.angle.values[before]).max() < 0.5


def test_the_command_takes_a_test_up_to_its_warm_up_alone(whole, tmp_path, monkeypatch):
    taken = []

    def spied(result, record, **options):
        taken.append(record)
        return st.predict(result, record, **options)

    monkeypatch.setattr(fits, "predict", spied)
    files = []
    for name, later in (("train", whole.angle.values), ("test", whole.angle.values), ("other", LATER)):
        angle = np.where(TIME < 4.0, whole.angle.values, later)
        if name != "train":
            angle[100] += 0.5
        table = pd.DataFrame({"time": TIME, "angle": angle, "torque (N*m)": whole.u.values})
        files.append(tmp_path / f"{name}.csv")
        table.to_csv(files[-1], index=False)
    for file in files[1:]:
        asked = ("--input", "u=torque", "--angle", "angle", "--random-force", "off")
        forces = ("--forces", "gain,zeta", "--window", "1:", "--test", file, "--warm-up", "3")
        ending = run("identify", files[0], *asked, *forces)
        assert ending.status == 0, ending.err
    before = taken[0].time.values < 4.0
    assert taken[0].time.identical(taken[1].time)
    np.testing.assert_array_equal(taken[0].angle.values[before], taken[1].angle.values[before])
