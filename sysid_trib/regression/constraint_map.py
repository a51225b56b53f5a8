"""Fixed, bounded and tied coefficients as a linear map of the free ones."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary


@dataclass(frozen=True)
class ConstraintMap:
    """Coefficients as ``matrix @ free coefficients + constant``.

    Attributes
    ----------
    free : (free,) array of int
        Places of the free coefficients among all.
    matrix : (force, free) array of float
    constant : (force,) array of float
    low, high : (free,) array of float
        Bounds of the free coefficients.
    """

    free: NDArray[np.intp]
    matrix: Array
    constant: Array
    low: Array
    high: Array

    def impose(self, coefficients: Array) -> Array:
        """The coefficients (force,) with the free ones within their bounds and the others by them."""
        return self.matrix @ np.clip(coefficients[self.free], self.low, self.high) + self.constant

    def hold(self, held: Mask, values: Array) -> "ConstraintMap":
        """The map with some free coefficients (mask over `free`) held at values, (held,)."""
        kept, constant = ~held, self.constant + self.matrix[:, held] @ values
        return ConstraintMap(self.free[kept], self.matrix[:, kept], constant, self.low[kept], self.high[kept])

    def keep(self, active: Mask) -> "ConstraintMap":
        """The map in which the free coefficients that are not active (force,) are zero."""
        dropped = ~active[self.free]
        return self.hold(dropped, np.zeros(int(np.sum(dropped))))

    def active(self, kept: Mask) -> Mask:
        """Coefficients (force,) that are in the model if some free ones (mask over `free`) are kept."""
        constrained = np.ones(len(self.constant), bool)
        constrained[self.free] = False
        fixed = constrained & ~self.matrix.any(axis=1)
        return fixed | (self.constant != 0.0) | self.matrix[:, kept].any(axis=1)


def constraint_map(
    constraints: Constraints, library: ForceLibrary, shapes: Mapping[str, float]
) -> ConstraintMap:
    """The map of a regression, in which all shape parameters are held.

    Parameters
    ----------
    constraints : Constraints
    library : ForceLibrary
        The forces to identify.
    shapes : mapping of str to float
        Values of shape parameters.

    Returns
    -------
    ConstraintMap

    Raises
    ------
    UsageError
        A name is no parameter, a tie is not linear in the coefficients, a bound is on a shape parameter, or
        no coefficient is free.
    """
    constraints.check(library)
    for name in constraints.bounds:
        if name not in library.symbols:
            raise UsageError(f"Shape parameter {name} is bounded, which only a trajectory fit can do.")
    names, matrix, constant = constraints.linear_map(library, shapes)
    if not names:
        raise UsageError("Every coefficient is fixed or tied; leave at least one free.")
    free = np.array([library.symbols.index(name) for name in names], dtype=np.intp)
    limits = np.array([constraints.bounds.get(name, (-np.inf, np.inf)) for name in names])
    return ConstraintMap(free, matrix, constant, limits[:, 0], limits[:, 1])
