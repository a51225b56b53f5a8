"""Decrement of solid friction beside powers of the speed (Wu et al. 2007)."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.averaging.signatures import averages
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods.classical import ClassicalMethod, decrement_scope, needed_forces
from sysid_trib.regression.relations import Equations


class WuDecrement(ClassicalMethod):
    """Solid friction and all powers of the speed in a library from the decrement, and the frequency.

    Parameters
    ----------
    correct : bool
        Whether the bias of half-sines and energy balance is removed by indirect inference.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the motion is pushed at random (see `ClassicalMethod`).

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


def energy_balance(library: ForceLibrary) -> Equations:
    """Equations of the decrement for powers of the speed."""
    unit = [(-np.pi * averages(force, np.ones(1))[0].item(), force.degree or 0.0) for force in library]

    def decrements(extremum: Array, time: Array) -> tuple[Array, Array]:
        mean = 0.5 * (extremum[1:] + extremum[:-1])
        return np.stack([b * mean**p for b, p in unit], axis=1), -np.diff(extremum)

    return decrements


def _is_power(force: Force) -> bool:
    powers = force.degree is not None and force.degree == force.speed_degree
    return powers and force.kind == "force" and force.character == "dissipative"
