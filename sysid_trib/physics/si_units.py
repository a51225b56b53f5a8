"""Coefficients in SI units: torques and forces of the contact, friction, and forces per unit of input."""

from collections.abc import Set

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force
from sysid_trib.forces.notation import signal_powers
from sysid_trib.physics import model_estimate as estimates
from sysid_trib.records.signal import ANGLE_UNIT
from sysid_trib.records.unit_tables import METRES
from sysid_trib.results.kinds import MASS, MU, STIFFNESS
from sysid_trib.results.variables import described, signal_units, variable

# A value and its standard error.
Measured = tuple[float, float]


def physical_units(result: xr.Dataset, inertia: float, *, inertia_standard_error: float = 0.0) -> xr.Dataset:
    """Convert the coefficients of an identification to torques.

    Parameters
    ----------
    result : Dataset
        An identification.
    inertia : float, kg m^2
        Moment of inertia (for a translation with theta = x: mass, kg).
    inertia_standard_error : float, kg m^2
        Standard error of `inertia`.

    Returns
    -------
    Dataset
        Over `force`: `coefficient` and `standard_error` in the unit of the coordinate `unit`; each is the
        factor of the expression in the coordinate `multiplies`; `covariance(force, other_force)`. Scalars:
        `linear_stiffness`, the sum of all terms proportional to the angle, and `inertia`, with errors.

    Raises
    ------
    UsageError
        The dataset is not an identification of an angle, or the inertia is not positive.

    Notes
    -----
    A force of degree q in v is the torque I w^(2-q) c h(theta, theta'), theta' in rad/s; a numerical factor
    of a power law is included in the coefficient: 2 zeta I w. A force without such a degree is I w^2 c
    h(theta, theta'/w). The errors include those of w and of the inertia.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> torques = st.physics.physical_units(result, inertia=0.012)
    >>> torques.multiplies.sel(force="zeta").item(), torques.unit.sel(force="zeta").item()
    ("|theta'|", 'N m s rad-1')
    >>> torques.coefficient.sel(force="zeta").round(5).item(), round(2 * 0.012 * 9.91 * 0.0097, 5)
    (0.00231, 0.00231)
    """
    return in_si_units(result, inertia=(inertia, inertia_standard_error))


def _in_si(estimate: estimates.ModelEstimate, body: Measured, length: str | None) -> xr.Dataset:
    """Return the coefficients for an inertia, or for a mass and a unit of length, with errors.

    c becomes m w^(2-q) c, where q is the degree in the rate, times the unit of length to the power of length
    in c; a numerical factor of a power law is included in the coefficient.
    """
    count, (size, error) = len(estimate.forces), body
    speeds = np.array([force.speed_degree or 0.0 for force in estimate.forces])
    factors = np.array([power_law_factor(force) for force in estimate.forces])
    if length is None:
        coordinate, units = "theta", [_unit(force) for force in estimate.forces]
    else:
        degrees = _degrees(estimate)
        coordinate, factors = "x", factors * METRES[length] ** (1.0 - degrees)
        units = [_unit_of_force(*pair) for pair in zip(degrees, speeds, strict=True)]
    powers, c, w = 2.0 - speeds, estimate.coefficients, estimate.frequency
    scale = factors * size * w**powers
    # Derivatives with respect to (coefficients, w, inertia).
    jacobian = np.zeros((count, count + 2))
    jacobian[:, :count] = np.diag(scale)
    jacobian[:, count] = powers * c * scale / w
    jacobian[:, count + 1] = c * scale / size
    covariance = jacobian @ estimate.with_inertia(size, error)[1] @ jacobian.T
    errors = np.sqrt(np.diag(covariance))
    data = {"coefficient": scale * c, "standard_error": errors, "covariance": covariance}
    terms = [_term(force).replace("theta", coordinate) for force in estimate.forces]
    coords = {"force": estimate.symbols, "other_force": estimate.symbols}
    labels = {"unit": ("force", units), "multiplies": ("force", terms)}
    return xr.Dataset(described("si_units", data), {**coords, **labels}, estimate.provenance)


def _stiffness(estimate: estimates.ModelEstimate, values: Array) -> float:
    """Return the whole linear stiffness: I w^2, plus the force of formula `x` if w does not contain it."""
    elastic = estimate.in_model & [force.matches("x") for force in estimate.forces]
    return float(values[-1] * values[-2] ** 2 * (1.0 + values[:-2][elastic].sum()))


def _is_monomial(force: Force) -> bool:
    """Return true if the force is a product of a power of |x|, one of |v|, signs and a number."""
    return force.degree is not None and force.speed_degree is not None


def power_law_factor(force: Force) -> float:
    """Return the number in a power law, 2 of `2*v`; 1 for other forces."""
    if not _is_monomial(force):
        return 1.0
    corners = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
    return float(np.abs(force.value(corners[:, 0], corners[:, 1])).max())


