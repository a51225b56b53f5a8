"""One campaign at a time writes to a store, whatever locks its file system and its platform have."""

import errno
import fcntl
import os
import sys
from types import SimpleNamespace

import pytest

from sysid_trib.campaigns import chunks as lock
from sysid_trib.errors import RecordError


def held_by_another(file: int, *_: int) -> None:
    raise PermissionError(errno.EACCES, "locked")


def test_the_second_is_told_and_the_lock_goes(tmp_path):
    store = tmp_path / "s.zarr"
    with (
        lock.sole_writer(store),
        pytest.raises(RecordError, match="another campaign"),
        lock.sole_writer(store),
    ):
        pass
    assert not list(tmp_path.iterdir())
    with lock.sole_writer(store):
        pass


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
