"""Hostile input ends in a result or in one sentence of the package; the full run is benchmarks/fuzz.py."""

import os
import subprocess
import sys
from time import process_time

import command_line
import h5py
import numpy as np
import pytest
import xarray as xr

import sysid_trib as st
from benchmarks.fuzz import FAULTS, run
from benchmarks.hostile.pieces import ANGLE, TIME
from benchmarks.hostile.records import CHANGES
from sysid_trib.errors import DecayError, RecordError, UsageError
from sysid_trib.results.files import write_file

SLOWEST_S = 5.0
COMMAND = [sys.executable, "-c", "from sysid_trib.cli import main; main()"]
FORCE = '[[force]]\nsymbol = "s"\n'


def ends_of(tmp_path, kind, numbers):
    """Return the cases of a kind that end in a fault."""
    cases = [run(kind, 0, number, tmp_path) for number in numbers]
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


def test_references_in_circles(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("a", "b"):
            file.create_dataset(name, shape=(2,), dtype=h5py.ref_dtype)
        for name, other in (("a", "b"), ("b", "a")):
            file[name][:] = [file[other].ref] * 2
    with pytest.raises(RecordError, match=r"a\.h5: cannot be read"):
        st.read_record(tmp_path / "a.h5")


@pytest.mark.parametrize("surface", ["1", "p"])
def test_a_switch_that_never_switches(tmp_path, surface):
    shape = "shape = { p = { default = 1.0, low = 0.1, high = 4.0 } }\n"
    library = written(tmp_path / "a.toml", f'{FORCE}formula = "abs({surface})*v"\n{shape}')
    moved = st.simulate(st.Model(st.load_library(library), {"s": 0.02}, 9.0), TIME, 0.3)
    viscous = st.simulate(st.Model(st.load_library(), {"zeta": 0.01}, 9.0), TIME, 0.3)
    np.testing.assert_allclose(moved.angle, viscous.angle, atol=1e-9)


def test_a_table_of_a_hundred_thousand_columns(tmp_path):
    place = written(tmp_path / "a.csv", "\n".join([",".join(["1.0"] * 100_000)] * 3))
    start = process_time()
    with pytest.raises(RecordError, match="100,000 columns"):
        st.read_record(place)
    assert process_time() - start < SLOWEST_S


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


@pytest.mark.parametrize("change", CHANGES)
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
def test_files_of_a_killed_process_are_removed_at_the_next_write(tmp_path):
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
