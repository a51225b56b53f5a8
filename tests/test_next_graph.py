"""Follow `Next:` from `look` to its end: each command runs, none is repeated, and there are at most four."""

import shlex
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import Ending, run, write_csv

import sysid_trib as st
from sysid_trib.simulation.trajectory import trajectory

MOST_STEPS = 4
# Windows keep searches short.
MEASURED = {
    "string": "string_pendulum/run_1.txt --window :60",
    "string, large": "string_pendulum/run_high.txt",
    "ship": "roll_decay/model_test_21337.csv",
    "tank": "sloshing/decay_0p953.csv --window :40",
    "servo": "servo_pendulum/free_swing_kp400.csv",
    "random force": "simulated/random_force_1.csv --window :15",
    "presliding": "simulated/dahl.csv",
    "steel pendulum": "single_pendulum/free_swing.csv --window 60:75",
}


@dataclass(frozen=True)
class Made:
    """A record that is simulated: coefficients, start, duration (s), rate (Hz), noise."""

    coefficients: tuple[tuple[str, float], ...]
    start: float = 0.3
    duration: float = 15.0
    rate: float = 50.0
    noise: float = 2e-4


GENERATED = {
    "viscous": Made((("zeta", 0.01),)),
    "dry": Made((("lambda", 1e-3), ("zeta", 3e-3))),
    "drag": Made((("zeta", 2e-3), ("delta", 0.04))),
    "hardening": Made((("zeta", 5e-3), ("epsilon", 0.3)), start=0.5),
    "tribometer": Made((("zeta", 0.01), ("delta", 0.04), ("nu", -0.4), ("epsilon", 0.3))),
    "pendulum": Made((("zeta", 2e-3), ("delta", 0.02), ("gravity", 1.0)), start=1.2),
    "small pendulum": Made((("lambda", 5e-4), ("zeta", 2e-3), ("gravity", 1.0)), start=0.3),
    "three periods": Made((("zeta", 5e-3),), duration=2.2),
    "noisy": Made((("zeta", 0.02),), noise=0.02),
    "hidden": Made((("zeta", 4e-3), ("stribeck", 4e-3)), start=0.4),
}


def write_made(folder: Path, made: Made) -> Path:
    """Write a simulated record."""
    shipped = st.load_library(), st.load_library("candidate_effects")
    offered = {force.symbol: force for library in reversed(shipped) for force in library}
    library = st.forces.ForceLibrary("made", tuple(offered[symbol] for symbol, _ in made.coefficients))
    time = np.arange(0.0, made.duration, 1.0 / made.rate)
    angle = trajectory(st.Model(library, dict(made.coefficients), 9.0), time, made.start, 0.0).angle
    angle = angle + made.noise * np.random.default_rng(1).standard_normal(time.size)
    return write_csv(folder / "made.csv", time, angle)


@cache
def ran(command: tuple[str, ...]) -> Ending:
    """A command, run once however often a chain comes to it."""
    return run(*command)


def following(ending: Ending) -> tuple[str, ...] | None:
    """The command after `Next:`, or None at an end."""
    lines = [line for line in ending.out.splitlines() if line.startswith("Next: ")]
    assert len(lines) <= 1, lines
    if not lines:
        return None
    words = shlex.split(lines[0].removeprefix("Next: "), comments=True)
    # The placeholder of a file that is to be measured first is never in the only next step.
    assert not [word for word in words if word.startswith("<")], lines
    assert words[0] == "sysid-trib"
    return tuple(words[1:])


def chain_from(command: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The commands from one to an end."""
    chain = [command]
    while True:
        ending = ran(chain[-1])
        assert ending.status == 0, (chain, ending.err)
        step = following(ending)
        if step is None:
            return chain
        assert step not in chain, chain
        chain.append(step)
        assert len(chain) <= 1 + MOST_STEPS, chain


def says_an_answer(ending: Ending) -> bool:
    """True if the end of a chain explains the record, or says that no force that is known does."""
    words = "is explained", "nothing missing", "predicts", "next run", "frequency (rad/s)"
    return any(word in ending.out for word in words)


@pytest.mark.slow
@pytest.mark.parametrize("name", MEASURED)
def test_from_a_measured_record_an_end_is_reached(name, data_folder, monkeypatch):
    monkeypatch.chdir(data_folder)
    chain = chain_from(("look", *MEASURED[name].split()))
    # The path as it was given.
    assert all(command[1] == chain[0][1] for command in chain)
    print(name, *(" ".join(command) for command in chain[1:]), sep="\n    ")


@pytest.mark.slow
@pytest.mark.parametrize("name", GENERATED)
def test_from_a_generated_record_an_end_is_reached(name, tmp_path):
    chain = chain_from(("look", str(write_made(tmp_path, GENERATED[name]))))
    print(name, *(" ".join(command) for command in chain[1:]), sep="\n    ")
