"""Datasets: every entry is complete and loads; whatever differs from the registry is refused."""

import hashlib
import json
import re
import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from urllib.error import URLError

import numpy as np
import pytest
from command_line import run

import sysid_trib as st
from sysid_trib.datasets import fetching, registry as listed
from sysid_trib.datasets.conversion import converted
from sysid_trib.errors import RecordError, UsageError

PUBLISHED = {name: record for name, record in listed.registry().items() if record.kind != "certified"}
FILES = {file.local: file for record in PUBLISHED.values() for file in record.files}


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """No folder of data, an empty cache, and no network."""
    pooch = pytest.importorskip("pooch")
    monkeypatch.delenv(fetching.FOLDER_VARIABLE, raising=False)
    monkeypatch.setattr(pooch, "os_cache", lambda project: tmp_path / "cache")

    def no_network(url, timeout):
        raise URLError(OSError(101, "Network is unreachable"))

    monkeypatch.setattr(fetching, "urlopen", no_network)
    return tmp_path


@pytest.fixture
def online(nowhere, monkeypatch):
    """Sources that answer with what is put into this dictionary, for every address."""
    answers = {}
    monkeypatch.setattr(fetching, "urlopen", lambda url, timeout: BytesIO(answers[Path(url).name]))
    return answers


@pytest.mark.parametrize("record", PUBLISHED.values(), ids=list(PUBLISHED))
def test_an_entry_is_complete(record):
    assert re.fullmatch(r"[a-z0-9_]+", record.name)
    assert record.kind in ("measured", "driven")
    for text in (record.title, record.licence, record.citation, record.known):
        assert text.strip()
    assert re.fullmatch(r"[0-9a-f]{40}", record.commit)
    assert re.fullmatch(r"[\w.-]+/[\w.-]+", record.repository)
    for file in record.files:
        assert re.fullmatch(r"[0-9a-f]{64}", file.sha256)
        assert 0 < file.bytes < fetching.LARGEST_DOWNLOAD
        assert not {"..", ""} & set(Path(file.local).parts)
        assert not Path(file.local).is_absolute()
        assert " " not in record.url(file)


@pytest.mark.parametrize("name", PUBLISHED)
def test_an_entry_loads(name, data_folder, monkeypatch):
    monkeypatch.setenv(fetching.FOLDER_VARIABLE, str(data_folder))
    if not all((data_folder / file.local).is_file() for file in PUBLISHED[name].files):
        pytest.skip(f"{name} is not in {data_folder}")
    record = st.datasets.load(name)
    assert record.sizes["time"] > 400
    assert record.attrs["source"] == f"dataset:{name}"
    for key in ("name", "licence", "citation", "source_url"):
        assert record.attrs[key] == getattr(PUBLISHED[name], key.removesuffix("_url"))
    # A driven record has its input.
    assert (len(record.data_vars) > 1) == (PUBLISHED[name].kind == "driven")
    assert sum(path.stat().st_size for path in st.datasets.files(name)) == st.datasets.table().bytes[name]


def test_the_parts_of_the_steel_pendulum_are_joined(data_folder, monkeypatch):
    monkeypatch.setenv(fetching.FOLDER_VARIABLE, str(data_folder))
    record = st.datasets.load("steel_pendulum")
    np.testing.assert_allclose(np.diff(record.time), 1e-3, rtol=1e-6)
    part = st.read_record("dataset:steel_pendulum", time="Time_id[1]", angle="Y_id[1][0]")
    joined = record.angle.sel(time=part.time, method="nearest")
    np.testing.assert_array_equal(part.angle, joined)


def test_options_of_the_user_win(data_folder, monkeypatch):
    monkeypatch.setenv(fetching.FOLDER_VARIABLE, str(data_folder))
    pitch = st.read_record("dataset:ship_roll", angle="theta")
    assert pitch.attrs["angle_column"] == "theta"
    scaled = st.read_record("dataset:steel_pendulum", time_units="ms")
    assert float(scaled.time[-1]) == pytest.approx(0.055)
    held = st.read_record("dataset:silverbox", input="V1", between="held")
    assert held.u.attrs != st.datasets.load("silverbox").u.attrs


