"""Heads and rows as laboratories write them: the intended content is read, or a sentence gives the reason."""

import io
import struct

import numpy as np
import pytest
import scipy.io

import sysid_trib as st
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.read import read_record, read_records
from sysid_trib.records.units import bare_rate, noted_rate, noted_unit

TIME = np.arange(0.0, 10.0, 0.01)
RNG = np.random.default_rng(0)
SWING = 0.35 * np.exp(-0.05 * TIME) * np.cos(9.0 * TIME) + 1e-4 * RNG.standard_normal(TIME.size)
OTHER = 0.3 * np.exp(-0.05 * TIME) * np.cos(9.0 * TIME + 0.4) + 1e-4 * RNG.standard_normal(TIME.size)


def rows(*columns, sep=","):
    return "".join(sep.join(f"{cell:.6f}" for cell in row) + "\n" for row in zip(*columns, strict=True))


def record_of(tmp_path, text, **how):
    (tmp_path / "r.csv").write_text(text, encoding="utf-8")
    return read_record(tmp_path / "r.csv", **how)


def is_the_swing(record, scale=1.0):
    assert record.time.values == pytest.approx(TIME, abs=1e-6)
    assert record.angle.values == pytest.approx(scale * SWING, abs=1e-5)


BY_VALUE, BY_CHANCE = np.argsort(SWING), np.random.default_rng(1).permutation(TIME.size)


@pytest.mark.parametrize("order", [BY_VALUE, BY_VALUE[::-1], BY_CHANCE, np.arange(TIME.size)[::-1]])
@pytest.mark.parametrize("head", ["", "time (s),theta (rad)\n"])
def test_rows_out_of_order_are_sorted_with_a_notice(tmp_path, order, head):
    record = record_of(tmp_path, head + rows(TIME[order], SWING[order]))
    is_the_swing(record)
    assert "rows are not in order of time" in record.attrs["reading"]


def test_numbers_of_sorted_rows_are_no_clock(tmp_path):
    columns = np.arange(TIME.size), SWING[BY_VALUE], TIME[BY_VALUE]
    is_the_swing(record_of(tmp_path, ",x (rad),t\n" + rows(*columns)))


def test_runs_below_each_other_stay_apart(tmp_path):
    record = record_of(tmp_path, "time,theta (rad)\n" + rows(np.tile(TIME, 3), np.tile(SWING, 3)))
    assert "order of time" not in record.attrs["reading"]
    assert "used as 3 pieces" in record.attrs["clock"]


@pytest.mark.parametrize(("sep", "more"), [("\t", "\t\t"), (",", ", "), (";", ";"), (",", ",,")])
def test_empty_cells_at_the_end_of_a_row_are_nothing(tmp_path, sep, more):
    lines = rows(TIME, SWING, sep=sep).splitlines()
    lines[14] += more
    lines[300] += more
    is_the_swing(record_of(tmp_path, "\n".join(["t" + sep + "y (rad)", *lines])))


def test_a_row_with_a_cell_too_many_is_named(tmp_path):
    lines = rows(TIME, SWING).splitlines()
    lines[14] += ",bumped"
    with pytest.raises(RecordError, match=r"line 16 has 3 cells \(.*bumped\), the others have 2; correct it"):
        record_of(tmp_path, "\n".join(["t,y", *lines]))


@pytest.mark.parametrize(
    "head",
    [
        "Time,Analog 1,Digital 1\nms,Servo position,Not selected\n",
        "ms,deg,V\nTime,Angle,Drive\n",
        "Time,Angle,Drive\nmilliseconds,degrees,volts\nraw,filtered,raw\n",
        "Time,Analog 1,Digital 1\n(ms),(Servo position),(None)\n",
    ],
)
def test_a_row_of_units_next_to_the_names(tmp_path, head):
    record = record_of(tmp_path, head + rows(1e3 * TIME, np.degrees(SWING), 0.0 * TIME))
    is_the_swing(record)
    assert record.attrs["time_unit_in_file"] in ("ms", "milliseconds")


@pytest.mark.parametrize("sep", [",", "\t"])
@pytest.mark.parametrize("bodies", [("mass A", "mass B"), ("plate", "left"), ("Marker 1", "Marker 2")])
def test_bodies_of_one_run_are_signals_by_their_names(tmp_path, sep, bodies):
    head = f"{bodies[0]},,{bodies[1]},\nt,x,t,x\n".replace(",", sep)
    (tmp_path / "r.csv").write_text(head + rows(TIME, SWING, TIME, OTHER, sep=sep))
    with pytest.raises(UsageError, match=f"{bodies[0]} x .* and {bodies[1]} x .* could each be the signal"):
        read_records(tmp_path / "r.csv")
    is_the_swing(read_record(tmp_path / "r.csv", angle=f"{bodies[0]} x", units="rad"))


def test_runs_in_two_rows_of_head_stay_runs(tmp_path):
    (tmp_path / "r.csv").write_text("Run 1,,Run 2,\nt,x,t,x\n" + rows(TIME, SWING, TIME, OTHER))
    assert len(read_records(tmp_path / "r.csv")) == 2


