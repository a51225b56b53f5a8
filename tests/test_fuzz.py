"""Hostile input ends in a result or in one sentence of the package; the full run is benchmarks/fuzz.py."""

import math
import os
import subprocess
import sys
from pathlib import Path
from time import process_time

import command_line
import h5py
import numpy as np
import openpyxl
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import DecayError, LibraryError, RecordError, SysidTribError, UsageError
from sysid_trib.forces.selection import load_system
from sysid_trib.records import probe
from sysid_trib.records.half_periods import dominant_periods
from sysid_trib.records.headers import split_header
from sysid_trib.records.numbers import _number
from sysid_trib.records.units import signal_unit
from sysid_trib.results.files import write_file

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from hostile import files, worker
from hostile.pieces import ANGLE, TIME

SLOWEST_S = 5.0
FAULTS = ("fault", "unreadable")
COMMAND = [sys.executable, "-c", "from sysid_trib.cli import main; main()"]
FORCE = '[[force]]\nsymbol = "s"\n'


def ends_of(tmp_path, kind, numbers):
    """How cases of a kind end, but those that end well."""
    cases = [worker.run(kind, 0, number, tmp_path) for number in numbers]
    return [case for case in cases if case["end"].startswith(FAULTS)]


@pytest.mark.parametrize(
    ("kind", "count"), [("text", 30), ("library", 40), ("toml", 40), ("record", 12), ("formula", 20)]
)
def test_hostile_input_ends_in_a_result_or_in_a_sentence(tmp_path, kind, count):
    assert ends_of(tmp_path, kind, range(count)) == []


@pytest.mark.in_full
@pytest.mark.parametrize(
    ("kind", "count"),
    [("binary", 60), ("damaged", 20), ("store", 20), ("page", 4), ("command", 30), ("discover", 10)],
)
def test_hostile_files_results_and_commands(tmp_path, kind, count):
    assert ends_of(tmp_path, kind, range(count)) == []


def written(place, text):
    place.write_text(text, encoding="utf-8")
    return place


def linked(tmp_path, kind):
    """An HDF5 file whose angle is in another file, or that links a group twice."""
    other, place = tmp_path / "other.h5", tmp_path / "linked.h5"
    with h5py.File(other, "w") as file:
        file["angle"] = ANGLE
    (tmp_path / "raw").write_bytes(ANGLE.tobytes())
    with h5py.File(place, "w") as file:
        file["time"] = TIME
        if kind == "external link":
            file["angle"] = h5py.ExternalLink(str(other), "/angle")
        elif kind == "virtual":
            layout = h5py.VirtualLayout(shape=ANGLE.shape, dtype="f8")
            layout[:] = h5py.VirtualSource(str(other), "angle", shape=ANGLE.shape)
            file.create_virtual_dataset("angle", layout)
        elif kind == "external storage":
            raw = [(str(tmp_path / "raw"), 0, h5py.h5f.UNLIMITED)]
            file.create_dataset("angle", shape=ANGLE.shape, dtype="f8", external=raw)
        else:
            group = file
            for at in range(40):
                following = file.create_group(f"g{at}")
                group["a"], group["b"] = following, following
                group = following
    return place


@pytest.mark.parametrize("kind", ["external link", "virtual", "external storage", "groups"])
def test_nothing_outside_of_a_file_is_read(tmp_path, kind):
    with pytest.raises(RecordError, match=r"copy all numbers into one plain file") as caught:
        st.read_record(linked(tmp_path, kind), units="rad")
    assert "linked.h5" in str(caught.value)
    with pytest.raises(RecordError):
        st.load(linked(tmp_path, kind))


@pytest.mark.parametrize("datasets", [1, 20])
def test_numbers_that_no_memory_holds(tmp_path, datasets):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = TIME
        for at in range(datasets):
            size = 2**33 // datasets
            file.create_dataset(f"angle{at}", shape=(size,), dtype="f8", chunks=(1024,))
    with pytest.raises(RecordError, match="far more memory"):
        st.read_record(tmp_path / "a.h5")


