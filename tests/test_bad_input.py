"""Whatever is given to the command line, Ctrl-C too: a status, one clear line, nothing left behind."""

import os
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import command_line
import numpy as np
import pytest
import xarray as xr
from command_line import TIME, linear, run, write_csv, write_table

from sysid_trib.commands import fits


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder with a decay and a driven record, from which every command of a test is run."""
    write_csv(tmp_path / "good.csv")
    columns = [TIME[:601], np.sin(3.0 * TIME[:601]), linear(TIME[:601]), np.ones(601)]
    write_table(tmp_path / "driven.csv", "time (s),drive (V),angle (rad),still (V)", *columns)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(folder):
    def command(*arguments) -> tuple[int, str]:
        before = sorted(p for p in folder.rglob("*"))
        ending = run(*arguments)
        assert sorted(p for p in folder.rglob("*")) == before, "something was written"
        assert len(ending.complaint) < 420
        return ending.status, ending.complaint

    return command


# Content of the file (text, bytes, or a signal), and the message about it.
RECORDS = {
    "binary": (bytes(range(256)) * 8, "binary content"),
    "escape sequence": ("time,angle\n0,1\n0.1,\x1b[31m\n0.2,1\n", "row 2 of column angle contains"),
    "huge": ((TIME, linear(amplitude=1e300)), "too much for an oscillation"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_record(refused, folder, name):
    content, reason = RECORDS[name]
    if isinstance(content, tuple):
        write_csv(folder / "bad.csv", *content)
    else:
        (folder / "bad.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    status, complaint = refused("identify", "bad.csv", "-o", "result.nc", "--json")
    assert status == 1
    assert reason in complaint
    assert "bad.csv" in complaint
    assert "\x1b" not in complaint


GOOD = ("identify", "good.csv")
# For each command, invalid arguments, the exit status, and a part of the message.
REFUSALS = tomllib.loads(Path(__file__).with_name("refusals.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("command", "arguments", "status", "reason"),
    [(command, *row) for command, rows in REFUSALS.items() for row in rows],
)
def test_command(refused, command, arguments, status, reason):
    found, complaint = refused(*filter(None, [command]), *shlex.split(arguments))
    assert reason in complaint
    assert found == status


@pytest.mark.parametrize("symbol", ["stribeck", "bouc_wen_g", "history_drag"])
def test_forces_that_come_along_are_simulated_by_their_names(symbol, tmp_path):
    path = tmp_path / "swing.csv"
    assert (
        run("simulate", "-o", path, "--duration", "5", "--set", "zeta=0.01", "--set", f"{symbol}=1e-3").status
        == 0
    )


LIBRARIES = {
    "__import__('os').system('touch X')": "contains something other than",
    "-v^2": "(write ** for a power, sign for sgn)",
    "exp(800*x)": "is not a finite number",
    "v": "z and g are the same force",
}


def write_library(path: Path, **formulas: str) -> None:
    path.write_text("".join(f'[[force]]\nsymbol = "{s}"\nformula = "{f}"\n' for s, f in formulas.items()))


@pytest.mark.parametrize("formula", LIBRARIES)
def test_library(refused, folder, formula):
    write_library(folder / "own.toml", z="2*v", g=formula)
    status, complaint = refused(*GOOD, "--library", "own.toml", "-o", "result.nc")
    assert LIBRARIES[formula] in complaint
    assert status == 1


def test_stiffness_alone(refused, folder):
    write_library(folder / "own.toml", k="x")
    status, complaint = refused(*GOOD, "--library", "own.toml")
    assert (status, "Force 'k' cannot be separated from the frequency" in complaint) == (2, True)


def test_control_characters_of_a_library(refused, folder):
    (folder / "own.toml").write_text('[[force]]\nsymbol = "z"\nformula = "v"\nname = "\\u001b[31m"\n')
    assert refused("forces", "own.toml") == (
        1,
        r"sysid-trib: own.toml, force 'z': name must be a text in quotes, without control characters, "
        r"not '\x1b[31m'.",
    )


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_read_only_folder(refused, folder):
    (folder / "locked").mkdir(mode=0o500)
    assert refused("simulate", "-o", "locked/x.csv")[0] == 1
    assert refused(*GOOD, "--plot", "locked")[0] == 1


def test_result_does_not_replace_the_record(refused, folder):
    xr.Dataset({"angle": ("time", linear())}, {"time": TIME}).to_netcdf("run.nc", engine="h5netcdf")
    assert refused("identify", "run.nc", "-o", "../" + folder.name + "/run.nc")[0] == 1


def test_disk_that_fills_up_leaves_no_half_file(refused, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert "x.csv: cannot be written (No space left on device)" in refused("simulate", "-o", "x.csv")[1]


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 1, "Out of memory"),
        (KeyError("a\nb"), 1, "Internal error (KeyError in test_bad_input.py"),
    ],
)
def test_interrupt_and_faults(refused, monkeypatch, error, status, said):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(fits, "read_decays", fail)
    found, complaint = refused(*GOOD)
    assert (found, said in complaint) == (status, True)


@pytest.mark.slow
def test_a_true_process():
    command = [sys.executable, "-m", "sysid_trib", "identify", "missing.csv"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)


def test_refusals_come_before_the_work(refused):
    begin = time.process_time()
    refused(*GOOD, "-o", "missing/x.nc")
    assert time.process_time() - begin < 1.0


def test_errors_of_methods_name_the_file(folder):
    paths = [write_csv(folder / f"{at}.csv", angle=linear(zeta=0.01 + 0.01 * at)) for at in range(2)]
    said = run("identify", paths[0], "--window", "0:1.9").complaint
    assert said.startswith("sysid-trib: 0.csv: 3 amplitudes cannot determine 5 forces")
    write_library(folder / "own.toml", z="2*v", g="v")
    said = run("identify", *paths, "--library", folder / "own.toml").complaint
    assert said.startswith("sysid-trib: 0.csv and 1 more: ")


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


def test_an_interrupt_that_a_library_turns_into_another_error_is_one(tmp_path, monkeypatch):
    def fail(*_, **__):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise AttributeError("module 'sympy' has no attribute 'core'") from None

    monkeypatch.setattr(fits, "read_decays", fail)
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
    """Python would end the process by the signal, as it does with `python -m`."""
    (tmp_path / "program.py").write_text(
        "from sysid_trib import cli\n"
        "cli._outcome = lambda: exec('raise KeyboardInterrupt')\n"
        "import sysid_trib.errors\n"
        "cli.main()\n"
    )
    words = [sys.executable, "-m", "program"]
    ended = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "sysid-trib: interrupted.\n")
