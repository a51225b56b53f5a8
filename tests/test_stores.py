"""Stores of campaigns: damage is noticed, one campaign at a time writes, and nothing else is replaced."""

import errno
import fcntl
import json
import os
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import linear, run, write_csv

import sysid_trib as st
from sysid_trib.campaigns import rows as lock
from sysid_trib.campaigns.rows import sole_writer
from sysid_trib.errors import RecordError

pytest.importorskip("zarr", reason="campaigns need the extra of this name")
TASK = st.campaigns.Task("identify", st.load_library().select(["zeta"]), {"direct": st.methods.Direct()})
TIME = np.arange(0.0, 12.0, 0.02)
OPTIONS = ("--forces", "zeta", "--methods", "direct", "--workers", "0")


def do(records, place):
    return st.campaign(records, TASK, output=place, workers=0)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three records, and the store of two of them."""
    folder = tmp_path_factory.mktemp("made")
    records = [write_csv(folder / f"r{at}.csv", TIME, linear(TIME, 0.01 + 0.01 * at)) for at in range(3)]
    do(records[:2], folder / "base.zarr")
    return records, folder / "base.zarr"


def flip(place):
    """Flip one bit of the stored numbers, so that only their checksum detects it."""
    import zarr

    group = zarr.open_group(place, mode="r+")
    values = group["coefficient"][:]
    values.view(np.uint64)[1] ^= np.uint64(1)
    group["coefficient"][:] = values


def edited(name, key, value):
    def edit(place):
        file = place / name / ".zarray"
        file.write_text(json.dumps(json.loads(file.read_text()) | {key: value}))

    return edit


def swapped(place):
    import zarr

    names = zarr.open_group(place, mode="r+")["record"]
    names[:] = names[:][::-1]


DAMAGES = {
    "a bit": flip,
    "a chunk is gone": lambda place: (place / "coefficient" / "0.0.0").unlink(),
    "a chunk is cut": lambda place: os.truncate(place / "outline" / "0.0.0", 30),
    "an array is gone": lambda place: shutil.rmtree(place / "verdict"),
    "names are gone": lambda place: shutil.rmtree(place / "record"),
    "names are swapped": swapped,
    "no JSON": lambda place: (place / "coefficient" / ".zarray").write_text("{"),
    "chunks of nothing": edited("coefficient", "chunks", [0, 1, 1]),
    "another length": edited("status", "shape", [10**10]),
    "another kind": edited("verdict", "dtype", "|O"),
    "pickles": edited("coefficient", "filters", [{"id": "pickle"}]),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_in_a_store_is_detected(made, tmp_path, damage):
    records, base = made
    place = tmp_path / "a.zarr"
    shutil.copytree(base, place)
    DAMAGES[damage](place)
    for ask in (
        lambda: do(records[:2], place),
        lambda: do(records, place),
        lambda: st.campaigns.open_store(place),
    ):
        with pytest.raises(RecordError, match=r"a\.zarr: a part of the store is damaged"):
            ask()


def test_one_campaign_at_a_time_writes_to_a_store(made, tmp_path):
    records, base = made
    place = tmp_path / "a.zarr"
    shutil.copytree(base, place)
    with sole_writer(place), pytest.raises(RecordError, match="another campaign writes to this store"):
        do(records, place)
    # A lock file left by a killed process locks nothing.
    (tmp_path / ".a.zarr.lock").touch()
    assert do(records, place).sizes["record"] == 3
    assert os.listdir(tmp_path) == ["a.zarr"]


def test_a_file_is_no_store(made, tmp_path):
    records = made[0]
    (tmp_path / "x.zarr").symlink_to(records[0])
    said = run("campaign", *records, "--task", "identify", *OPTIONS, "-o", tmp_path / "x.zarr").complaint
    assert "is a file, not the store of a campaign; choose another place with -o." in said
    assert "zarr'" not in said


def test_a_link_to_a_store_stays_one(made, tmp_path):
    records, base = made
    (tmp_path / "disk").mkdir()
    shutil.copytree(base, tmp_path / "disk" / "a.zarr")
    (tmp_path / "a.zarr").symlink_to(tmp_path / "disk" / "a.zarr")
    assert do(records, tmp_path / "a.zarr").sizes["record"] == 3
    assert (tmp_path / "a.zarr").is_symlink()
    assert sorted(os.listdir(tmp_path)) == ["a.zarr", "disk"]
    assert st.campaigns.open_store(tmp_path / "disk" / "a.zarr").sizes["record"] == 3


@pytest.mark.parametrize("which", ["record", "conditions", "library"])
def test_the_page_replaces_nothing_that_is_read(made, tmp_path, which):
    given = {"record": made[0][0], "conditions": tmp_path / "c.csv", "library": tmp_path / "l.toml"}
    given["conditions"].write_text("load\n1\n")
    given["library"].write_text('[[force]]\nsymbol = "zeta"\nformula = "2*v"\n')
    page = shutil.copy(given[which], tmp_path / "out.html")
    before = page.read_bytes()
    given[which] = page
    words = ["--conditions", given["conditions"], "--library", given["library"], *OPTIONS]
    if which == "library":
        shutil.copy(page, tmp_path / "l.toml")
    ending = run("campaign", given["record"], *words, "-o", tmp_path / "out.zarr")
    assert (ending.status, "would replace a file that is read" in ending.complaint) == (1, True)
    assert page.read_bytes() == before


@pytest.mark.slow
def test_conditions_of_any_letters_are_drawn_and_escaped(made, tmp_path):
    names = r"load $\si{N}$", "<script>alert(1)</script>"
    rows = ["1,$\\x$", "2,a&b", "4,a&b"]
    place = tmp_path / "o.zarr"
    (tmp_path / "c.csv").write_text("\n".join([",".join(names), *rows]))
    ending = run("campaign", *made[0], "--conditions", tmp_path / "c.csv", *OPTIONS, "-o", place)
    assert (ending.status, ending.err) == (0, "")
    assert "<script>alert" not in (tmp_path / "o.html").read_text(encoding="utf-8")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize(
    "words",
    [
        ["identify", "PIPE"],
        ["report", "PIPE", "-o", "a.html"],
    ],
)
def test_a_pipe_is_not_waited_for(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("PIPE")
    ending = run(*words)
    assert (ending.status, "this is a pipe" in ending.complaint) == (1, True)


def held_by_another(file: int, *_: int) -> None:
    raise PermissionError(errno.EACCES, "locked")


def test_where_files_cannot_be_locked_whole_their_records_are(tmp_path, monkeypatch):
    asked = []

    def no_flock(*_: int) -> None:
        raise OSError(errno.ENOTSUP, "no such locks")

    monkeypatch.setattr(fcntl, "flock", no_flock)
    monkeypatch.setattr(fcntl, "lockf", lambda *how: asked.append(how))
    with lock.sole_writer(tmp_path / "s.zarr"):
        assert len(asked) == 1
    monkeypatch.setattr(fcntl, "lockf", held_by_another)
    with pytest.raises(RecordError, match="another campaign"), lock.sole_writer(tmp_path / "s.zarr"):
        pass


def test_windows_locks_by_its_own_call(tmp_path, monkeypatch):
    asked = []
    windows = SimpleNamespace(LK_NBLCK=2, locking=lambda *how: asked.append(how[1:]))
    monkeypatch.setitem(sys.modules, "msvcrt", windows)
    monkeypatch.setattr(sys, "platform", "win32")
    with lock.sole_writer(tmp_path / "s.zarr"):
        assert asked == [(2, 1)]
        assert os.listdir(tmp_path) == [".s.zarr.lock"]
    assert not os.listdir(tmp_path)
    windows.locking = held_by_another
    with pytest.raises(RecordError, match="another campaign"), lock.sole_writer(tmp_path / "s.zarr"):
        pass
