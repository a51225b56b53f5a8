"""Torsional stiffness of the contact, from the frequencies and from the contact's size."""

import numpy as np
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.physics.quantities import Array, check_quantity, propagated, with_error


def contact_stiffness(
    frequency: xr.Dataset | float,
    omega0: float,
    inertia: float,
    *,
    frequency_standard_error: float = 0.0,
    omega0_standard_error: float = 0.0,
    inertia_standard_error: float = 0.0,
) -> xr.Dataset:
    """Stiffness that the contact adds, K_c = I (w_inf^2 - w0^2) (Le Bot et al. 2019, Sec. 3.3).

    Parameters
    ----------
    frequency : an identification, whose asymptotic frequency is taken with its error; or w_inf, rad/s.
    omega0 : frequency without the contact, rad/s.
    inertia : kg m^2.
    frequency_standard_error : of a w_inf given as a number, rad/s.
    omega0_standard_error, inertia_standard_error : of the other two, rad/s and kg m^2.

    Returns
    -------
    Dataset with `contact_stiffness` and its standard error, N m (per rad).

    Raises
    ------
    UsageError
        A quantity that is not positive, or an error given beside an identification that has its own.
    """
    if isinstance(frequency, xr.Dataset):
        if frequency_standard_error or "asymptotic_frequency" not in frequency:
            raise UsageError(
                "Give an identification, whose asymptotic frequency has its error, or a frequency with "
                "frequency_standard_error."
            )
        w_inf = float(frequency.asymptotic_frequency.item())
        frequency_standard_error = float(frequency.asymptotic_frequency_standard_error.item())
    else:
        w_inf = frequency
    check_quantity("frequency", w_inf, frequency_standard_error)
    check_quantity("frequency without contact", omega0, omega0_standard_error)
    check_quantity("inertia", inertia, inertia_standard_error)

    def stiffness(z: Array) -> float:
        return float(z[2] * (z[0] ** 2 - z[1] ** 2))

    errors = np.array([frequency_standard_error, omega0_standard_error, inertia_standard_error])
    found = propagated(stiffness, np.array([w_inf, omega0, inertia]), np.diag(errors**2))
    return xr.Dataset(with_error("contact_stiffness", (), found, "N m", "torsional stiffness of the contact"))


def sphere_stiffness(
    shear_modulus: float,
    contact_radius: float,
    *,
    shear_modulus_standard_error: float = 0.0,
    contact_radius_standard_error: float = 0.0,
) -> xr.Dataset:
    """Torsional stiffness 16 G a^3/3 of an elastic sphere that does not slip (Johnson 1985).

    Parameters
    ----------
    shear_modulus : G, Pa.
    contact_radius : a, m.
    shear_modulus_standard_error, contact_radius_standard_error : theirs.

    Returns
    -------
    Dataset with `contact_stiffness` and its standard error, N m (per rad).

    Raises
    ------
    UsageError
        A quantity that is not positive.
    """
    check_quantity("shear modulus", shear_modulus, shear_modulus_standard_error)
    check_quantity("contact radius", contact_radius, contact_radius_standard_error)
    errors = np.array([shear_modulus_standard_error, contact_radius_standard_error])
    found = propagated(
        lambda z: 16.0 * z[0] * z[1] ** 3 / 3.0, np.array([shear_modulus, contact_radius]), np.diag(errors**2)
    )
    return xr.Dataset(with_error("contact_stiffness", (), found, "N m", "torsional stiffness of the sphere"))
