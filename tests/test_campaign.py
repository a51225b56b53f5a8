"""Campaigns: one row a record, whatever the workers, the order, the bad records and the kills."""

import errno
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from command_line import TIME, linear, run, write_csv

import sysid_trib as st
from sysid_trib.campaigns.conditions import read_conditions
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.printing import campaign
from sysid_trib.results.store import Status, counts_of

pytest.importorskip("zarr", reason="campaigns need the extra of this name")
LIBRARY_OF_ALL = st.load_library("contact_forces")
LIBRARY = LIBRARY_OF_ALL.select(["lambda", "zeta"])
# The tests check the places of rows in a store, not their contents.
METHODS = {"direct": st.methods.Direct(refine=False)}
FILES = st.campaigns.Task("identify", LIBRARY, METHODS)
TIMES = np.arange(0.0, 8.0, 1.0 / 60.0)
# Names of records that are drawn by their number, see `drawn`.
RECORDS = [str(at) for at in range(6)]


def drawn(name: str) -> list[xr.Dataset]:
    """Draw a record by its number: friction and release are those of the number alone."""
    model, angle, noise = drawn_model(int(name))
    motion = st.simulate(model, TIMES, angle)
    record = xr.Dataset({"angle": ("time", motion.angle.values + noise)}, {"time": TIMES})
    return [st.free_decay(record)]


def drawn_model(number: int) -> tuple[st.Model, float, np.ndarray]:
    """Draw the model, the release (rad) and the noise (rad) of a record."""
    random = np.random.default_rng([7, number])
    truth = {"lambda": random.choice([5e-4, 1e-3]), "zeta": random.uniform(1e-3, 3e-3)}
    noise = 1e-4 * random.standard_normal(TIMES.size)
    return st.Model(LIBRARY, truth, 8.87), random.normal(0.3, 0.01), noise


TASK = st.campaigns.Task("identify", LIBRARY, METHODS, read=drawn)


def numbers(store):
    """All but the times that records took."""
    return store.drop_vars("seconds").load()


@pytest.mark.slow
def test_records_that_a_function_of_ones_own_reads_are_rows(tmp_path):
    store = st.campaign(RECORDS, TASK, output=tmp_path / "a.zarr", workers=0)
    assert store.coefficient.sizes == {"record": 6, "model": 1, "force": 2}
    low, high = store.outline.transpose("edge", "record", "part").values
    (decay,) = drawn("3")
    assert (low[3].min(), high[3].max()) == (decay.angle.min(), decay.angle.max())
    assert counts_of(store)["done"] == 6
    truth = np.array([list(drawn_model(at)[0].coefficients.values()) for at in range(6)])
    off = (store.coefficient.values[:, 0] - truth) / store.standard_error.values[:, 0]
    assert np.all(np.abs(off) < 8.0)


def test_finished_records_are_not_computed_again_but_others_are(tmp_path):
    whole = numbers(st.campaign(RECORDS, TASK, output=tmp_path / "whole.zarr", workers=0))

    class StoppedError(Exception):
        pass

    def stop(activity, done=None):
        if done and done >= 0.5:
            raise StoppedError

    with pytest.raises(StoppedError):
        st.campaign(RECORDS, TASK, output=tmp_path / "part.zarr", workers=0, tell=stop)
    half = st.campaigns.open_store(tmp_path / "part.zarr")
    half_seconds = half.seconds[:3].load()
    assert counts_of(half) == {"waiting": 3, "done": 3, "refused": 0, "failed": 0, "lost": 0}
    resumed = st.campaign(RECORDS, TASK, output=tmp_path / "part.zarr", workers=0)
    xr.testing.assert_identical(numbers(resumed), whole)
    # The computing time is measured again if a record is computed again.
    xr.testing.assert_identical(resumed.seconds[:3].load(), half_seconds)


def disk_with_room(monkeypatch, room):
    """Let the files of a store grow by at most this number of bytes; then the disk is full."""
    left, opened = [room], Path.open

    class Written(io.BufferedWriter):
        def write(self, content):
            left[0] -= memoryview(content).nbytes
            if left[0] < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(content)

    def open_file(path, mode="r", *rest, **options):
        file = opened(path, mode, *rest, **options)
        return Written(file.detach()) if path.suffix == ".partial" and mode == "wb" else file

    monkeypatch.setattr(Path, "open", open_file)
    return left


