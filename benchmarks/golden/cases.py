"""Golden cases: a command, the simulated motions or files that it is asked of, and where it is compared."""

import runpy
import shutil
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from helpers import FIVE, W
from numpy.typing import NDArray

import sysid_trib as st
from benchmarks import DATA

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """A decay from rest and how it is sampled."""

    coefficients: Mapping[str, float]
    library: str = "contact_forces"
    shapes: Mapping[str, float] = field(default_factory=dict)
    start: float = 0.3
    periods: int = 16
    per_period: int = 20
    noise: float = 2e-4
    # Of one sample with the next.
    correlation: float = 0.0
    # (rad/s^2)^2/Hz
    random_force: float = 0.0
    # What the sensor rounds to, rad.
    step: float = 0.0
    # Share of the samples that are missing in a row, from the middle on.
    gap: float = 0.0
    # A tone beside the resonance, rad/s^2, in a column `u`.
    drive: float = 0.0
    # Square of the angle that the sensor adds.
    curved: float = 0.0

    def columns(self, seed: int) -> dict[str, Array]:
        """Columns of its file."""
        time = np.arange(self.periods * self.per_period) * round(2.0 * np.pi / W / self.per_period, 5)
        forces = st.load_library(self.library)
        model = st.Model(forces.select(self.coefficients), self.coefficients, W, dict(self.shapes))
        drive = self.drive * np.sin(7.3 * time)
        pushed = {"known_input": drive} if self.drive else {}
        motion = st.simulate(model, time, self.start, random_force=self.random_force, seed=seed, **pushed)
        angle = motion.angle.values + self.curved * motion.angle.values**2 + self._noise(seed)
        if self.step:
            angle = self.step * np.round(angle / self.step)
        first, missing = len(time) // 2, int(self.gap * len(time))
        kept = np.r_[0:first, first + missing : len(time)]
        found = {"time (s)": time, "angle (rad)": angle} | ({"u": drive} if self.drive else {})
        return {name: values[kept] for name, values in found.items()}

    def _noise(self, seed: int) -> Array:
        white = np.random.default_rng([seed, 5]).standard_normal(self.periods * self.per_period)
        found = white.copy()
        for i in range(1, len(white)):
            found[i] = self.correlation * found[i - 1] + np.sqrt(1.0 - self.correlation**2) * white[i]
        return self.noise * found


MOTIONS = {
    "paper": Motion(FIVE),
    "viscous": Motion({"zeta": 0.008}),
    "dry": Motion({"lambda": 1.5e-3, "zeta": 0.004}),
    # It stops before the record ends.
    "stopped": Motion({"lambda": 6e-3, "zeta": 0.002}),
    "drag": Motion({"zeta": 0.003, "delta": 0.06}),
    "pendulum": Motion({"lambda": 2e-4, "zeta": 0.006, "epsilon": -1.0 / 6.0}, start=0.5),
    "hardening": Motion({"zeta": 0.006, "epsilon": 0.9}, start=0.5),
    "contact": Motion({"lambda": 5e-4, "delta": 0.03, "nu": -0.2}),
}
FILES = ("swing", "second", "third")
# Ways of a noise and of a sampling.
WAYS: dict[str, dict[str, float]] = {
    "white": {},
    "coloured": {"correlation": 0.8},
    "pushed": {"random_force": 2e-4},
    "finely": {"per_period": 60},
    "gap": {"gap": 0.12},
}


def motion(kind: str, way: str = "white", **others: float) -> Motion:
    """A kind of motion, with a noise or a sampling."""
    return replace(MOTIONS[kind], **WAYS[way], **others)


def written(*motions: Motion) -> Callable[[Path], None]:
    """Return a function that writes swing.csv, second.csv, ... and two libraries into a folder."""

    def write(folder: Path) -> None:
        for name in ("own.toml", "few.toml"):
            shutil.copy(Path(__file__).with_name(name), folder)
        for number, (name, each) in enumerate(zip(FILES, motions, strict=False)):
            columns = each.columns(seed=number + 1)
            table, head = np.column_stack(list(columns.values())), ",".join(columns)
            path = folder / f"{name}.csv"
            np.savetxt(path, table, "%.9g", ",", header=head, comments="", encoding="utf-8")

    return write


SHARED = DATA.parent


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
        """Folder outside of the project that it reads."""
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
