"""Records come in from any format, with true times and units, and bad files are refused in one line."""

import hashlib
import json

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr
from hypothesis import given, strategies as st

from sysid_trib.errors import RecordError, SysidTribError, UsageError
from sysid_trib.records import probe
from sysid_trib.records.read import read_record, scale_translation

TIME = np.round(np.arange(0.0, 3.0, 0.01), 3)
ANGLE = np.round(0.3 * np.exp(-0.1 * TIME) * np.cos(9.91 * TIME), 6)


def table(delimiter=",", decimal=".", header=None, time=TIME, angle=ANGLE, comment=""):
    rows = [f"{t:.6f}{delimiter}{x:.6f}" for t, x in zip(time, angle, strict=True)]
    text = "\n".join(([header] if header else []) + rows) + "\n"
    return comment + (text if decimal == "." else text.replace(".", ","))


def written(tmp_path, content, name="run.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def holds(record, angle=ANGLE, time=TIME):
    np.testing.assert_allclose(record["time"], time, atol=1e-12)
    np.testing.assert_allclose(record["angle"], angle, atol=1e-12)
    assert record["angle"].attrs["units"] == "rad"
    assert record["time"].attrs["units"] == "s"
    assert all(isinstance(value, str | int | float) for value in record.attrs.values())


PLAIN_TEXT = {
    "comma and header": table(header="time,angle"),
    "quoted header": table(header='"time (s)","angle (rad)"'),
    "semicolon, decimal comma": table(";", ",", "Time;Angle"),
    "tab, decimal comma": table("\t", ","),
    "spaces, decimal comma": table(" ", ","),
    "trailing delimiter": table(header="time,angle,").replace("\n", ",\n").replace(",,", ","),
    "comments": table(comment="# a pendulum\n# 2019\n", header="time,angle"),
    "commented header": table(" ", comment="# time angle\n"),
    "comments within": table().replace("\n1.000000,", "\n# the door closed\n1.000000,"),
    "preamble": table(comment="Logger 7\nRate,100\nStart,12:30\n\n", header="time,angle"),
    "lone number above the header": "300\n" + table(header="time,angle"),
    "units below the header": table(comment="Time,Angle\n(s),(rad)\n\n"),
    "excel's hint": "sep=;\n" + table(";", header="time;angle"),
    "utf-16": table(header="time,angle").encode("utf-16"),
    "latin-1": table(header="zeit,angle (rad) Ã¼ber".encode().decode("latin-1")).encode("latin-1"),
    "dos lines": table(header="time,angle").replace("\n", "\r\n"),
    "milliseconds": table(header="time_ms,angle", time=1000 * TIME),
    "milliseconds after a slash": table(header="t / ms,theta", time=1000 * TIME),
}


@pytest.mark.parametrize("name", PLAIN_TEXT)
def test_text(tmp_path, name):
    path = written(tmp_path, PLAIN_TEXT[name])
    record = read_record(path)
    holds(record)
    assert record.attrs["source"] == "run.csv"
    assert record.attrs["record_checksum"] == hashlib.sha256(path.read_bytes()).hexdigest()


@given(
    delimiter=st.sampled_from([",", ";", "\t", " ", "  ", " , "]),
    decimal=st.sampled_from([".", ","]),
    header=st.booleans(),
    shift=st.floats(-1e3, 1e3),
    scale=st.sampled_from([1e-6, 1.0, 3.0]),
)
def test_any_text_table_is_read_as_written(tmp_path_factory, delimiter, decimal, header, shift, scale):
    if decimal == "," and "," in delimiter:
        return
    line = f"time{delimiter}angle" if header else None
    path = written(
        tmp_path_factory.mktemp("text"), table(delimiter, decimal, line, TIME + shift, ANGLE * scale)
    )
    record = read_record(path)
    np.testing.assert_allclose(record["time"], TIME + shift, atol=1e-6)
    np.testing.assert_allclose(record["angle"], ANGLE * scale, atol=1e-6)


@pytest.mark.parametrize(
    ("header", "options", "reason"),
    [
        ("time,angle (rad)", {"units": "deg"}, r"angle \(rad\) says rad, but --units says deg \(units="),
        ("time,angle_mrad", {"units": "mm"}, "says mrad, but --units says mm"),
        ("time (ms),angle", {"time_units": "s"}, r"says ms, but --time-units says s \(time_units="),
    ],
)
def test_an_option_against_the_header_is_refused(tmp_path, header, options, reason):
    with pytest.raises(UsageError, match=reason):
        read_record(written(tmp_path, table(header=header)), **options)


def test_columns_by_name_and_number(tmp_path):
    rows = "\n".join(f"{t},{t * t},{x},7" for t, x in zip(TIME, ANGLE, strict=True))
    path = written(tmp_path, f"time,drift,phi,2\n{rows}\n")
    holds(read_record(path))
    holds(read_record(path, angle="phi"))
    holds(read_record(path, time="0", angle="phi"))
    holds(read_record(path, time=0, angle=2))
    # A column called 2 wins over the column number 2.
    assert np.all(read_record(path, angle="2")["angle"] == 7)
    assert read_record(path, angle=2).attrs["angle_column"] == "phi"
    with pytest.raises(UsageError, match=r"'psi'; its columns are 0: time, 1: drift, 2: phi, 3: 2\."):
        read_record(path, angle="psi")
    with pytest.raises(UsageError, match="'9'"):
        read_record(path, time=9)


def test_two_likely_angles_are_not_guessed(tmp_path):
    path = written(
        tmp_path,
        "time,phi,theta\n"
        + "\n".join(f"{t},{x},{0.8 * y}" for t, x, y in zip(TIME, ANGLE, np.roll(ANGLE, 21), strict=True)),
    )
    with pytest.raises(UsageError, match=r"phi \(.*\) and theta \(.*\) could each be the signal; name one"):
        read_record(path)


def test_a_column_of_zeros_is_not_read_for_its_name(tmp_path):
    rows = "\n".join(f"{t},{x},0" for t, x in zip(TIME, ANGLE, strict=True))
    record = read_record(written(tmp_path, f"time,phi,theta\n{rows}\n"))
    holds(record)
    assert record.attrs["angle_column"] == "phi"


@pytest.mark.parametrize("decimal", [".", ","])
def test_sampling_rate(tmp_path, decimal):
    column = "angle\n" + "\n".join(f"{x:.6f}" for x in ANGLE)
    path = written(tmp_path, column.replace(".", decimal))
    holds(read_record(path, sampling_rate=100))
    with pytest.raises(RecordError, match="no time column"):
        read_record(path)
    both = written(tmp_path, table(header="time,angle", time=np.floor(TIME * 10 + 1e-6) / 10))
    holds(read_record(both, sampling_rate=100))
    with pytest.raises(UsageError, match="not both"):
        read_record(both, sampling_rate=100, time="time")


def test_whole_stamps_without_a_unit_are_read_as_seconds_with_a_notice(tmp_path):
    """They may be milliseconds, or count samples."""
    path = written(tmp_path, table(time=np.arange(60), angle=ANGLE[::5]))
    assert (
        "unit of time not stated: taken as s, though its stamps are whole"
        in read_record(path).attrs["reading"]
    )
    with pytest.raises(RecordError, match=r"the period would be .* s in ms.*--time-units"):
        read_record(written(tmp_path, table(time=1000 * TIME)))
    for options, text in (({"time_units": "ms"}, table(time=1000 * TIME)), ({}, table())):
        assert "unit of time" not in read_record(written(tmp_path, text), **options).attrs["reading"]


def test_matlab_cells_and_structs(tmp_path):
    cells = np.empty(2, dtype=object)
    cells[:] = [np.stack([ANGLE, 0 * ANGLE]), np.stack([ANGLE[:50], ANGLE[:50]])]
    times = np.empty(2, dtype=object)
    times[:] = [TIME, TIME[:50]]
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"T_id": times, "Y_id": cells, "run": {"time": TIME, "angle": ANGLE}, "note": "x"})
    holds(read_record(path, time="T_id[0]", angle="Y_id[0][0]"))
    holds(read_record(path, time="run.time", angle="run.angle"))
    holds(read_record(path, time="run.time", angle="angle"))
    with pytest.raises(UsageError, match=r"0: T_id\[0\], 1: T_id\[1\], 2: Y_id\[0\]\[0\]"):
        read_record(path, time="T_id", angle="Y_id[0][0]")
    with pytest.raises(RecordError, match="50 times, 300 angles"):
        read_record(path, time="T_id[1]", angle="Y_id[0][0]")
    scipy.io.savemat(tmp_path / "plain.mat", {"t": TIME[:, None], "theta": ANGLE[:, None]})
    holds(read_record(tmp_path / "plain.mat"))


