"""Ctrl-C at any moment ends a command with one word, and leaves nothing that a later file could meet."""

import os
import signal
import subprocess
import sys

import command_line
import h5py
import numpy as np
import pytest

import sysid_trib as st
from sysid_trib.commands import record_inputs
from sysid_trib.errors import RecordError
from sysid_trib.records import probe

# One module asked for ends in an interrupt, as if it came while it is imported.
INTERRUPTED_IMPORT = """
import importlib.abc, sys
class Interrupt(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "MODULE":
            sys.meta_path.remove(self)
            raise KeyboardInterrupt
from sysid_trib.cli import main
sys.meta_path.insert(0, Interrupt())
main()
"""


@pytest.mark.slow
def test_an_answer_is_that_to_its_own_question(tmp_path, monkeypatch):
    time = np.arange(600) * 0.02
    with h5py.File(tmp_path / "good.h5", "w") as file:
        file["time"], file["angle"] = time, 0.3 * np.cos(9.9 * time) * np.exp(-0.1 * time)
    with h5py.File(tmp_path / "linked.h5", "w") as file:
        file["time"] = np.arange(500.0)
        file.create_dataset("angle", (500,), "u1", external=[("/etc/passwd", 0, 500)])

    def interrupted(process, question):
        process._process.stdin.write(question.encode() + b"\n")
        process._process.stdin.flush()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(probe._ReadingProcess, "_line_for", interrupted)
        with pytest.raises(KeyboardInterrupt):
            st.read_record(tmp_path / "good.h5")
    for _ in range(2):
        with pytest.raises(RecordError, match="in another file"):
            st.read_record(tmp_path / "linked.h5")
        assert st.read_record(tmp_path / "good.h5").angle.size == 600


def test_an_interrupt_that_a_library_turns_into_another_error_is_one(tmp_path, monkeypatch):
    def fail(*_, **__):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise AttributeError("module 'sympy' has no attribute 'core'") from None

    monkeypatch.setattr(record_inputs, "read_decays", fail)
    place, before = command_line.write_csv(tmp_path / "a.csv"), signal.getsignal(signal.SIGINT)
    ended = command_line.run("identify", place)
    assert (ended.status, ended.complaint) == (130, "sysid-trib: interrupted.")
    # In the background of a shell it was to be ignored.
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("module", ["typer", "rich.console"])
def test_an_interrupt_while_a_module_is_imported(module):
    script = INTERRUPTED_IMPORT.replace("MODULE", module)
    ended = subprocess.run([sys.executable, "-c", script, "forces"], capture_output=True, text=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "sysid-trib: interrupted.\n")


def test_an_interrupt_within_a_text_that_is_executed(tmp_path):
    """Python would end the process by the signal, as what `python -m` runs."""
    (tmp_path / "program.py").write_text(
        "from sysid_trib import cli\n"
        "cli._outcome = lambda: exec('raise KeyboardInterrupt')\n"
        "import sysid_trib.errors\n"
        "cli.main()\n"
    )
    words = [sys.executable, "-m", "program"]
    ended = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "sysid-trib: interrupted.\n")


@pytest.mark.slow
def test_what_is_compiled_logs_nothing_where_there_is_no_home(tmp_path):
    command = [sys.executable, "-m", "sysid_trib", "simulate", "-o", "a.csv", "--duration", "5"]
    environment = {
        name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")
    }
    ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (ended.stdout, ended.stderr) == ("a.csv: 500 simulated samples.\n", "")
