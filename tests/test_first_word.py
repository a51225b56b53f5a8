"""What a command says while it works: its first word before heavy imports, and how long it still takes."""

import re
import subprocess
import sys
import time

import numpy as np
import pytest

from sysid_trib.commands import terminal
from sysid_trib.records.sensor import sensor_step

COMMANDS = ("look", "identify", "discover", "compare", "simulate", "report", "forces")
HEAVY = ("numpy", "scipy", "pandas", "xarray", "matplotlib", "pysindy", "numba")


def test_nothing_heavy_is_imported_before_the_first_word(tmp_path):
    # The progress of each command begins before its imports: at that point none of these may be there.
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


def test_progress_shows_the_part_that_is_done_and_begins_anew(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with terminal.progress() as tell:
        tell("search")
        for done in (0.0, 0.25, 0.75):
            tell("records", done)
        time.sleep(0.3)
        tell("records", 0.1)
        tell("figures")
        time.sleep(0.3)
    shown = re.sub(r"\x1b\[[^a-zA-Z]*[a-zA-Z]", "", capsys.readouterr().err)
    assert re.search(r"records\s+75%\s+0:00:0\d", shown)
    assert "figures" in shown.rpartition("75%")[2]
    assert "%" not in shown.rpartition("figures")[2]


@pytest.mark.parametrize("step", [1e-6, 1.57e-4, 2e-2])
def test_the_step_of_a_sensor_is_that_of_its_lattice(step):
    random = np.random.default_rng(0)
    time = np.arange(3000) / 100.0
    signal = 0.4 * np.exp(-0.01 * time) * np.cos(8.0 * time) + 1e-4 * random.standard_normal(time.size)
    rounded = step * np.round(signal / step)
    assert sensor_step(rounded) == pytest.approx(step, rel=1e-3)
    # Digits of a file, and a unit, change nothing.
    assert sensor_step(np.round(57.3 * rounded, 9)) == pytest.approx(57.3 * step, rel=1e-2)
    assert np.isnan(sensor_step(signal))


def test_values_between_the_steps_of_an_encoder_do_not_hide_them():
    time = np.arange(20000) / 1000.0
    signal = 0.4 * np.exp(-0.1 * time) * np.cos(8.0 * time)
    step = 1.57e-4
    counts = step * np.round(signal / step)
    changes = np.flatnonzero(np.diff(counts, prepend=counts[0] - 1.0))
    # Where it moves, the logger interpolates between the counts.
    between = np.interp(time, time[changes], counts[changes])
    shown = np.where(np.diff(counts, prepend=counts[0]) == 0.0, counts, between + 1e-9 * time)
    assert sensor_step(shown) == pytest.approx(step, rel=1e-3)
