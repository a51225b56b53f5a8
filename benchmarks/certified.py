"""The certified decays: twelve free decays at three noise levels, with exact truth and Cramér-Rao bounds.

python -m benchmarks.certified --write      make sysid_trib/datasets/certified anew, and check it
python -m benchmarks certified [--seeds N] [--only NAME] [--answers FILE]      score programs
"""

import argparse
import gzip
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

import sysid_trib as st
from benchmarks.certified_check import Motion, motion_and_sensitivities
from sysid_trib.forces.selection import with_shipped

FOLDER = Path(st.__file__).parent / "datasets" / "certified"
LEVELS = (1e-3, 1e-4, 1e-5)
# Relative difference allowed between the two engines.
AGREEMENT = 1e-9
# Terms of the equation by symbol, in v = theta'/w.
TERMS = {
    "lambda": "lambda*sign(v)",
    "zeta": "2*zeta*v",
    "delta": "delta*v*abs(v)",
    "alpha": "alpha*theta",
    "nu": "nu*theta*abs(theta)",
    "epsilon": "epsilon*theta^3",
    "gravity": "gravity*(sin(theta) - theta)",
    "stribeck": "stribeck*exp(-(v/s)^2)*sign(v)",
}
FREQUENCY, ANGLE, RATE = "reference_frequency", "start_angle", "start_rate"
UNITS = {FREQUENCY: "rad/s", ANGLE: "rad", RATE: "rad/s"}


@dataclass(frozen=True, kw_only=True)
class Decay:
    """A certified decay: its equation, start and sampling; `w_is_given` says that w is no unknown."""

    name: str
    title: str
    w: float
    coefficients: dict[str, float]
    angle: float = 0.3
    # Not at rest: with dry friction the derivative by the start rate has a step there.
    rate: float = -0.2
    duration: float = 20.0
    sampling_rate: float = 100.0
    w_is_given: bool = False
    shapes: dict[str, float] = field(default_factory=dict)

    @property
    def time(self) -> np.ndarray:
        return np.arange(round(self.duration * self.sampling_rate)) / self.sampling_rate

    @property
    def model(self) -> st.Model:
        library = with_shipped(st.load_library("contact_forces"), self.coefficients)
        return st.Model(library.select(list(self.coefficients)), self.coefficients, self.w, self.shapes)

    @property
    def equation(self) -> str:
        terms = " + ".join(TERMS[symbol] for symbol in self.coefficients)
        shapes = "".join(f", {key.rpartition('.')[2]} = {value:g}" for key, value in self.shapes.items())
        return f"theta'' + w^2*(theta + {terms}) = 0, v = theta'/w{shapes}"

    @property
    def unknowns(self) -> list[str]:
        """The unknowns of the bound, the sensor's zero not among them."""
        return [*self.coefficients, *([] if self.w_is_given else [FREQUENCY]), ANGLE, RATE]

    @property
    def truth(self) -> dict[str, float]:
        return {**self.coefficients, FREQUENCY: self.w, ANGLE: self.angle, RATE: self.rate}


PAPER = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "alpha": 0.02, "nu": -0.40, "epsilon": 0.30}
DECAYS = (
    Decay(name="dry", title="Dry friction alone", w=9.0, coefficients={"lambda": 2e-3}),
    Decay(name="viscous", title="Viscous friction alone", w=9.0, coefficients={"zeta": 0.01}),
    Decay(name="quadratic", title="Quadratic drag alone", w=9.0, coefficients={"delta": 0.1}),
    Decay(
        name="paper_six", title="The six forces of the paper's run, w given", w=9.91, coefficients=PAPER,
        duration=25.0, w_is_given=True,
    ),
    Decay(
        name="three_frictions", title="Dry, viscous and quadratic friction together", w=8.0,
        coefficients={"lambda": 1e-3, "zeta": 5e-3, "delta": 0.05}, duration=25.0, sampling_rate=80.0,
    ),
    Decay(
        name="pendulum", title="A pendulum from 2.2 rad, gravity unknown", w=6.0,
        coefficients={"lambda": 5e-3, "zeta": 2e-3, "delta": 0.02, "gravity": 1.0},
        angle=2.2, duration=25.0,
    ),
    Decay(
        name="stribeck", title="Friction that falls with speed (Stribeck)", w=9.0,
        coefficients={"lambda": 1.5e-3, "zeta": 3e-3, "stribeck": 1e-3}, shapes={"stribeck.s": 0.05},
    ),
    Decay(
        name="short", title="Three periods", w=9.0, coefficients={"lambda": 5e-3, "zeta": 0.02},
        duration=2.1, sampling_rate=200.0,
    ),
    Decay(
        name="low_rate", title="Fewer than six samples per period", w=9.0,
        coefficients={"zeta": 5e-3, "delta": 0.05}, rate=0.4, duration=60.0, sampling_rate=8.0,
    ),
    Decay(
        name="stops", title="Strong dry friction, which stops the motion within the record", w=9.0,
        coefficients={"lambda": 0.02, "zeta": 5e-3}, angle=0.5, duration=6.0, sampling_rate=200.0,
    ),
    Decay(
        name="softening", title="A softening spring from 1 rad", w=7.0,
        coefficients={"zeta": 4e-3, "delta": 0.03, "epsilon": -0.2}, angle=1.0, rate=-1.0,
        duration=30.0, sampling_rate=50.0,
    ),
    Decay(
        name="hardening", title="A hardening spring from 0.8 rad", w=12.0,
        coefficients={"zeta": 5e-3, "epsilon": 0.8}, angle=0.8, duration=15.0,
    ),
)  # fmt: skip


