"""A shell completes commands, options and the names of what the program knows."""

import os
import shutil
import subprocess
import sys

import pytest
from command_line import run

import sysid_trib as st
from sysid_trib.forces.library import known_libraries
from sysid_trib.forces.systems import load_systems

# The program with its name, whatever the folder of the environment.
PROGRAM = "import sys; sys.argv[0] = 'sysid-trib'; from sysid_trib.cli import main; main()"
OWN = """
[[force]]
symbol = "felt"
formula = "v"
"""


@pytest.fixture
def completed(monkeypatch):
    """Function that returns what bash would offer for the last word of a command line."""

    def offered(*words):
        monkeypatch.setenv("_SYSID_TRIB_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", " ".join(["sysid-trib", *words]))
        monkeypatch.setenv("COMP_CWORD", str(len(words)))
        ending = run()
        assert (ending.status, ending.err) == (0, "")
        return ending.out.split()

    return offered


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["iden"], ["identify"]),
        (["identify", "--res"], []),
        (["identify", "--sens"], ["--sensitivity"]),
        (["identify", "--system", "t"], ["torsion", "tribometer"]),
        (["forces", "contact"], ["contact_forces"]),
        (["discover", "--candidates", "cand"], ["candidate_effects"]),
        (["identify", "--forces", "del"], ["delta"]),
        (["identify", "--forces", "zeta,ze"], []),
        (["identify", "--forces", "lambda,ze"], ["lambda,zeta"]),
        (["identify", "--library", "no_such", "--forces", "ze"], []),
        (["laws", "--own", "fr"], ["friction"]),
        (["campaign", "--methods", "direct,tr"], ["direct,trajectory"]),
        (["campaign", "--task", ""], ["identify", "compare", "discover", "laws"]),
        (["export", "result.nc", "--as", "sy"], ["sympy"]),
        # The shell completes names of files itself.
        (["identify", "swi"], []),
        (["simulate", "-o", ""], []),
    ],
    ids=lambda value: " ".join(value) or "nothing",
)
def test_values_of_options(words, offered, completed):
    assert completed(*words) == offered


def test_all_libraries_and_systems_are_offered(completed):
    assert completed("identify", "--library", "") == known_libraries()
    assert completed("identify", "--system", "") == [*load_systems()]


def test_forces_are_those_of_the_given_library(completed, tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(OWN, encoding="utf-8")
    assert completed("identify", "--library", str(own), "--forces", "") == ["felt"]
    assert completed("identify", "--forces", "") == list(st.load_library().symbols)


@pytest.mark.skipif(sys.platform == "win32" or shutil.which("bash") is None, reason="needs bash")
def test_installed_completion_works_in_bash(tmp_path):
    program = tmp_path / "sysid-trib"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{PROGRAM}" "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    environment = os.environ | {"HOME": str(tmp_path), "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    script = """
sysid-trib --install-completion
source ~/.bashrc
complete -p sysid-trib
COMP_WORDS=(sysid-trib identify --system pend) COMP_CWORD=3
_sysid_trib_completion sysid-trib pend --system
echo "${COMPREPLY[@]}"
[ "$(sysid-trib --show-completion)" = "$(cat ~/.bash_completions/sysid-trib.sh)" ] && echo same
"""
    ended = subprocess.run(["bash", "-c", script], env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    installed, restart, function, offered, shown = ended.stdout.splitlines()
    assert installed == f"bash completion installed in {tmp_path}/.bash_completions/sysid-trib.sh"
    assert restart.endswith("restart the terminal")
    assert function == "complete -o default -F _sysid_trib_completion sysid-trib"
    assert (offered, shown, ended.stderr) == ("pendulum", "same", "")
