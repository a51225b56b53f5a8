"""Linear equations between neighbouring half periods, solved with the covariance of the extrema's errors."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.linalg import cho_solve_banded

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.weak_form import whiten, whitener
from sysid_trib.methods.half_period_noise import HalfPeriodEquations

Equations: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]
"""From extrema (rad, positive) and their times (s) to design (equation, parameter) and target (equation,).

Equation i holds nothing but half periods i to i + m, where m is the number of half periods beyond that of the
equations.
"""

# Relative to an extremum and to a half period.
DIFFERENCE_STEP = 1e-5
ROUNDING = 1e-14


@dataclass(frozen=True)
class EquationSolution:
    """Generalised least squares of equations between half periods.

    Attributes
    ----------
    parameters : (parameter,) array of float
    influence : (parameter, error) array of float
        Of unit errors of the extrema, of their times and, if the motion is pushed, of unit impulses.
    equations : HalfPeriodEquations
        With their residual.
    factor : (band, equation) array of float
        Cholesky factor of the equations' covariance, lower banded.
    """

    parameters: Array
    influence: Array
    equations: HalfPeriodEquations
    factor: Array

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return max(1, len(self.equations.residual) - len(self.parameters))

    def chi_square(self, residual: Array) -> float:
        """Squares of a residual over its covariance, summed."""
        return float(residual @ cho_solve_banded((self.factor, True), residual))


def solve(equations: Equations, measured: xr.Dataset) -> EquationSolution:
    """Solve equations between the half periods of an envelope.

    Parameters
    ----------
    equations : Equations
    measured : Dataset
        The envelope (see `envelope`).

    Returns
    -------
    EquationSolution

    Raises
    ------
    DecayError
        Too few half periods for the parameters, or parameters that they cannot separate.
    """
    b, t = measured.extremum.values, measured.extremum_time.values
    design, target = equations(b, t)
    count = design.shape[1]
    if len(target) < count + 2:
        raise DecayError(f"{len(b)} half periods cannot decide {count} unknowns; give a longer record.")
    size = np.linalg.norm(design, axis=0)
    if np.any(size == 0.0) or np.linalg.cond(design / np.where(size, size, 1.0)) > 1e8:
        raise DecayError("The half periods cannot tell these forces apart; offer fewer.")
    parameters = np.linalg.lstsq(design / size, target, rcond=None)[0] / size
    rounded = _with_rounding(measured)
    # The covariance depends on the parameters, weakly.
    for _ in range(2):
        linear = _linear(equations, measured, parameters)
        noise = linear.noise(rounded)
        factor = whitener(noise)
        white = whiten(factor, design / size)
        inverse = np.linalg.inv(white.T @ white) / size[:, None]
        weights = inverse @ cho_solve_banded((factor, True), design / size).T
        parameters = weights @ target
    solved = replace(linear, residual=target - design @ parameters)
    return EquationSolution(parameters, weights @ noise, solved, factor)


def _linear(equations: Equations, measured: xr.Dataset, parameters: Array) -> HalfPeriodEquations:
    """The equations with their slopes by the extrema and their times."""
    b, t = measured.extremum.values, measured.extremum_time.values

    def residual(extremum: Array, time: Array) -> Array:
        design, target = equations(extremum, time)
        return target - design @ parameters

    design, target = equations(b, t)
    rows = np.arange(len(target))
    count = len(b) - len(rows) + 1
    steps = _steps(measured)
    entries, columns = [], []
    for kind, first in np.ndindex(2, count):
        # Half periods so far apart that no equation holds two of them are moved at once.
        shift = np.zeros_like(steps)
        shift[kind, first::count] = steps[kind, first::count]
        change = residual(b + shift[0], t + shift[1]) - residual(b - shift[0], t - shift[1])
        half = rows + (first - rows) % count
        entries.append(change / (2.0 * steps[kind, half]))
        columns.append(kind * len(b) + half)
    places = np.tile(rows, len(columns)), np.concatenate(columns)
    slopes = sp.csr_matrix((np.concatenate(entries), places), (len(rows), 2 * len(b)))
    return HalfPeriodEquations(design, target - design @ parameters, slopes, rows)


def _steps(measured: xr.Dataset) -> Array:
    """Differences of the extrema (rad), and of their times (s), (2, half_period)."""
    b, t = measured.extremum.values, measured.extremum_time.values
    return np.stack([DIFFERENCE_STEP * b, np.full(len(b), DIFFERENCE_STEP * float(np.mean(np.diff(t))))])


def _with_rounding(measured: xr.Dataset) -> xr.Dataset:
    """The envelope with errors that are never less than rounding."""
    names = ("extremum_standard_error", "extremum_time_standard_error")
    rounding = ROUNDING * _steps(measured) / DIFFERENCE_STEP
    return measured.assign({name: measured[name] + part for name, part in zip(names, rounding, strict=True)})
