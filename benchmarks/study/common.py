"""Common parts of the studies: records of a truth, rows over seeds, scores of estimates, tables."""

import json
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import xarray as xr
from helpers import correlated_noise, density_that_wanders
from kicked_motion import kicked_motion, smooth_forces
from rich.console import Console
from rich.table import Table
from scipy.stats import kstest

import sysid_trib as st
from sysid_trib.errors import SysidTribError

W, NOISE = 8.87, 2e-4
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
METHODS = {
    f"{name}{ending}": kind(random_force=option)
    for name, kind in (("direct", st.methods.Direct), ("trajectory", st.methods.Trajectory))
    for ending, option in (("", "estimated"), ("-off", "off"))
}
# Of a step of 0.4 mrad, half the noise before it is rounded.
ROUNDING_STEP = 4e-4
AT_ONCE = 50


def time_of(periods: int, per_period: int) -> np.ndarray:
    """Times of the samples, s."""
    return np.arange(periods * per_period) * 2.0 * np.pi / W / per_period


def density_of(wander: float, time: np.ndarray) -> float:
    """Density that lets the angle wander by so many noise levels at the end (RMS), (rad/s^2)^2/Hz."""
    return density_that_wanders(wander, NOISE, time, W)


@dataclass(frozen=True)
class Pushed:
    """Records of one kind, pushed by a generator that shares nothing with the package.

    Parameters
    ----------
    wander : float
        RMS wander at the end, in noise levels.
    friction : float
        lambda.
    per_period, periods : int
        Samples a period, and how many periods.
    start : float, rad
    noise : {"white", "AR(0.8)", "rounded"}
        Of the sensor.
    """

    wander: float
    friction: float = 0.0
    per_period: int = 60
    start: float = 0.3
    noise: str = "white"
    periods: int = 20

    @property
    def title(self) -> str:
        """Title in tables and files."""
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
        return time_of(self.periods, self.per_period)

    @property
    def density(self) -> float:
        """Density of the random force."""
        return density_of(self.wander, self.time)

    @property
    def stop(self) -> float:
        """Stop time of the motion without a random force, s; infinite if it goes on."""
        return float(st.simulate(self.model, self.time, self.start).stop_time.fillna(np.inf))

    def records(
        self, seeds: Sequence[int], stream: Sequence[int] = (), times: float = 1.0
    ) -> Iterator[xr.Dataset]:
        """A record of each seed, with noise of a stream; where friction stops it, without its rest."""
        forces, start = smooth_forces(TRUTH), (self.start, 0.0)
        density = times * self.density
        motions = kicked_motion(self.time, W, forces, self.friction, density, seeds, start=start)[0]
        for seed, motion in zip(seeds, motions, strict=True):
            shown = self.measured(motion, [seed, *stream] if stream else seed)
            decay = xr.Dataset({"angle": ("time", shown)}, {"time": self.time})
            yield decay.isel(time=self.time <= self.stop)

    def measured(self, angle: np.ndarray, seed) -> np.ndarray:
        """The angle as the sensor shows it."""
        if self.noise == "AR(0.8)":
            return angle + correlated_noise(len(angle), seed, 0.8, NOISE)
        white = np.random.default_rng(seed).standard_normal(len(angle))
        if self.noise == "rounded":
            return ROUNDING_STEP * np.round((angle + 0.5 * NOISE * white) / ROUNDING_STEP)
        return angle + NOISE * white

    def bound(self) -> np.ndarray:
        """Cramér-Rao bounds of coefficients and reference frequency."""
        time = self.time[self.time <= self.stop]
        bound = st.validation.cramer_rao_bound(
            self.model, time, self.start, 0.0, NOISE, free=True, random_force=self.density
        )
        return np.append(bound.standard_error.values, bound.reference_frequency_standard_error)


def columns(rows: Iterable[dict], *keys: str) -> tuple[np.ndarray, ...]:
    """Numbers of all rows of each key, (row, ...)."""
    rows = list(rows)
    return tuple(np.array([row[key] for row in rows], dtype=float) for key in keys)


def covered(errors: np.ndarray, stated: np.ndarray) -> np.ndarray:
    """Per cent of the 95 % intervals that hold, of each name."""
    return 100.0 * np.mean(np.abs(errors) < 1.96 * stated, axis=0)


def uniform(p_values: Sequence[float]) -> float:
    """p-value of Kolmogorov and Smirnov that these are uniform."""
    return float(kstest(p_values, "uniform").pvalue)


def read(out: Path | None) -> list[dict]:
    """All rows of a file; a line that was cut off counts for nothing."""
    rows = []
    for line in out.read_text(encoding="utf-8").splitlines() if out is not None and out.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def added(out: Path | None, row: object) -> None:
    """Add a row to the file, if there is one."""
    if out is not None:
        with out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def tried(call: Callable, *given: object) -> dict:
    """A row, or why the package refused it."""
    try:
        return call(*given)
    except SysidTribError as error:
        return {"failed": str(error)}


def over_seeds(
    asked: Namespace, one: Callable, records: Callable | None = None, seeds: int | None = None, **names: str
) -> list[dict]:
    """A row of each seed under these names: those of the file, then those that are added to it.

    `one(record)` makes a row of each of `records(seeds)`; without these, `one(seed)` of the seed.
    """
    known = [row for row in read(asked.out) if all(row.get(key) == value for key, value in names.items())]
    wanted = range(asked.seeds if seeds is None else min(seeds, asked.seeds))
    missing = sorted({*wanted} - {row["seed"] for row in known})
    for first in range(0, len(missing), AT_ONCE):
        batch = missing[first : first + AT_ONCE]
        for seed, record in zip(batch, records(batch) if records else batch, strict=True):
            known.append({**names, "seed": seed, **tried(one, record)})
            added(asked.out, known[-1])
    return known


def shown(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]], width: int = 150) -> None:
    """Print a table, if it has a row."""
    table = Table(*heads, title=title)
    for row in rows:
        table.add_row(*row)
    if table.row_count:
        Console(width=width).print(table)


Result = TypeVar("Result")
Clock = Callable[[], float]


def timed(call: Callable[[], Result], clock: Clock = time.perf_counter) -> tuple[Result, float]:
    """Return the result of a call, and its time, s."""
    begin = clock()
    result = call()
    return result, clock() - begin


def times(call: Callable[[], object], repeats: int, clock: Clock = time.perf_counter) -> np.ndarray:
    """Times of repeated calls, s; a first call, which compiles and imports, is not counted."""
    call()
    return np.array([timed(call, clock)[1] for _ in range(repeats)])


def median_ms(call: Callable[[], object], repeats: int, clock: Clock = time.perf_counter) -> float:
    """Median time of repeated calls, ms."""
    return 1e3 * float(np.median(times(call, repeats, clock)))
