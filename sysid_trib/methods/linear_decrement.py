"""Linear decrement (Lorenz 1924, Kimball 1929): solid friction from the difference of successive extrema."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.methods.classical import ClassicalMethod, decrement_scope


class LinearDecrement(ClassicalMethod):
    """Solid friction lambda (rad) from |X_i| - |X_i+1| = 2 lambda, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of the half-sines is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion is pushed at random (see `ClassicalMethod`).
    """

    FORMULAS = ("sign(v)",)
    scope = decrement_scope("linear decrement", "solid friction")

    def relation(self, extremum: Array, time: Array) -> tuple[Array, Array]:
        """|X_i| - |X_i+1| = 2 lambda."""
        return np.full((len(time) - 1, 1), 2.0), -np.diff(extremum)

    def values(self, parameters: Array) -> Array:
        """From lambda and half a period (s) to lambda and w, which solid friction does not change."""
        return np.array([parameters[0], np.pi / parameters[1]])
