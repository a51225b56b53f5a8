"""Forces in the unit of an input, by its gain: mass, stiffness, friction as a drive feels them."""

import numpy as np
import xarray as xr

from sysid_trib.forces.force import Force
from sysid_trib.results.schema import library_of
from sysid_trib.results.variables import variable

MASS, STIFFNESS = "mass", "stiffness"


def per_input(result: xr.Dataset) -> xr.Dataset | None:
    """Mass, stiffness and forces over the gain of an input; None where no force is an input by itself.

    Parameters
    ----------
    result : Dataset
        An identification with a force of formula `-u`, u any input.

    Returns
    -------
    Dataset or None
        Over `quantity`: `value` and `standard_error`. With g the gain and u in N these are SI: the mass
        1/(w^2 g), N/(m/s^2); the stiffness 1/g, N/m (none of a body that is free to move); of a force that is
        a power q of the rate its size at a rate of 1, c h(0, 1)/(g w^q), N/(m/s)^q. Others are left out.

    Notes
    -----
    From theta'' + w^2 (theta + c h - g u) = 0, divided by w^2 g; errors to first order.
    """
    library = library_of(result)
    drive = next((force for force in library if _is_gain(force)), None)
    if drive is None:
        return None
    w, gain = result.reference_frequency.item(), result.coefficient.sel(force=drive.symbol).item()
    rows: dict[str, tuple[str | None, float, float]] = {MASS: (None, 1.0 / w**2, -2.0)}
    if not any(force.matches("-x") for force in library):
        rows[STIFFNESS] = (None, 1.0, 0.0)
    for force in library:
        if (factor := _at_unit_rate(force)) is not None:
            q = float(force.speed_degree or 0.0)
            rows[force.symbol] = (force.symbol, factor / w**q, -q)
    values, errors = [], []
    for symbol, factor, power in rows.values():
        value = factor / gain * (1.0 if symbol is None else result.coefficient.sel(force=symbol).item())
        values.append(value)
        errors.append(_error(result, drive.symbol, symbol, value, power))
    return xr.Dataset(
        {
            "value": variable("quantity", values, "in the unit of the input"),
            "standard_error": variable("quantity", errors, "standard error"),
        },
        {"quantity": list(rows)},
        {"input": drive.inputs[0]},
    )


def _is_gain(force: Force) -> bool:
    """Whether a force is an input of a unit of its own, with the sign of one that drives."""
    single = len(force.channels) == 1 and not force.channels[0].kind
    return single and force.formula.text.replace(" ", "") == f"-{force.channels[0].name}"


def _at_unit_rate(force: Force) -> float | None:
    """h(0, 1) of a force of the rate alone that is a power of it; None of others."""
    names = {name for formula in force.formulas for name in formula.names}
    if force.kind != "force" or not names <= {"v"} or force.speed_degree is None:
        return None
    return float(force.value(0.0, 1.0))


def _error(result: xr.Dataset, gain: str, symbol: str | None, value: float, power: float) -> float:
    """Standard error of c/g w^power, by the covariance of c and g; of w by itself."""
    relative = {gain: -1.0 / result.coefficient.sel(force=gain).item()}
    if symbol is not None and (c := result.coefficient.sel(force=symbol).item()):
        relative[symbol] = 1.0 / c
    names, slopes = list(relative), np.array(list(relative.values()))
    covariance = result.covariance.sel(force=names, other_force=names).values
    w = power * result.reference_frequency_standard_error.item() / result.reference_frequency.item()
    return float(abs(value) * np.sqrt(max(0.0, float(slopes @ covariance @ slopes)) + w**2))
