"""Logarithmic decrement (Rayleigh 1877, art. 46): viscous friction from the ratio of successive extrema."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.methods.classical import ClassicalMethod, decrement_scope


class LogarithmicDecrement(ClassicalMethod):
    """Damping ratio zeta from ln |X_i/X_i+1| = pi zeta/sqrt(1 - zeta^2), and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of the half-sines is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion is pushed at random (see `ClassicalMethod`).
    """

    FORMULAS = ("2*v",)
    scope = decrement_scope("logarithmic decrement", "viscous friction")

    def relation(self, extremum: Array, time: Array) -> tuple[Array, Array]:
        """ln |X_i/X_i+1| = pi zeta/sqrt(1 - zeta^2)."""
        return np.full((len(time) - 1, 1), np.pi), -np.diff(np.log(extremum))

    def values(self, parameters: Array) -> Array:
        """From zeta/sqrt(1 - zeta^2) and half a period (s) to zeta and w."""
        stretch = np.hypot(1.0, parameters[0])
        return np.array([parameters[0] / stretch, np.pi / parameters[1] * stretch])
