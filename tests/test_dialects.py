"""Text, columns and files as written by laboratories; each is read correctly, or refused with the reason."""

import gzip
import io
import sys
import types

import numpy as np
import pytest
import scipy.io

import sysid_trib as st
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.read import read_record, read_records

TIME = np.arange(0.0, 10.0, 0.01)
SWING = 0.35 * np.exp(-0.05 * TIME) * np.cos(9.0 * TIME)
NOISE = 1e-3 * np.random.default_rng(0).standard_normal((6, TIME.size))


def rows(*columns, sep=","):
    """Lines of cells."""
    return "\n".join(sep.join(cells) for cells in zip(*columns, strict=True)) + "\n"


SECONDS = [f"{t:.3f}" for t in TIME]
DEGREES = [f"{x:.6f}" for x in np.degrees(SWING)]
CLOCK = [f"16:04:{20.0 + t:06.3f}" for t in TIME]
TEXTS = {
    "three decimals between commas": (
        "t (s),x (mm),y (mm)\n"
        + rows(SECONDS, (f"{x:.3f}" for x in SWING), (f"{5 + x:.3f}" for x in NOISE[0])),
        SWING,
    ),
    "blanks for thousands": (
        "t [s];x [mm]\n" + rows(SECONDS, (f"{1e3 * (5 + x):,.3f}".replace(",", " ") for x in SWING), sep=";"),
        5000 + 1000 * SWING,
    ),
    "names in columns of blanks": (
        "Time (s)   Swing (deg)\n--------   -----------\n" + rows(SECONDS, DEGREES, sep="   "),
        SWING,
    ),
    "dates with thousandths behind a colon": (
        "stamp,angle (deg)\n" + rows((f"2024-03-01 {t.replace('.', ':')}" for t in CLOCK), DEGREES),
        SWING,
    ),
    "degrees of Mac Roman": ("t (s),theta (\u00a1)\n" + rows(SECONDS, DEGREES), SWING),
}


@pytest.mark.parametrize("name", TEXTS)
def test_texts(tmp_path, name):
    text, right = TEXTS[name]
    path = tmp_path / "r.csv"
    path.write_bytes(text.encode("latin-1" if "Mac" in name else "utf-8"))
    record = read_record(path)
    assert record.angle.values == pytest.approx(right, abs=1e-3)
    assert record.time.values - record.time.values[0] == pytest.approx(TIME, abs=1e-3)


def test_what_stands_for_a_file(tmp_path, monkeypatch):
    text = ("t (s),theta (deg)\n" + rows(SECONDS, DEGREES)).encode()
    packed = tmp_path / "r.csv.gz"
    packed.write_bytes(gzip.compress(text))
    monkeypatch.setattr(sys, "stdin", types.SimpleNamespace(buffer=io.BytesIO(text)))
    for path in (packed, "-"):
        assert read_record(path).angle.values == pytest.approx(SWING, abs=1e-5)
    packed.write_bytes(gzip.compress(text)[:-500])
    with pytest.raises(RecordError, match="cannot be unpacked"):
        read_record(packed)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"<phyphox version='1'>\n<title>1, 2</title>\n", "this is XML"),
        (b"\xef\xbb\xbf<?xml version='1.0'?>\n1,2\n3,4\n", "this is XML"),
        (b"<!DOCTYPE html>\n<p>1,2\n", "a web page"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600), "save it as .xlsx"),
    ],
)
def test_other_files_than_tables_are_named(tmp_path, content, reason):
    path = tmp_path / "r.csv"
    path.write_bytes(content)
    with pytest.raises(RecordError, match=reason):
        read_record(path)


def table(path, head, *columns):
    """A file of columns of numbers."""
    path.write_text(
        head + "\n" + rows(*([f"{x:.6f}" for x in column] for column in columns)), encoding="utf-8"
    )
    return path


