"""Hostile input ends in a result or in one sentence of the package; the full run is benchmarks/fuzz.py."""

import os
import subprocess
import sys
from time import monotonic

import h5py
import hostile
import numpy as np
import openpyxl
import pytest

import sysid_trib as st
from sysid_trib.errors import LibraryError, RecordError, SysidTribError
from sysid_trib.results.files import write_file

SLOWEST_S = 5.0


def ends_well(action):
    """Run it: a result, or an error of the package's own, in time."""
    start, said = monotonic(), "a result"
    try:
        action()
    except SysidTribError as error:
        said = str(error)
    assert said.strip()
    assert monotonic() - start < SLOWEST_S


@pytest.mark.parametrize("seed", range(4))
def test_damaged_text_libraries_and_records(tmp_path, seed):
    random = np.random.default_rng(seed)
    sound = hostile.sound_files(tmp_path)[0].read_bytes()
    place = tmp_path / "any.csv"
    for _ in range(10):
        place.write_bytes(hostile.damaged(sound, random))
        ends_well(lambda: st.read_record(place))
        (tmp_path / "any.toml").write_text(hostile.library(random), encoding="utf-8")
        ends_well(lambda: st.load_library(tmp_path / "any.toml"))
        ends_well(hostile.record(random))


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".h5", ".nc", ".mat", ".xlsx"])
def test_damaged_binary_files(tmp_path, ending):
    random = np.random.default_rng(5)
    sound = next(place for place in hostile.sound_files(tmp_path) if place.suffix == ending).read_bytes()
    place = tmp_path / f"any{ending}"
    for _ in range(8):
        place.write_bytes(hostile.damaged(sound, random))
        ends_well(lambda: st.read_record(place))
        ends_well(lambda: st.load(place))


def linked(tmp_path, kind):
    """An HDF5 file whose angle is in another file, or that links a group twice."""
    other, place = tmp_path / "other.h5", tmp_path / "linked.h5"
    with h5py.File(other, "w") as file:
        file["angle"] = hostile.ANGLE
    (tmp_path / "raw").write_bytes(hostile.ANGLE.tobytes())
    with h5py.File(place, "w") as file:
        file["time"] = hostile.TIME
        if kind == "external link":
            file["angle"] = h5py.ExternalLink(str(other), "/angle")
        elif kind == "virtual":
            layout = h5py.VirtualLayout(shape=hostile.ANGLE.shape, dtype="f8")
            layout[:] = h5py.VirtualSource(str(other), "angle", shape=hostile.ANGLE.shape)
            file.create_virtual_dataset("angle", layout)
        elif kind == "external storage":
            raw = [(str(tmp_path / "raw"), 0, h5py.h5f.UNLIMITED)]
            file.create_dataset("angle", shape=hostile.ANGLE.shape, dtype="f8", external=raw)
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


def test_numbers_that_no_memory_holds(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"] = hostile.TIME
        file.create_dataset("angle", shape=(2**33,), dtype="f8", chunks=(1024,))
    with pytest.raises(RecordError, match="far more memory"):
        st.read_record(tmp_path / "a.h5")


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
    text = hostile.library(np.random.default_rng(0)).splitlines()[:-2]
    shape = f'shape = {{ p = {{ default = {number}, low = 0.1, high = 4.0, meaning = "m" }} }}'
    (tmp_path / "a.toml").write_text("\n".join([*text, 'formula = "p*v"', shape]), encoding="utf-8")
    with pytest.raises(LibraryError):
        st.load_library(tmp_path / "a.toml")


def test_a_table_of_a_hundred_thousand_columns(tmp_path):
    (tmp_path / "a.csv").write_text("\n".join([",".join(["1.0"] * 100_000)] * 3))
    start = monotonic()
    with pytest.raises(RecordError, match="100,000 columns"):
        st.read_record(tmp_path / "a.csv")
    assert monotonic() - start < SLOWEST_S


def test_steps_that_lose_their_digits(tmp_path):
    rows = "\n".join(f"{at * 1e-320},{angle:.9g}" for at, angle in enumerate(hostile.ANGLE))
    (tmp_path / "a.csv").write_text(f"time (s),angle (rad)\n{rows}\n")
    with pytest.raises(RecordError, match="no clock has such steps"):
        st.read_record(tmp_path / "a.csv")


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