def _product(*factors: tuple[str, float], mark: str = "^") -> str:
    """Return a product of powers as text, without factors of exponent zero."""
    return " ".join(name if p == 1.0 else f"{name}{mark}{p:g}" for name, p in factors if p)


def _unit(force: Force) -> str:
    speed = force.speed_degree or 0.0
    whole = (force.degree or 0.0) if _is_monomial(force) else 0.0
    # The coefficient of a force that drifts has its own unit of time.
    drift = 0.0 if force.units == "1" else -float(force.units[1:])
    return _product(("N m", 1.0), ("s", speed - drift), ("rad", -whole), mark="")


def _term(force: Force) -> str:
    if not _is_monomial(force):
        rate = "theta'/w" if force.speed_degree is None else "theta'"
        return f"{force.formula.text}, x = theta, v = {rate}"
    speed = force.speed_degree or 0.0
    return _product(("|theta|", (force.degree or 0.0) - speed), ("|theta'|", speed)) or "1"


def per_input(result: xr.Dataset) -> xr.Dataset | None:
    """Return mass, stiffness and forces per gain of an input; None if no force is an input alone.

    Parameters
    ----------
    result : Dataset
        An identification with a force of formula `-u`, where u is any input.

    Returns
    -------
    Dataset or None
        Over `quantity`: `value` and `standard_error`. With the gain g and u in N these are in SI units: the
        mass 1/(w^2 g), N/(m/s^2); the stiffness 1/g, N/m (omitted for a body that is free to move); for a
        force proportional to a power q of the rate, its magnitude at unit rate, c h(0, 1)/(g w^q), N/(m/s)^q.
        Other forces are omitted.

    Notes
    -----
    From theta'' + w^2 (theta + c h - g u) = 0, divided by w^2 g; the errors are of first order.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> forces = st.library(st.load_library("inputs")["gain"], "zeta")
    >>> time = np.arange(0.0, 15.0, 0.02)
    >>> push = np.sin(7.0 * time) + np.sin(11.0 * time)
    >>> model = st.Model(forces, {"gain": 0.05, "zeta": 0.02}, 10.0)
    >>> record = st.simulate(model, time, inputs={"u": push})
    >>> quantities = st.physics.per_input(st.identify(record, forces, "direct"))
    >>> quantities.value.round(3).to_series().to_dict()
    {'mass': 0.2, 'stiffness': 20.0, 'zeta': 0.08}
    """
    estimate = estimates.model_estimate(result)
    drive = next((at for at, force in enumerate(estimate.forces) if _is_gain(force)), None)
    if drive is None:
        return None
    bound = not any(force.matches("-x") for force in estimate.forces)
    sizes = [(at, _at_unit_rate(force), force) for at, force in enumerate(estimate.forces)]
    of_rate = [(at, size, force) for at, size, force in sizes if size is not None]

    def quantities(z: Array) -> list[float]:
        forces = [z[at] * size / z[-1] ** (force.speed_degree or 0.0) for at, size, force in of_rate]
        return [part / z[drive] for part in (z[-1] ** -2.0, *[1.0] * bound, *forces)]

    covariance = estimate.covariance.copy()
    # The correlations of the frequency with the coefficients are neglected.
    covariance[-1, :-1] = covariance[:-1, -1] = 0.0
    values, errors = estimates.propagate(quantities, estimate.values, covariance)
    data = {"value": variable("quantity", values, "in the unit of the input")}
    data["standard_error"] = variable("quantity", errors, "standard error")
    names = [MASS, *[STIFFNESS] * bound, *(force.symbol for *_, force in of_rate)]
    return xr.Dataset(data, {"quantity": names}, {"input": estimate.forces[drive].inputs[0]})


def _is_gain(force: Force) -> bool:
    """Return true if a force is a driving input with its own unit."""
    single = len(force.channels) == 1 and not force.channels[0].kind
    return single and force.formula.text.replace(" ", "") == f"-{force.channels[0].name}"


def _at_unit_rate(force: Force) -> float | None:
    """Return h(0, 1) for a force that is a power of the rate alone; None for other forces."""
    names = {name for formula in force.formulas for name in formula.names}
    if force.kind != "force" or not names <= {"v"} or force.speed_degree is None:
        return None
    return float(force.value(0.0, 1.0))


def check_measured(names: Set[str]) -> None:
    """Raise an error unless the given quantities, by their names in `in_si_units`, suffice for SI units.

    Raises
    ------
    UsageError
        Inertia and mass are both given or both missing, or the radius lacks inertia or load, or the load
        lacks them.
    """
    if ("inertia" in names) == ("mass" in names) or ("radius" in names) != ({"inertia", "load"} <= names):
        raise UsageError(
            "SI units need the inertia for an angle, or the mass for a displacement; the "
            "coefficient of friction "
            "also needs the load and, for an angle, the friction radius."
        )


