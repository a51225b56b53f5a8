"""Quadratic friction from the hyperbolic decay (Majdoub et al. 2015)."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.methods.classical import ClassicalMethod, decrement_scope


class QuadraticDecay(ClassicalMethod):
    """Quadratic friction delta from the linear growth of 1/a, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of half-sines and averaging is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion is pushed at random (see `ClassicalMethod`).

    Notes
    -----
    d(1/a)/dt = (4/(3 pi)) w delta.
    """

    FORMULAS = ("v*abs(v)",)
    scope = decrement_scope("quadratic decay", "quadratic friction", weak=True)

    def relation(self, extremum: Array, time: Array) -> tuple[Array, Array]:
        """Growth of 1/a from one half period to the next."""
        return 4.0 / (3.0 * np.pi) * np.diff(time)[:, None], np.diff(1.0 / extremum)

    def values(self, parameters: Array) -> Array:
        """From w delta and half a period (s) to delta and w."""
        w = np.pi / parameters[1]
        return np.array([parameters[0] / w, w])
