"""Files of results: an older one is replaced only by a whole one, on whatever disk."""

import os
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from sysid_trib.commands.predicted import write_record
from sysid_trib.errors import RecordError
from sysid_trib.reporting.page import write_page
from sysid_trib.results.files import load, save, write_figure

TIME = np.arange(1500) / 100.0
RECORD = xr.Dataset({"angle": ("time", 0.3 * np.cos(9.91 * TIME))}, {"time": TIME})
NAMES = ["one.nc", "one.csv", "one.html", "one.pdf"]


def write(target):
    """Write some 15 to 60 kB."""
    if target.suffix == ".html":
        write_page("<p>" * 20_000, target)
    elif target.suffix == ".pdf":
        figure = Figure()
        figure.subplots().plot(TIME, RECORD.angle)
        write_figure(figure, target.with_suffix(""))
    else:
        write_record(RECORD, target)


def full(_):
    raise OSError(28, "No space left on device")


def cut_short(descriptor):
    os.ftruncate(descriptor, 10)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "reason"), [(full, "No space left"), (cut_short, "read back")])
@pytest.mark.parametrize("name", NAMES)
def test_a_disk_that_fills_up_leaves_the_older_file(tmp_path, monkeypatch, fault, reason, name):
    target = tmp_path / name
    target.write_text("older")
    monkeypatch.setattr(os, "fsync", fault)
    with pytest.raises(RecordError, match=rf"{name}: cannot be written \(.*{reason}"):
        write(target)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert target.read_text() == "older"


@pytest.fixture(params=[44, 56, 80], ids="{}k".format)
def small_disk(tmp_path, request):
    """A folder on a file system of a few kB."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        pytest.skip("only root can mount a file system")
    command = ["mount", "-t", "tmpfs", "-o", f"size={request.param}k", "tmpfs", str(tmp_path)]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")
    yield tmp_path
    subprocess.run(["umount", str(tmp_path)], check=True)


@pytest.mark.parametrize("name", NAMES)
def test_a_small_disk_holds_the_older_file_or_the_whole_new_one(small_disk, name):
    target = small_disk / name
    target.write_bytes(b"older" * 4000)
    complaint = ""
    try:
        write(target)
    except RecordError as error:
        complaint = str(error)
    if f"{name}: cannot" in complaint:
        assert "cannot be written (No space left on device); choose another place" in complaint
        assert target.read_bytes() == b"older" * 4000
    else:
        assert target.read_bytes()[:5] != b"older"
    if name == "one.nc" and not complaint:
        xr.testing.assert_identical(load(target).to_dataset(), RECORD)
    assert {p.name for p in small_disk.iterdir()} <= {name, target.with_suffix(".png").name}


@pytest.mark.parametrize("place", ["missing/one.nc", "file/one.nc", "folder"])
def test_unwritable_output_is_refused(tmp_path, place):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    before = sorted(p.name for p in tmp_path.rglob("*"))
    with pytest.raises(RecordError, match="cannot be written"):
        save(RECORD, tmp_path / place)
    assert sorted(p.name for p in tmp_path.rglob("*")) == before


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_a_result_may_be_read_by_all_whom_the_umask_allows(tmp_path):
    save(RECORD, tmp_path / "one.nc")
    (tmp_path / "plain").write_text("")
    assert (tmp_path / "one.nc").stat().st_mode == (tmp_path / "plain").stat().st_mode
