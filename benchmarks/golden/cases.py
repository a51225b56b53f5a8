"""Golden cases: a command, the record that it is asked of, and where it is compared."""

import os
import runpy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.golden.records import FILES, MOTIONS, WAYS, motion, written

SHARED = Path(os.environ.get("SYSID_TRIB_DATA", Path(__file__).parents[3] / "shared" / "data")).parent


@dataclass(frozen=True)
class Case:
    """A command on a record; `part` is the part of the tests in which it is compared, or `benchmark`."""

    name: str
    command: str
    # What writes its files into the folder where it runs.
    write: Callable[[Path], None]
    part: str = "benchmark"

    @property
    def group(self) -> str:
        """The file of tests/golden that keeps it."""
        return self.name.partition(" ")[0]

    @property
    def needs(self) -> Path | None:
        """What it reads beside the project."""
        return {"measured": SHARED / "data", "laboratory": SHARED / "contact"}.get(self.group)


FAST = {"viscous white", "drag coloured", "dry white", "viscous pushed", "drag gap", "stopped white"}
SLOW = {"paper white", "pendulum coloured", "contact pushed", "hardening finely"}


def _simulated() -> Iterator[Case]:
    """Every kind of motion with every noise and sampling, offered its own forces."""
    for kind, moving in MOTIONS.items():
        for way in WAYS:
            name = f"{kind} {way}"
            part = "fast" if name in FAST else "slow" if name in SLOW else "benchmark"
            command = f"identify swing.csv --forces {','.join(moving.coefficients)}"
            yield Case(f"simulated {name}", command, written(motion(kind, way)), part)


def _asked(
    name: str, command: str, *motions: tuple[str, str] | str, part: str = "benchmark", **others: float
):
    each = (motion(*(m.split() if isinstance(m, str) else m), **others) for m in motions)
    verb, _, options = command.partition(" ")
    files = " ".join(f"{file}.csv" for file in FILES[: len(motions)])
    return Case(f"asked {name}", f"{verb} {files} {options}", written(*each), part)


ASKED = (
    _asked("two runs", "identify --forces zeta", "viscous", "viscous", part="fast"),
    _asked("three runs, pushed", "identify --forces zeta", *["viscous pushed"] * 3),
    _asked("two runs that differ", "identify --forces zeta,delta", "viscous", "drag"),
    _asked("two runs of the paper", "identify", "paper", "paper finely"),
    _asked("coarse steps", "identify --forces zeta", "viscous", step=2e-3),
    _asked("a force left out", "identify --forces zeta,delta", "contact"),
    _asked("a force too many", "identify --forces lambda,zeta,delta", "viscous"),
    _asked("a sensor that curves", "identify --library own.toml --forces zeta,sensor_curve", "viscous",
           curved=0.02, part="slow"),
    _asked("a shape", "identify --library own.toml --forces own_damping", "viscous"),
    _asked("a shape held", "identify --library own.toml --forces own_damping --set own_damping.q=0.7",
           "viscous"),
    _asked("candidate with a state", "identify --library candidate_effects --forces maxwell", "viscous"),
    _asked("one held", "identify --forces lambda,zeta,epsilon --fix lambda=2e-4", "pendulum", part="fast"),
    _asked("one bounded, one tied", "identify --forces zeta,delta,nu --bound zeta=0: --tie nu=-6.6*delta",
           "contact", part="slow"),
    _asked("frequency held", "identify --forces zeta --reference-frequency 9.91", "viscous"),
    _asked("frequency without contact", "identify --forces zeta --omega0 9.90±0.01", "viscous"),
    _asked("random force off", "identify --forces zeta --random-force off", "viscous pushed"),
    _asked("random force in any case", "identify --forces zeta --random-force estimated", "viscous"),
    _asked("a pendulum by its name", "identify --system pendulum", "pendulum"),
    _asked("a window", "identify --forces zeta --window 1:7", "viscous"),
    _asked("a known input", "identify --input u --forces zeta,gain", "viscous", drive=3.0, part="fast"),
    _asked("a known input, held", "identify --input u --between held --forces zeta,epsilon,gain", "hardening",
           drive=3.0),
)  # fmt: skip

