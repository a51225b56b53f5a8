"""Contact: its stiffness, the inertia, and the fingerprint of slip in a six-force model."""

import numpy as np
import scipy
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.physics.model_estimate import model_estimate, of_measured
from sysid_trib.results.effects import significant
from sysid_trib.results.models import library_of
from sysid_trib.results.variables import variable, with_error


def contact_stiffness(
    frequency: xr.Dataset | float,
    omega0: float,
    inertia: float,
    *,
    frequency_standard_error: float = 0.0,
    omega0_standard_error: float = 0.0,
    inertia_standard_error: float = 0.0,
) -> xr.Dataset:
    """Return the stiffness added by the contact, K_c = I (w_inf^2 - w0^2) (Le Bot et al. 2019, Sec. 3.3).

    Parameters
    ----------
    frequency : Dataset or float, rad/s
        An identification (its asymptotic frequency and the error of it are used), or w_inf.
    omega0 : float, rad/s
        Frequency without the contact.
    inertia : float, kg m^2
        Moment of inertia.
    frequency_standard_error : float, rad/s
        Standard error of w_inf, if w_inf is a number.
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
        A quantity is not positive, or an error is given together with an identification that has its own.

    Examples
    --------
    >>> import sysid_trib as st
    >>> stiffness = st.physics.contact_stiffness(9.91, omega0=8.87, inertia=0.012, omega0_standard_error=0.01)
    >>> print(f"{stiffness.contact_stiffness:.3f} ± {stiffness.contact_stiffness_standard_error:.3f} N m")
    0.234 ± 0.002 N m
    """
    if isinstance(frequency, xr.Dataset):
        if frequency_standard_error or "asymptotic_frequency" not in frequency:
            raise UsageError(
                "Give an identification, which has the error, or a frequency with frequency_standard_error."
            )
        frequency_standard_error = frequency.asymptotic_frequency_standard_error.item()
        frequency = float(frequency.asymptotic_frequency.item())
    return of_measured(
        lambda z: z[2] * (z[0] ** 2 - z[1] ** 2),
        ("contact_stiffness", "torsional stiffness of the contact", "N m"),
        ("frequency", frequency, frequency_standard_error),
        ("frequency without contact", omega0, omega0_standard_error),
        ("inertia", inertia, inertia_standard_error),
    )


def sphere_stiffness(
    shear_modulus: float,
    contact_radius: float,
    *,
    shear_modulus_standard_error: float = 0.0,
    contact_radius_standard_error: float = 0.0,
) -> xr.Dataset:
    """Return the torsional stiffness 16 G a^3/3 of an elastic sphere that does not slip (Johnson 1985).

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
        A quantity is not positive.

    Examples
    --------
    >>> import sysid_trib as st
    >>> sphere = st.physics.sphere_stiffness(shear_modulus=0.6e6, contact_radius=2e-3)
    >>> print(f"{sphere.contact_stiffness:.4f} N m")
    0.0256 N m
    """
    return of_measured(
        lambda z: 16.0 * z[0] * z[1] ** 3 / 3.0,
        ("contact_stiffness", "torsional stiffness of the sphere", "N m"),
        ("shear modulus", shear_modulus, shear_modulus_standard_error),
        ("contact radius", contact_radius, contact_radius_standard_error),
    )


def inertia_with_mass(
    inertia: float,
    mass: float,
    radius: float,
    *,
    inertia_standard_error: float = 0.0,
    mass_standard_error: float = 0.0,
    radius_standard_error: float = 0.0,
) -> xr.Dataset:
    """Return the moment of inertia I0 + m l^2 of a pendulum with an added mass (Le Bot et al. 2019, Sec. 3).

    Parameters
    ----------
    inertia : float, kg m^2
        Moment of inertia without the mass.
    mass : float, kg
        The mass.
    radius : float, m
        Distance of the mass from the axis.
    inertia_standard_error : float, kg m^2
        Standard error of `inertia`.
    mass_standard_error : float, kg
        Standard error of `mass`.
    radius_standard_error : float, m
        Standard error of `radius`.

    Returns
    -------
    Dataset
        `inertia` and its standard error, kg m^2.

    Raises
    ------
    UsageError
        A quantity is not positive.

    Examples
    --------
    >>> import sysid_trib as st
    >>> total = st.physics.inertia_with_mass(0.012, mass=0.1, radius=0.2, radius_standard_error=0.001)
    >>> print(f"{total.inertia:.4f} ± {total.inertia_standard_error:.5f} kg m^2")
    0.0160 ± 0.00004 kg m^2
    """
    return of_measured(
        lambda z: z[0] + z[1] * z[2] ** 2,
        ("inertia", "moment of inertia", "kg m2"),
        ("inertia", inertia, inertia_standard_error),
        ("mass", mass, mass_standard_error),
        ("radius", radius, radius_standard_error),
    )


# Ratio nu/delta of a contact in which slip progresses from the rim inwards.
SLIP_RATIO = -0.75 * np.pi
# Relative error allowed for six forces. On simulated slip (kappa 0.005 to 0.2, zeta 0.002 and 0.01) they give
# -2.0 to -2.3, because the loops of a decay are not closed and epsilon describes a part of nu.
ALLOWED = 0.1
# A ratio is informative if its quadratic friction differs from zero by this number of errors, and if the
# error of the ratio is at most this fraction of `SLIP_RATIO`.
SIGNIFICANT_FRICTION = 3.0
SHARP = 1.0 / 3.0
# Conservative forces of a contact, to leading orders. Any other one also changes the stiffness with
# amplitude.
CONTACT_STIFFNESS = ("x", "x*abs(x)", "x**3")


