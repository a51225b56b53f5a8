"""The app without a browser: its work, its process, and what it may import."""

import ast
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import linear, run, write_table

import sysid_trib as st
from sysid_trib.app import tasks
from sysid_trib.app.messages import TITLES, Failure, Progress, Request, Section, Signal
from sysid_trib.app.worker import STOPPED, Worker

PATIENCE = 120.0
APP = Path(tasks.__file__).parent
TIME = np.arange(0.0, 8.0, 0.02)


@pytest.fixture
def swing(tmp_path):
    noise = 1e-4 * np.random.default_rng(0).standard_normal(TIME.size)
    return write_table(tmp_path / "swing.csv", "time (s),angle (rad)", TIME, linear(TIME) + noise)


@pytest.fixture
def worker():
    made = Worker()
    yield made
    made.stop()


def done(request):
    """All messages on a request, without a process."""
    return list(tasks.messages_of(request, lambda *_: None))


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def messages(worker):
    found = []
    until(lambda: found.extend(worker.messages()) or not worker.busy)
    return found


def test_the_app_imports_only_public_names():
    for path in APP.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0
                own = node.module.partition(".")[0] == "sysid_trib"
                assert not own or node.module.startswith("sysid_trib.app"), path
            elif isinstance(node, ast.Import):
                for name in node.names:
                    assert name.name.partition(".")[0] != "sysid_trib" or name.asname == "st", path
            elif isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "st":
                assert node.attr in dir(st), path


def test_the_app_offers_every_option_value_that_readers_take():
    from sysid_trib.app.controls import SIGNAL_CHOICES, TIME_CHOICES

    for quantity in SIGNAL_CHOICES[1:]:
        st.records.Reading(signal=quantity)
    for unit in TIME_CHOICES[1:]:
        st.records.Reading(time_units=unit)


