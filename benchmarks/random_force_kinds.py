"""Is white acceleration enough? What random force measured free decays ask for.

python -m benchmarks random_force_kinds [--only WORD] [--simulated N] [--drawn N]

By how much the restricted deviance of `Direct`'s rows is lower where a second random force stands beside the
white one: in proportion to a speed, an angle or an amplitude, of finite correlation time, a wandering
equilibrium. First with the model of each record alone, then with free coefficients for all that goes with the
motion (harmonics of its phase times polynomials of its amplitude): a force that was left out goes with it.
Halves of a record stand for repeats. Below, the largest gains in N records that are simulated from the
identified model, with white acceleration alone; and the medians in N draws of rows (along the same motion)
whose random force is of a kind alone: what the test would have seen.
"""

from argparse import Namespace
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from benchmarks.measured import BOTH, Record
from benchmarks.study.common import shown
from sysid_trib import methods, simulate
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.selection import forces_to_identify
from sysid_trib.likelihood.least_squares import constraint_map
from sysid_trib.likelihood.regression import begin
from sysid_trib.likelihood.rows import rows_about, solve, weak_rows
from sysid_trib.likelihood.stochastic_columns import regress_stochastic
from sysid_trib.likelihood.variance_ratio import WhiteRows
from sysid_trib.likelihood.weak_form import coloured
from sysid_trib.physics import model_of

Array = NDArray[np.float64]

HARMONICS, POLYNOMIALS = 6, 4
# First guesses of the logarithm of the second force's size over the white one's.
SIZES = (-6.0, -3.0, 0.0, 3.0)
EVALUATIONS = 60
# A random force that is drawn, over the sensor's noise in the rows.
DRAWN_SIZE = 5.0


SWING, FILM = "single_pendulum/free_swing.csv", "string_pendulum/run_1.txt"
SHIP = "roll_decay/model_test_21337.csv"
RECORDS = (
    Record("Ship model", SHIP, {"angle": "phi"}, (25.0, 78.0), 5, "lambda delta epsilon"),
    Record("Bob on a string", FILM, {}, (None, None), 1, "zeta delta gravity sensor_curve sensor_cubic"),
    Record("Steel pendulum", SWING, {}, (15.0, 75.0), 20, "lambda zeta delta gravity sensor_curve"),
)


@dataclass(frozen=True)
class DenseRows:
    """Rows of a record along its smoothed motion, with dense covariances of them.

    Attributes
    ----------
    table : (row, column) array of float
        Columns of all that is free, then the target.
    sensor : (row, row) array of float
        Covariance by the sensor's noise.
    value : (row, sample) array of float
        Integrals against the test functions.
    tau, x, v, amplitude : (sample,) array of float
        The smoothed motion; its amplitude on the mean of half a period.
    """

    table: Array
    sensor: Array
    value: Array
    tau: Array
    x: Array
    v: Array
    amplitude: Array

    def with_all_that_goes_with_the_motion(self) -> "DenseRows":
        """The rows with free coefficients for every force that is a function of phase and amplitude."""
        phase, level = np.arctan2(-self.v, self.x), np.log(self.amplitude)
        of_amplitude = legvander(2.0 * (level - level.min()) / np.ptp(level) - 1.0, POLYNOMIALS - 1)
        waves = [f(n * phase) for n in range(HARMONICS + 1) for f in ((np.cos, np.sin) if n else (np.cos,))]
        forces = [self.amplitude * part * wave for part in of_amplitude.T for wave in waves]
        free = np.column_stack([self.table[:, :-1], self.value @ np.stack(forces, axis=1)])
        basis, size, _ = np.linalg.svd(free / np.linalg.norm(free, axis=0), full_matrices=False)
        return replace(self, table=np.column_stack([basis[:, size > 1e-8 * size[0]], self.table[:, -1]]))

    def in_proportion(self, weight: Array) -> Array:
        """Covariance by white acceleration times a weight at each sample."""
        return (self.value * (weight**2 / np.gradient(self.tau))) @ self.value.T

    def correlated(self, time: float) -> Array:
        """Covariance by a force that forgets within `time` (of tau); a Brownian path if it is infinite."""
        since = self.tau - self.tau[0]
        if np.isinf(time):
            return self.value @ np.minimum.outer(since, since) @ self.value.T
        return self.value @ np.exp(-np.abs(np.subtract.outer(since, since)) / time) @ self.value.T

    def deviance(self, covariance: Array) -> float:
        """Minus twice the logarithm of the restricted likelihood, the scale of the covariance profiled."""
        factor = cholesky(covariance, lower=True, check_finite=False)
        white = solve_triangular(factor, self.table, lower=True, check_finite=False)
        determinant = 2.0 * float(np.sum(np.log(np.diag(factor))))
        return WhiteRows(white[:, -1], white[:, :-1], determinant).restricted_deviance()[0]

    def least(self, forces: list[Array], starts: Iterable[tuple[float, ...]]) -> tuple[float, list[float]]:
        """Least deviance with these random forces beside the sensor's noise, logarithms of their sizes."""

        def with_sizes(sizes: Sequence[float]) -> float:
            pushed = sum(np.exp(size) * force for size, force in zip(sizes, forces, strict=True))
            return self.deviance(self.sensor + pushed)

        first = min(starts, key=with_sizes)
        found = minimize(with_sizes, first, method="Nelder-Mead", options={"maxfev": EVALUATIONS})
        return float(found.fun), found.x.tolist()

    def gains(self) -> list[float]:
        """Return the fall of the deviance with each of `KINDS` in addition to white acceleration."""
        white = self._sized(self.in_proportion(np.ones_like(self.tau)))
        alone, (size,) = self.least([white], [(float(size),) for size in range(-10, 14, 2)])
        starts = [(size, size + more) for more in SIZES]
        both = [self.least([white, self._sized(kind(self))], starts)[0] for kind in KINDS.values()]
        return [max(0.0, alone - deviance) for deviance in both]

    def drawn(self, kind: str, random: np.random.Generator) -> "DenseRows":
        """The rows with noise in place of the record: the sensor's, and a random force of one kind alone."""
        force = self._sized(KINDS[kind](self) if kind else self.in_proportion(np.ones_like(self.tau)))
        factor = cholesky(self.sensor + DRAWN_SIZE * force, lower=True)
        noise = factor @ random.standard_normal(len(factor))
        return replace(self, table=np.column_stack([self.table[:, :-1], noise]))

    def _sized(self, covariance: Array) -> Array:
        """A covariance as large as the sensor's, on the mean of all rows."""
        return covariance * (np.trace(self.sensor) / np.trace(covariance))