def test_references_in_circles(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("a", "b"):
            file.create_dataset(name, shape=(2,), dtype=h5py.ref_dtype)
        for name, other in (("a", "b"), ("b", "a")):
            file[name][:] = [file[other].ref] * 2
    with pytest.raises(RecordError, match=r"a\.h5: cannot be read"):
        st.read_record(tmp_path / "a.h5")


@pytest.mark.slow
def test_a_reader_that_crashes_or_hangs_ends_in_a_sentence(tmp_path, monkeypatch):
    place = written(tmp_path / "a.h5", "any")
    process = probe._ReadingProcess()
    monkeypatch.setattr(probe, "_process", process)
    os.kill(process._process.pid, 9)
    process._process.wait()
    # Another one takes its place.
    with pytest.raises(RecordError, match="seems damaged"):
        probe.check_binary(place, "read_hdf5")
    assert probe._process is not process
    monkeypatch.setattr(probe, "BUSY", 1e-9)
    with pytest.raises(RecordError, match="far too long"):
        probe.check_binary(place, "read_hdf5")


@pytest.mark.slow
def test_a_sheet_with_a_cell_at_its_far_corner(tmp_path):
    book = openpyxl.Workbook()
    book.active.append([0.0, 1.0])
    book.active.cell(row=1048576, column=16384, value=1.0)
    book.save(tmp_path / "far.xlsx")
    with pytest.raises(RecordError, match=r"far\.xlsx"):
        st.read_record(tmp_path / "far.xlsx")


@pytest.mark.parametrize("number", ["9" * 4301, "9" * 400, "18446744073709551616", "nan", "1e308"])
def test_numbers_of_a_library_that_are_none(tmp_path, number):
    shape = f'shape = {{ p = {{ default = {number}, low = 0.1, high = 4.0, meaning = "m" }} }}'
    with pytest.raises(LibraryError):
        st.load_library(written(tmp_path / "a.toml", f'{FORCE}formula = "p*v"\n{shape}\n'))


def test_a_start_that_is_divided_by_zero(tmp_path):
    library = f'{FORCE}formula = "z"\nstate = {{ z = "v" }}\nstart = {{ z = "1/0" }}\n'
    with pytest.raises(LibraryError, match="not a finite number"):
        st.load_library(written(tmp_path / "a.toml", library))


def test_letters_beyond_the_first_plane_are_letters(tmp_path):
    words = 'title = "😀"\n' + FORCE + 'name = "𝜁😀"\nformula = "2*v"\nmeaning = "🐍"\n'
    library = st.load_library(written(tmp_path / "a.toml", words))
    data = xr.Dataset({"angle": ("time", ANGLE, {"units": "rad"})}, {"time": ("time", TIME, {"units": "s"})})
    found = st.identify(st.free_decay(data), library, st.methods.Direct())
    assert found.coefficient.item() == pytest.approx(0.05 / 9.0, rel=1e-3)
    again = st.load_library(written(tmp_path / "again.toml", library.to_toml()))
    assert (again.title, again.forces) == (library.title, library.forces)
    with pytest.raises(LibraryError):
        st.load_library(written(tmp_path / "b.toml", FORCE + 'formula = "𝑥😀"\n'))


@pytest.mark.parametrize(
    "entry",
    [
        "forces = 1",
        "held = 2",
        "held = { zeta = true }",
        'signal = "noise"',
        f"held = {{ zeta = {'9' * 4301} }}",
    ],
)
def test_systems_that_are_none(tmp_path, entry):
    with pytest.raises(LibraryError, match=r"a\.toml"):
        load_system(str(written(tmp_path / "a.toml", f'[[system]]\nname = "own"\n{entry}\n')))


def test_a_force_beside_a_state_that_stays_at_zero_has_a_signature(tmp_path):
    library = f'{FORCE}formula = "-1 + z"\nstate = {{ z = "0" }}\n'
    force = next(iter(st.load_library(written(tmp_path / "a.toml", library))))
    assert st.forces.signature(force, 0.3).sine.item() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("surface", ["1", "p"])
def test_a_switch_that_never_switches(tmp_path, surface):
    shape = "shape = { p = { default = 1.0, low = 0.1, high = 4.0 } }\n"
    library = written(tmp_path / "a.toml", f'{FORCE}formula = "abs({surface})*v"\n{shape}')
    moved = st.simulate(st.Model(st.load_library(library), {"s": 0.02}, 9.0), TIME, 0.3)
    viscous = st.simulate(st.Model(st.load_library(), {"zeta": 0.01}, 9.0), TIME, 0.3)
    np.testing.assert_allclose(moved.angle, viscous.angle, atol=1e-9)


def test_a_start_model_without_a_slope_along_the_record_is_refused(tmp_path):
    formula = "max(sin(tan(v)*pi/max(v, z))**3, min(cos(0.1 - sqrt(v**-20)), 0.5))**2"
    memory = 'memory = { z = "v" }'
    library = st.load_library(written(tmp_path / "a.toml", f'{FORCE}formula = "{formula}"\n{memory}\n'))
    noise = 1e-4 * np.random.default_rng(0).standard_normal(ANGLE.size)
    data = xr.Dataset({"angle": ("time", ANGLE + noise, {"units": "rad"})}, {"time": TIME})
    with pytest.raises(LibraryError, match=r"along this record \(s\): a force or its slope"):
        st.discover(st.free_decay(data), library, st.load_library("contact_forces"), max_effects=1)


def test_whole_numbers_beyond_all_floats_are_infinite():
    assert _number(-(10**400), "a", 1, "a.csv") == -np.inf


def test_times_that_are_all_but_equal_have_no_period():
    assert dominant_periods(np.zeros(ANGLE.size), ANGLE) == []


def test_a_time_that_dwarfs_all_others_is_named_by_its_row(tmp_path):
    time = 0.01 * np.arange(400.0)
    time[200] = -(2.0**63)
    rows = "\n".join(f"{t!r},{0.3 * math.cos(6.0 * t)}" for t in time.tolist())
    with pytest.raises(RecordError, match="row 20"):
        st.read_record(written(tmp_path / "a.csv", f"time (s),angle (rad)\n{rows}"), time=0)


def test_times_that_are_one_number_do_not_contradict_a_sampling_rate(tmp_path):
    text = "time (s),angle (rad)\n0,0.1\n,0.2\n0,0.3\n"
    assert st.read_record(written(tmp_path / "a.csv", text), sampling_rate=10.0).time.values.tolist() == [
        0.0,
        0.2,
    ]


def test_a_table_of_a_hundred_thousand_columns(tmp_path):
    place = written(tmp_path / "a.csv", "\n".join([",".join(["1.0"] * 100_000)] * 3))
    start = process_time()
    with pytest.raises(RecordError, match="100,000 columns"):
        st.read_record(place)
    assert process_time() - start < SLOWEST_S


@pytest.mark.parametrize("text", [" " * 5000 + "(", "(" * 5000, "[" * 2500 + "]" * 2500, "a per " * 1000])
def test_headers_and_units_take_no_time(text):
    start = process_time()
    split_header(text)
    signal_unit(text)
    assert process_time() - start < 0.5


def test_steps_that_lose_their_digits(tmp_path):
    rows = "\n".join(f"{at * 1e-320},{angle:.9g}" for at, angle in enumerate(ANGLE))
    with pytest.raises(RecordError, match="no clock has such steps"):
        st.read_record(written(tmp_path / "a.csv", f"time (s),angle (rad)\n{rows}\n"))


def test_rates_that_overflow(tmp_path):
    rows = "\n".join(f"{t:.2f},{rate}" for t, rate in zip(TIME, np.sign(ANGLE) * 1.7e308, strict=True))
    with pytest.raises(RecordError, match="too much for an oscillation"):
        st.read_record(written(tmp_path / "a.csv", f"time (s),rate (rad/s)\n{rows}\n"))


def test_letters_of_a_file_steer_no_terminal(tmp_path):
    place = written(tmp_path / "a.csv", "time (s),\x1b[31mangle\x1b]0;owned\x07\n0,1\n1,2\n2,1\n")
    with pytest.raises(UsageError) as caught:
        st.read_record(place, angle="none")
    assert str(caught.value).isprintable()


def test_letters_where_numbers_are_asked_for(tmp_path):
    place = command_line.write_csv(tmp_path / "a.csv")
    assert command_line.run("look", place, "--angle", "²").status == 2
    nul = tmp_path / "b.csv"
    nul.write_bytes(b"time (s),an\0gle (rad)\n0,1\n1,2\n")
    assert "binary content" in command_line.run("look", nul).complaint
    assert "too long" in command_line.run("look", tmp_path / ("a" * 5000)).complaint


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_name_that_is_no_text(tmp_path):
    place = command_line.write_csv(tmp_path / "a\udcff.csv")
    target = tmp_path / "r\udcff.nc"
    done = command_line.run("identify", place, "--forces", "zeta", "-o", target, "--csv", tmp_path / "t.csv")
    assert done.status == 0, done.err
    assert "a?.csv" in st.load(target).attrs["command"]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.drop_vars("angle"),
        lambda data: data.drop_vars("time"),
        lambda data: data.rename(time="t"),
        lambda data: data.isel(time=slice(0, 0)),
        lambda data: data.assign(angle=data.angle.astype(str)),
        lambda data: data.expand_dims("run"),
        lambda data: data.assign(angle=data.angle * np.nan),
        lambda data: data.assign(angle=data.angle * 1e90),
        lambda data: data.assign(angle=(data.angle * 0.0).assign_attrs(units="mm")),
        lambda data: data.isel(time=slice(None, None, -1)),
    ],
)
def test_data_that_are_no_record(change):
    data = change(xr.Dataset({"angle": ("time", ANGLE)}, {"time": TIME}))
    library = st.load_library().select(["zeta"])
    for asked in (
        st.free_decay,
        st.records.envelope,
        lambda record: st.identify(record, library, st.methods.Direct()),
    ):
        with pytest.raises((UsageError, DecayError)):
            asked(data)