def test_matlab_7_3(tmp_path):
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"], file["theta"] = TIME[None, :], ANGLE[None, :]
        file["#refs#/a"] = ANGLE[None, :]
        cell = file.create_dataset("Y", (1, 1), dtype=h5py.ref_dtype)
        cell[0, 0] = file["#refs#/a"].ref
        file["note"] = np.array([[65, 66]], dtype="u2")
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
    holds(read_record(path))
    holds(read_record(path, time="t", angle="Y[0]"))


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_netcdf(tmp_path, engine):
    path = tmp_path / "run.nc"
    angle = ("time", np.degrees(ANGLE), {"units": "degrees"})
    time = ("time", 1000 * TIME, {"units": "ms"})
    xr.Dataset({"angle": angle, "other": ("time", ANGLE)}, coords={"time": time}).to_netcdf(
        path, engine=engine
    )
    holds(read_record(path))


def test_parquet(tmp_path):
    pytest.importorskip("pyarrow")
    pd.DataFrame({"time_ms": 1000 * TIME, "angle": ANGLE}).to_parquet(tmp_path / "run.parquet")
    holds(read_record(tmp_path / "run.parquet"))


def test_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "run.tdms"
    properties = {
        "wf_increment": 0.01,
        "wf_start_offset": 0.0,
        "wf_samples": ANGLE.size,
        "unit_string": "deg",
    }
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("run", "angle", np.degrees(ANGLE), properties=properties)])
    holds(read_record(path))