def speaks_of_slip(result: xr.Dataset) -> bool:
    """Return true if the ratio nu/delta of an identification can indicate partial slip.

    Parameters
    ----------
    result : Dataset
        An identification.

    Notes
    -----
    Partial slip is a loop of Masing's kind about a backbone k x - kappa x^2 (see `slip_fingerprint`): the
    contact has a stiffness k > 0, dissipates energy (delta > 0) and softens (nu < 0). So the ratio indicates
    slip only under three conditions: the contact's stiffness was measured separately from the frequency
    without contact; nu and delta are both significant; and nothing else, such as gravity or a magnet, changes
    the stiffness with amplitude.
    """
    library = library_of(result)
    roles = [library.role(formula) for formula in ("x", "x*abs(x)", "v*abs(v)")]
    if any(force is None for force in roles):
        return False
    if any(f.character == "conservative" and not any(map(f.matches, CONTACT_STIFFNESS)) for f in library):
        return False
    at = [library.symbols.index(force.symbol) for force in roles if force is not None]
    return bool(np.all(significant(result)[at]) and np.all(result.coefficient.values[at] * [1, -1, 1] > 0.0))


def slip_fingerprint(result: xr.Dataset) -> xr.Dataset:
    """Compare the ratio nu/delta with the ratio of partial slip, -3 pi/4.

    Parameters
    ----------
    result : Dataset
        An identification with the forces of formulas `x*abs(x)` (nu) and `v*abs(v)` (delta).

    Returns
    -------
    Dataset
        `ratio` and its standard error, `slip_ratio` = -3 pi/4, `allowance` (a tenth of it, the error of six
        forces for a slipping contact), `z` and `p_value` of the difference, with both errors, and
        `significance` of delta (its magnitude over its error). attrs: `verdict`, which is `compatible`,
        `not compatible` or `undecided` (the errors allow both), and `numerator`, `denominator`, their
        symbols.

    Raises
    ------
    UsageError
        The dataset is not an identification, or one of the two forces is missing.

    Notes
    -----
    A hysteresis of Masing's kind with the backbone k x - kappa x^2 (Mindlin's partial slip to leading order)
    appears as delta = kappa/2 and nu = -3 pi kappa/8. z tests nu + (3 pi/4) delta = 0. This test is valid
    even if delta is not significant and the ratio has no symmetric error (Fieller). A nu with another cause,
    such as a magnet, hides the fingerprint.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> fingerprint = st.physics.slip_fingerprint(result)
    >>> fingerprint.ratio.round(1).item(), fingerprint.slip_ratio.round(2).item()
    (-10.8, -2.36)
    >>> fingerprint.attrs["verdict"]
    'not compatible'
    """
    estimate = model_estimate(result)
    roles = [estimate.library.role(formula) for formula in ("x*abs(x)", "v*abs(v)")]
    symbols = [force.symbol for force in roles if force is not None]
    if len(symbols) < 2:
        raise UsageError("The fingerprint of slip needs forces of formulas x*abs(x) and v*abs(v).")
    at = [estimate.symbols.index(symbol) for symbol in symbols]
    (nu, delta), covariance = estimate.coefficients[at], estimate.coefficient_covariance[np.ix_(at, at)]
    combination = np.array([1.0, -SLIP_RATIO])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = nu / delta
        slope = np.array([1.0, -ratio]) / delta
        error = np.sqrt(slope @ covariance @ slope)
        variance = combination @ covariance @ combination + (ALLOWED * SLIP_RATIO * delta) ** 2
        z = (combination @ [nu, delta]) / np.sqrt(variance)
        significance = delta / np.sqrt(covariance[1, 1])
    p_value = 2.0 * scipy.stats.norm.sf(abs(z))
    known = abs(significance) >= SIGNIFICANT_FRICTION and error <= SHARP * abs(SLIP_RATIO)
    # Slip dissipates energy: a quadratic friction that feeds energy in has another cause.
    # Below this p-value the ratio differs from that of slip.
    other = p_value < 0.01 or significance <= -SIGNIFICANT_FRICTION
    verdict = "not compatible" if other else "compatible" if known else "undecided"
    of_delta = f"size of {symbols[1]} over its standard error"
    data = {
        **with_error("ratio", (), (ratio, error), f"{symbols[0]}/{symbols[1]}"),
        "slip_ratio": variable((), SLIP_RATIO, "ratio of partial slip", "1"),
        "allowance": variable((), ALLOWED * abs(SLIP_RATIO), "error of the ratio as a fingerprint", "1"),
        "z": variable((), float(z), "difference from partial slip over its error", "1"),
        "p_value": variable((), float(p_value), "p-value of partial slip", "1"),
        "significance": variable((), float(abs(significance)), of_delta, "1"),
    }
    attrs = {"verdict": verdict, "numerator": symbols[0], "denominator": symbols[1]}
    return xr.Dataset(data, attrs=attrs)
