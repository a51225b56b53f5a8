"""Exact fits: forces and errors of the sensor with their shapes, along the motion that they imply."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.likelihood import Likelihood, RunProducts, likelihood
from sysid_trib.discrepancy.paths import RecordPath
from sysid_trib.discrepancy.run_rows import RunRows, nuisances, run_rows
from sysid_trib.discrepancy.settings import Settings
from sysid_trib.discrepancy.trials import (
    TrialEffect,
    end_of_range,
    from_unit,
    reference_power,
    slope_of_unit,
    stepped_shape,
    to_unit,
)
from sysid_trib.errors import SysidTribError
from sysid_trib.noise.residual_noise import NoiseModel
from sysid_trib.records.runs import root_mean_square

# Rounds after which a path goes half of its way.
WHOLE_STEPS = 3
# A kink of a force may have the path swing about where it settles: then the best two rounds agree to this,
# the deviance of one standard error.
ROUNDS_AGREE = 1.0
# Difference of a shape parameter for its column, in parts of its range.
SHAPE_DIFFERENCE = 1e-4
# A path runs away to where nothing is finite, or rows say nothing: there is no fit.
NOT_FITTED = (SysidTribError, np.linalg.LinAlgError, ValueError)


@dataclass(frozen=True)
class FittedModel:
    """A model at its most likely, with the rows about its smoothed motions.

    Attributes
    ----------
    trials : tuple of TrialEffect
        Forces and errors of the sensor, with their shapes.
    coefficients : (trial,) array of float
    stiffness : float
        By which the square of the frequency differs from the paths', as a part of it.
    rows : tuple of RunRows
        Of each run.
    tables : tuple of (row, column) array of float
        Columns in each run: trials, stiffness where the frequency is fitted, zeros of the sensor in each run,
        steps of the shapes in parts of their ranges.
    frequency_free : bool
    likelihood : Likelihood
        Of these columns.
    at_ends : dict of int to (float, float)
        Of the columns of shapes held at an end of their range: by how much of it they would leave it, and
        the standard error of that.
    settled : bool
        Whether paths and parameters have.
    """

    trials: tuple[TrialEffect, ...]
    coefficients: Array
    stiffness: float
    rows: tuple[RunRows, ...]
    tables: tuple[Array, ...]
    frequency_free: bool
    likelihood: Likelihood
    at_ends: dict[int, tuple[float, float]]
    settled: bool = True

    @property
    def settings(self) -> Settings:
        """Of the search."""
        return self.rows[0].path.settings

    @cached_property
    def deviance(self) -> float:
        """Minus twice the logarithm of the likelihood, with what rows of other models resolve otherwise."""
        ratios = self.likelihood.ratios.tolist()
        excess = [
            rows.unresolved(rows.path.tangent(self.trials, self.coefficients, self.stiffness), ratio)
            for rows, ratio in zip(self.rows, ratios, strict=True)
            if ratio > 0.0
        ]
        return self.likelihood.deviance + float(sum(excess))

    @property
    def columns(self) -> int:
        """Number of its columns: trials, nuisances, steps of the shapes."""
        return len(self.likelihood.coefficients)

    @property
    def stiffness_error(self) -> float:
        """Standard error of the stiffness; 0 where the frequency is held."""
        at = len(self.trials)
        return float(np.sqrt(self.likelihood.covariance[at, at])) if self.frequency_free else 0.0

    @property
    def shape_columns(self) -> list[tuple[int, str, int]]:
        """TrialEffect, name and column, from 0, of each shape parameter."""
        names = [(at, name) for at, trial in enumerate(self.trials) for name in trial.force.shape]
        first = self.columns - len(names)
        return [(at, name, first + i) for i, (at, name) in enumerate(names)]

    def columns_of(self, symbol: str) -> list[int]:
        """Columns of a force: its own and those of its shapes."""
        at = [trial.force.symbol for trial in self.trials].index(symbol)
        return [at, *(column for trial, _, column in self.shape_columns if trial == at)]

    def columns_without(self, symbols: Sequence[str]) -> list[int]:
        """Columns of the tables, the target at 0, that stay without some forces."""
        gone = {column for symbol in symbols for column in self.columns_of(symbol)}
        return [1 + column for column in range(self.columns) if column not in gone]

    def sensor(self, run: int) -> NoiseModel:
        """Noise of the sensor in a run, its level that of what the smoothed motion leaves of the record."""
        path = self.rows[run].path
        level = root_mean_square(path.angle - self.sensor_errors(run) - path.at_samples[0])
        return NoiseModel(
            level / NoiseModel(1.0, path.sensor.filter_).standard_deviation, path.sensor.filter_
        )

    def light(self) -> "FittedModel":
        """The same without what its runs can compute again: many are kept."""
        return replace(self, rows=tuple(replace(run, path=replace(run.path)) for run in self.rows))

    @property
    def follows(self) -> bool:
        """Whether each path is nearer to its record than rest."""
        near = [
            np.max(np.abs(run.path.at_samples[0] - run.path.angle)) < np.max(np.abs(run.path.angle))
            for run in self.rows
        ]
        return bool(np.isfinite(self.likelihood.deviance) and all(near))

    @property
    def without_values(self) -> list[str]:
        """Symbols of the forces that are not finite along a path; of all where their slopes are not."""
        finite = np.ones(len(self.trials), bool)
        for run in self.rows:
            finite &= np.isfinite(run.path.columns(self.trials, run.operator)).all(axis=0)
        named = [t.force.symbol for t, good in zip(self.trials, finite, strict=True) if not good]
        return named or [trial.force.symbol for trial in self.trials]

    def sensor_errors(self, run: int) -> Array:
        """Zero and errors of the sensor along a run's path, (sample,), rad."""
        b, count = self.likelihood.coefficients, len(self.trials)
        sensors = [at for at, trial in enumerate(self.trials) if trial.force.kind == "sensor"]
        errors = self.rows[run].path.sensor_values([self.trials[i] for i in sensors]) @ b[sensors]
        return np.asarray(b[count + self.frequency_free + run] + errors)

    def covariance_with_frequency(self) -> Array:
        """Covariance of the coefficients and the frequency (rad/s), of a fit whose paths have its frequency.

        A frequency that is a little higher has smaller coefficients give the same force.
        """
        count, whole = len(self.trials), self.likelihood.covariance
        if not self.frequency_free:
            return np.pad(whole[:count, :count], (0, 1))
        powers = np.array([reference_power(trial.force) for trial in self.trials])
        jacobian = np.eye(count + 1)
        jacobian[:count, -1] = 0.5 * powers * self.coefficients
        jacobian[-1, -1] = 0.5 * self.rows[0].path.frequency
        return np.asarray(jacobian @ whole[: count + 1, : count + 1] @ jacobian.T)

    def without_zeros(self, rows: RunRows) -> tuple[Array, Array]:
        """Columns of the parameters in the rows of any run, (row, parameter), and their covariance.

        Without the zeros of the sensor, which are each run's own.
        """
        guess, first = np.append(self.coefficients, self.stiffness), len(self.trials) + self.frequency_free
        table = _table(rows, 0, 1, self.trials, guess, self.frequency_free)
        kept = [*range(first), *range(first + len(self.rows), self.columns)]
        return np.delete(table, first, axis=1), self.likelihood.covariance[np.ix_(kept, kept)]

    def shape_errors(self) -> dict[str, float]:
        """Standard errors of the shape parameters, by their names."""
        errors = np.sqrt(np.diag(self.likelihood.covariance))
        errors_by_name = {}
        for at, name, column in self.shape_columns:
            trial, key = self.trials[at], f"{self.trials[at].force.symbol}.{name}"
            errors_by_name[key] = float(
                errors[column] * slope_of_unit(trial.force.shape[name], trial.shapes[key])
            )
        return errors_by_name

    def residuals(self) -> list[Array]:
        """What the model leaves of each run's rows, (row,)."""
        b = self.likelihood.coefficients
        return [rows.target - table @ b for rows, table in zip(self.rows, self.tables, strict=True)]

    def white_residuals(self) -> list[Array]:
        """The same, white and of unit variance."""
        pairs = zip(self.rows, self.residuals(), strict=True)
        return [
            rows.whitened(residual[:, None], self.likelihood, at)[:, 0]
            for at, (rows, residual) in enumerate(pairs)
        ]

    def white_tables(self) -> list[Array]:
        """Target and columns of each run, (row, 1 + column), its noises white and of unit variance."""
        return [
            rows.whitened(np.column_stack([rows.target, table]), self.likelihood, at)
            for at, (rows, table) in enumerate(zip(self.rows, self.tables, strict=True))
        ]

    def is_on_its_way(self, reach: float) -> bool:
        """Whether a shape would go further than it may in a round, and by more than its error.

        The deviance is that along the tangent: it may have settled before the shape has.
        """
        steps, errors = self.likelihood.coefficients, np.sqrt(np.diag(self.likelihood.covariance))
        return any(abs(steps[at]) > max(reach, errors[at]) for *_, at in self.shape_columns)

    def next_paths(self, coefficients: Array, part: float = 1.0) -> list[RecordPath]:
        """The most likely motions, or a part of the way there; their fine part by such forces, (trial,)."""
        paths = []
        for at, (rows, residual) in enumerate(zip(self.rows, self.residuals(), strict=True)):
            ratio = float(self.likelihood.ratios[at])
            errors = self.sensor_errors(at), rows.path.sensor_slopes(self.trials, self.coefficients)
            motion = rows.smoothed_motion(residual, *errors, ratio, part)
            paths.append(rows.path.follow(motion, self.trials, coefficients))
        return paths

    def possible_rows(self, random: np.random.Generator) -> list[RunRows]:
        """The rows of each run along a motion that may be the true one as well, drawn by its probability."""
        rows_of_runs = []
        for at, rows in enumerate(self.rows):
            deviation, ratio = np.sqrt(self.likelihood.variances[at]), float(self.likelihood.ratios[at])
            slopes = rows.path.sensor_slopes(self.trials, self.coefficients)
            aside = rows.possible_deviation(float(deviation), slopes, ratio, random)
            rows_of_runs.append(replace(rows, path=rows.path.beside(aside)))
        return rows_of_runs

    def next_trials(self, reach: float) -> list[TrialEffect]:
        """The trials with their shapes a step further, of `reach` at most, within their ranges.

        No step changes an effect by more than its own size: a tangent does not hold so far. Of a frequency
        that is a radian of its phase over the record.
        """
        shapes = [dict(trial.shapes) for trial in self.trials]
        sizes = np.sqrt(np.sum([np.sum(table**2, axis=0) for table in self.tables], axis=0))
        for at, name, column in self.shape_columns:
            trial, key = self.trials[at], f"{self.trials[at].force.symbol}.{name}"
            own_size = abs(self.coefficients[at]) * sizes[at] / max(sizes[column], np.finfo(float).tiny)
            most = min(reach, own_size)
            step = np.clip(self.likelihood.coefficients[column], -most, most)
            shapes[at][key] = stepped_shape(trial.force, name, trial.shapes[key], step)
        return [replace(trial, shapes=table) for trial, table in zip(self.trials, shapes, strict=True)]


