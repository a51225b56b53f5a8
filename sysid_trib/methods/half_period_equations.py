"""Equations between neighbouring half periods: their two noises, and their least squares."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.linalg import cho_solve_banded

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.sensor_noise import covariance_band
from sysid_trib.likelihood.smoothness import smooth_least_squares
from sysid_trib.likelihood.weak_form import cholesky_factor, whiten
from sysid_trib.records.half_sines import half_period_responses

# Standard errors of an envelope: of extrema and of their times; and the density of a random force.
ENVELOPE_ERRORS = ("extremum_standard_error", "extremum_time_standard_error")
DENSITY = "random_force_density"
Equations: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]
"""Function from extrema (rad, positive) and their times since the first sample (s) to design and target.

Shapes are (instant, parameter) and (instant,), or (instant, 2, parameter) and (instant, 2) for two equations
at each instant. The equations of instant i contain only half periods i to i + m, where m is the number of
half periods minus the number of instants.
"""
Rule: TypeAlias = Literal["weighted", "plain", "last"]

# Relative to an extremum and to a half period.
DIFFERENCE_STEP = 1e-5
ROUNDING = 1e-14


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
        First half period in each equation.
    """

    design: Array
    residual: Array
    slopes: sp.csr_matrix
    first: Index

    def noise(self, measured: xr.Dataset) -> sp.csr_matrix:
        """Return the change of each equation by unit errors of extrema and times, and by unit impulses.

        Parameters
        ----------
        measured : Dataset
            The envelope (see `envelope`, `with_random_force`).
        """
        parts = [self.slopes.multiply(errors_of_half_periods(measured))]
        if DENSITY in measured:
            parts.append(np.sqrt(measured[DENSITY].item()) * self.impulses(measured))
        return sp.hstack(parts, format="csr")

    def impulses(self, measured: xr.Dataset) -> sp.csr_matrix:
        """Return the change of each equation by unit impulses of density 1 (rad/s^2)^2/Hz.

        Parameters
        ----------
        measured : Dataset
            The envelope.

        Returns
        -------
        (equation, impulse) sparse array of float
            `IMPULSES` impulses between neighbouring extrema, before the first extremum and after the last.
        """
        # A step at a half period changes this half period and all later ones of an equation, but not its
        # first. So the slope of a half period counts for steps at all half periods after the first, up to its
        # own.
        slopes = self.slopes.tocoo()
        times = slopes.col % (slopes.shape[1] // 2) - self.first[slopes.row]
        steps = np.arange(times.sum()) - np.repeat(np.cumsum(times) - times, times)
        column = np.repeat(slopes.col - times, times) + 1 + steps
        data, row = (np.repeat(part, times) for part in (slopes.data, slopes.row))
        by_later_steps = sp.csr_matrix((data, (row, column)), slopes.shape)
        lasting, passing = half_period_responses(measured)
        return sp.csr_matrix(by_later_steps @ lasting + self.slopes @ passing)


@dataclass(frozen=True)
class Penalty:
    """Prior knowledge of the parameters of curves.

    Attributes
    ----------
    precision : (parameter,) array of float
        Inverse prior variance of each parameter, over the variance of the whitened equations; zero without a
        penalty.
    mean : (parameter,) array of float
        Prior mean.
    """

    precision: Array
    mean: Array


@dataclass(frozen=True)
class EquationSolution:
    """Least squares of equations between the half periods of all runs, by common parameters.

    Attributes
    ----------
    parameters : (parameter,) array of float
    influence : (parameter, error) array of float
        Effect of unit errors of the extrema, of their times and, with a random force, of unit impulses; then,
        for curves, of unit errors of their penalty and smoothness.
    runs : sequence of HalfPeriodEquations
        Equations of each run, with their residual.
    factors : sequence of (band, equation) array of float
        Cholesky factor of the covariance of each run's equations, lower banded.
    fitted : float
        Number of parameters; for curves, which are penalised, the effective number.
    precision : (parameter,) array of float, optional
        Parameters of the `Penalty`, if there are curves.
    """

    parameters: Array
    influence: Array
    runs: Sequence[HalfPeriodEquations]
    factors: Sequence[Array]
    fitted: float
    precision: Array | None = None

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return max(1, round(sum(len(run.residual) for run in self.runs) - self.fitted))

    @property
    def chi_square(self) -> float:
        """Sum of squares of the residual over its covariance."""
        pairs = zip(self.runs, self.factors, strict=True)
        whites = [whiten(factor, run.residual) for run, factor in pairs]
        return float(sum(white @ white for white in whites))

    def without_bias(self, simulated: "EquationSolution") -> "EquationSolution":
        """Return this solution with the residual of a simulated motion's solution subtracted from its own."""
        runs = []
        for run, other in zip(self.runs, simulated.runs, strict=True):
            kept = slice(min(len(run.residual), len(other.residual)))
            excess = run.residual[kept] - other.residual[kept]
            runs.append(HalfPeriodEquations(run.design[kept], excess, run.slopes[kept], run.first[kept]))
        return replace(simulated, runs=runs)


def solve(
    equations: Equations, measured: Sequence[xr.Dataset], rule: Rule = "weighted", names: Sequence[str] = ()
) -> EquationSolution:
    """Solve equations between the half periods of envelopes.

    Parameters
    ----------
    equations : Equations
    measured : sequence of Dataset
        The envelope of each run (see `measure`).
    rule : {"weighted", "plain", "last"}
        Generalised or ordinary least squares; with `last`, the last parameter is the last target.
    names : sequence of str
        Names of the first parameters.

    Returns
    -------
    EquationSolution

    Raises
    ------
    DecayError
        There are too few half periods for the parameters, or they cannot separate the parameters.
    """
    linear = [_linear(equations, run) for run in measured]
    design, target = (np.concatenate(parts) for parts in zip(*(run[:2] for run in linear), strict=True))
    free = design[:, :-1] if rule == "last" else design
    _check_rank(free, names, sum(first[-1] + 1 for _, _, first, _ in linear))
    size, ends = np.linalg.norm(design, axis=0), np.cumsum([len(run[1]) for run in linear])[:-1]
    weights = _plain_weights(design, last=rule == "last")
    parameters = weights @ target
    # The covariance depends weakly on the parameters. But averages over a cycle may leave a large residual of
    # a record; wrong parameters would then give wrong weights. Ordinary least squares does not depend on the
    # covariance.
    for _ in range(2 if rule == "weighted" and not names else 1):
        runs, noises, factors = _with_noise(linear, measured, parameters)
        if rule == "weighted":
            pairs = list(zip(factors, np.split(design / size, ends), strict=True))
            white = np.concatenate([whiten(factor, part) for factor, part in pairs])
            inverse = np.linalg.inv(white.T @ white) / size[:, None]
            weights = inverse @ np.concatenate([cho_solve_banded((f, True), part) for f, part in pairs]).T
            parameters = weights @ target
    influence = [part @ noise for part, noise in zip(np.split(weights, ends, axis=1), noises, strict=True)]
    solved = [replace(run, residual=run.residual - run.design @ parameters) for run in runs]
    return EquationSolution(parameters, np.hstack(influence), solved, factors, len(parameters))


def solve_curves(
    equations: Equations,
    measured: Sequence[xr.Dataset],
    names: Sequence[str],
    curves: Sequence[Index],
    penalty: Penalty | None = None,
) -> EquationSolution:
    """Solve equations between half periods in which some parameters belong to smooth curves.

    Parameters
    ----------
    equations : Equations
    measured : sequence of Dataset
        The envelope of each run.
    names : sequence of str
        Names of the first parameters.
    curves : sequence of arrays of int
        Parameters of each curve (see `smooth_least_squares`).
    penalty : Penalty, optional
        Penalty of the curves; by default estimated from the equations.

    Returns
    -------
    EquationSolution

    Raises
    ------
    DecayError
        There are too few half periods for the parameters without a penalty, or they cannot separate them.
    """
    linear = [_linear(equations, run) for run in measured]
    design, target = (np.concatenate(parts) for parts in zip(*(run[:2] for run in linear), strict=True))
    outside = np.setdiff1d(np.arange(design.shape[1]), np.concatenate(curves))
    kept = [names[at] for at in outside if at < len(names)]
    _check_rank(design[:, outside], kept, sum(first[-1] + 1 for _, _, first, _ in linear))
    size, ends = np.linalg.norm(design, axis=0), np.cumsum([len(run[1]) for run in linear])[:-1]
    first_estimate = smooth_least_squares(design / size, target, curves).coefficients / size
    runs, noises, factors = _with_noise(linear, measured, first_estimate)
    pairs = list(zip(factors, np.split(np.column_stack([design / size, target]), ends), strict=True))
    white = np.concatenate([whiten(factor, part) for factor, part in pairs])
    white, white_target = white[:, :-1], white[:, -1]
    mean = np.zeros(len(size)) if penalty is None else penalty.mean * size
    fit = None
    if penalty is None:
        fit = smooth_least_squares(white, white_target, curves)
        precision = fit.penalty
    else:
        precision = penalty.precision / size**2
    gram = white.T @ white
    inverse = np.linalg.inv(gram + np.diag(precision))
    scaled = mean + inverse @ (white.T @ (white_target - white @ mean))
    whitened_twice = [cho_solve_banded((f, True), part[:, :-1]) for f, part in pairs]
    weights = np.split((inverse @ np.concatenate(whitened_twice).T) / size[:, None], ends, axis=1)
    influence = [part @ noise for part, noise in zip(weights, noises, strict=True)]
    if fit is not None:
        scaled = fit.coefficients
        unexplained = fit.covariance / fit.noise**2 - inverse @ gram @ inverse
        values, vectors = np.linalg.eigh(unexplained)
        influence.append(vectors * np.sqrt(np.maximum(values, 0.0)) / size[:, None])
    parameters = scaled / size
    solved = [replace(run, residual=run.residual - run.design @ parameters) for run in runs]
    fitted = float(np.trace(inverse @ gram))
    return EquationSolution(parameters, np.hstack(influence), solved, factors, fitted, precision * size**2)


def _with_noise(
    linear: Sequence[tuple[Array, Array, Index, Callable[[Array], sp.csr_matrix]]],
    measured: Sequence[xr.Dataset],
    parameters: Array,
) -> tuple[list[HalfPeriodEquations], list[sp.csr_matrix], list[Array]]:
    """Return the equations at an estimate, the effects of unit errors, and the factor of their covariance."""
    runs = [HalfPeriodEquations(a, y, slopes(parameters), first) for a, y, first, slopes in linear]
    noises = [run.noise(envelope) for run, envelope in zip(runs, measured, strict=True)]
    return runs, noises, [cholesky_factor(covariance_band(noise)) for noise in noises]


def _plain_weights(design: Array, *, last: bool) -> Array:
    """Return the weight of each target in ordinary least squares, (parameter, equation)."""
    free = design[:, :-1] if last else design
    size = np.linalg.norm(free, axis=0)
    inverse = np.linalg.pinv(free / size) / size[:, None]
    if not last:
        return np.asarray(inverse, dtype=float)
    of_last = np.eye(1, len(design), len(design) - 1)
    # The error of the last target enters all other targets, because it is subtracted from them.
    return np.vstack([inverse - (inverse @ design[:, -1:]) @ of_last, of_last])


def _check_rank(design: Array, names: Sequence[str], instants: int) -> None:
    """Raise an error naming the parameters that the equations cannot determine."""
    of_what = f"{len(names)} forces" if names else f"{design.shape[1]} unknowns"
    if len(design) < design.shape[1] + 2:
        raise DecayError(f"{instants} amplitudes cannot determine {of_what}; give a longer record or fewer.")
    size = np.linalg.norm(design, axis=0)
    silent = [s for s, n in zip(names, size, strict=False) if n < 1e-12 * size.max()]
    if silent:
        raise DecayError(
            f"Force {silent[0]} has no signature in envelope or frequency: averaging cannot identify it; "
            "leave it out (--forces) or use the direct method alone."
        )
    _, singular, axes = np.linalg.svd(design / np.where(size, size, 1.0), full_matrices=False)
    if singular[-1] < 1e-8 * singular[0]:
        if not names:
            raise DecayError("The half periods cannot separate these forces; offer fewer.")
        tied = [s for s, part in zip((*names, "the frequency"), axes[-1], strict=False) if abs(part) > 1e-3]
        raise DecayError(
            f"Averaging cannot separate {' and '.join(tied)}: their signatures are the same; leave one out."
        )


def _rows(
    equations: Equations, measured: xr.Dataset, change: Array | float = 0.0
) -> tuple[Array, Array, Index]:
    """Return design, target and instant of all equations, at half periods displaced by (2, half)."""
    t = measured.extremum_time.values - measured.attrs["first_time"]
    design, target = equations(*(np.stack([measured.extremum.values, t]) + change))
    instant = np.repeat(np.arange(len(target)), target.size // len(target))
    return design.reshape(target.size, -1), target.ravel(), instant


def _linear(
    equations: Equations, measured: xr.Dataset
) -> tuple[Array, Array, Index, Callable[[Array], sp.csr_matrix]]:
    """Return design, target, instant, and the function from parameters to slopes by extrema and times."""
    design, target, instant = _rows(equations, measured)
    steps = DIFFERENCE_STEP * _sizes(measured)
    half_periods = steps.shape[1]
    count = half_periods - instant[-1]
    of_design, of_target, columns = [], [], []
    for kind, first in np.ndindex(2, count):
        # Displace half periods together if they are so far apart that no equation contains two of them.
        shift = np.zeros_like(steps)
        shift[kind, first::count] = steps[kind, first::count]
        (after, y_after, _), (before, y_before, _) = (
            _rows(equations, measured, side * shift) for side in (1.0, -1.0)
        )
        half = instant + (first - instant) % count
        difference = 2.0 * steps[kind, half]
        of_design.append((after - before) / difference[:, None])
        of_target.append((y_after - y_before) / difference)
        columns.append(kind * half_periods + half)
    places = np.tile(np.arange(len(target)), len(columns)), np.concatenate(columns)
    slopes_of_design, slopes_of_target = np.concatenate(of_design), np.concatenate(of_target)

    def slopes(parameters: Array) -> sp.csr_matrix:
        entries = slopes_of_target - slopes_of_design @ parameters
        return sp.csr_matrix((entries, places), (len(target), 2 * half_periods))

    return design, target, instant, slopes


def errors_of_half_periods(measured: xr.Dataset) -> Array:
    """Return the standard errors of the extrema (rad), then of their times (s), at least rounding."""
    errors = np.stack([measured[name].values for name in ENVELOPE_ERRORS]) + ROUNDING * _sizes(measured)
    return np.asarray(errors.ravel())


def _sizes(measured: xr.Dataset) -> Array:
    """Return the extrema (rad), and a half period (s) for each, (2, half_period)."""
    b, t = measured.extremum.values, measured.extremum_time.values
    return np.stack([b, np.full(len(b), np.mean(np.diff(t)))])
