"""How well a random force is identified: coverage and errors on pushed motions, false ones on others.

python benchmarks/random_force_study.py --out FILE [--seeds N] [--method NAME] [--only TEXT]

Twenty periods at w = 8.87 rad/s in noise of 0.2 mrad, pushed until they have wandered at the end by so many
noise levels (RMS), by a generator that shares nothing with the package (tests/kicked_motion.py). A line of
JSON for each record goes to FILE; what is there already is not done again. The table is of all in FILE.
Methods are direct, trajectory, and both without a random force (direct-off, trajectory-off): with these in
FILE too, a second table has the errors where nothing pushes over those without.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from helpers import correlated_noise  # noqa: E402
from kicked_motion import kicked_motion, smooth_forces  # noqa: E402
from stopwatch import timed  # noqa: E402

import sysid_trib as st  # noqa: E402
from sysid_trib.errors import SysidTribError  # noqa: E402
from sysid_trib.likelihood.random_force import RandomForce, random_force_of  # noqa: E402

W, NOISE, PERIODS = 8.87, 2e-4, 20
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
METHODS = {
    "direct": st.methods.Direct(random_force="estimated"),
    "trajectory": st.methods.Trajectory(random_force="estimated"),
    "direct-off": st.methods.Direct(random_force="off"),
    "trajectory-off": st.methods.Trajectory(random_force="off"),
}
# Of a step of 0.4 mrad, half the noise before it is rounded.
ROUNDING_STEP = 4e-4
SEEDS_AT_ONCE = 50
SEEDS_OF_A_CASE = 10_000


@dataclass(frozen=True)
class Case:
    """Records of one kind.

    Parameters
    ----------
    wander : float
        RMS wander at the end, in noise levels.
    friction : float
        lambda.
    per_period : int
        Samples a period.
    start : float, rad
    noise : {"white", "AR(0.8)", "rounded"}
        Of the sensor.
    """

    wander: float
    friction: float
    per_period: int
    start: float = 0.3
    noise: str = "white"

    @property
    def title(self) -> str:
        """What the table and the file call it."""
        stops = " to its stop" if self.start < 0.1 else ""
        return f"wander {self.wander:g}, lambda {self.friction:g}{stops}, {self.per_period}, {self.noise}"

    @property
    def model(self) -> st.Model:
        """The truth."""
        truth = ({"lambda": self.friction} if self.friction else {}) | TRUTH
        return st.Model(st.load_library("contact_forces").select(truth), truth, W)

    @property
    def time(self) -> np.ndarray:
        """Times of the samples, s."""
        return np.arange(PERIODS * self.per_period) * 2.0 * np.pi / W / self.per_period

    @property
    def density(self) -> float:
        """Of the random force, (rad/s^2)^2/Hz."""
        return RandomForce.density_of(2.0 * (self.wander * NOISE) ** 2 / (W * self.time[-1]), W)

    def decays(self, seeds: Sequence[int]) -> Iterator[tuple[int, xr.Dataset]]:
        """A noisy record of each seed; where friction stops it, without the tail at rest."""
        forces, start, own = smooth_forces(TRUTH), (self.start, 0.0), [self.first_seed + s for s in seeds]
        motions = kicked_motion(self.time, W, forces, self.friction, self.density, own, start=start)[0]
        for seed, of_case, motion in zip(seeds, own, motions, strict=True):
            decay = xr.Dataset({"angle": ("time", self.measured(motion, of_case))}, {"time": self.time})
            yield seed, decay.isel(time=self.time <= self.stop)

    @property
    def first_seed(self) -> int:
        """Cases with the same kicks and noise would err alike, and a pooled figure rest on few of them."""
        return SEEDS_OF_A_CASE * (1 + PUSHED.index(self)) if self.wander else 0

    def measured(self, angle: np.ndarray, seed: int) -> np.ndarray:
        """The angle as the sensor shows it."""
        if self.noise == "AR(0.8)":
            return angle + correlated_noise(len(angle), seed, 0.8, NOISE)
        white = np.random.default_rng(seed).standard_normal(len(angle))
        if self.noise == "rounded":
            return ROUNDING_STEP * np.round((angle + 0.5 * NOISE * white) / ROUNDING_STEP)
        return angle + NOISE * white

    @property
    def stop(self) -> float:
        """When the motion without kicks stops, s; infinite where it goes on."""
        return float(st.simulate(self.model, self.time, self.start).stop_time.fillna(np.inf))

    def bound(self) -> np.ndarray:
        """Cramér-Rao bounds of coefficients and reference frequency."""
        time = self.time[self.time <= self.stop]
        bound = st.validation.cramer_rao_bound(
            self.model, time, self.start, 0.0, NOISE, free=True, random_force=self.density
        )
        return np.append(bound.standard_error.values, bound.reference_frequency_standard_error)


PUSHED = [
    Case(wander, friction, per_period, start)
    for per_period in (20, 200)
    for wander in (1, 5, 20)
    for friction, start in ((0.0, 0.3), (1e-3, 0.3), (1e-3, 0.06))
]
FREE = [Case(0, 0.0, 60, 0.3, noise) for noise in ("white", "AR(0.8)", "rounded")]


def identified(case: Case, decay: xr.Dataset, method: str) -> dict[str, object]:
    """What the file says of one record."""
    truth = case.model.coefficients
    try:
        identify = partial(st.identify, decay, case.model.library, METHODS[method])
        result, seconds = timed(identify, process_time)
    except SysidTribError as error:
        return {"failed": str(error)}
    force = random_force_of(result)
    errors = result.coefficient.values - [truth[s] for s in result.force.values]
    return {
        "names": [*result.force.values.tolist(), "w"],
        "errors": [*errors.tolist(), float(result.reference_frequency) - W],
        "standard_errors": [
            *result.standard_error.values.tolist(),
            float(result.reference_frequency_standard_error),
        ],
        "density": force.density,
        "p_value": force.p_value if force else 1.0,
        "noise": float(result.noise),
        "seconds": seconds,
    }


def read(out: Path) -> list[dict]:
    """All that was done before; a line that was cut off is done again."""
    lines = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
    known = []
    for line in lines:
        try:
            known.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return known


def run(case: Case, method: str, seeds: int, out: Path) -> None:
    """Identify what is missing."""
    done = {r["seed"] for r in read(out) if (r["case"], r["method"]) == (case.title, method)}
    missing = [seed for seed in range(seeds) if seed not in done]
    for first in range(0, len(missing), SEEDS_AT_ONCE):
        for seed, decay in case.decays(missing[first : first + SEEDS_AT_ONCE]):
            row = {"case": case.title, "method": method, "seed": seed, **identified(case, decay, method)}
            with out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")


def row_of(case: Case, rows: list[dict]) -> list[str]:
    """A case in the table."""
    found = [row for row in rows if "failed" not in row]
    counts = [str(len(rows)), str(len(rows) - len(found))]
    if not found:
        return [case.title, *counts]
    told = 100.0 * np.mean([row["p_value"] < 0.01 for row in found])
    noise = np.mean([row["noise"] for row in found]) / NOISE
    seconds = f"{np.mean([row['seconds'] for row in found]):.2f}"
    if not case.wander:
        return [case.title, *counts, "", "", "", "", "", "", f"{told:.1f}", f"{noise:.3f}", seconds]
    errors, stated = (np.array([row[key] for row in found]) for key in ("errors", "standard_errors"))
    inside = np.abs(errors) < 1.96 * stated
    cover, names = np.mean(inside, axis=0), np.array(found[0]["names"])
    deviation = (cover - 0.95) / np.sqrt(0.95 * 0.05 / len(found))
    worst = int(np.argmax(np.abs(deviation)))
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / case.bound()
    size = np.sqrt(np.mean((errors / stated) ** 2))
    density = np.mean([row["density"] for row in found]) / case.density
    most = int(np.argmax(ratio))
    return [
        case.title,
        *counts,
        f"{100.0 * np.mean(inside):.1f}",
        f"{100.0 * cover[worst]:.1f} {names[worst]} ({deviation[worst]:+.1f})",
        f"{size:.2f}",
        f"{np.sqrt(np.mean(ratio**2)):.2f}",
        f"{ratio[most]:.2f} {names[most]}",
        f"{density:.2f}",
        f"{told:.1f}",
        f"{noise:.3f}",
        seconds,
    ]


def table_of(method: str, rows: list[dict]) -> Table:
    """All cases of one method."""
    table = Table(title=f"{method}: coverage of 95 % intervals, errors over the Cramér-Rao bound")
    columns = ["wander, friction, samples a period, noise", "records", "failed", "covered (%)"]
    columns += ["worst (binomial errors off)", "RMS error / stated", "/ bound", "worst / bound"]
    columns += ["density / true", "told at 1 % (%)", "noise / true", "time (s)"]
    for name in columns:
        table.add_column(name, justify="left" if name.startswith("wander") else "right")
    for case in (*PUSHED, *FREE):
        if of_case := [row for row in rows if (row["case"], row["method"]) == (case.title, method)]:
            table.add_row(*row_of(case, of_case))
    return table


def pooled(method: str, rows: list[dict]) -> str:
    """Coverage of all pushed records, and of those that go on and those that stop."""
    parts = []
    for title, words in (("all", ""), ("to its stop", "to its stop"), ("going on", None)):
        inside = [
            np.mean(np.abs(np.array(row["errors"])) < 1.96 * np.array(row["standard_errors"]))
            for row in rows
            if row["method"] == method and "errors" in row and not row["case"].startswith("wander 0")
            if (words or "") in row["case"] and (words is not None or "stop" not in row["case"])
        ]
        if inside:
            error = np.std(inside) / np.sqrt(len(inside))
            parts.append(f"{title} {100.0 * np.mean(inside):.1f} ± {100.0 * error:.1f} % of {len(inside)}")
    return "covered: " + "; ".join(parts) if parts else ""


def over_off(method: str, rows: list[dict]) -> Table:
    """RMS errors of a method over its own without a random force, of records that nothing pushes."""
    table = Table("noise", "records", "RMS error / off", "worst", title=f"{method}: where nothing pushes")
    for case in FREE:
        auto, off = (
            {
                r["seed"]: r["errors"]
                for r in rows
                if (r["case"], r["method"]) == (case.title, name) and "errors" in r
            }
            for name in (method, f"{method}-off")
        )
        if both := sorted(auto.keys() & off.keys()):
            sizes = [np.sqrt(np.mean(np.array([of[s] for s in both]) ** 2, axis=0)) for of in (auto, off)]
            ratio = sizes[0] / sizes[1]
            pooled = np.sqrt(np.mean(ratio**2))
            table.add_row(case.noise, str(len(both)), f"{pooled:.3f}", f"{ratio.max():.3f}")
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--method", choices=METHODS, default="trajectory")
    parser.add_argument("--only", default="", help="part of the names of the cases in the table")
    options = parser.parse_args()
    for case in (*PUSHED, *FREE):
        if options.only in case.title:
            run(case, options.method, options.seeds, options.out)
    console, rows = Console(width=200), read(options.out)
    console.print(table_of(options.method, rows))
    console.print(pooled(options.method, rows))
    if f"{options.method}-off" in {row["method"] for row in rows}:
        console.print(over_off(options.method, rows))


if __name__ == "__main__":
    main()