def in_si_units(
    result: xr.Dataset,
    *,
    inertia: Measured | None = None,
    mass: Measured | None = None,
    load: Measured | None = None,
    radius: Measured | None = None,
) -> xr.Dataset:
    """Return torques or forces of the contact and the friction coefficient in SI units, with errors.

    Parameters
    ----------
    result : Dataset
        An identification: of an angle, with an inertia, or of a displacement, with a mass.
    inertia : (float, float), kg m^2
        Moment of inertia and its standard error; the other pairs have the same form.
    mass : (float, float), kg
        Mass, for a displacement in a unit of length.
    load : (float, float), N
        Normal load of the contact.
    radius : (float, float), m
        Friction radius, for an angle: for a contact that turns about its centre, 2/3 of its radius under
        uniform pressure, and 3 pi/16 of it under Hertz's pressure.

    Returns
    -------
    Dataset
        As in `physical_units`; for a displacement `coefficient`, `standard_error` and `covariance` in the
        unit of the coordinate `unit` (N, kg s^-1, kg m^-1, ...), nan for forces without a degree in the
        signal, and `mass`. With a load also `friction_coefficient(force)` and its error, for forces that do
        not depend on the magnitude of the motion, otherwise nan.

    Raises
    ------
    UsageError
        The required identification is missing, or a quantity is missing or not positive.

    Notes
    -----
    A force of degree p in the signal and q in v is m w^(2-q) c |x|^(p-q) |x'|^q: a numerical factor of a
    power law is included in the coefficient, 2 zeta m w. The coefficient of friction is the force over the
    load, or the torque over load and radius. The errors include those of w and of all given quantities.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> torques = st.physics.in_si_units(result, inertia=(0.012, 0.0002))
    >>> zeta = torques.sel(force="zeta")
    >>> print(f"{zeta.coefficient.item():.5f} ± {zeta.standard_error.item():.5f} {zeta.unit.item()}")
    0.00231 ± 0.00004 N m s rad-1
    """
    given = {"inertia": inertia, "mass": mass, "load": load, "radius": radius}
    check_measured({name for name, value in given.items() if value is not None})
    for name, measured in given.items():
        if measured is not None:
            estimates.check_quantity(name, *measured)
    estimate = estimates.model_estimate(result)
    if mass is not None:
        unit = signal_units(result)
        check_length_unit(unit)
        values = _in_si(estimate, mass, unit).assign(described("si_units", {"mass": mass}))
    elif inertia is not None:
        check_angle_unit(signal_units(result))
        stiffness = estimates.propagate(lambda z: _stiffness(estimate, z), *estimate.with_inertia(*inertia))
        further = described("si_units", {"linear_stiffness": stiffness, "inertia": inertia})
        values = _in_si(estimate, inertia, None).assign(further)
    if load is None:
        return values
    arm = {"load": load} | ({} if radius is None else {"radius": radius})
    over, error = np.array(list(arm.values())).T
    # Forces that do not depend on the magnitude of the motion.
    dry = _degrees(estimate) == 0.0
    friction = np.where(dry, values.coefficient.values / over.prod(), np.nan)
    errors = np.hypot(values.standard_error.values / over.prod(), friction * np.linalg.norm(error / over))
    return values.assign(described("si_units", {**arm, MU: (friction, errors)}))


def _degrees(estimate: estimates.ModelEstimate) -> Array:
    """Return the degree of each force in the signal; nan for a force without one."""
    degrees = [signal_powers(force) for force in estimate.forces]
    return np.array([np.nan if degree is None else 1.0 - degree[""] for degree in degrees])


def check_length_unit(unit: str) -> None:
    """Raise an error for a signal that is not a length.

    Raises
    ------
    UsageError
        The message states what to give instead.
    """
    if unit not in METRES:
        raise UsageError(
            f"A mass makes forces of a displacement in a unit of length; this record is in {unit}. "
            "Give its unit, --units mm, or for an angle the inertia, --inertia."
        )


def check_angle_unit(unit: str) -> None:
    """Raise an error for a signal that is not an angle.

    Raises
    ------
    UsageError
        The message states what to give instead.
    """
    # The measured quantity may be the rate of an angle, in rad/s.
    if unit.partition("/")[0] != ANGLE_UNIT:
        raise UsageError(
            f"A moment of inertia makes torques of an angle; this record is in {unit}. Give the mass, "
            "--mass, or the length of a pendulum, --length, so that the displacement becomes an angle."
        )


def _unit_of_force(power: float, speed: float) -> str:
    """Return the unit of a coefficient: kg m^(1-p) s^(q-2), or N if it equals N."""
    if power == 0.0 and speed == 0.0:
        return "N"
    return _product(("kg", 1.0), ("m", 1.0 - power), ("s", speed - 2.0))
