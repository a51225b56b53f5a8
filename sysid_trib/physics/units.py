"""Coefficients in SI units: torques of the contact."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force
from sysid_trib.physics.error_propagation import check_quantity, propagate, propagate_measured
from sysid_trib.physics.model_estimate import ModelEstimate, model_estimate
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable, with_error


def physical_units(result: xr.Dataset, inertia: float, *, inertia_standard_error: float = 0.0) -> xr.Dataset:
    """Convert the coefficients of an identification to torques.

    Parameters
    ----------
    result : Dataset
        An identification.
    inertia : float, kg m^2
        Moment of inertia (of a translation with theta = x: mass, kg).
    inertia_standard_error : float, kg m^2
        Its standard error.

    Returns
    -------
    Dataset
        Over `force`: `coefficient` and `standard_error` in the unit of the coordinate `unit`, each the
        factor of the coordinate `multiplies`; `covariance(force, other_force)`. Scalars `linear_stiffness`,
        all that is proportional to the angle, and `inertia`, with errors.

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
    estimate = model_estimate(result)
    count = len(estimate.forces)
    powers = np.array([0.0 if f.speed_degree is None else f.speed_degree for f in estimate.forces])
    factors = np.array([power_law_factor(f) for f in estimate.forces])
    c, w = estimate.coefficients, estimate.frequency
    scale = factors * inertia * w ** (2.0 - powers)
    # By (coefficients, w, inertia).
    jacobian = np.zeros((count, count + 2))
    jacobian[:, :count] = np.diag(scale)
    jacobian[:, count] = (2.0 - powers) * c * scale / w
    jacobian[:, count + 1] = c * scale / inertia
    values, whole = estimate.with_inertia(inertia, inertia_standard_error)
    covariance = jacobian @ whole @ jacobian.T
    errors = np.sqrt(np.diag(covariance))
    data: Variables = {
        "coefficient": variable("force", scale * c, "coefficient in SI units", PER_FORCE_UNIT),
        "standard_error": variable("force", errors, "standard error of the coefficient", PER_FORCE_UNIT),
        "covariance": variable(("force", "other_force"), covariance, "covariance", PER_FORCE_UNIT),
    }
    stiffness = propagate(lambda z: _stiffness(estimate, z), values, whole)
    data |= with_error("linear_stiffness", (), stiffness, "linear stiffness", "N m rad-1")
    data |= with_error("inertia", (), (inertia, inertia_standard_error), "moment of inertia", "kg m2")
    coords = {
        "force": estimate.symbols,
        "other_force": estimate.symbols,
        "unit": ("force", [_unit(f) for f in estimate.forces]),
        "multiplies": ("force", [_term(f) for f in estimate.forces]),
    }
    return xr.Dataset(data, coords, estimate.provenance)


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
    inertia : float, kg m^2
        Without the mass.
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
        A quantity that is not positive.
    """
    total = propagate_measured(
        lambda z: z[0] + z[1] * z[2] ** 2,
        ("inertia", inertia, inertia_standard_error),
        ("mass", mass, mass_standard_error),
        ("radius", radius, radius_standard_error),
    )
    return xr.Dataset(with_error("inertia", (), total, "moment of inertia", "kg m2"))


def _stiffness(estimate: ModelEstimate, values: Array) -> float:
    """I w^2, and what a force of formula `x` adds to it where w does not hold it."""
    force = estimate.library.role("x")
    at = None if force is None else estimate.symbols.index(force.symbol)
    added = values[at] if at is not None and estimate.in_model[at] else 0.0
    return float(values[-1] * values[-2] ** 2 * (1.0 + added))


def _is_monomial(force: Force) -> bool:
    """Whether the force is a product of a power of |x|, one of |v|, signs and a number."""
    return force.degree is not None and force.speed_degree is not None


def power_law_factor(force: Force) -> float:
    """The number in a power law, 2 of `2*v`; 1 of other forces."""
    if not _is_monomial(force):
        return 1.0
    corners = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    return float(np.abs(force.value(corners[:, 0], corners[:, 1])).max())


def _unit(force: Force) -> str:
    speed = force.speed_degree or 0.0
    whole = (force.degree or 0.0) if _is_monomial(force) else 0.0
    # A coefficient of a force that drifts has its own unit of time.
    drift = 0.0 if force.units == "1" else -float(force.units[1:])
    powers = (("s", speed - drift), ("rad", -whole))
    return "N m" + "".join(f" {name}{p:g}" if p != 1 else f" {name}" for name, p in powers if p)


def _term(force: Force) -> str:
    if not _is_monomial(force):
        rate = "theta'/w" if force.speed_degree is None else "theta'"
        return f"{force.formula.text}, x = theta, v = {rate}"
    speed = force.speed_degree or 0.0
    angle = (force.degree or 0.0) - speed
    parts = [_power("|theta|", angle), _power("|theta'|", speed)]
    return " ".join(part for part in parts if part) or "1"


def _power(name: str, exponent: float) -> str:
    return "" if not exponent else name if exponent == 1 else f"{name}^{exponent:g}"
