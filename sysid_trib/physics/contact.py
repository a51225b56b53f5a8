"""Torsional stiffness of the contact, from the frequencies and from the contact's size."""

import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.physics.model_estimate import propagate_measured
from sysid_trib.results.variables import with_error


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
    frequency : Dataset or float, rad/s
        An identification, whose asymptotic frequency is taken with its error; or w_inf.
    omega0 : float, rad/s
        Frequency without the contact.
    inertia : float, kg m^2
        Moment of inertia.
    frequency_standard_error : float, rad/s
        Of a w_inf given as a number.
    omega0_standard_error : float, rad/s
        Standard error of `omega0`.
    inertia_standard_error : float, kg m^2
        Standard error of `inertia`.

    Returns
    -------
    Dataset
        `contact_stiffness` and its standard error, N m (per rad).

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
    stiffness = propagate_measured(
        lambda z: z[2] * (z[0] ** 2 - z[1] ** 2),
        ("frequency", w_inf, frequency_standard_error),
        ("frequency without contact", omega0, omega0_standard_error),
        ("inertia", inertia, inertia_standard_error),
    )
    return xr.Dataset(
        with_error("contact_stiffness", (), stiffness, "torsional stiffness of the contact", "N m")
    )


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
    shear_modulus : float, Pa
        G.
    contact_radius : float, m
        a.
    shear_modulus_standard_error : float, Pa
        Standard error of G.
    contact_radius_standard_error : float, m
        Standard error of a.

    Returns
    -------
    Dataset
        `contact_stiffness` and its standard error, N m (per rad).

    Raises
    ------
    UsageError
        A quantity that is not positive.
    """
    stiffness = propagate_measured(
        lambda z: 16.0 * z[0] * z[1] ** 3 / 3.0,
        ("shear modulus", shear_modulus, shear_modulus_standard_error),
        ("contact radius", contact_radius, contact_radius_standard_error),
    )
    return xr.Dataset(
        with_error("contact_stiffness", (), stiffness, "torsional stiffness of the sphere", "N m")
    )
