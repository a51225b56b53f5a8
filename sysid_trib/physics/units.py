"""Coefficients in SI units: torques of the contact."""

import numpy as np
import xarray as xr

from sysid_trib.forces.force import Force
from sysid_trib.physics.quantities import Array, Variables, check_quantity, propagated, with_error
from sysid_trib.physics.unknowns import Unknowns, unknowns_of


def physical_units(result: xr.Dataset, inertia: float, *, inertia_standard_error: float = 0.0) -> xr.Dataset:
    """Convert the coefficients of an identification to torques.

    Parameters
    ----------
    result : an identification.
    inertia, inertia_standard_error : moment of inertia, kg m^2 (of a translation with theta = x: mass, kg).

    Returns
    -------
    Dataset over `force`: `coefficient` and `standard_error` in the unit of the coordinate `unit`, each the
    factor of the coordinate `multiplies`; `covariance(force, other_force)`. Scalars `linear_stiffness`, all
    that is proportional to the angle, and `inertia`, with errors.

    Raises
    ------
    UsageError
        Not an identification, or no positive inertia.

    Notes
    -----
    A force of degree q in v is the torque I w^(2-q) c h(theta, theta'), theta' in rad/s; a numerical factor
    of a power law goes to the coefficient: 2 zeta I w. One without such a degree is
    I w^2 c h(theta, theta'/w). Errors hold those of w and of the inertia.
    """
    check_quantity("inertia", inertia, inertia_standard_error)
    found = unknowns_of(result)
    count = len(found.forces)
    powers = np.array([0.0 if f.speed_degree is None else f.speed_degree for f in found.forces])
    factors = np.array([_factor(f) for f in found.forces])
    c, w = found.coefficients, found.frequency
    scale = factors * inertia * w ** (2.0 - powers)
    # By (coefficients, w, inertia).
    jacobian = np.zeros((count, count + 2))
    jacobian[:, :count] = np.diag(scale)
    jacobian[:, count] = (2.0 - powers) * c * scale / w
    jacobian[:, count + 1] = c * scale / inertia
    whole = np.zeros((count + 2, count + 2))
    whole[:-1, :-1] = found.covariance
    whole[-1, -1] = inertia_standard_error**2
    spread = jacobian @ whole @ jacobian.T
    own = {"units": "see the coordinate unit"}
    data: Variables = {
        "coefficient": (("force",), scale * c, own | {"long_name": "coefficient in SI units"}),
        "standard_error": (("force",), np.sqrt(np.diag(spread)), own | {"long_name": "its standard error"}),
        "covariance": (("force", "other_force"), spread, own | {"long_name": "covariance"}),
    }
    data |= _stiffness(found, inertia, whole)
    data |= with_error("inertia", (), (inertia, inertia_standard_error), "kg m2", "moment of inertia")
    coords = {
        "force": found.symbols,
        "other_force": found.symbols,
        "unit": ("force", [_unit(f) for f in found.forces]),
        "multiplies": ("force", [_term(f) for f in found.forces]),
    }
    return xr.Dataset(data, coords, {"library": result.attrs["library"]})


def inertia_with_mass(
    inertia: float,
    mass: float,
    radius: float,
    *,
    inertia_standard_error: float = 0.0,
    mass_standard_error: float = 0.0,
    radius_standard_error: float = 0.0,
) -> xr.Dataset:
    """Moment of inertia I0 + m l^2 of a pendulum with a mass fixed to it (Le Bot et al. 2019, Sec. 3).

    Parameters
    ----------
    inertia : without the mass, kg m^2.
    mass : kg.
    radius : distance of the mass from the axis, m.
    inertia_standard_error, mass_standard_error, radius_standard_error : theirs.

    Returns
    -------
    Dataset with `inertia` and its standard error, kg m^2.

    Raises
    ------
    UsageError
        A quantity that is not positive.
    """
    check_quantity("inertia", inertia, inertia_standard_error)
    check_quantity("mass", mass, mass_standard_error)
    check_quantity("radius", radius, radius_standard_error)
    errors = np.array([inertia_standard_error, mass_standard_error, radius_standard_error])
    found = propagated(
        lambda z: z[0] + z[1] * z[2] ** 2, np.array([inertia, mass, radius]), np.diag(errors**2)
    )
    return xr.Dataset(with_error("inertia", (), found, "kg m2", "moment of inertia"))


def _stiffness(found: Unknowns, inertia: float, whole: Array) -> Variables:
    """I w^2, and what a force of formula `x` adds to it where w does not hold it."""
    stiff = found.library.role("x")
    at = None if stiff is None else found.symbols.index(stiff.symbol)

    def total(z: Array) -> float:
        added = z[at] if at is not None and found.within[at] else 0.0
        return float(z[-1] * z[-2] ** 2 * (1.0 + added))

    values = np.append(found.values, inertia)
    return with_error(
        "linear_stiffness", (), propagated(total, values, whole), "N m rad-1", "linear stiffness"
    )


def _power_law(force: Force) -> bool:
    """Whether the force is a product of a power of |x|, one of |v|, signs and a number."""
    return force.degree is not None and force.speed_degree is not None


def _factor(force: Force) -> float:
    if not _power_law(force):
        return 1.0
    corners = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    return float(np.abs(force.value(corners[:, 0], corners[:, 1])).max())


def _unit(force: Force) -> str:
    speed, whole = force.speed_degree or 0.0, 0.0
    if _power_law(force):
        whole = force.degree or 0.0
    # A coefficient of a force that drifts has its own unit of time.
    drift = 0.0 if force.units == "1" else -float(force.units[1:])
    powers = (("s", speed - drift), ("rad", -whole if _power_law(force) else 0.0))
    return "N m" + "".join(f" {name}{p:g}" if p != 1 else f" {name}" for name, p in powers if p)


def _term(force: Force) -> str:
    if not _power_law(force):
        rate = "theta'/w" if force.speed_degree is None else "theta'"
        return f"{force.formula.text}, x = theta, v = {rate}"
    speed = force.speed_degree or 0.0
    angle = (force.degree or 0.0) - speed
    parts = [_power("|theta|", angle), _power("|theta'|", speed)]
    return " ".join(part for part in parts if part) or "1"


def _power(name: str, exponent: float) -> str:
    return "" if not exponent else name if exponent == 1 else f"{name}^{exponent:g}"
