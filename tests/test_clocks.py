"""Clocks as loggers write them: of few digits, coarse, in packets, in units that nothing states."""

import numpy as np
import pytest

from sysid_trib.errors import RecordError
from sysid_trib.records.read import read_record

RATE, PERIOD = 100.0, 0.7
TIME = np.arange(2000) / RATE
SWING = 20.0 * np.exp(-0.1 * TIME) * np.cos(2.0 * np.pi * TIME / PERIOD)
NOISE = 0.02 * np.random.default_rng(0).standard_normal(TIME.size)


def written(path, times, head="time,angle (deg)", values=SWING + NOISE):
    """A file of texts of times, and of the swing."""
    rows = [f"{time},{value:.3f}" for time, value in zip(times, values, strict=True)]
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return path


def holds(record, within=1e-4):
    """Every row is kept, one after the other at the rate at which it was sampled."""
    assert record.sizes["time"] == TIME.size
    rates = 1.0 / np.diff(record.time.values)
    assert rates == pytest.approx(RATE, rel=within)


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        ([f"{t:.2E}" for t in TIME], "stamps of 3 digits"),
        ([f"{t + 7000.0:.6g}" for t in TIME], "stamps rounded to 0.01"),
        ([f"{t:.1f}" for t in TIME], "stamps rounded to 0.1"),
        ([f"{np.floor(20.0 * t) / 20.0:.2f}" for t in TIME], "packets"),
        ([repr(float(np.float32(t + 9000.0))) for t in TIME], "single precision"),
    ],
)
def test_a_clock_that_is_coarser_than_the_sampling(tmp_path, texts, said):
    record = read_record(written(tmp_path / "r.csv", texts))
    holds(record, 2e-3)
    assert said in record.attrs["clock"] or "clock" in record.attrs["clock"]
    assert "left out" not in record.attrs["clock"]


def test_bursts_with_gaps_between_them_are_no_packets(tmp_path):
    stamps = TIME + np.arange(TIME.size) // 100 * 9.3
    values = 20.0 * np.exp(-0.001 * stamps) * np.cos(2.0 * np.pi * stamps / PERIOD)
    record = read_record(written(tmp_path / "r.csv", [f"{t:.3f}" for t in stamps], values=values))
    assert "packets" not in record.attrs["clock"]
    assert np.diff(record.time.values).max() > 9.0


def test_a_clock_that_stands_still_for_a_swing_is_refused(tmp_path):
    with pytest.raises(RecordError, match="most time stamps repeat"):
        read_record(written(tmp_path / "r.csv", [f"{t:.0f}" for t in TIME]))


@pytest.mark.parametrize("count", ["samples", "samples of 8 bits", "packets"])
def test_a_counter_beside_packets_counts_what_is_lost(tmp_path, count):
    number = np.arange(TIME.size)
    number = number[(number < 200) | (number >= 216)]
    stamps = number // 8 * (8.0 / RATE) + 0.03 * np.random.default_rng(1).random(TIME.size)[number // 8]
    counted = {"samples": number, "samples of 8 bits": number % 256, "packets": number // 8}[count]
    head = f"{'packet' if count == 'packets' else 'sample'},host time (s),angle (deg)"
    texts = [f"{c},{t:.4f}" for c, t in zip(counted, stamps, strict=True)]
    values = 20.0 * np.exp(-0.1 * number / RATE) * np.cos(2.0 * np.pi * number / RATE / PERIOD)
    record = read_record(written(tmp_path / "r.csv", texts, head, values=values))
    assert "16 samples lost" in record.attrs["reading"]
    gaps = np.round(np.diff(record.time.values) * RATE, 1)
    assert gaps[199] == 17.0
    assert np.all(np.delete(gaps, 199) == 1.0)


def test_a_stamp_next_to_nothing_among_others(tmp_path):
    texts = [f"{t:.2f}" for t in TIME]
    texts[0] = "-1e-300"
    record = read_record(written(tmp_path / "r.csv", texts))
    assert record.sizes["time"] == TIME.size