def test_the_axis_that_swings_far_is_taken_or_offered(tmp_path):
    slow = 0.35 * np.exp(-0.03 * TIME) * np.cos(3.0 * TIME)
    head = "Time (s),Acceleration x (m/s^2),Acceleration y (m/s^2)"
    record = read_record(table(tmp_path / "r.csv", head, TIME, 0.1 * slow + NOISE[0], SWING + NOISE[1]))
    assert record.attrs["angle_column"] == "Acceleration y (m/s^2)"
    with pytest.raises(UsageError, match='such as --angle "Acceleration y'):
        read_record(table(tmp_path / "r.csv", head, TIME, 0.5 * slow + NOISE[0], SWING + NOISE[1]))


def test_a_small_swing_is_not_preferred_to_a_far_larger_one(tmp_path):
    driven = 60.0 * np.cos(9.0 * TIME)
    head = "Time (s),Angle left (deg),Angle right (deg)"
    with pytest.raises(UsageError, match=r"Angle right \(deg\) moves .* times as far"):
        read_record(table(tmp_path / "r.csv", head, TIME, SWING + NOISE[0], driven + NOISE[1]))


@pytest.mark.parametrize(
    "heads", ["t1 (s),x1 (deg),t2 (ms),x2 (rad)", "time A [s],x A [deg],time B [ms],x B [rad]"]
)
def test_runs_side_by_side_in_units_of_their_own(tmp_path, heads):
    radians, thousandths = (f"{0.5 * x:.6f}" for x in SWING), (f"{1e3 * t:.0f}" for t in TIME)
    (tmp_path / "a.csv").write_text(f"{heads}\n" + rows(SECONDS, DEGREES, thousandths, radians))
    first, second = read_records(tmp_path / "a.csv")
    assert np.allclose(second.angle, 0.5 * first.angle, atol=1e-6)
    assert np.allclose(second.time, first.time)


def test_a_steady_frequency_distinguishes_degrees_from_radians(tmp_path):
    steady = read_record(table(tmp_path / "r.csv", "t,theta", TIME, 8.0 * SWING))
    assert steady.attrs["angle_unit_in_file"] == "deg"
    assert "as it decays" in steady.attrs["reading"]
    # As for a pendulum: w decreases by a^2/16.
    amplitude = 1.6 * np.exp(-0.1 * TIME)
    phase = 9.0 * np.concatenate(([0.0], np.cumsum(1.0 - amplitude[1:] ** 2 / 16.0))) * 0.01
    softening = read_record(table(tmp_path / "r.csv", "t,theta", TIME, amplitude * np.cos(phase)))
    assert softening.attrs["angle_unit_in_file"] == "rad"


def test_a_group_names_the_quantity_of_its_axis(tmp_path):
    head = "%time,field.angular_velocity.x,field.angular_velocity.y"
    path = table(tmp_path / "r.csv", head, TIME, 0.01 * NOISE[0], SWING)
    assert read_record(path).attrs["signal"] == "rate"


def test_a_column_without_a_name_that_swings_beyond_a_half_turn_is_no_angle(tmp_path):
    (tmp_path / "r.txt").write_text(
        "% fs = 100 Hz\n" + "".join(f"{500.0 * x / np.ptp(SWING):.3f}\n" for x in SWING)
    )
    assert read_record(tmp_path / "r.txt").attrs["angle_unit_in_file"] == "au"


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-16"])
def test_wide_letters_with_their_mark_or_without(tmp_path, encoding):
    text = "time (s),angle (deg)\n" + rows(SECONDS, DEGREES)
    (tmp_path / "r.csv").write_bytes(text.encode(encoding))
    assert read_record(tmp_path / "r.csv").attrs["angle_unit_in_file"] == "deg"


FORMULA_TIME = np.arange(600) * 0.02
FORMULA_SWING = 0.3 * np.exp(-0.1 * FORMULA_TIME) * np.cos(9.9 * FORMULA_TIME)


def written(tmp_path, *headers):
    """A record with one column for each header, each with the same swing of 3 units."""
    rows = (
        ",".join([f"{t:.6g}", *[f"{10 * x:.9g}"] * len(headers)])
        for t, x in zip(FORMULA_TIME, FORMULA_SWING, strict=True)
    )
    place = tmp_path / "a.csv"
    place.write_text("\n".join([",".join(["time (s)", *headers]), *rows]), encoding="utf-8")
    return place


