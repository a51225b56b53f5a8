"""Whatever is given to the command line, Ctrl-C too: a status, one clear line, nothing left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import command_line
import pytest
import xarray as xr
from command_line import TIME, linear, run, write_csv

from sysid_trib.commands import record_inputs


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder with one good record, from which every command of a test is run."""
    write_csv(tmp_path / "good.csv")
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


# Content of the file (text, bytes, or a signal), and what is said of it.
RECORDS = {
    "binary": (bytes(range(256)) * 8, "binary content"),
    "escape sequence": ("time,angle\n0,1\n0.1,\x1b[31m\n0.2,1\n", "row 2 of column angle holds"),
    "flat": ((TIME, 0.1 + 0.0 * TIME), "flat at 0.1"),
    "growing": ((TIME, linear(zeta=-0.005, amplitude=0.01)), "grows by 3"),
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
SIMULATE = ("simulate", "-o", "x.csv")
# Arguments after `sysid-trib`, exit status, and a part of what is said.
COMMANDS = [
    (["frobnicate"], 2, "No such command 'frobnicate'"),
    (["identfy"], 2, "Did you mean 'identify'? See"),
    ([], 2, "Missing command"),
    (["identify", "--frob"], 2, "No such option: --frob"),
    (["identify", "missing.csv"], 2, "missing.csv: there is no such file"),
    (["identify", "."], 1, "is a directory"),
    (["identify", "/dev/zero"], 1, "a pipe or a device"),
    ([*GOOD, "missing.csv"], 2, "missing.csv: there is no such file"),
    ([*GOOD, "--window", "a:b"], 2, "--window: 'a' is not a finite number"),
    ([*GOOD, "--window", "9:3"], 2, "start must come before its end"),
    ([*GOOD, "--window", "50:"], 1, "the record runs from 0 s to 19.99 s"),
    ([*GOOD, "--omega0", "-5"], 2, "--omega0 '-5' must be"),
    ([*GOOD, "--omega0", "9±-1"], 2, "the error must be positive"),
    ([*GOOD, "--omega0", "9±1±2"], 2, "must be VALUE or VALUE±ERROR"),
    ([*GOOD, "--omega0", "9", "--reference-frequency", "9"], 2, "choose one"),
    ([*GOOD, "--reference-frequency", "nan"], 2, "--reference-frequency 'nan' must be"),
    ([*GOOD, "--reference-frequency", "1e6"], 2, "swings at 9.9 rad/s, less than a fifth of that"),
    ([*GOOD, "--reference-frequency", "1.57"], 2, "which is 1.576 Hz; give it in rad/s"),
    (
        [*GOOD, "--omega0", "89"],
        2,
        "--omega0 '89': the record swings at 9.9 rad/s, less than a fifth of that",
    ),
    (["discover", "good.csv", "--reference-frequency", "89"], 2, "correct it, or leave it out: w is"),
    ([*GOOD, "--sampling-rate", "nan"], 2, "sampling rate nan"),
    ([*GOOD, "--time", "0", "--sampling-rate", "100"], 2, "not both"),
    ([*GOOD, "--equilibrium", "foo"], 2, "--equilibrium: 'foo'"),
    ([*GOOD, "--equilibrium", "5"], 1, "an equilibrium of 5 is outside of the record"),
    ([*GOOD, "--units", "furlong"], 2, "says rad, but --units says furlong"),
    (
        [*GOOD, "--units", "furlong"],
        2,
        "none of those that are known (rad, deg, mrad, m, mm, px",
    ),
    ([*GOOD, "--decay", "2"], 2, "holds 1 decay; give 1 to 1"),
    ([*GOOD, "--length", "-1"], 2, "give the pendulum's length in m"),
    ([*GOOD, "--sampling-rate", "50"], 2, "say 100 Hz, but --sampling-rate says 50 Hz"),
    ([*GOOD, "--time-units", "fortnight"], 2, "'fortnight' are unknown: give s, ms, us, ns, min, h or d"),
    ([*GOOD, "--signal", "foo"], 2, "signal 'foo' is unknown"),
    ([*GOOD, "--time", "7"], 2, "no single column '7'; its columns are 0: time (s), 1: angle (rad)"),
    ([*GOOD, "--forces", "foo"], 2, "no force 'foo'; it has lambda, zeta"),
    ([*GOOD, "--forces", ""], 2, "names no force"),
    ([*GOOD, "--forces", "alpha"], 2, "cannot be separated from the frequency: give --omega0"),
    ([*GOOD, "--library", "foo"], 2, "There is no library 'foo'"),
    ([*GOOD, "--library", "good.csv"], 1, "good.csv: not a readable TOML file"),
    (["forces", "missing.toml"], 2, "There is no library 'missing.toml'"),
    (["identify", "--units", "deg"], 2, "--units is for a RECORD"),
    ([*GOOD, "-o", "missing/x.nc"], 1, "missing/x.nc: cannot be written, its folder does not exist"),
    ([*GOOD, "-o", "good.csv"], 2, "the ending must be .nc"),
    ([*GOOD, "--plot", "good.csv"], 1, "good.csv is a file"),
    (["identify", "good.csv", "--angle", "0"], 1, "but time (s), which --angle takes"),
    (["simulate"], 2, "Missing option '-o'"),
    (["simulate", "-o", "x.txt"], 2, "the ending must be .csv or .nc"),
    ([*SIMULATE, "--duration", "1e8"], 2, "change --duration or --sampling-rate"),
    ([*SIMULATE, "--sampling-rate", "-100"], 2, "--sampling-rate '-100' must be"),
    ([*SIMULATE, "--reference-frequency", "1e6"], 2, "more than 1,000,000 periods"),
    ([*SIMULATE, "--angle0", "nan"], 2, "--angle0 'nan' must be a number from -1000 to 1000 rad."),
    ([*SIMULATE, "--rate0", "inf"], 2, "--rate0 'inf' must be a number from -1e+09 to 1e+09 rad/s."),
    ([*SIMULATE, "--noise", "1e308"], 2, "--noise '1e+308' must be a number from 0 to 1000 rad."),
    ([*SIMULATE, "--random-force", "-1"], 2, "--random-force '-1' must be a number from 0 to 1e+09"),
    ([*SIMULATE, "--set", "zeta=1e-3", "--random-force", "1e9"], 1, "a strong random force"),
    ([*SIMULATE, "--seed", "-1"], 2, "--seed '-1' must be a whole number, 0 or more."),
    ([*SIMULATE, "--set", "lambda"], 2, "must be SYMBOL=VALUE"),
    ([*SIMULATE, "--set", "lambda=x"], 2, "--set lambda: 'x' is not a finite number"),
    ([*SIMULATE, "--set", "epsilon=1e300"], 2, "larger than 1e+09"),
    ([*SIMULATE, "--set", "foo=1"], 2, "no force 'foo'"),
    ([*SIMULATE, "--set", "zeta=1,zeta.s=1"], 2, "no shape parameter 's'"),
    ([*SIMULATE, "--set", "zeta=-3"], 1, "The motion diverges"),
]


@pytest.mark.parametrize(("arguments", "status", "reason"), COMMANDS, ids=lambda a: None)
def test_command(refused, arguments, status, reason):
    found, complaint = refused(*arguments)
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
    "__import__('os').system('touch X')": "holds something other than",
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
        "sysid-trib: own.toml, force 'z': 'name' holds control characters; leave them out.",
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
    assert "x.csv: cannot be written (No space left on device)" in refused(*SIMULATE)[1]


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

    monkeypatch.setattr(record_inputs, "read_decays", fail)
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


def test_what_a_method_refuses_names_the_file(folder):
    paths = [write_csv(folder / f"{at}.csv", angle=linear(zeta=0.01 + 0.01 * at)) for at in range(2)]
    said = run("identify", paths[0], "--window", "0:1.9").complaint
    assert said.startswith("sysid-trib: 0.csv: 3 amplitudes cannot decide 5 forces")
    write_library(folder / "own.toml", z="2*v", g="v")
    said = run("identify", *paths, "--library", folder / "own.toml").complaint
    assert said.startswith("sysid-trib: 0.csv and 1 more: ")


def test_one_sample_is_no_plural():
    assert (
        "only 1 sample in the window 3:3.001" in run("identify", "good.csv", "--window", "3:3.001").complaint
    )


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