COMPARED = (
    _asked("methods", "compare --forces zeta", "viscous", part="fast"),
    _asked("methods, dry friction", "compare --forces lambda,zeta", "dry", part="slow"),
    _asked("methods, gap", "compare --forces zeta,delta", "drag gap"),
    _asked("methods, pushed", "compare --forces zeta,delta", "drag pushed"),
    _asked("methods, paper", "compare", "paper finely"),
    _asked("methods, one held", "compare --forces lambda,zeta --fix lambda=1.5e-3", "dry coloured"),
)

DISCOVERED = (
    _asked("nothing missing", "discover --forces zeta --candidates few.toml", "viscous", part="fast"),
    _asked("drag missing", "discover --forces zeta --candidates few.toml", "drag", part="fast"),
    _asked("friction missing, coloured", "discover --forces zeta --candidates few.toml", "dry coloured"),
    _asked("two missing, pushed", "discover --forces zeta --candidates few.toml", "contact pushed"),
    _asked("spring missing, two runs", "discover --forces zeta --candidates few.toml",
           "hardening", "hardening coloured", part="slow"),
    _asked("friction missing, gap", "discover --candidates few.toml", "dry gap"),
    _asked("all candidates", "discover --forces zeta", "drag"),
    _asked("all candidates, pendulum", "discover --forces zeta", "pendulum finely"),
)  # fmt: skip


def _measured(name: str, command: str, part: str = "benchmark") -> Case:
    return Case(f"measured {name}", command.replace("DATA", str(SHARED / "data")), written(), part)


MEASURED = (
    _measured(
        "string, short", "identify DATA/string_pendulum/run_high.txt --forces zeta,delta,epsilon", "slow"
    ),
    _measured("string", "identify DATA/string_pendulum/run_1.txt --forces zeta,delta,epsilon"),
    _measured("string by its system", "identify DATA/string_pendulum/run_high.txt --system pendulum"),
    _measured(
        "ship",
        "identify DATA/roll_decay/model_test_21337.csv --angle phi --window 25: --forces delta,epsilon",
    ),
    _measured("sloshing", "identify DATA/sloshing/decay_0p953.csv --forces zeta,epsilon"),
    _measured(
        "sloshing, two", "identify DATA/sloshing/decay_0p953.csv DATA/sloshing/decay_0p967.csv --forces zeta"
    ),
    _measured("string, methods", "compare DATA/string_pendulum/run_high.txt --forces zeta,delta,epsilon"),
    _measured("wall", "discover DATA/simulated/wall_strong.csv --forces zeta --candidates few.toml"),
)
LABORATORY = (
    *("02_video_30fps.csv", "06_pixels.csv --units px", "17_winkel_in_grad.csv", "22_time_in_column_2.txt"),
    *(
        "24_rest_release_stop.csv",
        "27_gaps.csv",
        "28_held_frames.csv",
        "33_milliradians.h5",
        "39_two_runs.csv",
    ),
    *("14_two_pendulums.csv", "38_three_half_periods.csv", "41_spring_mm.csv"),
)


def _laboratory(asked: str) -> Case:
    name = asked.partition(" ")[0]
    return Case(f"laboratory {name.partition('.')[0]}", f"identify {asked}", partial(_draw, name))


def _draw(name: str, folder: Path) -> None:
    """Write a file of ../shared/contact, from its own seed."""
    made = {
        case: make for case, make, _ in runpy.run_path(str(SHARED / "contact" / "make_files.py"))["CASES"]
    }
    made[name](folder / name, np.random.default_rng(int(name[:2])))


CASES = (*_simulated(), *ASKED, *COMPARED, *DISCOVERED, *MEASURED, *map(_laboratory, LABORATORY))