@pytest.mark.slow
def test_a_full_disk_ends_a_campaign_with_a_sentence_and_it_can_be_continued(tmp_path, monkeypatch):
    def store_of(name):
        return st.campaign(RECORDS, TASK, output=tmp_path / name, workers=0)

    with monkeypatch.context() as patch:
        left = disk_with_room(patch, 10**9)
        whole = numbers(store_of("whole.zarr"))
    of_records = sum(p.stat().st_size for p in (tmp_path / "whole.zarr").rglob("[0-9]*"))
    with monkeypatch.context() as patch:
        disk_with_room(patch, 2000)
        with pytest.raises(RecordError, match="cannot be created"):
            store_of("none.zarr")
    assert sorted(p.name for p in tmp_path.glob("*.zarr*")) == ["whole.zarr"]
    assert not list(tmp_path.glob(".*"))
    with monkeypatch.context() as patch:
        disk_with_room(patch, 10**9 - left[0] - of_records // 2)
        with pytest.raises(RecordError, match=r"No space left on device.*repeat the command"):
            store_of("part.zarr")
    part = st.campaigns.open_store(tmp_path / "part.zarr").load()
    done = np.flatnonzero(part.status.values == 1)
    assert 0 < len(done) < 6
    xr.testing.assert_identical(part.isel(record=done).drop_vars("seconds"), whole.isel(record=done))
    xr.testing.assert_identical(numbers(store_of("part.zarr")), whole)
    assert not [p for p in tmp_path.rglob("*") if p.suffix == ".partial"]


def test_a_bad_record_is_a_row_with_its_reason(tmp_path):
    files = [write_csv(tmp_path / f"{at}.csv", angle=linear(zeta=0.01 + 0.001 * at)) for at in range(2)]
    (tmp_path / "bad.csv").write_text("no, numbers\n")
    files.insert(1, tmp_path / "bad.csv")
    store = st.campaign(files, FILES, output=tmp_path / "out.zarr", workers=0)
    assert counts_of(store) == {"waiting": 0, "done": 2, "refused": 1, "failed": 0, "lost": 0}
    assert "no rows of numbers" in store.message.values[1]
    assert np.isnan(store.coefficient.values[1]).all()
    assert np.isfinite(store.coefficient.values[[0, 2]]).all()
    assert np.isfinite(store.outline.values).any(axis=(1, 2)).tolist() == [True, False, True]


def test_a_fault_of_the_package_ends_one_record_alone(tmp_path):
    def read(path):
        raise ZeroDivisionError(path)

    task = st.campaigns.Task("identify", LIBRARY, METHODS, read=read)
    store = st.campaign(["a.csv"], task, output=tmp_path / "out.zarr", workers=0)
    assert counts_of(store)["failed"] == 1
    assert store.message.values[0] == "ZeroDivisionError: a.csv"


def test_a_store_of_another_campaign_is_refused(tmp_path):
    st.campaign(RECORDS, TASK, output=tmp_path / "a.zarr", workers=0)
    others = [(RECORDS, st.campaigns.Task("identify", LIBRARY, {"direct": st.methods.Direct()}, read=drawn))]
    others.append((RECORDS, FILES))
    for records, task in others:
        with pytest.raises(UsageError, match="another campaign"):
            st.campaign(records, task, output=tmp_path / "a.zarr", workers=0)
    (tmp_path / "file.zarr").write_text("no store")
    with pytest.raises(RecordError, match="not the store of a campaign"):
        st.campaign(RECORDS, TASK, output=tmp_path / "file.zarr", workers=0)
    with pytest.raises(RecordError, match="not the store of a campaign"):
        st.campaigns.open_store(tmp_path)


def test_conditions_are_found_by_file_name_or_by_order(tmp_path):
    table = tmp_path / "runs.csv"
    table.write_text("record,load\nb.csv,2\na.csv,1\n")
    assert read_conditions(table, ["data/a.csv", "b.csv"]).load.tolist() == [1, 2]
    with pytest.raises(UsageError, match=r"no row for record 'c\.csv'"):
        read_conditions(table, ["c.csv"])
    table.write_text("load\n3\n4\n")
    assert read_conditions(table, ["x", "y"]).load.tolist() == [3, 4]
    with pytest.raises(UsageError, match="2 rows for 3 records"):
        read_conditions(table, ["x", "y", "z"])


def test_a_campaign_without_any_result_ends_with_one(tmp_path):
    (tmp_path / "a.csv").write_text("")
    write_csv(tmp_path / "b.csv", angle=linear(zeta=0.01))
    cases = (
        ("a", [], "the file is empty"),
        ("b", ["--methods", "direct", "--omega0", "89"], "'89': the record swings at 9.9 rad/s"),
    )
    for name, words, said in cases:
        words += ["--forces", "zeta", "--workers", "0", "-o", tmp_path / f"{name}.zarr"]
        done = run("campaign", tmp_path / f"{name}.csv", *words)
        assert done.status == 1
        assert "no record has a result" in done.err
        assert said in done.out
        assert (tmp_path / f"{name}.html").exists()


@pytest.mark.slow
def test_a_campaign_searches_as_discover_is_asked_to(tmp_path):
    drag = st.simulate(st.Model(LIBRARY_OF_ALL, {"zeta": 0.01, "delta": 0.2}, 9.9), TIME[:800], 0.3, 0.0)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(800)
    file = write_csv(tmp_path / "a.csv", TIME[:800], drag.angle.values + noise)
    (tmp_path / "drag.toml").write_text('[[force]]\nsymbol = "drag"\nformula = "v*abs(v)"\n')
    asked = ("campaign", file, "--task", "discover", "--candidates", tmp_path / "drag.toml", "--workers", "0")
    stores = [tmp_path / f"{at}.zarr" for at in range(3)]
    assert run(*asked, "-o", stores[0]).status == 0
    assert st.campaigns.open_store(stores[0]).named.item() == "drag"
    ending = run(*asked, "--max-effects", "0", "-o", stores[1])
    assert "Outcomes of the searches: 1 unknown effect." in ending.out
    assert st.campaigns.open_store(stores[1]).named.item() == ""
    ending = run(*asked, "--time-limit", "1e-6", "-o", stores[2])
    assert "; 1 ended before the search had converged." in ending.out


def test_a_folder_is_refused_before_a_store_is_made(tmp_path):
    (tmp_path / "data").mkdir()
    said = run("campaign", tmp_path / "data", "-o", tmp_path / "a.zarr")
    assert said.status == 2
    assert said.complaint.endswith("data: this is a folder; give its files: '" + f"{tmp_path}/data/*.csv'.")
    assert not (tmp_path / "a.zarr").exists()


@pytest.mark.slow
def test_workers_and_order_change_no_bit(tmp_path):
    alone = numbers(st.campaign(RECORDS, TASK, output=tmp_path / "a.zarr", workers=0))
    xr.testing.assert_identical(
        numbers(st.campaign(RECORDS, TASK, output=tmp_path / "b.zarr", workers=2)), alone
    )


@pytest.mark.slow
def test_records_in_another_unit_are_said_to_be_left_out():
    store = xr.Dataset(
        {
            "status": ("record", [Status.DONE] * 3),
            "signal_units": ("record", ["rad", "mm", "rad"]),
        }
    )
    (said,) = campaign.other_units(store)
    assert said == "1 record is in mm and left out of the mean, which is that of the records in rad."


@pytest.mark.slow
def test_the_command_ends_with_a_page(tmp_path):
    for at in range(3):
        noise = 1e-4 * np.random.default_rng(at).standard_normal(len(TIME))
        write_csv(tmp_path / f"run{at}.csv", angle=linear(zeta=0.01 + 0.001 * at) + noise)
    (tmp_path / "runs.csv").write_text("record,load\nrun0.csv,1\nrun1.csv,2\nrun2.csv,4\n")
    arguments = ["campaign", f"{tmp_path}/run?.csv", "--conditions", f"{tmp_path}/runs.csv"]
    (tmp_path / "out.html").write_text("of another result")
    done = run(*arguments, "--forces", "zeta,delta", "-o", f"{tmp_path}/out.zarr")
    assert done.status == 0, done.err
    assert "3 of 3 records done." in done.out
    page = (tmp_path / "out.html").read_text(encoding="utf-8")
    assert "Coefficients against conditions" in page
    assert "run2.csv" in page
    assert "of another result" not in page
    assert page.count('<svg class="thumbnail"') == 3
    # The same task with other output options continues the store.
    again = run(
        *arguments, "--forces", "zeta,delta", "-o", f"{tmp_path}/out.zarr", "--workers", "0", "--json"
    )
    assert again.status == 0, again.err


SCRIPT = """
import sys

sys.path[:0] = [sys.argv[1], f"{sys.argv[1]}/tests"]
import sysid_trib as st
from tests.test_campaign import MANY, TASK

if __name__ == "__main__":
    st.campaign(MANY, TASK, output=sys.argv[2], workers=2)
"""
MANY = [str(at) for at in range(30)]


@pytest.mark.slow
def test_a_killed_campaign_continues_with_the_same_store(tmp_path):
    whole = numbers(st.campaign(MANY, TASK, output=tmp_path / "whole.zarr", workers=0))
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, script, Path(__file__).parents[1], tmp_path / "part.zarr"], start_new_session=True
    )
    time.sleep(5.0)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    resumed = numbers(st.campaign(MANY, TASK, output=tmp_path / "part.zarr", workers=2))
    # Computed in other processes with another memory layout: sums may differ by rounding errors.
    xr.testing.assert_allclose(resumed, whole, rtol=1e-9, atol=0.0)
    assert not list((tmp_path / "part.zarr").rglob("*.partial"))