KINDS: dict[str, Callable[[DenseRows], Array]] = {
    "speed": lambda rows: rows.in_proportion(np.abs(rows.v)),
    "speed^2": lambda rows: rows.in_proportion(rows.v**2),
    "angle": lambda rows: rows.in_proportion(np.abs(rows.x)),
    "amplitude": lambda rows: rows.in_proportion(rows.amplitude),
    "amplitude^2": lambda rows: rows.in_proportion(rows.amplitude**2),
    "correlated, 1/w": lambda rows: rows.correlated(1.0),
    "correlated, 10/w": lambda rows: rows.correlated(10.0),
    "wandering equilibrium": lambda rows: rows.correlated(np.inf),
}


def dense_rows(decay: xr.Dataset, forces: str) -> DenseRows:
    """Rows of a record as `Direct` has them beside a random force."""
    library = forces_to_identify(BOTH.select(forces.split()), None, sensors=True)
    constraints = constraint_map(Constraints(), library, {})
    runs = begin([decay], library, constraints, reference_frequency=None, shapes={})
    runs = solve(weak_rows(runs), constraints).runs
    (run, *_) = regress_stochastic(runs, constraints, "estimated")[0].rows.runs
    acting, weak = coloured(run.operator, run.sensor.filter_), rows_about(run, run.operator)
    form = run.form
    half = max(3, round(np.pi / float(np.median(np.diff(form.tau)))))
    padded = np.pad(np.hypot(run.x, run.v), half, mode="edge")
    amplitude = np.convolve(padded, np.ones(half) / half, "same")[half:-half]
    table = np.column_stack([weak.columns, weak.nuisances, weak.target])
    sensor = (acting @ acting.T).toarray()
    return DenseRows(table, sensor, form.value.toarray(), form.tau, run.x, run.v, amplitude)


def alike(decay: xr.Dataset, forces: str, seed: int) -> xr.Dataset:
    """A record simulated from the model that is identified, with white acceleration and noise."""
    result = methods.Direct(random_force="estimated").identify(decay, BOTH.select(forces.split()))
    start, density = result.start_angle.item(), result.random_force_density.item()
    time = decay.time.values
    motion = simulate(
        model_of(result), time, start, rate=result.start_rate.item(), random_force=density, seed=seed
    )
    noise = result.noise.item() * np.random.default_rng(seed).standard_normal(len(time))
    return xr.Dataset({"angle": ("time", motion.angle.values + noise)}, {"time": time})


def rows_of_table(title: str, rows: DenseRows) -> list[list[str]]:
    """Gains with the model alone, and beside all that goes with the motion."""
    both = {"the model": rows, "all that goes with the motion": rows.with_all_that_goes_with_the_motion()}
    return [[title, name, *(f"{gain:.0f}" for gain in each.gains())] for name, each in both.items()]


def drawn_rows(rows: DenseRows, draws: int) -> list[list[str]]:
    """Median gains of rows with a random force of each kind, beside all that goes with the motion."""
    rows, random, table = rows.with_all_that_goes_with_the_motion(), np.random.default_rng(0), []
    for kind in ("", *KINDS) if draws else ():
        median = np.median([rows.drawn(kind, random).gains() for _ in range(draws)], axis=0)
        table.append([f"{draws} drawn: {kind or 'white'}", "all", *(f"{gain:.0f}" for gain in median)])
    return table


def random_force_kinds(asked: Namespace) -> None:
    for record in (record for record in RECORDS if asked.only.lower() in record.title.lower()):
        decay = record.decay()
        middle, table, simulated = decay.sizes["time"] // 2, [], []
        halves = decay.isel(time=slice(middle)), decay.isel(time=slice(middle, None))
        for name, part in zip(("", ", first half", ", rest"), (decay, *halves), strict=True):
            table += rows_of_table(record.title + name, dense_rows(part, record.models))
        for seed in range(asked.simulated):
            made = alike(decay, record.models, seed)
            simulated.append(rows_of_table("", dense_rows(made, record.models)))
        for each in zip(*simulated, strict=True):
            largest = np.max([[float(gain) for gain in row[2:]] for row in each], axis=0)
            table.append([f"{len(each)} simulated", each[0][1], *(f"{gain:.0f}" for gain in largest)])
        table += drawn_rows(dense_rows(decay, record.models), asked.drawn)
        shown(record.title, ("record", "beside", *KINDS), table, 200)