@pytest.mark.parametrize(("name", "module"), [("run.parquet", "pyarrow"), ("run.tdms", "nptdms")])
def test_missing_extra_is_named(tmp_path, monkeypatch, name, module):
    magic = {"run.parquet": b"PAR1", "run.tdms": b"TDSm"}[name]
    path = written(tmp_path, magic + bytes(100), name)
    absent = f'raise ImportError("none", name={module!r})'
    (tmp_path / f"{module}.py").write_text(absent, encoding="utf-8")
    # Files of foreign formats are first read in a separate process.
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(probe, "_processes", {})
    with pytest.raises(RecordError, match=r"package .*is needed: pip install pyarrow npTDMS"):
        read_record(path)


def test_translation(tmp_path):
    path = written(tmp_path, table(header="time,position (mm)"))
    record = read_record(path)
    assert record["angle"].attrs["units"] == "mm"
    scaled = scale_translation(record, mass=0.5, natural_frequency=20.0, load=2.0)
    np.testing.assert_allclose(scaled["angle"], ANGLE * 1e-3 * 0.5 * 400 / 2.0, atol=1e-15)
    assert scaled["angle"].attrs["units"] == "rad"
    assert "m = 0.5 kg" in scaled.attrs["translation"]
    assert scaled.attrs["record_checksum"] == record.attrs["record_checksum"]
    with pytest.raises(UsageError, match="load of 0"):
        scale_translation(record, 1.0, 1.0, 0.0)
    with pytest.raises(UsageError, match="units=m"):
        scale_translation(scaled, 1.0, 1.0, 1.0)