@pytest.mark.parametrize("exponent", [-20, -133])
@pytest.mark.parametrize("method", [st.methods.Direct(), st.methods.Averaging(), st.methods.Trajectory()])
def test_a_tiny_angle_has_the_coefficients_of_its_size(method, exponent):
    size, noise = 2.0**exponent, 1e-4 * np.random.default_rng(0).standard_normal(ANGLE.size)
    library = st.load_library().select(["zeta", "delta"])
    found = []
    for scale in (1.0, size):
        angle = ("time", scale * (ANGLE + noise), {"units": "rad"})
        data = xr.Dataset({"angle": angle}, {"time": ("time", TIME, {"units": "s"})})
        found.append(st.identify(st.free_decay(data), library, method))
    usual, tiny = found
    factors = size ** np.array([0.0, -1.0])
    for name in ("coefficient", "standard_error"):
        np.testing.assert_array_equal(tiny[name], usual[name] * factors)
    for name in ("reference_frequency", "reference_frequency_standard_error"):
        assert tiny[name].item() == usual[name].item()
    assert tiny.noise.item() == usual.noise.item() * size
    assert tiny.unit.values.tolist() == usual.unit.values.tolist()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a shell of another kind")
@pytest.mark.parametrize(
    ("shell", "status", "said"),
    [
        ("{} | true; exit ${{PIPESTATUS[0]}}", 0, ""),
        ("{} >&-", 1, "standard output is closed"),
        ("{} >/dev/full", 1, "standard output cannot be written"),
        ("ulimit -v 700000; {}", 1, "Out of memory"),
    ],
    ids=["true", "closed", "full", "memory"],
)
def test_terminals_and_limits(shell, status, said):
    asked = " ".join(f"'{word}'" for word in [*COMMAND, "identify" if "ulimit" in shell else "forces"])
    done = subprocess.run(["bash", "-c", shell.format(asked)], capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == (1 if said else 0)


@pytest.mark.slow
def test_what_a_killed_process_left_is_cleared_at_the_next_write(tmp_path):
    script = (
        "import os, sys, sysid_trib.results.files as files\n"
        "os.replace = lambda *_: os.kill(os.getpid(), 9)\n"
        "files.write_file(files.Path(sys.argv[1]), b'new')\n"
    )
    place = tmp_path / "a.txt"
    place.write_bytes(b"old")
    subprocess.run([sys.executable, "-c", script, place], check=False)
    assert place.read_bytes() == b"old"
    assert len(os.listdir(tmp_path)) == 2
    write_file(place, b"newer")
    assert os.listdir(tmp_path) == ["a.txt"]
    assert place.read_bytes() == b"newer"


def test_sound_files_are_read(tmp_path):
    for place in files.sound_files(tmp_path).values():
        assert st.read_record(place).angle.size == ANGLE.size, place


def test_all_errors_are_sentences_of_one_line():
    assert str(SysidTribError("a\nb\x1b[0m \udcff")) == "a b?[0m ?"
