"""Records as NumPy and JSON write them."""

import json

import numpy as np
import pandas as pd
import pytest

from sysid_trib.errors import RecordError
from sysid_trib.records.read import read_record

TIME = np.arange(1000) / 50.0
SWING = np.round(0.3 * np.exp(-0.05 * TIME) * np.cos(6.0 * TIME), 6)


def holds(path, column):
    record = read_record(path)
    assert record.attrs["angle_column"] == column
    np.testing.assert_allclose(record.angle, SWING, atol=1e-6)
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)


def test_arrays_of_numpy(tmp_path):
    np.save(tmp_path / "table.npy", np.c_[TIME, SWING])
    holds(tmp_path / "table.npy", "data[1]")
    np.save(tmp_path / "named.npy", np.rec.fromarrays([TIME, SWING], names="t,theta"))
    holds(tmp_path / "named.npy", "data.theta")
    np.savez_compressed(tmp_path / "vectors.npz", phi=SWING, t=TIME)
    holds(tmp_path / "vectors.npz", "phi")
    np.save(tmp_path / "other_order.npy", np.c_[TIME, SWING].astype(">f8"))
    holds(tmp_path / "other_order.npy", "data[1]")
    dates = np.datetime64("2024-01-01") + np.round(1e9 * TIME).astype("m8[ns]")
    np.save(tmp_path / "dates.npy", np.rec.fromarrays([dates, SWING], names="time,theta"))
    holds(tmp_path / "dates.npy", "data.theta")
    np.savez(tmp_path / "rate.npz", phi=SWING, fs=50.0)
    holds(tmp_path / "rate.npz", "phi")


def test_what_numpy_pickled_is_not_read(tmp_path):
    np.save(tmp_path / "p.npy", np.array([{"t": 1}, None], dtype=object))
    with pytest.raises(RecordError, match="cannot be read"):
        read_record(tmp_path / "p.npy")


ROWS = [{"t": t, "gyro": {"theta": x}} for t, x in zip(TIME.tolist(), SWING.tolist(), strict=True)]


@pytest.mark.parametrize(
    ("content", "column"),
    [
        ({"device": "x", "t": TIME.tolist(), "theta": SWING.tolist()}, "theta"),
        ({"runs": {"one": {"t": TIME.tolist(), "theta": [None, *SWING[1:].tolist()]}}}, "runs.one.theta"),
        (ROWS, "gyro.theta"),
        ({"samples": ROWS}, "samples.gyro.theta"),
        (np.c_[TIME, SWING].tolist(), "data[1]"),
        ({"fs": 50, "theta": SWING.tolist()}, "theta"),
        (json.loads(pd.DataFrame({"t": TIME, "theta": SWING}).to_json()), "theta"),
        (json.loads(pd.DataFrame({"t": TIME, "theta": SWING}).to_json(orient="split")), "theta"),
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
        pd.to_timedelta(TIME, unit="s"),
        pd.Timestamp("2024-01-01") + pd.to_timedelta(TIME, unit="s"),
    ):
        pd.DataFrame({"theta": SWING}, index=index.rename("time")).to_parquet(tmp_path / "r.parquet")
        holds(tmp_path / "r.parquet", "theta")


def test_json_that_is_none_or_deep_is_refused(tmp_path):
    for content in ("[" * 100_000 + "]" * 100_000, "{}", "[]", '{"a": [1, "b", {}]}', "[[1, 2], [3]]"):
        (tmp_path / "r.json").write_text(content)
        with pytest.raises(RecordError):
            read_record(tmp_path / "r.json")
