"""A model fitted to its runs, in units of their noise: its residual, and what its parameters can explain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.candidate_sensitivities import ReferenceMotion
from sysid_trib.noise.residual_noise import NoiseModel, estimate_noise
from sysid_trib.simulation.simulate import FAST
from sysid_trib.trajectory_fit.least_squares import fitted, grown
from sysid_trib.trajectory_fit.problem import FitProblem, WhitenedRecord
from sysid_trib.trajectory_fit.sensitivities import tangent

# Fits are done when chi-square falls by less than this part: far below what a candidate must gain.
REFIT_TOLERANCE = 1e-5


@dataclass(frozen=True)
class Baseline:
    """A model fitted to its runs.

    Attributes
    ----------
    problem : FitProblem
        The fit; its records whiten to unit noise.
    values : (parameter,) array of float
        The parameters.
    noises : tuple of NoiseModel
        Of each run.
    residual : (sample,) array of float
        Record minus motion of all runs, whitened, in units of the noise.
    table : (sample, parameter) array of float
        Sensitivities of the motion, whitened.
    noise_bases : tuple of array
        Of each run, what its noise was estimated beside; empty where the noise was given.
    """

    problem: FitProblem
    values: Array
    noises: tuple[NoiseModel, ...]
    residual: Array
    table: Array
    noise_bases: tuple[Array, ...] = ()

    @property
    def chi_square(self) -> float:
        """Sum of squares of the residual, in units of the noise."""
        return float(self.residual @ self.residual)

    @cached_property
    def column_space(self) -> Array:
        """Orthonormal basis of what the parameters can explain, (sample, parameter)."""
        return orthonormal_basis(self.table)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters."""
        return self.problem.parameters.covariance(self.table, self.values)

    @cached_property
    def references(self) -> list[ReferenceMotion]:
        """Each run's motion with its small deviations; a `SimulationError` if one cannot be followed."""
        parameters = self.problem.parameters
        model, starts = parameters.model(self.values), parameters.per_run(self.values)
        return [
            ReferenceMotion(
                model, (float(a), float(r)), record.time, tangent(model, record.time, float(a), float(r))
            )
            for record, (a, r, _) in zip(self.problem.records, starts, strict=True)
        ]

    def split_by_run(self, values: Array) -> list[Array]:
        """Whitened values of all runs, (sample,), run by run."""
        counts = [len(r.time) - n.warm_up for r, n in zip(self.problem.records, self.noises, strict=True)]
        return np.split(values, np.cumsum(counts)[:-1])


def project_out(values: Array, space: Array) -> Array:
    """The part of values (sample, ...) outside of an orthonormal basis (sample, column)."""
    return np.asarray(values - space @ (space.T @ values))


def orthonormal_basis(table: Array) -> Array:
    """Orthonormal basis of the columns of a table, whatever their sizes."""
    size = np.linalg.norm(table, axis=0)
    basis, _ = np.linalg.qr(table / np.where(size > 0.0, size, 1.0))
    return np.asarray(basis)


def fit(
    problem: FitProblem,
    values: Array,
    noises: Sequence[NoiseModel],
    *,
    far: bool = False,
    evaluations: int = 40,
) -> Baseline:
    """Fit a model from a first guess, in noise that is known; over a growing window if the guess is far."""
    weighted = with_noise(problem, noises)
    if far:
        values = grown(weighted, values, tolerance=REFIT_TOLERANCE)
    best = fitted(weighted, values, tolerance=REFIT_TOLERANCE, evaluations=evaluations)
    return Baseline(weighted, best.values, tuple(noises), -best.residual, best.sensitivity)


def with_noise(problem: FitProblem, noises: Sequence[NoiseModel]) -> FitProblem:
    """The problem whose residuals are whitened to unit noise."""
    records = [
        replace(record, filter_=noise.filter_, weight=1.0 / noise.innovation)
        for record, noise in zip(problem.records, noises, strict=True)
    ]
    return replace(problem, records=tuple(records))


def refit_in_residual_noise(problem: FitProblem, values: Array, bases: Sequence[Array]) -> Baseline:
    """A fit with the noise of its residual, estimated beside a modulated harmonic basis of each run."""
    residuals = zip(problem.residuals(values), bases, strict=True)
    noises = [estimate_noise(residual, basis) for residual, basis in residuals]
    return replace(fit(problem, values, noises), noise_bases=tuple(bases))


def fit_records(runs: Sequence[xr.Dataset]) -> tuple[WhitenedRecord, ...]:
    """The runs as records of a fit."""
    return tuple(
        WhitenedRecord(run.time.values.astype(float), run.angle.values.astype(float), engine=FAST)
        for run in runs
    )