def test_the_table_names_every_record():
    table = st.datasets.table()
    assert list(table.index) == st.datasets.names()
    assert table.index.name == "name"
    assert list(table) == ["title", "kind", "licence", "source", "citation", "bytes"]
    assert set(table.kind) <= {"measured", "driven", "certified"}


@pytest.mark.parametrize(
    "name", ["steel_pendulm", "../ship_roll", "/etc/passwd", "", "ship_roll/..", "a\x00b"]
)
def test_an_unknown_name_is_refused(name, nowhere):
    for use in (st.datasets.load, st.datasets.files, lambda n: st.read_record(f"dataset:{n}")):
        with pytest.raises(UsageError, match="There is no dataset"):
            use(name)


def test_a_similar_name_is_proposed():
    with pytest.raises(UsageError, match="Did you mean 'steel_pendulum'"):
        st.datasets.load("steel_pendulm")


def test_a_changed_file_is_refused(tmp_path, monkeypatch):
    file = PUBLISHED["string_pendulum"].files[0]
    (tmp_path / file.local).parent.mkdir()
    (tmp_path / file.local).write_text("0 1\n1 0\n", encoding="utf-8")
    monkeypatch.setenv(fetching.FOLDER_VARIABLE, str(tmp_path))
    with pytest.raises(RecordError, match="is not the published file"):
        st.datasets.files("string_pendulum")
    assert run("look", "dataset:string_pendulum").status == 1


