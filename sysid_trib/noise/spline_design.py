"""B-splines at points as sparse matrices, which many splines on the same knots have in common."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline

from sysid_trib.arrays import Array
from sysid_trib.noise.smoothing import MOST_KEPT, SPLINE_DEGREE


@dataclass(frozen=True)
class SplinesAt:
    """All splines on some knots, at some points.

    Attributes
    ----------
    points : (point,) array of float
    knots : (knot,) array of float
    """

    points: Array
    knots: Array

    @cached_property
    def _designs(self) -> dict[int, sp.csr_matrix]:
        return {}

    def design(self, order: int = 0) -> sp.csr_matrix:
        """Values of every B-spline, or of a derivative of it, (point, spline); computed once."""
        if order not in self._designs:
            self._designs[order] = spline_design(self.points, self.knots, order)
        return self._designs[order]

    def of(self, spline: BSpline, order: int = 0) -> Array:
        """A spline on these knots at the points or a derivative, (point,).

        At many points without the matrices, which would take more memory than records do.
        """
        if len(self.points) > MOST_KEPT:
            return np.asarray(spline(self.points, order))
        return np.asarray(self.design(order) @ spline.c)


def spline_design(tau: Array, knots: Array, order: int) -> sp.csr_matrix:
    """Values of the `order`-th derivative of every B-spline of `SPLINE_DEGREE` at points, (point, spline)."""
    # No point is beyond the knots: without extrapolation Python's own min and max look through all of them.
    lowest = knots[order : len(knots) - order]
    design = BSpline.design_matrix(tau, lowest, SPLINE_DEGREE - order, extrapolate=True)
    # d/dx B_{i,p} = p (B_{i,p-1}/(t_{i+p}-t_i) - B_{i+1,p-1}/(t_{i+p+1}-t_{i+1})), from low to high degree.
    for lift in range(order, 0, -1):
        degree = SPLINE_DEGREE - lift + 1
        inner = knots[lift - 1 : len(knots) - lift + 1]
        count = len(inner) - degree - 1
        scale = degree / (inner[degree + 1 : degree + count] - inner[1:count])
        lower = sp.diags_array([-scale, scale], offsets=[0, 1], shape=(count - 1, count))
        design = design @ lower
    return design.tocsr()