@pytest.mark.parametrize(
    ("headers", "formula", "unit"),
    [
        (["a (deg)", "b (degrees)"], "-a", "deg"),
        (["a (deg)", "b (degrees)"], "0.5*(a+b)", "deg"),
        (["a (deg)", "b (degrees)"], "sqrt(a**2 + b**2)*sign(a)", "deg"),
        (["a (deg)", "b (degrees)"], "a*b/abs(b)", "deg"),
        (["x (mm)"], "min(x, 100)", "mm"),
        (["x (mm)", "y (mm)"], "atan2(x - 3.1, 40 - y)", "rad"),
        (["rate (deg/s)"], "-rate", "deg/s"),
        (["theta"], "-theta", "deg"),
    ],
)
def test_the_unit_of_columns_is_that_of_a_formula(tmp_path, headers, formula, unit):
    record = st.read_record(written(tmp_path, *headers), angle=formula)
    assert record.attrs["angle_unit_in_file"] == unit
    assert record.attrs["angle_column"] == formula


@pytest.mark.parametrize(
    ("headers", "formula", "said"),
    [
        (["x (mm)", "x (deg)"], "2*x", "no single column 'x'"),
        (["a (deg)", "b (rad)"], "a + b", "does not follow"),
        (["a (deg)"], "a*a", "does not follow"),
        # By hand in rad.
        (["a (deg)"], "a*pi/180", "does not follow"),
        (["a (g)"], "9.81*a", "does not follow"),
        (["a (deg)"], "2*c", "Columns that it may contain: time, a"),
        (["a (deg)"], "__import__('os')", "__import__"),
        (["a (deg)"], "atan2(a)", "atan2"),
    ],
)
def test_a_unit_or_a_column_that_does_not_follow_is_asked_for(tmp_path, headers, formula, said):
    with pytest.raises(UsageError, match=r"a\.csv: ") as refusal:
        st.read_record(written(tmp_path, *headers), angle=formula)
    assert said in str(refusal.value)


def test_a_formula_may_contain_numbers_stated_once_in_a_file(tmp_path):
    time = np.arange(0.0, 8.0, 0.01)
    volts = 0.3 * np.exp(-0.02 * time) * np.cos(6.0 * time)
    place, twice = tmp_path / "rig.mat", tmp_path / "twice.csv"
    scipy.io.savemat(
        place, {"t": time, "pot": volts, "Gain": 0.5, "zero": 0.01, "rig": "a", "sin": 2.0, "pi": 3}
    )
    record = st.read_record(place, time="t", angle="gain*sin(pot) - pi*zero", units="rad")
    assert record.angle.values == pytest.approx(0.5 * np.sin(volts) - 0.01 * np.pi)
    with pytest.raises(UsageError, match=r"--input: 'gian\*pot' contains the unknown name 'gian'"):
        st.read_record(place, time="t", angle="pot", units="rad", input="gian*pot")
    rows = [f"{t!r},{v!r}" for t, v in zip(time.tolist(), volts.tolist(), strict=True)]
    head = ["// gain = 0.5", "# zero = 0.01", "time (s),a (deg)"]
    twice.write_text("\n".join([*head, *rows]))
    assert st.read_record(twice, angle="gain*a - zero").attrs["angle_unit_in_file"] == "deg"
    # As with a number written in place of `zero`.
    with pytest.raises(UsageError, match="says deg"):
        st.read_record(twice, angle="a - zero", units="rad")
    twice.write_text("\n".join(["# gain = 0.7", *head, *rows]))
    with pytest.raises(UsageError, match=r"contains gain, which the file states as 0.7 and 0.5; write"):
        st.read_record(twice, angle="gain*a - zero")


@pytest.mark.parametrize("formula", ["a*pi/180", "0.0115*pot - 0.2", "a + 0*b"])
def test_a_unit_that_does_not_follow_may_be_given(tmp_path, formula):
    place = written(tmp_path, "a (deg)", "b (rad)", "pot (V)")
    record = st.read_record(place, angle=formula, units="rad")
    assert record.attrs["angle_unit_in_file"] == "rad"
    with pytest.raises(UsageError, match="says deg"):
        st.read_record(place, angle="-a", units="rad")