@pytest.mark.parametrize("suggest", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_numbers_are_those_of_the_command(swing, tmp_path, monkeypatch, suggest):
    request = Request(tmp_path, str(swing), "swing.csv", window=(0.5, 7.0), laws=False, suggest=suggest)
    parts = {message.name: message for message in done(request) if isinstance(message, Section)}
    ours = pd.read_csv(tmp_path / "coefficients.csv").set_index(["model", "quantity"])
    monkeypatch.chdir(tmp_path)
    program, *arguments = parts["identify"].command.split()
    assert program == "sysid-trib"
    assert run(*arguments, "-o", "result.nc").status == 0
    theirs = st.summary(st.load(tmp_path / "result.nc"))
    pd.testing.assert_frame_equal(ours, theirs, check_exact=False, rtol=1e-12)
    assert parts["identify"].command in (tmp_path / "identify.html").read_text(encoding="utf-8")
    assert run(*parts["backbone"].command.split()[1:]).status == 0


@pytest.mark.slow
def test_laws_are_those_of_the_command(swing, tmp_path, monkeypatch):
    (part,) = (
        m for m in done(Request(tmp_path, str(swing), "swing.csv")) if getattr(m, "name", "") == "laws"
    )
    monkeypatch.chdir(tmp_path)
    assert run(*part.command.split()[1:], "-o", "result.nc").status == 0
    friction = st.best(st.load(tmp_path / "result.nc")).friction
    ours = pd.read_csv(tmp_path / "friction.csv")
    np.testing.assert_allclose(ours["friction (rad/s^2)"], friction.values, rtol=1e-12)
    np.testing.assert_allclose(ours["speed (rad/s)"], friction.speed.values, rtol=1e-12)


@pytest.mark.parametrize(
    ("request_", "command"),
    [
        (Request(Path()), "sysid-trib identify"),
        (Request(Path(), shown="my run.csv"), "sysid-trib identify 'my run.csv'"),
        (Request(Path(), shown="-o.csv"), "sysid-trib identify ./-o.csv"),
        (Request(Path(), shown="a$(b).csv"), "sysid-trib identify 'a$(b).csv'"),
        (
            Request(Path(), shown="a.csv", window=(None, 60.5), system="pendulum", forces=("zeta", "nu")),
            "sysid-trib identify a.csv --window :60.5 --system pendulum --forces zeta,nu",
        ),
        (
            Request(Path(), shown="a.csv", reading={"angle": "-y", "sampling_rate": 100.0}),
            "sysid-trib identify a.csv --angle=-y --sampling-rate 100",
        ),
    ],
)
def test_command_reproduces_the_request(request_, command):
    assert request_.command("identify") == command


def test_a_signal_keeps_every_extremum_and_its_ends(tmp_path):
    time = np.arange(0.0, 60.0, 0.001)
    file = write_table(tmp_path / "long.csv", "time (s),angle (rad)", time, linear(time))
    signal = next(tasks.messages_of(Request(tmp_path, str(file)), print))
    read = st.read_record(file).angle
    assert signal.time.size == signal.value.size <= 3000
    assert (signal.value.max(), signal.value.min()) == (read.max(), read.min())
    assert np.all(np.diff(signal.time) > 0.0)
    assert signal.ends == (time[0], pytest.approx(time[-1]))


def test_the_suggestion_is_that_of_look(tmp_path):
    """A short record does not determine all forces to which it points."""
    short = TIME[TIME < 2.2]
    file = write_table(tmp_path / "short.csv", "time (s),angle (rad)", short, linear(short))
    signal = next(tasks.messages_of(Request(tmp_path, str(file), suggest=True), print))
    suggested = replace(Request(tmp_path, str(file), str(file)), system=signal.system, forces=signal.forces)
    assert f"Next: {suggested.command('identify')}" in run("look", file).out


def test_a_bad_file_is_one_sentence(tmp_path):
    (tmp_path / "bad.csv").write_text("a,b\n<b>x</b>,y\n", encoding="utf-8")
    (failure,) = done(Request(tmp_path, str(tmp_path / "bad.csv"), "bad.csv"))
    assert isinstance(failure, Failure)
    assert failure.text.startswith("bad.csv: ")
    assert "\n" not in failure.text


def test_columns_to_choose_from_are_offered(tmp_path):
    two = linear(TIME), linear(TIME, omega=7.0)
    file = write_table(tmp_path / "two.csv", "t,first,second", TIME, *two)
    (failure,) = done(Request(tmp_path, str(file), "two.csv"))
    assert set(failure.choices) == {"first", "second"}
    first = next(
        tasks.messages_of(Request(tmp_path, str(file), "two.csv", reading={"angle": "first"}), print)
    )
    assert isinstance(first, Signal)


def test_names_of_columns_are_text(tmp_path):
    file = write_table(tmp_path / "x.csv", "t,<img src=x onerror=alert(1)> (rad)", TIME, linear(TIME))
    found = tasks.messages_of(Request(tmp_path, str(file), "<script>.csv"), lambda *_: None)
    for shown in (next(found), next(found)):
        assert "<img src=x" not in shown.text
        assert "<script" not in shown.text
        assert "&lt;img src=x" in shown.text or isinstance(shown, Section)


def test_the_example_needs_no_file(tmp_path):
    found = tasks.messages_of(Request(tmp_path), lambda *_: None)
    assert isinstance(next(found), Signal)
    assert next(found).command == "sysid-trib backbone"


@pytest.mark.slow
def test_a_sample_record_is_read_by_its_name(tmp_path):
    name = "dataset:certified/viscous_1e-4"
    found = done(Request(tmp_path, name, name, laws=False, suggest=True))
    signal, _, coefficients = found
    assert name in signal.text
    assert coefficients.command == f"sysid-trib identify {name}"
    table = pd.read_csv(tmp_path / "coefficients.csv").set_index(["model", "quantity"])
    truth = st.datasets.truth("certified/viscous_1e-4").value[0].item()
    zeta = table.loc["direct", "zeta"]
    assert abs(zeta["value"] - truth) < 4.0 * zeta["standard_error"]


def test_a_sample_that_cannot_be_downloaded_is_one_sentence(tmp_path, monkeypatch):
    def refused(*_, **__):
        raise OSError("no route")

    monkeypatch.delenv("SYSID_TRIB_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("sysid_trib.datasets.fetching.urlopen", refused)
    (failure,) = done(Request(tmp_path, "dataset:ship_roll", "dataset:ship_roll"))
    assert "cannot be downloaded (no route)" in failure.text
    assert "\n" not in failure.text


def test_samples_are_the_free_decays_of_the_registry():
    pytest.importorskip("panel")
    from sysid_trib.app.page import EXAMPLE, sample_names

    names = sample_names()
    assert names[0] == EXAMPLE
    assert {"ship_roll", "certified/dry_1e-3"} <= set(names)
    assert "silverbox" not in names


def test_stopping_ends_the_process_at_once_and_a_new_request_supersedes(worker, swing, tmp_path):
    missing = Request(tmp_path, str(tmp_path / "none.csv"), "none.csv")
    worker.start(missing)
    (failure,) = messages(worker)
    assert "none.csv" in failure.text
    worker.start(Request(tmp_path, str(swing), "swing.csv"))
    found = []
    until(lambda: found.extend(worker.messages()) or any(isinstance(m, Section) for m in found))
    assert Progress(TITLES["backbone"]) in found
    process, began = worker._process, time.monotonic()
    worker.start(missing)
    assert not process.is_alive()
    assert time.monotonic() - began < 2.0
    assert messages(worker) == [failure]
    worker.start(Request(tmp_path, str(swing), "swing.csv"))
    worker.stop()
    assert not worker.busy
    assert list(worker.messages()) == []


def test_a_killed_process_is_one_sentence(worker, swing, tmp_path):
    worker.start(Request(tmp_path, str(swing), "swing.csv"))
    until(lambda: list(worker.messages()))
    os.kill(worker._process.pid, signal.SIGKILL)
    assert messages(worker)[-1] == Failure(STOPPED)


def test_short_memory_and_internal_errors_are_one_sentence(monkeypatch, tmp_path):
    def fails(error):
        monkeypatch.setattr(tasks, "_signal", lambda _: (_ for _ in ()).throw(error))
        (failure,) = done(Request(tmp_path))
        return failure.text

    assert fails(MemoryError()) == tasks.NO_MEMORY
    assert "please report it" in fails(KeyError("x"))


def test_without_panel_the_remedy_is_said(monkeypatch):
    monkeypatch.setattr("sysid_trib.app.server.find_spec", lambda _: None)
    ended = run("app")
    assert ended.status == 1
    assert "pip install -e '.[app]'" in ended.complaint


def test_a_missing_file_is_said_before_the_page_opens(tmp_path):
    ended = run("app", tmp_path / "none.csv")
    assert ended.status == 2
    assert "there is no such file" in ended.complaint


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("../../etc/passwd", "passwd"),
        ("C:\\data\\run 1.csv", "run 1.csv"),
        ("<img onerror=x>.csv", "_img onerror_x_.csv"),
        ("..", "record"),
        ("", "record"),
        ("a\0b\n.txt", "a_b_.txt"),
        ("Messung größer.csv", "Messung größer.csv"),
        ("x" * 500 + ".csv", "x" * 96 + ".csv"),
    ],
)
def test_names_of_files_are_safe(name, safe):
    pytest.importorskip("panel")
    from sysid_trib.app.page import safe_name

    assert safe_name(name) == safe


@pytest.mark.skipif(os.name == "nt", reason="sends a signal")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_server_takes_a_free_port_and_ends_cleanly(tmp_path, number):
    pytest.importorskip("panel")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "sysid_trib", "app", "--no-browser", "--port", str(port)]
        server = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"TMPDIR": str(tmp_path)},
        )
        said = server.stdout.readline()
        assert said.startswith("The app runs at http://127.0.0.1:")
        assert f":{port}/" not in said
        server.send_signal(number)
        assert server.communicate(timeout=PATIENCE) == ("", "")
    assert server.returncode == 0
    assert list(tmp_path.iterdir()) == []
