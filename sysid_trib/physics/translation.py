"""Coefficients of a displacement in SI units: forces on a mass, and the coefficient of friction."""

import numpy as np
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.forces.scaling import signal_degree
from sysid_trib.physics.error_propagation import check_quantity
from sysid_trib.physics.model_estimate import model_estimate
from sysid_trib.physics.units import power_law_factor
from sysid_trib.records.units import METRES
from sysid_trib.results.signal_units import signal_units
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable


def translation_units(result: xr.Dataset, mass: float, load: float | None = None) -> xr.Dataset:
    """Forces on a mass from the coefficients of a displacement in a unit of length.

    Parameters
    ----------
    result : Dataset
        An identification of a displacement.
    mass : float, kg
    load : float, N, optional
        Normal load of the contact.

    Returns
    -------
    Dataset
        Over `force`: `coefficient` and `standard_error` in the unit of the coordinate `unit` (N, kg s^-1,
        kg m^-1, ...); with a load `friction_coefficient` and `friction_coefficient_standard_error` of forces
        that do not depend on the size of the motion, else nan. Forces of no degree in the signal are nan.

    Raises
    ------
    UsageError
        No identification of a length, or no positive mass or load.

    Notes
    -----
    A force of degree p in the signal and q in v is m w^(2-q) c |x|^(p-q) |x'|^q in SI units; a numerical
    factor of a power law goes to the coefficient: 2 zeta m w. Errors hold those of w, but not of the mass.
    """
    check_quantity("mass", mass, 0.0)
    if load is not None:
        check_quantity("load", load, 0.0)
    unit = signal_units(result)
    check_length_unit(unit)
    estimate = model_estimate(result)
    w, w_error = estimate.frequency, float(np.sqrt(estimate.covariance[-1, -1]))
    rows, names = [], []
    for force, c, error in zip(
        estimate.forces,
        estimate.coefficients,
        np.sqrt(np.diag(estimate.coefficient_covariance)),
        strict=True,
    ):
        degree, speed = signal_degree(force), force.speed_degree or 0.0
        power = np.nan if degree is None else degree.force
        scale = power_law_factor(force) * mass * w ** (2.0 - speed) * METRES[unit] ** (1.0 - power)
        rows.append((scale * c, np.hypot(scale * error, (2.0 - speed) * scale * c * w_error / w), power))
        names.append(_unit(power, speed))
    value, errors, powers = np.array(rows).T
    data: Variables = {
        "coefficient": variable("force", value, "coefficient in SI units", PER_FORCE_UNIT),
        "standard_error": variable("force", errors, "standard error of the coefficient", PER_FORCE_UNIT),
    }
    if load is not None:
        of_load = np.where(powers == 0.0, 1.0 / load, np.nan)
        meaning = "coefficient of friction"
        data["friction_coefficient"] = variable("force", of_load * value, meaning, "1")
        data["friction_coefficient_standard_error"] = variable(
            "force", of_load * errors, f"standard error of the {meaning}", "1"
        )
    coords = {"force": estimate.symbols, "unit": ("force", names)}
    return xr.Dataset(data, coords, estimate.provenance)


def check_length_unit(unit: str) -> None:
    """Refuse a signal that is no length.

    Raises
    ------
    UsageError
        With what to give instead.
    """
    if unit not in METRES:
        raise UsageError(
            f"A mass makes forces of a displacement in a unit of length; this record is in {unit}. Give its "
            "unit, --units mm, or for an angle the moment of inertia, --inertia."
        )


def _unit(power: float, speed: float) -> str:
    """Unit of a coefficient: kg m^(1-p) s^(q-2); N where that is one."""
    if power == 0.0 and speed == 0.0:
        return "N"
    powers = (("m", 1.0 - power), ("s", speed - 2.0))
    return " ".join(["kg", *(name if p == 1.0 else f"{name}^{p:g}" for name, p in powers if p)])
