"""Sentences on what a file holds: copies, columns without numbers, sheets, too few samples, units, causes."""

import pickle
import re
import zipfile

import numpy as np
import openpyxl
import pytest
from command_line import run, write_table

import sysid_trib as st
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.forces.symmetry import as_factor
from sysid_trib.records import no_decay
from sysid_trib.records.free_decay import swing_within
from sysid_trib.records.no_decay import Cause, NoDecayError
from sysid_trib.records.read import read_record, read_records
from sysid_trib.records.reading import Reading
from sysid_trib.records.sensors import ClippedError

TIME = np.arange(0.0, 20.0, 0.01)
RNG = np.random.default_rng(3)
SWING = 0.35 * np.exp(-0.05 * TIME) * np.cos(9.0 * TIME) + 1e-4 * RNG.standard_normal(TIME.size)
OTHER = RNG.standard_normal(TIME.size)


def reading_of(path):
    return read_record(path).attrs["reading"]


@pytest.mark.parametrize("third", [(), (OTHER,)])
def test_two_columns_of_the_same_numbers_are_one_signal_and_it_is_said(tmp_path, third):
    head = "time (s),left (deg),right (deg)" + ",temperature (C)" * len(third)
    record = read_record(write_table(tmp_path / "r.csv", head, TIME, 9.0 * SWING, 9.0 * SWING, *third))
    assert record.attrs["angle_column"] == "left (deg)"
    assert "the same numbers are in right (deg)" in record.attrs["reading"]
    assert "fundamental" not in record.attrs["reading"]


def test_columns_that_differ_in_one_number_are_two(tmp_path):
    other = np.where(TIME[7] == TIME, 0.0, SWING)
    path = write_table(tmp_path / "r.csv", "time (s),left (rad),right (rad)", TIME, SWING, other)
    with pytest.raises(UsageError, match="could each be the signal"):
        read_record(path)


@pytest.mark.parametrize("head", ["time (s),temp (C),angle (rad)", "time (s),angle (rad),temp (C)", ""])
def test_a_column_without_a_number_is_named(tmp_path, head):
    columns = [SWING, np.full(TIME.size, np.nan)]
    columns = columns if head.endswith("(C)") else columns[::-1]
    path = write_table(tmp_path / "r.csv", head, TIME, *columns)
    name = re.escape("temp (C)" if head else "1")
    assert re.search(f"column {name} contains no number, left out", reading_of(path))


def test_a_column_without_name_and_number_is_not_named(tmp_path):
    lines = [f"{t:.2f},,{x:.6f}," for t, x in zip(TIME, SWING, strict=True)]
    (tmp_path / "r.csv").write_text("\n".join(["time (s),,angle (rad),", *lines]))
    assert "no number" not in reading_of(tmp_path / "r.csv")


def test_three_samples_are_too_few_not_still(tmp_path):
    head = "time (s),one (V),two (V)"
    path = write_table(tmp_path / "r.csv", head, TIME[:4], [0.1, -0.3, 0.2, 0.4], [0.3, 0.1, 0.4, 0.1])
    said = run("look", path).complaint
    assert "only 4 samples, at least 20 are needed" in said
    assert said.endswith("record longer.")
    assert "driven" not in said


@pytest.mark.parametrize(
    ("signal", "cause"),
    [
        (SWING[:12], Cause.FEW_SAMPLES),
        (0.0 * TIME, Cause.STILL),
        (OTHER, Cause.NO_OSCILLATION),
        (SWING[::-1], Cause.GROWS),
        (np.cos(9.0 * TIME), Cause.DOES_NOT_DECAY),
        (np.concatenate([SWING[:1000], SWING[:1000]]), Cause.RISES_AGAIN),
        (np.clip(SWING, -0.05, 0.05), Cause.CLIPPED),
    ],
)
def test_the_reason_for_which_a_signal_is_no_decay_has_a_cause(signal, cause):
    reason = swing_within(TIME[: signal.size], signal)
    assert isinstance(reason, no_decay.NoDecay)
    assert reason.cause is cause


def test_an_error_states_reason_remedy_and_how_to_use_the_record_uncut():
    error = NoDecayError("r.csv", no_decay.few_half_periods(1, 2.0))
    assert str(error) == (
        "r.csv: only 1 whole half period of steady oscillation (period about 2 s), at least five are "
        "needed, in a record of three periods; record longer or widen the window, or name the forces that "
        "act (--forces) to use it uncut."
    )


def test_the_error_comes_whole_from_another_process():
    error = NoDecayError("r.csv", no_decay.grows(3.0))
    returned = pickle.loads(pickle.dumps(error))
    assert str(returned) == str(error)
    assert returned.reason == error.reason
    assert pickle.loads(pickle.dumps(ClippedError("all clipped", "rate"))).quantity == "rate"


@pytest.mark.parametrize(
    ("unit", "power"), [("mm", "mm^-1"), ("% of tank width", "(% of tank width)^-1"), ("m/V", "(m/V)^-1")]
)
def test_a_unit_of_several_words_is_in_parentheses_below_a_power(tmp_path, unit, power):
    path = write_table(tmp_path / "r.csv", f"time (s),level ({unit})", TIME, 40.0 * SWING)
    result = run("identify", path, "--forces", "zeta,delta")
    assert f"({power})" in result.out
    assert as_factor(unit) == power.removesuffix("^-1")