def test_groups_and_units_in_three_rows(tmp_path):
    head = "Trajectories\n100\n,,P:top,,P:bob,\nFrame,Sub Frame,X,Y,X,Y\n,,mm,mm,mm,mm\n"
    columns = np.arange(TIME.size), 0 * TIME, 0 * TIME + 3.0, 0 * TIME, SWING, 0.0 * TIME
    record = record_of(tmp_path, head + rows(*columns), sampling_rate=100.0)
    assert record.attrs["angle_column"] == "P:bob X (mm)"


@pytest.mark.parametrize(
    ("head", "sep"),
    [("t       y", "\t"), ("time(ms) theta(deg)", "\t"), ("time (ms),theta (deg)", "\t"), ("t theta", ";")],
)
def test_names_that_are_parted_otherwise_than_numbers(tmp_path, head, sep):
    time, scale = (1e3 * TIME, 180.0 / np.pi) if "ms" in head else (TIME, 1.0)
    record = record_of(tmp_path, head + "\n" + rows(time, scale * SWING, sep=sep))
    is_the_swing(record)
    assert record.attrs["angle_column"] != "1"


@pytest.mark.parametrize(
    ("note", "rate"),
    [
        *(
            (note, 1000.0)
            for note in (
                *("sample_rate 1000", "SampleRate=1000", "Sampling Freq. [Hz]: 1000", "sample_rate,1000,Hz"),
                *("Fs: 1 kHz", "Abtastrate in Hz: 1000", "Fréquence d'échantillonnage : 1000 Hz", "ODR 1000"),
                *("FREQUENCY\t1000", "Capture Frame Rate,1000", "samples per second: 1000", "Ts = 1e-3"),
                *("Sampling rate: 1,000 Hz", "sampled at 1000 Hz", "Data rate: 1 kS/s", "rate 1000"),
            )
        ),
        ("low-pass filter frequency 20 Hz", None),
        ("natural frequency: 2", None),
        ("Number of samples: 2000", None),
        ("strain rate 1000", None),
    ],
)
def test_the_sampling_rate_in_a_head(note, rate):
    assert noted_rate([note], 77) == (None if rate is None else pytest.approx(rate))


def test_a_stated_rate_is_no_name_of_a_column(tmp_path):
    record = record_of(tmp_path, "sample_rate: 100\n" + rows(SWING))
    is_the_swing(record)
    assert record.attrs["angle_column"] == "0"
    assert noted_rate(["dt:", "0.01\t0.01"], 9) == pytest.approx(100.0)


@pytest.mark.parametrize(("head", "sep"), [("90, 100, 10.", ","), ("90 100 10.", " "), ("90\t100", "\t")])
def test_a_head_of_bare_numbers_is_no_sample(tmp_path, head, sep):
    is_the_swing(record_of(tmp_path, f"{head}\n" + rows(TIME, SWING, sep=sep), units="rad"))


def test_a_head_of_bare_numbers_states_the_rate_by_the_number_of_rows(tmp_path):
    record = record_of(tmp_path, "90, 100, 10.\n" + rows(SWING), units="rad")
    is_the_swing(record)
    assert "100 Hz" in record.attrs["reading"]
    assert bare_rate(["90, 1000, 5."], 4800) is None


def test_waveforms_of_labview(tmp_path):
    stamps = [f"04.03.2021 14:22:{11.0 + t:09.6f}" for t in TIME]
    head = "waveform\t[0]\nt0\t04.03.2021 14:22:11,123\ndelta t\t0.010000\n\ntime\tY[0]\n"
    text = head + "".join(f"{t}\t{x:.6E}\n" for t, x in zip(stamps, SWING, strict=True))
    is_the_swing(record_of(tmp_path, text))
    text = "channel names:\nVoltage_0\nstart times:\n3/4/2021 2:22:11\ndt:\n0.010\ndata:\n" + rows(SWING)
    is_the_swing(record_of(tmp_path, text, units="rad"))


def test_segments_of_a_labview_file(tmp_path):
    text = "LabVIEW Measurement\t\nMulti_Headings\tYes\nX_Columns\tOne\n***End_of_Header***\t\n"
    for number, part in enumerate(np.array_split(np.arange(TIME.size), 4)):
        text += (
            f"Channels\t1\t\nTime\t14:22:{number}1.1\t\nX0\t0.0\t\nDelta_X\t0.01\t\n***End_of_Header***\t\t\n"
        )
        text += "X_Value\tAngle (rad)\tComment\n" + rows(TIME[part], SWING[part], sep="\t")
    is_the_swing(record_of(tmp_path, text))


