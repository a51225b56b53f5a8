"""Records that golden answers are of: simulated motions with their noises and samplings, written as files."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import sysid_trib as st

Array = NDArray[np.float64]
W = 9.91


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


PAPER = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
MOTIONS = {
    "paper": Motion(PAPER),
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
    """What writes swing.csv, second.csv, ... and two libraries into a folder."""

    def write(folder: Path) -> None:
        for name in ("own.toml", "few.toml"):
            shutil.copy(Path(__file__).with_name(name), folder)
        for number, (name, each) in enumerate(zip(FILES, motions, strict=False)):
            columns = each.columns(seed=number + 1)
            table, head = np.column_stack(list(columns.values())), ",".join(columns)
            path = folder / f"{name}.csv"
            np.savetxt(path, table, "%.9g", ",", header=head, comments="", encoding="utf-8")

    return write
