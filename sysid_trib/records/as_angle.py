"""What was measured as an angle or a displacement: rates and accelerations integrated, gravity undone."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.equilibrium import find_swing
from sysid_trib.decays.integration import integrated
from sysid_trib.errors import RecordError
from sysid_trib.records.units import ACCELEROMETER, INTEGRATIONS, METRES, STANDARD_GRAVITY, SignalUnit

# An accelerometer that feels less of gravity than this part shows no angle.
LEAST_FELT = 0.02


def as_position(
    time: Array, values: Array, unit: SignalUnit, attrs: dict[str, Any], length: float | None
) -> xr.Dataset:
    """The record of a signal; a rate is integrated once, an acceleration twice, without the drift of a bias.

    Parameters
    ----------
    time, values : (sample,) array of float, s and `unit`
    unit : SignalUnit
    attrs : dict
        How it was read.
    length : float or None, m
        Of a pendulum: turns a displacement in a unit of length into an angle.

    Returns
    -------
    Dataset
        `angle(time)`, and what was measured if that is another quantity.
    """
    record = xr.Dataset(coords={"time": ("time", time, {"units": "s", "long_name": "time"})}, attrs=attrs)
    position, times = unit.position, INTEGRATIONS[unit.quantity]
    if times:
        measured = f"{position}/s" if times == 1 else f"{position}/s^2"
        long_name = f"{unit.quantity} as measured"
        record[unit.quantity] = ("time", values, {"units": measured, "long_name": long_name})
        swing = find_swing(time, values)
        bias = float(np.median(values)) if swing is None else swing.equilibrium
        period = float(np.ptp(time)) if swing is None else swing.oscillation.period
        values = values - bias
        for _ in range(times):
            values = integrated(time, values, period)
        record.attrs["measured"] = unit.quantity
        record.attrs[f"{unit.quantity}_bias"] = bias
        count = "once" if times == 1 else "twice"
        record.attrs["integrations"] = times
        record.attrs["integration"] = (
            f"integrated {count}, without the drift of its bias (splines, knots two periods apart)"
        )
    if length is not None and position in METRES:
        values, by_length, position = values * METRES[position] / length, METRES[position] / length, "rad"
        if times:
            per = str(record[unit.quantity].attrs["units"]).partition("/")[2]
            record[unit.quantity] = (record[unit.quantity] * by_length).assign_attrs(
                record[unit.quantity].attrs | {"units": f"rad/{per}"}
            )
        record.attrs["length"] = length
    name = "angle" if position == "rad" else "displacement"
    record["angle"] = ("time", values, {"units": position, "long_name": name})
    return record


def as_felt(time: Array, values: Array, attrs: dict[str, Any], distance: float, source: str) -> xr.Dataset:
    """The record of an accelerometer on a pendulum, with the angle to first order.

    It feels g sin(x) + r x'' along its path. Without friction x'' = -w^2 sin(x): the angle is the arcsine of
    what it feels over g - r w^2.
    """
    swing = find_swing(time, values)
    if swing is None:
        raise RecordError(f"{source}: no oscillation stands out of the noise; choose another axis.")
    felt = STANDARD_GRAVITY - distance * (2.0 * np.pi / swing.oscillation.period) ** 2
    if felt < LEAST_FELT * STANDARD_GRAVITY:
        raise RecordError(
            f"{source}: at {distance:g} m from the axis an accelerometer feels next to nothing of this swing "
            f"along its path ({felt:.3g} m/s^2 of 9.81): correct --distance, or choose another axis."
        )
    sine = np.clip((values - swing.equilibrium) / felt, -1.0, 1.0)
    record = xr.Dataset(coords={"time": ("time", time, {"units": "s", "long_name": "time"})}, attrs=attrs)
    long_name = "acceleration that was felt"
    record[ACCELEROMETER] = ("time", values, {"units": "m/s^2", "long_name": long_name})
    record["angle"] = ("time", np.arcsin(sine), {"units": "rad", "long_name": "angle"})
    record.attrs |= {
        "signal": ACCELEROMETER,
        "measured": ACCELEROMETER,
        "integrations": 0,
        "distance": distance,
        "felt_per_sine": felt,
        "integration": "its angle by the arcsine, as if there were no friction",
    }
    return record
