"""Golden cases: a command, the record that it is asked of, and where it is compared."""

import os
import runpy
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

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
    name: str,
    command: str,
    motions: Sequence[str] = (),
    part: str = "benchmark",
    others: Mapping[str, float] = MappingProxyType({}),
) -> Case:
    """A command on simulated motions."""
    each = (motion(*one.split(), **others) for one in motions)
    verb, _, options = command.partition(" ")
    files = " ".join(f"{file}.csv" for file in FILES[: len(motions)])
    return Case(f"asked {name}", f"{verb} {files} {options}", written(*each), part)


def _measured(name: str, command: str, part: str = "benchmark") -> Case:
    return Case(f"measured {name}", command.replace("DATA", str(SHARED / "data")), written(), part)


def _laboratory(asked: str) -> Case:
    name = asked.partition(" ")[0]
    return Case(f"laboratory {name.partition('.')[0]}", f"identify {asked}", partial(_draw, name))


def _draw(name: str, folder: Path) -> None:
    """Write a file of ../shared/contact, from its own seed."""
    made = {
        case: make for case, make, _ in runpy.run_path(str(SHARED / "contact" / "make_files.py"))["CASES"]
    }
    made[name](folder / name, np.random.default_rng(int(name[:2])))


TABLE = tomllib.loads(Path(__file__).with_name("cases.toml").read_text(encoding="utf-8"))
CASES = (
    *_simulated(),
    *(_asked(**row) for row in TABLE["asked"]),
    *(_measured(**row) for row in TABLE["measured"]),
    *map(_laboratory, TABLE["laboratory"]),
)
