"""Solid and viscous friction from the decay of the energy (Rigaud et al. 2010)."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.methods.classical import ClassicalMethod, decrement_scope


class EnergyDecay(ClassicalMethod):
    """Solid friction lambda (rad) and damping ratio zeta from dE/dt, E = a^2/2, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of half-sines and averaging is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion is pushed at random (see `ClassicalMethod`).

    Notes
    -----
    dE/dt = -(2/pi) w lambda sqrt(2 E) - 2 w zeta E.
    """

    FORMULAS = ("sign(v)", "2*v")
    scope = decrement_scope("energy decay", "solid and viscous friction", weak=True)

    def relation(self, extremum: Array, time: Array) -> tuple[Array, Array]:
        """Rate of the energy from one half period before to one after."""
        before, after = extremum[:-2], extremum[2:]
        twice = 0.25 * (before + after) ** 2
        rate = 0.5 * (after**2 - before**2) / (time[2:] - time[:-2])
        return np.stack([-2.0 / np.pi * np.sqrt(twice), -twice], axis=1), rate

    def values(self, parameters: Array) -> Array:
        """From w lambda, w zeta and half a period (s) to lambda, zeta, w."""
        w = float(np.hypot(np.pi / parameters[2], parameters[1]))
        return np.array([parameters[0] / w, parameters[1] / w, w])
