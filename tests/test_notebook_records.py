"""The notebooks' measured records: from a folder, fetched and checked, or skipped with a reason."""

import hashlib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

pooch = pytest.importorskip("pooch")
FILE = Path(__file__).parents[1] / "notebooks" / "measured.py"
RUN = "string_pendulum/run_1.txt"


@pytest.fixture
def measured(monkeypatch, tmp_path):
    spec = spec_from_file_location("measured", FILE)
    module = module_from_spec(spec)
    monkeypatch.setitem(__import__("sys").modules, "measured", module)
    spec.loader.exec_module(module)
    monkeypatch.setenv("SYSID_TRIB_DATA", str(tmp_path / "records"))
    monkeypatch.delenv("SYSID_TRIB_FETCH", raising=False)
    monkeypatch.setattr(pooch, "os_cache", lambda project: tmp_path / "cache")
    return module


def put(folder, name):
    (folder / "records" / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / "records" / name).write_text("0 1\n", encoding="utf-8")


def test_records_are_found_in_the_folder(measured, tmp_path, capsys):
    for names in measured.RECORDS.values():
        put(tmp_path, names[0])
    assert {k: path.name for k, path in measured.files().items()} == {
        "pendulum": "free_swing.csv",
        "string": "run_1.txt",
        "ship": "model_test_21337.csv",
    }
    assert capsys.readouterr().out == ""


def test_what_is_missing_is_told_in_one_sentence_and_nothing_goes_online(
    measured, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(measured, "fetched", lambda name: pytest.fail("went online"))
    put(tmp_path, RUN)
    assert list(measured.files()) == ["string"]
    told = capsys.readouterr().out.splitlines()
    assert len(told) == 1
    assert "(pendulum, ship) were not found" in told[0]
    assert "SYSID_TRIB_FETCH=1" in told[0]


def test_fetched_files_are_checked(measured, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SYSID_TRIB_FETCH", "1")

    def answer(url, output_file, pooch, check_only=False):
        if "lab1" not in url:
            raise ConnectionError("no route")
        Path(output_file).write_text("0 1\n", encoding="utf-8")

    monkeypatch.setattr(pooch.core, "choose_downloader", lambda url, progressbar: answer)
    assert measured.files() == {}
    assert "it is not the file it was" in capsys.readouterr().out
    right = hashlib.sha256(b"0 1\n").hexdigest()
    source = measured.Source(
        *[getattr(measured.SOURCES[RUN], k) for k in ("repository", "commit", "path")], right
    )
    monkeypatch.setitem(measured.SOURCES, RUN, source)
    assert measured.files()["string"].read_text(encoding="utf-8") == "0 1\n"
    assert capsys.readouterr().out.count("there is no connection") == 2


def test_a_driven_record_is_found_or_its_absence_told(measured, tmp_path, capsys):
    assert measured.driven("silverbox") is None
    assert "SYSID_TRIB_DATA" in capsys.readouterr().out
    put(tmp_path, measured.DRIVEN["silverbox"])
    assert measured.driven("silverbox").name == "multisine_1_to_6.csv"
    assert capsys.readouterr().out == ""