def fit_model(
    paths: Sequence[RecordPath],
    trials: Sequence[TrialEffect],
    *,
    frequency_free: bool,
    first: Array | None = None,
    worst: float = np.inf,
    possible: Callable[["FittedModel"], bool] = lambda model: True,
) -> FittedModel:
    """Fit coefficients, shapes, frequency and both variances of each run along smoothed motions.

    Parameters
    ----------
    paths : sequence of RecordPath
        First guesses.
    trials : sequence of TrialEffect
        The model, with first guesses of the shapes.
    frequency_free : bool
    first : (trial + 1,) array of float, optional
        First guess of the coefficients and the stiffness, for the operator of small deviations.
    worst : float
        A fit that will not reach this deviance, by what its last round gained, is given up.
    possible : callable
        Whether physics allows a model: a fit that has left it for two rounds is given up.

    Notes
    -----
    The next path is the most likely motion of the model at hand: without a random force it becomes a free
    motion (Newton's method on all samples), with one the smoothed motion.
    """
    guess = np.zeros(len(trials) + 1) if first is None else first
    model, settings = fitted_along(paths, trials, guess, frequency_free), paths[0].settings
    rounds, reach, before, astray, part = list[FittedModel](), settings.shape_step, 0.0, 0, 1.0
    for turn in range(settings.rounds):
        latest = np.append(model.coefficients, model.stiffness)
        guess = guess + part * (latest - guess) if turn else latest
        nearer = model.next_paths(guess[:-1], part)
        try:
            after = fitted_along(nearer, model.next_trials(reach), guess, frequency_free)
        except NOT_FITTED:
            return _best([*rounds, model])
        if not np.isfinite(after.likelihood.deviance):
            return _best([*rounds, model])
        fall, model = model.likelihood.deviance - after.likelihood.deviance, after
        # Falls shrink as a geometric series at least: the next one is this one times their ratio.
        next_fall = abs(fall) * min(1.0, abs(fall) / before) if before else abs(fall)
        on_its_way = model.is_on_its_way(reach)
        if next_fall < settings.least_gain and not on_its_way:
            return model
        before = abs(fall)
        astray = 0 if possible(model) else astray + 1
        if astray > 1 and turn > 1:
            return replace(model, settled=False)
        if turn > 1 and not on_its_way and model.likelihood.deviance - 2.0 * abs(fall) > worst:
            return replace(model, settled=False)
        # Shapes are stepped along tangents: one that leads up was too long. A force that is narrow or has a
        # history may have path and coefficients swing about where they settle.
        uphill = bool(turn) and fall < 0.0
        reach *= 0.5 if uphill else 1.0
        part = 0.5 if uphill or turn + 1 >= WHOLE_STEPS else part
        rounds.append(model.light())
    best, next_best = sorted(rounds, key=lambda fitted: fitted.likelihood.deviance)[:2]
    return replace(best, settled=next_best.likelihood.deviance - best.likelihood.deviance < ROUNDS_AGREE)