def record_name(decay: Decay, noise: float) -> str:
    """Return the name of a record: certified/dry_1e-3."""
    return f"certified/{decay.name}_1e{round(np.log10(noise))}"


def seed_of(decay: Decay, noise: float) -> int:
    """Return the seed of the noise of a record."""
    return 10 * (1 + DECAYS.index(decay)) + LEVELS.index(noise)


def noisy(decay: Decay, motion: np.ndarray, noise: float, seed: int) -> np.ndarray:
    """Return the motion with white noise, rounded to a ten-thousandth of the noise."""
    angle = motion + noise * np.random.default_rng(seed).standard_normal(len(motion))
    return np.round(angle, 4 - round(np.log10(noise)))


def bounds(decay: Decay) -> dict[str, float]:
    """Return the Cramér-Rao bound of each unknown for a noise of 1 rad; it is proportional to the noise."""
    start = decay.angle, decay.rate
    found = st.cramer_rao_bound(decay.model, decay.time, *start, noise=1.0, free=not decay.w_is_given)
    errors = dict(zip(found.force.values.tolist(), found.standard_error.values.tolist(), strict=True))
    errors |= {name: found[f"{name}_standard_error"].item() for name in (FREQUENCY, ANGLE, RATE)}
    return {name: errors[name] for name in decay.unknowns}


def checked(decay: Decay) -> Motion:
    """Return the motion and bounds of the independent engine; raise an error where ours are others."""
    other = motion_and_sensitivities(decay)
    motion = st.simulate(decay.model, decay.time, decay.angle, decay.rate).angle.values
    off = float(np.max(np.abs(motion - other.angle)) / np.max(np.abs(motion)))
    ours, theirs = bounds(decay), other.bounds()
    off_bounds = max(abs(ours[name] / theirs[name] - 1.0) for name in decay.unknowns)
    print(f"{decay.name}: motions within {off:.1e}, bounds within {off_bounds:.1e}", flush=True)
    if max(off, off_bounds) > AGREEMENT:
        raise AssertionError(f"{decay.name}: the two engines differ by more than {AGREEMENT:g}.")
    return other


def contents() -> dict[str, bytes]:
    """Return the files of the set by name, uncompressed."""
    decays, truths, files = [], [], {}
    for decay in DECAYS:
        motion = st.simulate(decay.model, decay.time, decay.angle, decay.rate).angle.values
        of_one = bounds(decay)
        for noise in LEVELS:
            name = record_name(decay, noise)
            files[f"{name.partition('/')[2]}.csv"] = _csv_of(decay, motion, noise)
            row = {"name": name, "title": f"{decay.title}, noise {noise:g} rad", "equation": decay.equation}
            row |= {
                "w_given": f"{decay.w:g}" if decay.w_is_given else "",
                ANGLE: decay.angle,
                RATE: decay.rate,
            }
            row |= {"duration": decay.duration, "sampling_rate": decay.sampling_rate, "noise": noise}
            decays.append(row | {"seed": seed_of(decay, noise), "unknowns": " ".join(decay.unknowns)})
            for quantity in decay.unknowns:
                value, bound = decay.truth[quantity], f"{noise * of_one[quantity]:.11e}"
                unit = UNITS.get(quantity, "1")
                truths.append(
                    {"name": name, "quantity": quantity, "value": value, "bound": bound, "unit": unit}
                )
    for name, rows in (("decays.csv", decays), ("truth.csv", truths)):
        files[name] = pd.DataFrame(rows).to_csv(index=False, lineterminator="\n").encode()
    return files


def _csv_of(decay: Decay, motion: np.ndarray, noise: float) -> bytes:
    angle = noisy(decay, motion, noise, seed_of(decay, noise))
    digits = 4 - round(np.log10(noise))
    rows = (f"{t:.4f},{x:.{digits}f}" for t, x in zip(decay.time, angle, strict=True))
    return "\n".join(["time (s),angle (rad)", *rows, ""]).encode()


def write() -> None:
    """Write the set; records are compressed, the two tables are not."""
    FOLDER.mkdir(exist_ok=True)
    for name, content in contents().items():
        if name in ("decays.csv", "truth.csv"):
            (FOLDER / name).write_bytes(content)
        else:
            (FOLDER / f"{name}.gz").write_bytes(gzip.compress(content, 9, mtime=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the set")
    parser.add_argument("--check", action="store_true", help="hold it against the independent engine")
    asked = parser.parse_args()
    if not (asked.write or asked.check):
        sys.exit("Give --write or --check.")
    for decay in DECAYS:
        checked(decay)
    if asked.write:
        write()


if __name__ == "__main__":
    main()
