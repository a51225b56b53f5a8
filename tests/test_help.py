"""What --help shows: options in groups, and examples that work as they stand."""

import contextlib
import shlex

import pytest
from command_line import run

from sysid_trib.commands.app import app, examples_of

GROUPS = {
    "identify": ["Records", "Model", "Constraints", "How sure", "Output", "Other", "Examples"],
    "discover": ["Records", "Model", "Search", "Output", "Other", "Examples"],
    "campaign": ["Records", "Model", "Constraints", "Search", "Campaign", "Output", "Other", "Examples"],
}
EXAMPLES = {info.callback.__name__: examples_of(info.callback) for info in app.registered_commands}
SLOW = {"identify", "discover", "compare", "difference", "plan", "response", "campaign"}


@pytest.mark.parametrize("command", GROUPS)
def test_options_stand_in_groups(command):
    lines = run(command, "--help").out.splitlines()
    assert [line[:-1] for line in lines if line.endswith(":") and not line.startswith(" ")] == GROUPS[command]


def test_every_command_has_two_examples():
    for name, examples in EXAMPLES.items():
        assert len(examples) == 2
        said = run(name, "--help").out
        assert said.endswith(f"Examples:\n  {examples[0]}\n  {examples[1]}\n")


def _works(names, folder):
    with contextlib.chdir(folder):
        # The others read what this one writes.
        for name in sorted(names, key=lambda name: name != "simulate"):
            for example in EXAMPLES[name]:
                program, *words = shlex.split(example)
                ending = run(*words)
                assert program == "sysid-trib"
                assert ending.status == 0, f"{example}: {ending.err}"


@pytest.mark.slow
def test_examples_that_are_quick_work(tmp_path):
    _works([name for name in EXAMPLES if name not in SLOW | {"report"}], tmp_path)


@pytest.mark.slow
def test_all_examples_work(tmp_path):
    _works(EXAMPLES, tmp_path)