def _best(rounds: Sequence[FittedModel]) -> FittedModel:
    """The likeliest round of a path that ran away."""
    return replace(min(rounds, key=lambda fitted: fitted.likelihood.deviance), settled=False)


def fitted_along(
    paths: Sequence[RecordPath], trials: Sequence[TrialEffect], guess: Array, frequency_free: bool
) -> FittedModel:
    """The most likely coefficients, and steps of the shapes, along paths that are held."""
    rows = tuple(run_rows(path, trials, guess) for path in paths)
    tables = [_table(run, at, len(rows), trials, guess, frequency_free) for at, run in enumerate(rows)]
    products = [run.products(table) for run, table in zip(rows, tables, strict=True)]
    most_likely, at_ends = _within_ranges(products, tables[0].shape[1], trials)
    b, count = most_likely.coefficients, len(trials)
    stiffness = float(b[count]) if frequency_free else 0.0
    forces, columns = tuple(trials), tuple(tables)
    return FittedModel(forces, b[:count], stiffness, rows, columns, frequency_free, most_likely, at_ends)


def _within_ranges(
    products: Sequence[RunProducts], count: int, trials: Sequence[TrialEffect]
) -> tuple[Likelihood, dict[int, tuple[float, float]]]:
    """Maximum likelihood in `count` columns; shapes at an end of their range that would leave it are held."""
    shapes = [(t.force.shape[k], t.shapes[f"{t.force.symbol}.{k}"]) for t in trials for k in t.force.shape]
    first = count - len(shapes)
    held: dict[int, tuple[float, float]] = {}
    while True:
        free = [column for column in range(count) if column not in held]
        likeliest = likelihood(products, [1 + column for column in free])
        steps = dict(zip(free, likeliest.coefficients.tolist(), strict=True))
        leaving = [
            first + i
            for i, (shape, value) in enumerate(shapes)
            if (side := end_of_range(shape, value)) and side * steps.get(first + i, 0.0) > 0.0
        ]
        if not leaving:
            return likeliest.among(free, count), held
        errors = dict(zip(free, np.sqrt(np.diag(likeliest.covariance)).tolist(), strict=True))
        held |= {column: (abs(steps[column]), errors[column]) for column in leaving}


def _table(
    rows: RunRows, run: int, runs: int, trials: Sequence[TrialEffect], guess: Array, frequency_free: bool
) -> Array:
    """Columns of the trials, the nuisances, and the steps of the shapes."""
    columns = rows.columns(trials)
    steps = []
    for at, trial in enumerate(trials):
        for name in trial.force.shape:
            beside, difference = _beside(trial, name)
            steps.append(guess[at] * (rows.columns([beside])[:, 0] - columns[:, at]) / difference)
    return np.column_stack([columns, nuisances(rows, run, runs, frequency_free), *steps])


def _beside(trial: TrialEffect, name: str) -> tuple[TrialEffect, float]:
    """The trial with a shape a little aside, and by how much of its range."""
    shape, key = trial.force.shape[name], f"{trial.force.symbol}.{name}"
    part = to_unit(shape, trial.shapes[key])
    step = SHAPE_DIFFERENCE if part < 0.5 else -SHAPE_DIFFERENCE
    value = float(from_unit(shape, np.asarray(part + step)))
    return replace(trial, shapes={**trial.shapes, key: value}), step
