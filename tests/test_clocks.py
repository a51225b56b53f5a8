"""Clocks as loggers write them: of few digits, coarse, in packets, in units that nothing states."""

import numpy as np
import pytest

from sysid_trib.errors import RecordError, UsageError
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
def test_a_counter_of_packets_shows_lost_samples(tmp_path, count):
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


# Of an input whose file begins 0.1 s before the record's.
EARLY = np.arange(-0.1, 21.0, 0.005)


def two_files(folder, stamps_of_record, stamps_of_input):
    """A record and its input, which is the time itself, in two files."""
    written(folder / "y.csv", stamps_of_record, "time,angle (deg)")
    written(folder / "u.csv", stamps_of_input, "time,torque", EARLY)
    return read_record(folder / "y.csv", input="u.csv:torque")


def dates(seconds, zone=""):
    start = np.datetime64("2026-03-01T23:59:50.000000")
    return [f"{start + np.timedelta64(round(1e6 * s), 'us')}{zone}" for s in seconds]


def epoch(seconds, factor=1.0):
    return [f"{factor * (1.7e9 + s):.6f}" for s in seconds]


@pytest.mark.parametrize(
    ("of_record", "of_input"),
    [
        ([f"{t + 3e5:.3f}" for t in TIME], [f"{t + 3e5:.3f}" for t in EARLY]),
        (epoch(TIME), epoch(EARLY)),
        (epoch(TIME, 1e3), epoch(EARLY)),
        (dates(TIME), dates(EARLY)),
        (dates(TIME, "Z"), dates(EARLY, "+00:00")),
        (dates(TIME, "+01:00"), dates(EARLY + 3600.0, "+02:00")),
        ([d[11:] for d in dates(TIME + 10.0)], [d[11:] for d in dates(EARLY + 10.0)]),
        ([f"{46000.5 + t / 86400.0:.12f}" for t in TIME], [f"{46000.5 + t / 86400.0:.12f}" for t in EARLY]),
    ],
    ids=["seconds", "epoch", "epoch in ms and s", "dates", "zones", "two zones", "times of day", "days"],
)
def test_two_files_have_one_clock(tmp_path, of_record, of_input):
    record = two_files(tmp_path, of_record, of_input)
    elapsed = record.time.values - record.time.values[0]
    assert np.interp(record.time.values, record.u_time.values, record.u.values) == pytest.approx(
        elapsed, abs=2e-4
    )


@pytest.mark.parametrize(
    ("of_record", "of_input"),
    [
        (dates(TIME), [f"{t:.3f}" for t in EARLY]),
        ([f"{t:.3f}" for t in TIME], epoch(EARLY)),
        (dates(TIME), dates(EARLY, "Z")),
        (dates(TIME), [d[11:] for d in dates(EARLY)]),
    ],
    ids=["dates and seconds", "seconds and epoch", "with and without a zone", "dates and times of day"],
)
def test_two_clocks_without_a_common_instant_are_refused(tmp_path, of_record, of_input):
    with pytest.raises(UsageError, match=r"y\.csv counts its times .*, and u\.csv .*: nothing says how"):
        two_files(tmp_path, of_record, of_input)


@pytest.mark.parametrize(
    ("head", "signal", "step"),
    [
        ("Timed,With (m/s^2),,Timed,Without (m/s^2)", "With (m/s^2)", 0.01),
        ("Timed,With (m/s^2),,Timed,Without (m/s^2)", "Without (m/s^2)", 0.012),
        ("stamp a,x a (mm),,stamp b,x b (mm)", "x b (mm)", 0.012),
        ("t,left (mm),,t,right (mm)", "right (mm)", 0.012),
    ],
)
def test_runs_side_by_side_have_each_its_own_clock(tmp_path, head, signal, step):
    rows = [f"{0.01 * i:.4f},{v:.3f},,{0.012 * i:.4f},{v:.3f}" for i, v in enumerate(SWING)]
    (tmp_path / "both.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    record = read_record(tmp_path / "both.csv", angle=signal)
    assert np.diff(record.time.values) == pytest.approx(step)


def test_whole_stamps_of_a_column_named_time_are_asked_about(tmp_path):
    rng = np.random.default_rng(2)
    stamps = 6107 + np.cumsum(rng.choice([7, 10, 10, 11], TIME.size))
    swing = 20.0 * np.exp(-1e-4 * stamps) * np.cos(2.0 * np.pi * stamps / 2700.0)
    path = written(tmp_path / "log.csv", stamps, "Time,yaw (deg)", swing)
    with pytest.raises(RecordError, match=r"the period would be 2\.7\de\+03 s in s, 2\.7\d s in ms"):
        read_record(path)
    assert read_record(path, time_units="ms").time.values[0] == pytest.approx(6.117, abs=0.01)