def changed(row, time=None, angle=None):
    rows = table(header="time,angle").splitlines()
    old_time, old_angle = rows[row].split(",")
    rows[row] = f"{old_time if time is None else time},{old_angle if angle is None else angle}"
    return "\n".join(rows) + "\n"


BAD = {
    "empty": ("", "is empty"),
    "header only": ("time,angle\n", "no rows of numbers"),
    "prose": ("this is not\na record at all\n", "no rows of numbers"),
    "binary": (bytes(range(256)) * 10, "binary content"),
    "infinite": (changed(17, angle="inf"), "row 17 of column angle is infinite"),
    "text": (changed(17, angle="bad"), "row 17 of column angle contains 'bad'"),
    "text in time": (changed(9, time="later"), "row 9 of column time contains 'later'"),
    "one sample": ("time,angle\n0,1\n", "single sample"),
    "ragged": (changed(17, angle="0.1,5,6"), r"line 18 has 4 cells .*, the others have 2"),
    "unknown unit of time": (table(header="time (fortnights),angle"), "unit 'fortnights' .*--time-units"),
    "degrees as radians": (table(header="time,angle (rad)", angle=1000 * ANGLE), "--units deg"),
    "cut netcdf": (b"\x89HDF\r\n\x1a\n" + bytes(300), "damaged or cut off"),
    "cut matlab": (b"MATLAB 5.0 MAT-file" + bytes(300), "damaged or cut off"),
    "cut excel": (b"PK\x03\x04" + bytes(300), "damaged or cut off"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_file_is_refused_in_one_line(tmp_path, name):
    content, reason = BAD[name]
    with pytest.raises(RecordError, match=reason) as refusal:
        read_record(written(tmp_path, content, "bad.dat"))
    message = str(refusal.value)
    assert message.startswith("bad.dat: ")
    assert "\n" not in message
    assert refusal.value.exit_status == 1


def read_or_refused(path):
    """The record, or None if it was refused in one line; any other exception is a bug."""
    try:
        return read_record(path)
    except SysidTribError as error:
        message = str(error)
    assert "\n" not in message
    return None


@given(st.binary(max_size=400))
def test_any_bytes_are_read_or_refused(tmp_path_factory, content):
    read_or_refused(written(tmp_path_factory.mktemp("bytes"), content))


@given(st.text(alphabet="0123456789.,;- \t\nabe#()", max_size=200))
def test_any_text_is_read_or_refused(tmp_path_factory, content):
    record = read_or_refused(written(tmp_path_factory.mktemp("text"), content))
    if record is not None:
        assert np.all(np.isfinite(record["angle"]))
        assert np.all(np.diff(record["time"]) > 0)


def test_an_unknown_unit_is_reported_with_the_known_ones(tmp_path):
    known = "rad, deg, mrad, m, mm, px, V, au, rad/s, deg/s, m/s^2 or g"
    said = f"unit furlong is unknown (known are {known}): coefficients are in this unit"
    stated = read_record(written(tmp_path, table(header="time (s),signal (furlong)")))
    assert (stated.angle.attrs["units"], stated.attrs["reading"]) == ("furlong", said)
    plain = written(tmp_path, table(header="time (s),signal"))
    assert read_record(plain, units="furlong").attrs["reading"] == said
    assert "known are" not in read_record(plain, units="px").attrs["reading"]
    # A slip in the unit of an angle would leave coefficients off by powers of it.
    with pytest.raises(UsageError, match=r"'degr' is not a known unit of an angle; give rad, mrad, deg"):
        read_record(plain, units="degr", signal="angle")


ARRAY_TIME = np.arange(1000) / 50.0
SWING = np.round(0.3 * np.exp(-0.05 * ARRAY_TIME) * np.cos(6.0 * ARRAY_TIME), 6)


def array_holds(path, column):
    record = read_record(path)
    assert record.attrs["angle_column"] == column
    np.testing.assert_allclose(record.angle, SWING, atol=1e-6)
    np.testing.assert_allclose(record.time, ARRAY_TIME, atol=1e-9)


def test_arrays_of_numpy(tmp_path):
    np.save(tmp_path / "table.npy", np.c_[ARRAY_TIME, SWING])
    array_holds(tmp_path / "table.npy", "data[1]")
    np.save(tmp_path / "named.npy", np.rec.fromarrays([ARRAY_TIME, SWING], names="t,theta"))
    array_holds(tmp_path / "named.npy", "data.theta")
    np.savez_compressed(tmp_path / "vectors.npz", phi=SWING, t=ARRAY_TIME)
    array_holds(tmp_path / "vectors.npz", "phi")
    np.save(tmp_path / "other_order.npy", np.c_[ARRAY_TIME, SWING].astype(">f8"))
    array_holds(tmp_path / "other_order.npy", "data[1]")
    dates = np.datetime64("2024-01-01") + np.round(1e9 * ARRAY_TIME).astype("m8[ns]")
    np.save(tmp_path / "dates.npy", np.rec.fromarrays([dates, SWING], names="time,theta"))
    array_holds(tmp_path / "dates.npy", "data.theta")
    np.savez(tmp_path / "rate.npz", phi=SWING, fs=50.0)
    array_holds(tmp_path / "rate.npz", "phi")


def test_pickled_arrays_are_not_read(tmp_path):
    np.save(tmp_path / "p.npy", np.array([{"t": 1}, None], dtype=object))
    with pytest.raises(RecordError, match="cannot be read"):
        read_record(tmp_path / "p.npy")


ROWS = [{"t": t, "gyro": {"theta": x}} for t, x in zip(ARRAY_TIME.tolist(), SWING.tolist(), strict=True)]


@pytest.mark.parametrize(
    ("content", "column"),
    [
        ({"device": "x", "t": ARRAY_TIME.tolist(), "theta": SWING.tolist()}, "theta"),
        (
            {"runs": {"one": {"t": ARRAY_TIME.tolist(), "theta": [None, *SWING[1:].tolist()]}}},
            "runs.one.theta",
        ),
        (ROWS, "gyro.theta"),
        ({"samples": ROWS}, "samples.gyro.theta"),
        (np.c_[ARRAY_TIME, SWING].tolist(), "data[1]"),
        ({"fs": 50, "theta": SWING.tolist()}, "theta"),
        (json.loads(pd.DataFrame({"t": ARRAY_TIME, "theta": SWING}).to_json()), "theta"),
        (json.loads(pd.DataFrame({"t": ARRAY_TIME, "theta": SWING}).to_json(orient="split")), "theta"),
    ],
)
def test_tables_of_json(tmp_path, content, column):
    (tmp_path / "r.json").write_text(json.dumps(content), encoding="utf-8")
    record = read_record(tmp_path / "r.json")
    assert record.attrs["angle_column"] == column
    np.testing.assert_allclose(record.angle, SWING[-record.sizes["time"] :], atol=1e-6)


def test_times_of_parquet_may_be_its_index(tmp_path):
    pytest.importorskip("pyarrow")
    for index in (
        pd.to_timedelta(ARRAY_TIME, unit="s"),
        pd.Timestamp("2024-01-01") + pd.to_timedelta(ARRAY_TIME, unit="s"),
    ):
        pd.DataFrame({"theta": SWING}, index=index.rename("time")).to_parquet(tmp_path / "r.parquet")
        array_holds(tmp_path / "r.parquet", "theta")


def test_json_that_is_none_or_deep_is_refused(tmp_path):
    for content in ("[" * 100_000 + "]" * 100_000, "{}", "[]", '{"a": [1, "b", {}]}', "[[1, 2], [3]]"):
        (tmp_path / "r.json").write_text(content)
        with pytest.raises(RecordError):
            read_record(tmp_path / "r.json")
