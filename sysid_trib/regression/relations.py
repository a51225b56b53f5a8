"""Linear equations between neighbouring half periods, solved with the covariance of the extrema's errors."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp
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
ROUNDS = 2
# Relative to an extremum and to a half period.
STEP = 1e-5
ROUNDING = 1e-14


@dataclass(frozen=True)
class Solution:
    """Generalised least squares of equations between half periods.

    Attributes
    ----------
    unknown : (unknown,)
    influence : (unknown, 2 half periods) of unit errors of the extrema, then of their times.
    residual : (equation,)
    factor : Cholesky factor of the equations' covariance, lower banded.
    """

    unknown: Array
    influence: Array
    residual: Array
    factor: Array

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual."""
        return max(1, len(self.residual) - len(self.unknown))

    def chi_square(self, residual: Array) -> float:
        """Squares of a residual over its covariance, summed."""
        return float(residual @ cho_solve_banded((self.factor, True), residual))


def solve(equations: Equations, measured: xr.Dataset) -> Solution:
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
    unknown = np.linalg.lstsq(design / size, target, rcond=None)[0] / size
    for _ in range(ROUNDS):
        noise = _noise(equations, measured, unknown)
        factor = _factor(noise)
        weighted = cho_solve_banded((factor, True), design / size)
        inverse = np.linalg.inv(weighted.T @ (design / size)) / size[:, None]
        unknown = inverse @ (weighted.T @ target)
    influence = inverse @ (noise.T @ weighted).T
    return Solution(unknown, influence, target - design @ unknown, factor)


def _noise(equations: Equations, measured: xr.Dataset, unknown: Array) -> sp.csr_matrix:
    """How unit errors of the extrema and their times move each equation, (equation, extrema then times)."""
    b, t = measured.extremum.values, measured.extremum_time.values

    def gap(values: tuple[Array, Array]) -> Array:
        design, target = equations(*values)
        return target - design @ unknown

    count = len(b) - len(gap((b, t))) + 1
    here = np.arange(len(b) - count + 1)
    blocks = []
    reaches = (STEP * b, np.full(len(b), STEP * float(np.mean(np.diff(t)))))
    names = ("extremum_standard_error", "extremum_time_standard_error")
    for at, (reach, name) in enumerate(zip(reaches, names, strict=True)):
        error = measured[name].values + ROUNDING * reach / STEP
        block = sp.csr_matrix((len(here), len(b)))
        # Half periods so far apart that no equation holds two of them are moved at once.
        for first in range(count):
            moved = np.where(np.arange(len(b)) % count == first, reach, 0.0)
            near = [gap((b + s * moved, t) if at == 0 else (b, t + s * moved)) for s in (1.0, -1.0)]
            touched = here + (first - here) % count
            slope = (near[0] - near[1]) / (2.0 * reach[touched]) * error[touched]
            block += sp.csr_matrix((slope, (here, touched)), block.shape)
        blocks.append(block)
    return sp.csr_matrix(sp.hstack(blocks))


def _factor(noise: sp.csr_matrix) -> Array:
    """Cholesky factor of the covariance, lower banded."""
    covariance = (noise @ noise.T).todia()
    size = covariance.shape[0]
    width = int(np.max(np.abs(covariance.offsets)))
    banded = np.zeros((width + 1, size))
    for offset in range(width + 1):
        banded[offset, : size - offset] = covariance.diagonal(-offset)
    return np.asarray(cholesky_banded(banded, lower=True))
