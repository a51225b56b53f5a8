"""The classical decrements, one equation between half periods each: Rayleigh (1877) to Wu et al. (2007)."""

import numpy as np
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods.classical import ClassicalMethod, decrement_scope, energy_balance, needed_forces
from sysid_trib.methods.half_period_equations import Equations


class EnergyDecay(ClassicalMethod):
    """Solid friction lambda (rad) and damping ratio zeta from dE/dt, E = a^2/2, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of half-sines and averaging is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion has a random force (see `ClassicalMethod`).

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


# tanh(pi beta/2) of a damping ratio near one, at which nothing swings any more.
LARGEST = 1.0 - 1e-12


class FeenyLiang(ClassicalMethod):
    """Solid friction lambda (rad) and damping ratio zeta from turning points, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of the half-sines is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion has a random force (see `ClassicalMethod`).

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


class LinearDecrement(ClassicalMethod):
    """Solid friction lambda (rad) from |X_i| - |X_i+1| = 2 lambda, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of the half-sines is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion has a random force (see `ClassicalMethod`).
    """

    FORMULAS = ("sign(v)",)
    scope = decrement_scope("linear decrement", "solid friction")

    def relation(self, extremum: Array, time: Array) -> tuple[Array, Array]:
        """|X_i| - |X_i+1| = 2 lambda."""
        return np.full((len(time) - 1, 1), 2.0), -np.diff(extremum)

    def values(self, parameters: Array) -> Array:
        """From lambda and half a period (s) to lambda and w, which solid friction does not change."""
        return np.array([parameters[0], np.pi / parameters[1]])


class LogarithmicDecrement(ClassicalMethod):
    """Damping ratio zeta from ln |X_i/X_i+1| = pi zeta/sqrt(1 - zeta^2), and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of the half-sines is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion has a random force (see `ClassicalMethod`).
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


class QuadraticDecay(ClassicalMethod):
    """Quadratic friction delta from the linear growth of 1/a, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of half-sines and averaging is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion has a random force (see `ClassicalMethod`).

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


class WuDecrement(ClassicalMethod):
    """Solid friction and all powers of the speed in a library from the decrement, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of half-sines and energy balance is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion has a random force (see `ClassicalMethod`).

    Notes
    -----
    The energy that a half period loses is the work of the forces along a sine of the mean amplitude a: for
    forces c_p |v|^p sign(v), |X_i| - |X_i+1| = sum of c_p B_p a^p, B_p the integral of sin^(p+1) over half a
    period: 2 lambda + pi zeta a + (4/3) delta a^2. All powers are estimated at once. An elastic force
    nu x |x|, by which half periods last longer or shorter with the amplitude, passes for a delta of about
    -2 zeta nu; `frequency_birge_ratio` shows it, the envelope does not.
    """

    scope = decrement_scope("Wu decrement", "solid friction, powers of the speed")

    def forces_of(self, library: ForceLibrary) -> ForceLibrary:
        """The powers of the speed in a library, solid friction among them.

        Raises
        ------
        DecayError
            The library lacks solid friction or any other power.
        """
        needed_forces(self, library, ["sign(v)"])
        powers = library.select(force.symbol for force in library if _is_power(force))
        if len(powers) < 2:
            label = self.scope.sentence_label
            raise DecayError(f"{label} wants a power of the speed beside sign(v), as 2*v or v*abs(v).")
        return powers

    def equations(self, library: ForceLibrary) -> Equations:
        """Energy balance of each half period."""
        return energy_balance(library)

    def values(self, parameters: Array) -> Array:
        """From coefficients and half a period (s) to coefficients and w.

        Damping of any power lowers the frequency to second order, together by what is well known of it: that
        is left to the correction, for the part of viscous friction alone is not.
        """
        return np.append(parameters[:-1], np.pi / parameters[-1])


def _is_power(force: Force) -> bool:
    powers = force.degree is not None and force.degree == force.speed_degree
    return powers and force.kind == "force" and force.character == "dissipative"