def test_sheets_of_the_same_columns_are_runs_and_others_are_named(tmp_path):
    book = openpyxl.Workbook()
    for sheet, scale in (("load 1", 1.0), ("load 2", 0.8), ("spectrum", None)):
        table = book.create_sheet(sheet)
        table.append(["Time (s)", "Angle (rad)"] if scale else ["f (Hz)", "level"])
        for row in zip(TIME[:900].tolist(), ((scale or 3.0) * SWING[:900]).tolist(), strict=True):
            table.append(row)
    book.save(tmp_path / "r.xlsx")
    runs = read_records(tmp_path / "r.xlsx")
    assert [record.angle.values[0] for record in runs] == pytest.approx([SWING[0], 0.8 * SWING[0]])
    assert "each sheet a run (load 1, load 2)" in runs[0].attrs["reading"]
    assert "sheet spectrum left out" in runs[0].attrs["reading"]


def test_a_row_of_text_among_the_numbers_is_left_out_and_it_is_said(tmp_path):
    path = write_table(tmp_path / "r.csv", "time (s),angle (rad)", TIME, SWING)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:500], "Sensor error", *lines[500:]]))
    record = read_record(path)
    assert record.sizes["time"] == TIME.size
    assert "1 row of text left out, such as line 501: 'Sensor error'" in record.attrs["reading"]


def test_a_row_of_text_that_holds_a_number_is_no_remark(tmp_path):
    path = write_table(tmp_path / "r.csv", "time (s),angle (rad)", TIME, SWING)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:500], "broken,0.2", *lines[500:]]))
    with pytest.raises(RecordError, match=r"row 500 of column time \(s\) contains 'broken'"):
        read_record(path)


@pytest.mark.parametrize("name", ["../../run.csv", "a/b/run.csv", "run.csv", ".."])
def test_the_only_file_of_an_archive_is_read_and_nothing_is_written_elsewhere(tmp_path, name):
    path = write_table(tmp_path / "r.csv", "time (s),angle (rad)", TIME, SWING)
    (tmp_path / "in").mkdir()
    with zipfile.ZipFile(tmp_path / "in" / "r.zip", "w") as archive:
        archive.writestr(name, path.read_text())
        archive.writestr("__MACOSX/._run.csv", "nothing")
    if name == "..":
        with pytest.raises(RecordError, match="this archive contains no file"):
            read_record(tmp_path / "in" / "r.zip")
        return
    assert read_record(tmp_path / "in" / "r.zip").angle.values == pytest.approx(SWING)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["in", "r.csv"]


def test_an_archive_in_another_one_is_named(tmp_path):
    with zipfile.ZipFile(tmp_path / "inner.zip", "w") as archive:
        archive.writestr("r.csv", "time,angle\n0,1\n")
    with zipfile.ZipFile(tmp_path / "r.zip", "w") as archive:
        archive.write(tmp_path / "inner.zip", "inner.zip")
    with pytest.raises(RecordError, match="this is an archive in another one; unpack it"):
        read_record(tmp_path / "r.zip")


def test_no_space_for_an_unpacked_file_is_not_taken_for_damage(tmp_path, monkeypatch):
    path = write_table(tmp_path / "r.csv", "time (s),angle (rad)", TIME, SWING)
    with zipfile.ZipFile(tmp_path / "r.zip", "w") as archive:
        archive.write(path, "r.csv")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(RecordError, match="no copy of it can be written to the temporary folder"):
        read_record(tmp_path / "r.zip")


def test_a_clock_in_two_columns_keeps_its_dates(tmp_path):
    stamps = np.datetime64("2019-03-12T14:02:33", "ms") + np.round(1e3 * TIME).astype("m8[ms]")
    lines = [
        f"{str(stamp)[:19].replace('T', ' ')},{int(str(stamp)[20:])},{x:.6f}"
        for stamp, x in zip(stamps, SWING, strict=True)
    ]
    (tmp_path / "r.csv").write_text("\n".join(["Date Time,ms,angle (rad)", *lines]))
    record = read_record(tmp_path / "r.csv")
    assert record.time.values - record.time.values[0] == pytest.approx(TIME)
    assert "time from Date Time and ms" in record.attrs["reading"]


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("0.01 deg", 0.01 * np.pi / 180.0), ("10^-3 rad", 1e-3), ("1/100 °", np.pi / 18000.0)],
)
def test_a_unit_with_a_factor_is_multiplied(tmp_path, unit, factor):
    path = write_table(tmp_path / "r.csv", f"time (s),sensor ({unit})", TIME, SWING / factor)
    record = read_record(path)
    assert record.attrs["signal"] == "angle"
    assert record.angle.values == pytest.approx(SWING, rel=1e-6)


def test_a_table_on_its_side_is_to_be_turned(tmp_path):
    times = ",".join(f"{t:.2f}" for t in TIME[:500])
    angles = ",".join(f"{x:.5f}" for x in SWING[:500])
    (tmp_path / "r.csv").write_text(f"time (s),{times}\nangle (rad),{angles}\n")
    with pytest.raises(RecordError, match=r"501 columns and 2 rows: .* turn the table"):
        read_record(tmp_path / "r.csv")


def test_each_run_of_structs_has_its_own_clock(tmp_path):
    import scipy.io

    runs = np.empty((1, 2), dtype=[("t", "O"), ("theta", "O")])
    for at, rate in enumerate((1.0, 2.0)):
        runs[0, at] = (TIME / rate, SWING)
    scipy.io.savemat(tmp_path / "r.mat", {"runs": runs})
    records = read_records(tmp_path / "r.mat", Reading())
    assert [record.time.values[-1] for record in records] == pytest.approx([TIME[-1], TIME[-1] / 2.0])


def test_a_swing_pushed_up_in_one_half_period_is_not_cut_without_a_word():
    period = 2.0 * np.pi / 9.0
    first = SWING[: int(9.0 * period / 0.01)]
    angle = np.concatenate([first, SWING])[: TIME.size]
    with pytest.raises(NoDecayError) as caught:
        st.records.free_decays((TIME, angle))
    assert caught.value.reason.cause is Cause.RISES_AGAIN