def _element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def _objects(*classes):
    """Variables of a MATLAB 5 file that are objects of its own."""
    flags = _element(6, struct.pack("<II", 13, 0)) + _element(5, struct.pack("<ii", 6, 1)) + _element(1, b"")
    reference = _element(14, flags + _element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    texts = [[_element(1, text.encode()) for text in ("phi", "MCOS", name)] for name in classes]
    opaque = _element(6, struct.pack("<II", 17, 0))
    return b"".join(_element(14, opaque + b"".join(text) + reference) for text in texts)


@pytest.mark.parametrize("name", ["timeseries", "timetable", "Simulink.SimulationOutput"])
@pytest.mark.parametrize("variables", [{}, {"tout": TIME}])
def test_objects_of_matlab_are_named_with_how_to_save_them(tmp_path, name, variables):
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, variables)
    (tmp_path / "r.mat").write_bytes(buffer.getvalue() + _objects(name, name))
    with pytest.raises(RecordError, match=rf"r.mat: contains objects of MATLAB \({name}\).*save") as refusal:
        read_record(tmp_path / "r.mat")
    assert "damaged" not in str(refusal.value)
    scipy.io.savemat(tmp_path / "r.mat", {"tout": TIME, "theta": SWING})
    with (tmp_path / "r.mat").open("ab") as file:
        file.write(_objects(name))
    assert read_record(tmp_path / "r.mat").angle.values == pytest.approx(SWING)


def test_units_in_a_list(tmp_path):
    scipy.io.savemat(tmp_path / "r.mat", {"d": {"time": 1e3 * TIME, "acc": SWING, "units": "ms, m/s^2"}})
    record = read_record(tmp_path / "r.mat")
    assert (record.attrs["signal"], record.attrs["angle_unit_in_file"]) == ("acceleration", "m/s^2")
    assert record.time.values == pytest.approx(TIME)
    assert noted_unit(["Y_Unit_Label\tVolts\tN"], 1, 2) == "N"
    assert noted_unit(["Time unit: ms"]) == ""


def test_a_signal_about_gravity_is_no_angle(tmp_path):
    felt = 9.4 + 14.0 * SWING
    with pytest.raises(UsageError, match=r"swings about 9\.\d+, like an accelerometer .*--units m/s\^2"):
        record_of(tmp_path, "t,s1\n" + rows(TIME, felt))
    assert record_of(tmp_path, "t,s1\n" + rows(TIME, felt), units="deg").attrs["signal"] == "angle"
    assert record_of(tmp_path, "t,theta\n" + rows(TIME, felt)).attrs["signal"] == "angle"
    axes = 0.4 + 0.02 * OTHER, felt, 2.75 + 0.02 * OTHER[::-1]
    record = record_of(tmp_path, "t,X,Y,Z\n" + rows(TIME, *axes))
    assert (record.attrs["angle_column"], record.attrs["angle_unit_in_file"]) == ("Y", "m/s^2")


@pytest.mark.parametrize("name", ["Level (dB)", "L_Aeq [dB(A)]", "SPL_dB", "Amplitude (dBFS)", "Schallpegel"])
def test_levels_in_decibels_are_no_oscillation(tmp_path, name):
    with pytest.raises(RecordError, match="is a level in dB, the logarithm of an amplitude"):
        record_of(tmp_path, f"t (s),{name}\n" + rows(TIME, 60.0 + SWING))
    is_the_swing(record_of(tmp_path, f"t (s),theta (rad),{name}\n" + rows(TIME, SWING, 60.0 + OTHER)))


def tracked(*wrong):
    """A decay of 69 swings; of some that begin at a time, the way to one side is so many times too long."""
    time = np.round(np.arange(0.0, 79.0, 1.0 / 30.0), 3)
    angle = 0.5 * np.exp(-0.028 * time) * np.cos(2.0 * np.pi * time / 1.155)
    angle += 0.006 * np.random.default_rng(3).standard_normal(time.size)
    for instant, factor in wrong:
        angle[(np.abs(time - instant) < 0.29) & (angle > 0.03)] *= factor
    return np.column_stack([time, angle])


@pytest.mark.parametrize(
    "wrong", [[(20.79, 1.3)], [(20.79, 1.3), (27.72, 1.45)], [(3.465, 1.4)], [(20.79, 0.5)]]
)
def test_a_swing_that_a_tracker_shows_wrongly_is_left_out(wrong):
    decays = st.records.free_decays(tracked(*wrong))
    said = " ".join(decay.attrs["free_decay"] for decay in decays)
    assert f"{len(wrong)} half period" in said
    assert "like an error of a tracker" in said
    for instant, _ in wrong:
        assert not any(np.any(np.abs(decay.time.values - instant) < 0.1) for decay in decays)


def test_a_push_is_no_wrong_swing():
    pushed = tracked()
    pushed[pushed[:, 0] > 30.0, 1] *= 2.0
    with pytest.raises(st.errors.DecayError, match="rises again"):
        st.free_decay(pushed)


def test_a_swing_that_is_soon_damped_away_is_found_in_a_long_record():
    time = np.arange(0.0, 60.0, 0.01)
    after, w = np.maximum(time - 20.0, 0.0), 2.0 * np.pi / 0.2
    swing = (after > 0.0) * np.exp(-0.1 * w * after) * np.cos(w * after)
    noise = np.random.default_rng(0).standard_normal(time.size) / 25.0
    decay = st.free_decay(np.column_stack([time, swing + noise]))
    assert 20.0 < decay.time.values[0] < 20.5
    with pytest.raises(st.errors.DecayError, match="no oscillation"):
        st.free_decay(np.column_stack([time, noise]))
