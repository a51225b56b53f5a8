"""Simultaneous decrement of solid and viscous friction (Feeny & Liang 1996, Liang & Feeny 1998)."""

import numpy as np
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.methods.classical import ClassicalMethod, decrement_scope

# tanh(pi beta/2) of a damping ratio near one, at which nothing swings any more.
LARGEST = 1.0 - 1e-12


class FeenyLiang(ClassicalMethod):
    """Solid friction lambda (rad) and damping ratio zeta from turning points, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of the half-sines is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion is pushed at random (see `ClassicalMethod`).

    Notes
    -----
    |X_i+1| = q |X_i| - lambda (1 + q) with q = exp(-pi beta), beta = zeta/sqrt(1 - zeta^2), is exact; it is
    solved as |X_i| - |X_i+1| = tanh(pi beta/2) (|X_i| + |X_i+1|) + 2 lambda, where the noise of a difference
    has nothing in common with that of the sum.
    """

    FORMULAS = ("sign(v)", "2*v")
    scope = decrement_scope("Feeny-Liang decrement", "solid and viscous friction")

    def relation(self, extremum: Array, time: Array) -> tuple[Array, Array]:
        """Differences of successive extrema against their sums."""
        both = extremum[:-1] + extremum[1:]
        return np.column_stack([np.full(len(both), 2.0), both]), -np.diff(extremum)

    def values(self, parameters: Array) -> Array:
        """From lambda, tanh(pi beta/2) and half a period (s) to lambda, zeta, w."""
        beta = 2.0 / np.pi * np.arctanh(np.clip(parameters[1], -LARGEST, LARGEST))
        stretch = np.hypot(1.0, beta)
        return np.array([parameters[0], beta / stretch, np.pi / parameters[2] * stretch])


def feeny_liang_decrement(turning_points: ArrayLike) -> tuple[float, float]:
    """Solid friction lambda (rad) and damping ratio zeta from exact turning points.

    Parameters
    ----------
    turning_points : (turn,) array of float, rad
        Angles about the equilibrium at which the motion turns; signed or not.

    Returns
    -------
    solid : float, rad
        Solid friction lambda.
    viscous : float
        Damping ratio zeta.

    Raises
    ------
    DecayError
        Fewer than three, or they do not decay as these two forces have it.
    """
    extremum = np.abs(np.asarray(turning_points, dtype=float))
    if len(extremum) < 3:
        raise DecayError(f"{len(extremum)} turning points cannot decide two forces; give at least three.")
    method = FeenyLiang()
    parameters = np.linalg.lstsq(*method.relation(extremum, np.arange(float(len(extremum)))), rcond=None)[0]
    if not abs(parameters[1]) < LARGEST:
        raise DecayError("The turning points do not decay as solid and viscous friction have it.")
    solid, viscous, _ = method.values(np.append(parameters, 1.0))
    return float(solid), float(viscous)