def test_a_folder_that_does_not_exist_is_reported(tmp_path, monkeypatch):
    monkeypatch.setenv(fetching.FOLDER_VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(UsageError, match="is no folder"):
        st.datasets.files("ship_roll")


def test_without_network_one_sentence_says_so(nowhere):
    ending = run("look", "dataset:ship_roll", "--json")
    assert ending.status == 1
    assert ending.out == ""
    first, second = ending.err.splitlines()
    assert first.startswith("Downloading dataset ship_roll from https://raw.githubusercontent.com/")
    assert "cannot be downloaded (Network is unreachable)" in second
    assert fetching.FOLDER_VARIABLE in second


def test_without_pooch_the_package_is_named(nowhere, monkeypatch):
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(RecordError, match=r"pip install -e '\.\[datasets\]'"):
        st.datasets.files("ship_roll")


def entry_of(monkeypatch, name, content, **changed):
    """Let the registry expect this content in the first file of a record."""
    record = PUBLISHED[name]
    file = replace(record.files[0], sha256=hashlib.sha256(content).hexdigest(), **changed)
    monkeypatch.setitem(listed.registry(), name, replace(record, files=(file,)))


def test_a_download_is_checked_and_kept(online, monkeypatch, capsys):
    online["lab1_data.txt"] = b"0 1\n1 0\n"
    with pytest.raises(RecordError, match="is not the published one"):
        st.datasets.files("string_pendulum")
    entry_of(monkeypatch, "string_pendulum", online["lab1_data.txt"])
    (path,) = st.datasets.files("string_pendulum")
    assert path.read_bytes() == online.pop("lab1_data.txt")
    # It is not downloaded again.
    assert capsys.readouterr().err.count("Downloading dataset string_pendulum from https://") == 2
    assert st.datasets.files("string_pendulum") == [path]
    assert capsys.readouterr().err == ""


def test_a_damaged_file_in_the_cache_is_downloaded_again(online, monkeypatch):
    online["lab1_data.txt"] = b"0 1\n1 0\n"
    entry_of(monkeypatch, "string_pendulum", online["lab1_data.txt"])
    (path,) = st.datasets.files("string_pendulum")
    path.write_bytes(b"0 1\n")
    assert st.datasets.files("string_pendulum")[0].read_bytes() == online["lab1_data.txt"]


def test_a_huge_download_is_stopped(online, monkeypatch):
    monkeypatch.setattr(fetching, "LARGEST_DOWNLOAD", 7)
    online["lab1_data.txt"] = b"0 1\n1 0\n"
    with pytest.raises(RecordError, match="it is larger than"):
        st.datasets.files("string_pendulum")


def test_a_source_is_cut_and_gets_a_clock(online, monkeypatch, tmp_path):
    rows = [f"{k / 7},{k}" for k in range(100_000)]
    online["SNLS80mV.csv"] = "\n".join(["V1,V2", *rows]).encode()
    lines = [f"{k / 610.3515625:.9f},{row}\n" for k, row in enumerate(rows[40500:92620])]
    entry_of(monkeypatch, "silverbox", "".join(["time (s),V1 (V),V2 (V)\n", *lines]).encode())
    (path,) = st.datasets.files("silverbox")
    assert len(path.read_text(encoding="utf-8").splitlines()) == 52121
    assert list(path.parent.iterdir()) == [path]


def test_a_cell_array_becomes_a_table(tmp_path):
    from scipy.io import savemat

    cells = np.empty((3, 2), dtype=object)
    for row in range(3):
        cells[row, 0] = np.arange(4.0)[None, :] * 0.033
        cells[row, 1] = np.array([[-4.2818011, 1.0 / 3.0, 0.0, float(row)]])
    savemat(tmp_path / "xData.mat", {"xData": cells})
    text = converted(tmp_path / "xData.mat", PUBLISHED["sloshing_0p967"].files[0]).decode()
    assert text.splitlines() == [
        "time (s),x (% of tank width)",
        "0.000000,-4.281801",
        "0.033000,0.3333333",
        "0.066000,0",
        "0.099000,2",
    ]


@pytest.mark.parametrize("name", ["silverbox", "sloshing_0p953"])
def test_a_source_of_another_form_is_refused(name, online, nowhere):
    online[Path(PUBLISHED[name].files[0].path).name] = b"<!doctype html>\n"
    with pytest.raises(RecordError, match="does not have the expected form"):
        st.datasets.files(name)
    assert not [path for path in (nowhere / "cache").rglob("*") if path.is_file()]


def test_the_text_of_a_source_is_kept(data_folder, tmp_path):
    """The converted file, taken apart and converted again, is the same to the last byte."""
    file = PUBLISHED["bouc_wen"].files[0]
    columns = (line.split(",") for line in (data_folder / file.local).read_text("utf-8").splitlines()[1:])
    source = tmp_path / "train_data.csv"
    source.write_text("y,u\n" + "".join(f"{y},{u}\n" for _, u, y in columns), encoding="utf-8")
    assert hashlib.sha256(converted(source, file)).hexdigest() == file.sha256


def test_the_command_lists_all(nowhere):
    ending = run("datasets")
    assert ending.status == 0
    assert all(f"dataset:{name}" in ending.out for name in st.datasets.names())
    data = json.loads(run("datasets", "--json").out)
    assert [row["name"] for row in data["datasets"]] == st.datasets.names()
    assert all(row["citation"] and row["known"] for row in data["datasets"])


def test_look_reads_a_dataset_and_its_input(data_folder, monkeypatch):
    monkeypatch.setenv(fetching.FOLDER_VARIABLE, str(data_folder))
    free = run("look", "dataset:ship_roll")
    assert free.status == 0
    assert "from column phi" in free.out
    assert "sysid-trib identify dataset:ship_roll" in free.out
    driven = run("look", "dataset:friction_frame_250g", "--json")
    assert driven.status == 0
    assert "--input" in json.loads(driven.out)["next"]


def test_datasets_with_other_inputs_are_not_mixed(data_folder, monkeypatch):
    monkeypatch.setenv(fetching.FOLDER_VARIABLE, str(data_folder))
    ending = run("identify", "dataset:silverbox", "dataset:friction_frame_250g")
    assert ending.status == 2
    assert "have different inputs" in ending.complaint


def test_an_unknown_dataset_ends_with_2():
    ending = run("look", "dataset:steel_pendulm")
    assert ending.status == 2
    assert "Did you mean" in ending.complaint
