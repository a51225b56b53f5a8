"""Model at its most likely values, with the rows about its smoothed motions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.discovery.engine.likelihood import Likelihood
from sysid_trib.discovery.engine.paths import RecordPath, Terms
from sysid_trib.discovery.engine.run_rows import RunRows
from sysid_trib.discovery.engine.trials import Settings, TrialEffect, reference_power
from sysid_trib.likelihood.sensor_noise import NoiseModel, whitened

# Step of a shape parameter for its difference quotient, as a fraction of its range.
SHAPE_DIFFERENCE = 1e-4


@dataclass(frozen=True)
class FittedModel:
    """Model at its most likely values, with the rows about its smoothed motions.

    Attributes
    ----------
    trials : tuple of TrialEffect
        Forces and errors of the sensor, with their shapes.
    rows : tuple of RunRows
        Rows of each run.
    tables : tuple of (row, column) array of float
        Columns of each run: the trials, the stiffness if the frequency is fitted, the sensor zero of each
        run, and the shape steps as fractions of their ranges.
    likelihood : Likelihood
        Likelihood with the present shapes; its covariance includes their steps.
    stepped : Likelihood
        Likelihood of all columns, with the shape steps. Each step follows the tangent, so its decrease of the
        deviance is an expectation, not yet a result.
    at_ends : dict of int to (float, float)
        For the column of each shape held at an end of its range: the fraction of the range by which the free
        fit would leave the range, and the standard error of this fraction.
    settled : bool
        Whether paths and parameters have converged.
    """

    trials: tuple[TrialEffect, ...]
    rows: tuple[RunRows, ...]
    tables: tuple[Array, ...]
    likelihood: Likelihood
    stepped: Likelihood
    at_ends: dict[int, tuple[float, float]]
    settled: bool = True

    @property
    def coefficients(self) -> Array:
        """Coefficients of the trials, (trial,)."""
        return self.likelihood.coefficients[: len(self.trials)]

    @property
    def effects(self) -> tuple[str, ...]:
        """Symbols of the effects added to the start model."""
        return tuple(trial.force.symbol for trial in self.trials if trial.added)

    @property
    def terms(self) -> Terms:
        """The trials with their coefficients."""
        return list(zip(self.trials, self.coefficients.tolist(), strict=True))

    @property
    def shapes(self) -> dict[str, float]:
        """Shape parameters of all trials by their names."""
        return {name: value for trial in self.trials for name, value in trial.shapes.items()}

    @property
    def stiffness(self) -> float:
        """Relative difference between the square of the frequency and that of the paths."""
        return float(self.likelihood.coefficients[len(self.trials)]) if self.frequency_free else 0.0

    @property
    def estimate(self) -> Array:
        """Coefficients and, last, the stiffness, (trial + 1,)."""
        return np.append(self.coefficients, self.stiffness)

    @property
    def frequency_free(self) -> bool:
        """True if the frequency is fitted."""
        return self.rows[0].path.frequency_free

    @property
    def settings(self) -> Settings:
        """Settings of the search."""
        return self.rows[0].path.settings

    @cached_property
    def deviance(self) -> float:
        """Minus twice the log likelihood, corrected for a stiffness that the rows do not resolve."""
        excess = 0.0
        for rows, ratio in zip(self.rows, self.likelihood.ratios.tolist(), strict=True):
            if ratio > 0.0:
                tangent = rows.path.tangent(self.terms, self.stiffness)
                excess += rows.unresolved(tangent, ratio)
        return self.likelihood.deviance + excess

    @property
    def is_finite(self) -> bool:
        """True if the model and the steps of its shapes have a finite likelihood."""
        return bool(np.isfinite(self.likelihood.deviance) and np.isfinite(self.stepped.deviance))

    @property
    def columns(self) -> int:
        """Number of its columns: trials, nuisances, steps of the shapes."""
        return len(self.likelihood.coefficients)

    @property
    def stiffness_error(self) -> float:
        """Standard error of the stiffness; 0 if the frequency is fixed."""
        at = len(self.trials)
        return float(np.sqrt(self.likelihood.covariance[at, at])) if self.frequency_free else 0.0

    @property
    def shape_columns(self) -> list[tuple[int, str, int]]:
        """TrialEffect, name and column, from 0, of each shape parameter."""
        names = [(at, name) for at, trial in enumerate(self.trials) for name in trial.force.shape]
        first = self.columns - len(names)
        return [(at, name, first + i) for i, (at, name) in enumerate(names)]

    def columns_of(self, symbol: str) -> list[int]:
        """Return the columns of a force: its own and those of its shapes."""
        at = [trial.force.symbol for trial in self.trials].index(symbol)
        return [at, *(column for trial, _, column in self.shape_columns if trial == at)]

    def columns_without(self, symbols: Sequence[str]) -> list[int]:
        """Return the columns of the tables that remain without some forces; column 0 is the target."""
        gone = {column for symbol in symbols for column in self.columns_of(symbol)}
        return [1 + column for column in range(self.columns) if column not in gone]

    def sensor(self, run: int) -> NoiseModel:
        """Return the noise of the sensor in a run, with the level of the residual of the smoothed motion."""
        path = self.rows[run].path
        residual = path.angle - self.sensor_errors(run) - path.at_samples[0]
        filter_ = path.sensor.filter_
        return NoiseModel(root_mean_square(whitened(residual, filter_)), filter_)

    def without_caches(self) -> "FittedModel":
        """Return the model without the values that its runs can compute again, to save memory."""
        return replace(self, rows=tuple(replace(run, path=replace(run.path)) for run in self.rows))

    @property
    def follows(self) -> bool:
        """True if each path follows its record more closely than a motion at rest does."""
        pairs = [(run.path.angle, run.path.at_samples[0]) for run in self.rows]
        near = (np.max(np.abs(motion - angle)) < np.max(np.abs(angle)) for angle, motion in pairs)
        return bool(np.isfinite(self.likelihood.deviance) and all(near))

    @property
    def without_values(self) -> list[str]:
        """Symbols of the forces that are not finite along a path; all forces if slopes are not finite."""
        finite = np.ones(len(self.trials), bool)
        for run in self.rows:
            finite &= np.isfinite(run.path.columns(self.trials, run.operator)).all(axis=0)
        named = [t.force.symbol for t, good in zip(self.trials, finite, strict=True) if not good]
        return named or [trial.force.symbol for trial in self.trials]

    def sensor_errors(self, run: int) -> Array:
        """Return zero and errors of the sensor along a run's path, (sample,), rad."""
        zero = self.likelihood.coefficients[len(self.trials) + self.frequency_free + run]
        return np.asarray(zero + self.rows[run].path.sensor_errors(self.terms))

    def covariance_with_frequency(self) -> Array:
        """Return the covariance of coefficients and frequency (rad/s), for paths with the fitted frequency.

        With a slightly higher frequency, smaller coefficients give the same force.
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
        """Return the columns of the parameters in the rows of any run, (row, parameter), with covariance.

        The zeros of the sensor are left out, because each run has its own zero.
        """
        first = len(self.trials) + self.frequency_free
        table = table_of(rows, 0, 1, self.trials)
        for at, _, column in self.shape_columns:
            table[:, column + 1 - len(self.rows)] *= self.coefficients[at]
        kept = [*range(first), *range(first + len(self.rows), self.columns)]
        return np.delete(table, first, axis=1), self.likelihood.covariance[np.ix_(kept, kept)]

    def shape_errors(self) -> dict[str, float]:
        """Return the standard errors of the shape parameters, by their names."""
        errors, by_name = np.sqrt(np.diag(self.likelihood.covariance)), dict[str, float]()
        for at, name, column in self.shape_columns:
            trial = self.trials[at]
            slope = trial.force.shape[name].slope(trial.value(name))
            by_name[f"{trial.force.symbol}.{name}"] = float(errors[column] * slope)
        return by_name

    def white_residuals(self) -> list[Array]:
        """Return the residuals, white and of unit variance."""
        return [table[:, 0] - table[:, 1:] @ self.likelihood.coefficients for table in self.white_tables()]

    def white_tables(self) -> list[Array]:
        """Return target and columns of each run, (row, 1 + column), with white noises of unit variance."""
        return [
            rows.whitened(np.column_stack([rows.target, table]), self.likelihood, at)
            for at, (rows, table) in enumerate(zip(self.rows, self.tables, strict=True))
        ]

    def ahead(self, shapes: Array) -> Array:
        """Return the changes of coefficients and stiffness due to these steps of the shapes, (trial + 1,)."""
        first, count = self.columns - len(shapes), len(self.trials)
        covariance = self.stepped.covariance
        errors = np.sqrt(np.diag(covariance)[first:])
        errors[errors == 0.0] = 1.0  # held at an end of its range
        inner = covariance[first:, first:] / np.outer(errors, errors)
        along = np.linalg.pinv(inner, hermitian=True) @ (shapes / errors) / errors
        changes = covariance[: count + 1, first:] @ along
        return np.asarray(changes if self.frequency_free else np.append(changes[:count], 0.0))

    def next_paths(
        self, coefficients: Array, part: float = 1.0, random_force: float = 1.0
    ) -> list[RecordPath]:
        """Return the most likely motions with these forces, or paths a fraction of the way to them."""
        paths = []
        for at, (rows, table) in enumerate(zip(self.rows, self.tables, strict=True)):
            residual = rows.target - table @ self.stepped.coefficients
            ratio = random_force * float(self.stepped.ratios[at])
            errors = self.sensor_errors(at), rows.path.sensor_slopes(self.terms)
            motion = rows.smoothed_motion(residual, *errors, ratio, part)
            follower = rows.path.follow(motion, list(zip(self.trials, coefficients.tolist(), strict=True)))
            paths.append(replace(follower, ratio=float(self.likelihood.ratios[at])))
        return paths

    def possible_rows(self) -> list[RunRows]:
        """Return the rows of each run along a motion drawn from the distribution of its possible motions."""
        rows_of_runs, random = [], np.random.default_rng(self.settings.seed)
        for at, rows in enumerate(self.rows):
            deviation, ratio = np.sqrt(self.likelihood.variances[at]), float(self.likelihood.ratios[at])
            slopes = rows.path.sensor_slopes(self.terms)
            aside = rows.possible_deviation(float(deviation), slopes, ratio, random)
            rows_of_runs.append(replace(rows, path=rows.path.through(rows.path.at_samples[0] + aside)))
        return rows_of_runs

    def next_steps(self, reach: float) -> Array:
        """Return the shape steps, of `reach` at most, as fractions of their ranges, (shape,).

        A step changes an effect by at most the effect's own size, because its tangent is not valid beyond. A
        step of a frequency changes the phase over the record by one radian at most.
        """
        sizes = np.sqrt(np.sum([np.sum(table**2, axis=0) for table in self.tables], axis=0))
        steps = list[float]()
        for at, _, column in self.shape_columns:
            own_size = abs(self.coefficients[at]) * sizes[at] / max(sizes[column], np.finfo(float).tiny)
            most = min(reach, own_size)
            steps.append(float(np.clip(self.stepped.coefficients[column], -most, most)))
        return np.array(steps)

    def next_trials(self, steps: Array) -> list[TrialEffect]:
        """Return the trials with their shapes changed by these steps, (shape,), within their ranges."""
        trials = list(self.trials)
        for (at, name, _), step in zip(self.shape_columns, steps.tolist(), strict=True):
            trials[at] = trials[at].stepped(name, step)
        return trials


def table_of(rows: RunRows, run: int, runs: int, trials: Sequence[TrialEffect]) -> Array:
    """Return columns of trials, of stiffness and of each run's zero, and slopes of trials by their shapes."""
    # Step towards the middle of the range, so that the changed shape stays within it.
    deviated = [
        (at, name, SHAPE_DIFFERENCE if trial.part(name) < 0.5 else -SHAPE_DIFFERENCE)
        for at, trial in enumerate(trials)
        for name in trial.force.shape
    ]
    # One call for all trials: history-dependent forces then share one integration along the motion.
    whole = rows.columns([*trials, *(trials[at].stepped(name, step) for at, name, step in deviated)])
    columns, aside = np.split(whole, [len(trials)], axis=1)
    slopes = [
        (column - columns[:, at]) / step for column, (at, _, step) in zip(aside.T, deviated, strict=True)
    ]
    stiffness = [rows.path.stiffness_column] * rows.path.frequency_free
    zeros = np.zeros((len(columns), runs))
    zeros[:, run] = -(rows.operator @ np.ones(len(rows.path.time)))
    return np.column_stack([columns, *stiffness, zeros, *slopes])
