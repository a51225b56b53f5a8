"""The regression of Eq. 1 on its force columns: rows of all runs about their paths, and their solution."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask, dependent_columns
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.least_squares import ConstraintMap
from sysid_trib.likelihood.paths import RecordPath, path_of
from sysid_trib.likelihood.run_rows import RunRows, nuisances, run_rows
from sysid_trib.likelihood.sensor_noise import NoiseModel
from sysid_trib.likelihood.trials import TrialEffect, stiffness_powers
from sysid_trib.likelihood.variance_ratio import VarianceRatio, known_noise
from sysid_trib.likelihood.weak_form import SAMPLES_PER_ROW
from sysid_trib.records.inputs import inputs_for
from sysid_trib.records.smoothing import (
    KNOTS_PER_PERIOD,
    first_frequency,
    knot_intervals,
    nominal_frequency,
    sensor_noise,
)
from sysid_trib.simulation.initial_conditions import FittedMotion

# The paths of the first are at a frequency of two digits, and its operator knows no force that is free.
FIRST_ESTIMATES = 2
# Part by which a step of the square of a frequency lowers it at most.
LOWEST_STEP = 0.25


@dataclass(frozen=True)
class Solution:
    """Least squares of the rows.

    Attributes
    ----------
    values : (force + 1,) array of float
        Coefficients, zero where a force is not in the model, and the reference frequency (rad/s): a stiffness
        that was found is part of it.
    zeros : (run,) array of float, rad
        Of the sensor.
    covariance : (force + 1, force + 1) array of float
        Of the values.
    birge_ratio : float
        RMS residual of the rows, white and of unit variance.
    lags : int
        Lags over which the covariance allows for correlated residuals.
    constraints : ConstraintMap
        With the coefficients that are held at a bound.
    """

    values: Array
    zeros: Array
    covariance: Array
    birge_ratio: float
    lags: int
    constraints: ConstraintMap


@dataclass(frozen=True)
class Regression:
    """Rows of all runs about their paths, with common coefficients and a common frequency.

    Attributes
    ----------
    rows : tuple of RunRows
        Of each run.
    tables : tuple of (row, column) array of float
        Target, forces, stiffness where it is free, and zeros of the sensor of each run.
    trials : tuple of TrialEffect
        The forces offered, and terms of the sensor, their shapes held.
    constraints : ConstraintMap
        Of all of them.
    frequency_free : bool
        Whether the reference frequency is fitted.
    noises : tuple of VarianceRatio
        Of each run.
    coefficients : (force,) array of float
        The last estimate, that gave the paths.
    motions : tuple of FittedMotion
        Free motions of that estimate; none where the paths are smoothed records.
    lags : int
        Rows over which residuals may be correlated: two periods.
    """

    rows: tuple[RunRows, ...]
    tables: tuple[Array, ...]
    trials: tuple[TrialEffect, ...]
    constraints: ConstraintMap
    frequency_free: bool
    noises: tuple[VarianceRatio, ...]
    coefficients: Array
    motions: tuple[FittedMotion, ...] = ()
    lags: int = 2 * KNOTS_PER_PERIOD

    @property
    def paths(self) -> list[RecordPath]:
        """The path of each run."""
        return [rows.path for rows in self.rows]

    @property
    def values(self) -> Array:
        """The last estimate: coefficients and reference frequency (rad/s), (force + 1,)."""
        return np.append(self.coefficients, self.rows[0].path.frequency)

    @cached_property
    def white(self) -> Array:
        """The tables of all runs, their noises white and of unit variance, (row, column)."""
        of_runs = zip(self.rows, self.tables, self.noises, strict=True)
        return np.concatenate([rows.white(table, n.ratio, n.variance) for rows, table, n in of_runs])

    def free_table(self, run: int, constraints: ConstraintMap) -> Array:
        """Target and columns of a run by those that constraints leave free; see `ConstraintMap`."""
        powers = stiffness_powers(self.trials)
        return constraints.free_table(self.tables[run], self.coefficients, powers, self.frequency_free)

    def solve(self, active: Mask, constraints: ConstraintMap | None = None) -> Solution:
        """Least squares of the rows for the active coefficients, (force,).

        Notes
        -----
        Where the residual is correlated the covariance is the sandwich of `WhitenedLeastSquares` over two
        periods. Coefficients that would pass a bound are found by an active set and held there.
        """
        # Here, since importing pysindy takes as long as twenty identifications.
        from sysid_trib.likelihood.pysindy_features import WhitenedLeastSquares

        kept = (self.constraints if constraints is None else constraints).keep(active)
        powers, further = stiffness_powers(self.trials), self.tables[0].shape[1] - 1 - len(self.trials)
        columns, held = kept.with_further(self.coefficients, powers, self.frequency_free, further)
        design, target = self.white[:, 1:] @ columns, self.white[:, 0] - self.white[:, 1:] @ held
        fit = WhitenedLeastSquares(correlation_lags=self.lags).fit(design, target)
        solved, free, forces = fit.coef_[0], len(kept.free), len(self.trials)
        if kept.passed(solved[:free]):
            return self.solve(active, kept.hold_at_bounds(design, target))
        coefficients, frequency = (columns @ solved + held)[:forces], self.rows[0].path.frequency
        jacobian, factor = np.zeros((forces + 1, len(solved))), 1.0
        jacobian[:-1, :free] = kept.matrix
        if self.frequency_free:
            factor = float(np.sqrt(max(LOWEST_STEP, 1.0 + solved[free])))
            # From the stiffness to the frequency, and to coefficients that refer to it.
            jacobian[:-1, free] = kept.matrix @ (0.5 * powers * coefficients)[kept.free]
            jacobian[-1, free] = 0.5 * frequency * factor
        return Solution(
            np.append(kept.impose(coefficients * factor**powers), frequency * factor),
            solved[free + self.frequency_free :],
            jacobian @ fit.covariance_[0] @ jacobian.T,
            float(fit.noise_[0]),
            int(fit.lags_[0]),
            kept,
        )

    def with_errors_of_dropped(self, solution: Solution, active: Mask) -> Solution:
        """The solution with the variances that forces which are not active would have if they were added."""
        covariance = solution.covariance.copy()
        for j in self.constraints.free[~active[self.constraints.free]]:
            added = active.copy()
            added[j] = True
            covariance[j, j] = self.solve(added).covariance[j, j]
        return replace(solution, covariance=covariance)

    def about(
        self,
        paths: Sequence[RecordPath],
        coefficients: Array,
        motions: Sequence[FittedMotion] = (),
        operators: Sequence[RunRows] | None = None,
    ) -> "Regression":
        """The regression about other paths.

        Parameters
        ----------
        paths : sequence of RecordPath
        coefficients : (force,) array of float
            Of the estimate that gave them.
        motions : sequence of FittedMotion
            Where they are the exact motions of that estimate.
        operators : sequence of RunRows, optional
            With the operators of small deviations; linearised about the paths where left out.

        Notes
        -----
        Along an exact motion the integrals of Eq. 1 vanish, so that their errors cannot bias the result.
        """
        guess, rows = np.append(coefficients, 0.0), list[RunRows]()
        for run, path in enumerate(paths):
            rows.append(
                run_rows(path, self.trials, guess) if operators is None else operators[run].about(path)
            )
        tables = list[Array]()
        for run, of_run in enumerate(rows):
            columns, target = of_run.columns(self.trials), of_run.target
            if motions:
                acting = np.where([trial.force.kind == "force" for trial in self.trials], coefficients, 0.0)
                target = columns @ acting - of_run.operator @ (of_run.path.angle - motions[run].x)
            further = nuisances(of_run, run, len(rows), self.frequency_free)
            tables.append(np.column_stack([target, columns, further]))
        return replace(
            self, rows=tuple(rows), tables=tuple(tables), coefficients=coefficients, motions=tuple(motions)
        )

    def along_smoothed(self, values: Array) -> "Regression":
        """The regression about the same paths, with another estimate (force + 1,)."""
        return self.about([path.rescaled(float(values[-1])) for path in self.paths], values[:-1])

    def in_strong_form(self) -> "Regression":
        """Rows theta'' + theta of the smoothed records, one a sample.

        For comparison: the noise of second derivatives makes them far less precise than the weak form, and
        smoothing biases them.
        """
        tables = list[Array]()
        for run, path in enumerate(self.paths):
            # On fewer knots, where two samples or less are between those of test functions.
            near = path_of(path.time, path.angle, path.frequency, path.sensor)
            path = replace(path, form=near.form, spline=near.spline)
            x, acceleration = path.at_samples[0], path.spline(path.form.tau, 2)
            zeros = np.zeros((len(x), len(self.rows)))
            zeros[:, run] = -1.0
            columns = [
                -(acceleration + x),
                path.forces_at_samples(self.trials),
                *[x] * self.frequency_free,
                zeros,
            ]
            tables.append(np.column_stack(columns))
        lags = 2 * round(2.0 * np.pi / float(np.median(np.diff(self.paths[-1].form.tau))))
        strong = replace(self, tables=tuple(tables), lags=lags)
        levels = [np.sqrt(noise.variance) for noise in self.noises]
        white = np.concatenate([table / level for table, level in zip(tables, levels, strict=True)])
        strong.__dict__["white"] = white
        return strong

    @property
    def rms_forces(self) -> Array:
        """RMS of each force along the paths (force,), rad: a coefficient in units of it is a force."""
        squares = [path.mean_squares(self.trials) for path in self.paths]
        rms = np.sqrt(np.average(squares, axis=0, weights=[path.form.rows for path in self.paths]))
        return np.where(rms > 0, rms, 1.0)

    def select(self, optimizers: Sequence[Any]) -> Mask:
        """Forces to which all of the optimisers give a coefficient.

        Parameters
        ----------
        optimizers : sequence of pysindy optimisers
            They see the columns of the free coefficients, scaled to their RMS force (rad) and white;
            nuisances are projected out and never thresholded.

        Returns
        -------
        (force,) array of bool
            Fixed coefficients are always in the model, tied ones with those that they are tied to.
        """
        constraints = self.constraints
        kept = np.ones(len(constraints.free), bool)
        if optimizers:
            forces, further = np.split(self.white[:, 1:], [len(self.trials)], axis=1)
            columns = forces @ constraints.matrix / self.rms_forces[constraints.free]
            target = self.white[:, 0] - forces @ constraints.constant
            basis, _ = np.linalg.qr(further)
            table = np.column_stack([columns, target])
            outside = table - basis @ (basis.T @ table)
        for optimizer in optimizers:
            # The optimiser may be the user's: it must not come back changed.
            kept &= deepcopy(optimizer).fit(outside[:, :-1], outside[:, -1:]).coef_[0] != 0.0
        return constraints.active(kept)


def begin(
    decays: Sequence[xr.Dataset],
    library: ForceLibrary,
    constraints: ConstraintMap,
    *,
    reference_frequency: float | None,
    shapes: Mapping[str, float],
) -> Regression:
    """The regression about the smoothed records, linearised at a first estimate.

    Parameters
    ----------
    decays : sequence of Dataset
        With `angle(time)`.
    library : ForceLibrary
        The forces to identify.
    constraints : ConstraintMap
    reference_frequency : float or None, rad/s
        None has it fitted.
    shapes : mapping of str to float

    Raises
    ------
    DecayError
        The records are too short, or some of the forces are the same on them.
    """
    free = reference_frequency is None
    nominal = reference_frequency or nominal_frequency(first_frequency(decays))
    values = library.shape_values(shapes)
    trials = tuple(
        TrialEffect(
            force, {k: v for k, v in values.items() if k.partition(".")[0] == force.symbol}, held=True
        )
        for force in library
    )
    paths = [_first_path(run, library, nominal, number) for number, run in enumerate(decays, 1)]
    rows = sum(path.form.rows for path in paths)
    if rows < len(library) + 3 + len(paths):
        raise DecayError(f"{rows} rows cannot decide {len(library)} forces; give a longer record.")
    _refuse_dependent(paths, trials, library, constraints, free)
    noises = tuple(known_noise(path.sensor.innovation**2) for path in paths)
    # What is held acts from the first estimate on: a stiffness is no part of the frequency then.
    held = constraints.impose(np.zeros(len(library)))
    regression = Regression((), (), trials, constraints, free, noises, held).about(paths, held)
    for _ in range(FIRST_ESTIMATES):
        solution = regression.solve(np.ones(len(library), bool))
        regression = regression.along_smoothed(solution.values)
    return regression


def _first_path(run: xr.Dataset, library: ForceLibrary, frequency: float, number: int) -> RecordPath:
    time, angle = run.time.values.astype(float), run.angle.values.astype(float)
    sensor = NoiseModel(sensor_noise(run), np.ones(1))
    intervals = knot_intervals(frequency * (time - time[0]), SAMPLES_PER_ROW)
    path = path_of(time, angle, frequency, sensor, intervals=intervals)
    return replace(path, inputs=inputs_for(run, library), number=number)


def _refuse_dependent(
    paths: Sequence[RecordPath],
    trials: Sequence[TrialEffect],
    library: ForceLibrary,
    constraints: ConstraintMap,
    frequency_free: bool,
) -> None:
    """Refuse forces that are the same on the first paths; in place of a sensor's term what shows alike."""
    tables = list[Array]()
    for path in paths:
        terms, tau = path.sensor_terms(trials), path.form.tau
        curvature = np.gradient(np.gradient(terms, tau, axis=0), tau, axis=0)
        tables.append(path.forces_at_samples(trials) + terms + curvature)
    columns = np.concatenate(tables) @ constraints.matrix
    names = [library.symbols[i] for i in constraints.free]
    if frequency_free:
        columns = np.column_stack([columns, np.concatenate([path.at_samples[0] for path in paths])])
        names.append("the frequency")
    if same := dependent_columns(columns):
        equal = " and ".join(names[i] for i in same[0])
        raise DecayError(f"On this record {equal} are the same force; leave one out (--forces).")
