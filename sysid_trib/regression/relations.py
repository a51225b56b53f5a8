"""Linear equations between neighbouring half periods, solved with the covariance of the extrema's errors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from sysid_trib.errors import DecayError

Array = NDArray[np.float64]

Equations: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]
"""From extrema (rad, positive) and their times (s) to design (equation, unknown) and target (equation,).

Equation i holds nothing but half periods i to i + m, where m is the number of half periods beyond that of the
equations.
"""

# The covariance depends on the unknowns, weakly.
REWEIGHTINGS = 2
# Relative to an extremum and to a half period.
DIFFERENCE_STEP = 1e-5
ROUNDING = 1e-14


@dataclass(frozen=True)
class EquationSolution:
    """Generalised least squares of equations between half periods.

    Attributes
    ----------
    parameters : (parameter,)
    influence : (parameter, 2 half periods) of unit errors of the extrema, then of their times.
    residual : (equation,)
    factor : Cholesky factor of the equations' covariance, lower banded.
    """

    parameters: Array
    influence: Array
    residual: Array
    factor: Array

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return max(1, len(self.residual) - len(self.parameters))

    def chi_square(self, residual: Array) -> float:
        """Squares of a residual over its covariance, summed."""
        return float(residual @ cho_solve_banded((self.factor, True), residual))


def solve(equations: Equations, measured: xr.Dataset) -> EquationSolution:
    """Solve equations between the half periods of an envelope.

    Raises
    ------
    DecayError
        Too few half periods for the unknowns, or unknowns that they cannot tell apart.
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
    for _ in range(REWEIGHTINGS):
        noise = _noise(equations, measured, parameters)
        factor = _factor(noise)
        weighted = cho_solve_banded((factor, True), design / size)
        inverse = np.linalg.inv(weighted.T @ (design / size)) / size[:, None]
        parameters = inverse @ (weighted.T @ target)
    return EquationSolution(
        parameters, inverse @ _influence(noise, weighted), target - design @ parameters, factor
    )


def _noise(equations: Equations, measured: xr.Dataset, parameters: Array) -> Array:
    """How unit errors move each equation i, (extremum or time, j, i): those of half period i + j."""
    b, t = measured.extremum.values, measured.extremum_time.values

    def residual(extremum: Array, time: Array) -> Array:
        design, target = equations(extremum, time)
        return target - design @ parameters

    here = np.arange(len(residual(b, t)))
    count = len(b) - len(here) + 1
    reaches = np.stack([DIFFERENCE_STEP * b, np.full(len(b), DIFFERENCE_STEP * float(np.mean(np.diff(t))))])
    stated = (measured.extremum_standard_error.values, measured.extremum_time_standard_error.values)
    errors = np.stack(stated) + ROUNDING * reaches / DIFFERENCE_STEP
    noise = np.empty((2, count, len(here)))
    for at, first in np.ndindex(2, count):
        # Half periods so far apart that no equation holds two of them are moved at once.
        shift = np.zeros_like(reaches)
        shift[at, first::count] = reaches[at, first::count]
        change = residual(b + shift[0], t + shift[1]) - residual(b - shift[0], t - shift[1])
        offset = (first - here) % count
        touched = here + offset
        noise[at, offset, here] = change / (2.0 * reaches[at, touched]) * errors[at, touched]
    return noise


def _factor(noise: Array) -> Array:
    """Cholesky factor of the equations' covariance, lower banded."""
    _, count, size = noise.shape
    banded = np.zeros((count, size))
    for k in range(count):
        banded[k, : size - k] = np.sum(noise[:, k:, : size - k] * noise[:, : count - k, k:], axis=(0, 1))
    return np.asarray(cholesky_banded(banded, lower=True))


def _influence(noise: Array, weighted: Array) -> Array:
    """Weights of the equations carried over to unit errors, (parameter, extrema then times)."""
    _, count, size = noise.shape
    carried = np.zeros((weighted.shape[1], 2, size + count - 1))
    for j in range(count):
        carried[:, :, j : j + size] += noise[None, :, j] * weighted.T[:, None]
    return carried.reshape(weighted.shape[1], -1)
