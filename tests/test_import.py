"""Importing changes nothing in the process and waits for nothing heavy; namespaces show public names."""

import subprocess
import sys
from abc import ABCMeta
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import sysid_trib as st
from sysid_trib.commands.terminal import one_thread

PACKAGE = Path(st.__file__).parent
STATE = """
import locale, logging, os, signal, sys, warnings

def state():
    loggers = logging.root.manager.loggerDict.items()
    return {
        "warnings": (list(warnings.filters), warnings.showwarning),
        "logging": (logging.root.level, list(logging.root.handlers), logging.root.manager.disable),
        "loggers": {name: (one.level, one.disabled) for name, one in loggers if hasattr(one, "level")},
        "environment": dict(os.environ),
        "signals": [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)],
        "interpreter": (sys.excepthook, sys.getrecursionlimit(), sys.stdout, sys.stderr),
        "locale": locale.setlocale(locale.LC_ALL),
        "folder": os.getcwd(),
    }

before = state()
import sysid_trib, sysid_trib.cli, sysid_trib.errors
after = state()
print([name for name in before if before[name] != after[name]])
"""


def test_importing_changes_nothing_in_the_process():
    ended = subprocess.run([sys.executable, "-c", STATE], capture_output=True, text=True, check=True)
    assert ended.stdout == "[]\n"


def test_commands_compute_in_one_thread_and_leave_the_others_as_they_were():
    def threads():
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    with one_thread():
        assert set(threads()) == {1}
    with threadpool_limits(2, user_api="blas"):
        before = threads()
        with one_thread():
            assert set(threads()) == {1}
        assert threads() == before


COLLECTOR = """
import gc, sys
from sysid_trib import cli
sys.argv = ["sysid-trib", "forces"]
try:
    cli.main()
except SystemExit:
    print(gc.isenabled(), gc.get_freeze_count() > 100_000, file=sys.stderr)
"""


def test_garbage_is_collected_while_a_command_computes_but_not_in_imported_modules():
    ended = subprocess.run([sys.executable, "-c", COLLECTOR], capture_output=True, text=True, check=True)
    assert ended.stderr == "True True\n"


def test_few_names_carry_a_newcomer():
    assert len(st.__all__) <= 20
    assert all(getattr(st, name) is not None for name in dir(st))


SPACES = (
    "",
    ".campaigns",
    ".control",
    ".forces",
    ".methods",
    ".physics",
    ".plots",
    ".records",
    ".validation",
)


@pytest.mark.parametrize("space", SPACES)
def test_a_namespace_shows_its_public_names_alone(space):
    package = import_module(f"sysid_trib{space}")
    shown = [name for name in dir(package) if not name.startswith("__")]
    assert shown
    assert {type(getattr(package, name)) for name in shown} <= {type, ABCMeta, FunctionType, ModuleType}
    others = {"np", "xr", "json", "Any", "UsageError"}
    assert others.isdisjoint(shown)


@pytest.mark.parametrize("package", sorted(PACKAGE.glob("*/__init__.pyi")), ids=lambda stub: stub.parent.name)
def test_no_module_hides_a_public_name(package):
    """A module that is imported becomes an attribute of its package, also in the place of a function."""
    modules = {path.stem for path in package.parent.glob("*.py")}
    assert modules.isdisjoint(import_module(f"sysid_trib.{package.parent.name}").__all__)


COMMANDS = ("look", "identify", "discover", "compare", "simulate", "report", "forces")
HEAVY = ("numpy", "scipy", "pandas", "xarray", "matplotlib", "pysindy", "numba")


def test_nothing_heavy_is_imported_before_the_first_word(tmp_path):
    # The progress of a command starts before its imports: at that point none of these may be imported.
    script = f"""
import sys
from contextlib import contextmanager
from sysid_trib.commands.app import app
from sysid_trib.commands import terminal
class Reached(Exception): pass
@contextmanager
def progress():
    heavy = sorted(set({HEAVY!r}) & set(sys.modules))
    raise Reached(",".join(heavy))
    yield
arguments = {{"report": ["a.nc", "-o", "b.html"], "simulate": ["-o", "a.csv"]}}
for name in {COMMANDS!r}:
    terminal.progress = progress
    try:
        app([name, *arguments.get(name, [])], standalone_mode=False)
    except Reached as reached:
        print(name, reached)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"{name} " for name in COMMANDS], done.stdout
