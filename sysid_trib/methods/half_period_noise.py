"""Noise of equations between half periods: the sensor's, and that of a motion with a random force.

A random force makes amplitude and phase do a random walk. The measured ones obey the equations all the same,
from any half period on: what an equation is off by is what came between its own half periods alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.cycles.impulse_response import half_period_responses
from sysid_trib.likelihood.random_force import RandomForce, RandomForceOption
from sysid_trib.likelihood.row_noise import covariance_band
from sysid_trib.likelihood.variance_ratio import (
    VarianceRatio,
    WhiteRows,
    held_ratio,
    ratio_span,
    variance_ratio,
)
from sysid_trib.likelihood.weak_form import whitened_by_both
from sysid_trib.records.half_sines import EnvelopeCurve

DENSITY = "random_force_density"


@dataclass(frozen=True)
class HalfPeriodEquations:
    """Linear equations between the half periods of one run, at an estimate of their parameters.

    Attributes
    ----------
    design : (equation, parameter) array of float
    residual : (equation,) array of float
    slopes : (equation, 2 half periods) sparse array of float
        Derivatives of the residual by the extrema (rad), then by their times (s).
    first : (equation,) array of int
        The first half period that each equation holds.
    """

    design: Array
    residual: Array
    slopes: sp.csr_matrix
    first: Index

    def without_bias(self, simulated: "HalfPeriodEquations") -> "HalfPeriodEquations":
        """These equations with what their residual is beyond that of a simulated motion."""
        count = min(len(self.residual), len(simulated.residual))
        residual = self.residual[:count] - simulated.residual[:count]
        return HalfPeriodEquations(self.design[:count], residual, self.slopes[:count], self.first[:count])

    def noise(self, measured: xr.Dataset) -> sp.csr_matrix:
        """How unit errors move each equation: of extrema, of their times and, if it is pushed, unit impulses.

        Parameters
        ----------
        measured : Dataset
            The envelope (see `envelope`, `with_random_force`).
        """
        names = ("extremum_standard_error", "extremum_time_standard_error")
        errors = np.concatenate([measured[name].values for name in names])
        sensor = sp.csr_matrix(self.slopes.multiply(errors))
        if DENSITY not in measured:
            return sensor
        impulses = np.sqrt(measured[DENSITY].item()) * self.impulses(measured)
        return sp.csr_matrix(sp.hstack([sensor, impulses], format="csr"))

    def impulses(self, measured: xr.Dataset) -> sp.csr_matrix:
        """How unit impulses of white acceleration of density 1 (rad/s^2)^2/Hz move each equation.

        Parameters
        ----------
        measured : Dataset
            The envelope.

        Returns
        -------
        (equation, impulse) sparse array of float
            `IMPULSES` impulses between neighbouring extrema, before the first and after the last.
        """
        lasting, passing = half_period_responses(measured)
        return sp.csr_matrix(self.by_later_steps() @ lasting + self.slopes @ passing)

    def by_later_steps(self) -> sp.csr_matrix:
        """Derivatives by what is added to a half period of an equation but its first, and to all after it."""
        entries = self.slopes.tocoo()
        count = entries.shape[1] // 2
        kind, half = np.divmod(entries.col, count)
        first = self.first[entries.row]
        parts = []
        for later in range(1, int(np.max(half - first)) + 1):
            held = half - first >= later
            column = kind[held] * count + first[held] + later
            parts.append((entries.data[held], entries.row[held], column))
        data, row, column = (np.concatenate(part) for part in zip(*parts, strict=True))
        return sp.csr_matrix((data, (row, column)), entries.shape)


def with_random_force(measured: xr.Dataset, ratio: VarianceRatio, curve: EnvelopeCurve) -> xr.Dataset:
    """An envelope whose errors are those of the sensor's noise and of a random force.

    Parameters
    ----------
    measured : Dataset
        The envelope (see `envelope`).
    ratio : VarianceRatio
        As `random_force_ratio` gives it.
    curve : {"half-sines", "analytic-signal"}
        What gave the extrema.
    """
    sensor = _at_noise(measured, float(np.sqrt(ratio.variance)))
    density = RandomForce.density_of(ratio.ratio * ratio.variance, swing_frequency(measured))
    return sensor.assign({DENSITY: density}).assign_attrs(curve=curve)


def swing_frequency(measured: xr.Dataset) -> float:
    """Median of the frequency of an envelope, rad/s: what the unit of the ratio refers to."""
    return float(np.median(measured.frequency.values))


def _at_noise(measured: xr.Dataset, noise: float) -> xr.Dataset:
    """The envelope with the errors of white noise of the sensor; the scatter of a random force is not its."""
    white = max(measured.white_noise.item(), float(np.finfo(float).tiny))
    names = {"extremum": "scatter_of_extrema", "extremum_time": "scatter_of_times"}
    errors = {f"{name}_standard_error": measured.attrs[scatter] for name, scatter in names.items()}
    return measured.assign({name: measured[name] * (noise / white / by) for name, by in errors.items()})


@dataclass(frozen=True)
class _RowsOfSensor(WhiteRows):
    """White rows whose variance is at least that of the samples' white noise.

    Waves and a wandering camera move extrema more than white noise does, nothing moves them less. Few half
    periods may look less noisy by chance: a random force would take what they lack.
    """

    least_variance: float = 0.0

    def restricted_deviance(self) -> tuple[float, float]:
        """Minus twice the logarithm of the restricted likelihood; and the variance."""
        deviance, variance = super().restricted_deviance()
        if variance >= self.least_variance:
            return deviance, variance
        ratio = variance / self.least_variance
        degrees_of_freedom = max(1, len(self.target) - self.design.shape[1])
        return deviance + degrees_of_freedom * float(ratio - 1.0 - np.log(ratio)), self.least_variance


def random_force_ratio(
    groups: Sequence[HalfPeriodEquations],
    measured: xr.Dataset,
    curve: EnvelopeCurve,
    option: RandomForceOption,
) -> VarianceRatio:
    """Ratio of a random force to the sensor's noise in one run, by restricted likelihood of its equations.

    Parameters
    ----------
    groups : sequence of HalfPeriodEquations
        Each with parameters of its own, of the same half periods.
    measured : Dataset
        Their envelope.
    curve : {"half-sines", "analytic-signal"}
        What gave the extrema.
    option : "auto" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, held.

    Returns
    -------
    VarianceRatio
        Of the growth of the variance of v a unit of tau to the variance of the sensor's noise (rad^2).
    """
    w, white = swing_frequency(measured), _at_noise(measured, 1.0).assign_attrs(curve=curve)
    order = np.argsort(np.concatenate([group.first for group in groups]), kind="stable")
    sensor = sp.vstack([group.noise(white) for group in groups]).tocsr()[order]
    impulses = sp.vstack([group.impulses(white) for group in groups]).tocsr()[order]
    noise, gram = (covariance_band(part @ part.T) for part in (sensor, impulses))
    gram = RandomForce.density_of(1.0, w) * gram
    design = sp.block_diag([group.design for group in groups]).toarray()
    table = np.column_stack([design, np.concatenate([group.residual for group in groups])])[order]

    def rows(ratio: float) -> WhiteRows:
        columns, determinant = whitened_by_both(noise, gram, ratio, table)
        return _RowsOfSensor(columns[:, -1], columns[:, :-1], determinant, measured.white_noise.item() ** 2)

    if not isinstance(option, str):
        return held_ratio(rows, RandomForce(float(option)).per_tau(w), None)
    times = measured.extremum_time.values
    # Of tau: largest impulses tried are those that hide the sensor's noise within so short a time.
    return variance_ratio(rows, *ratio_span(w * float(times[-1] - times[0]), 0.1))
