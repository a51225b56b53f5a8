"""The position of a translational tribometer as the angle of the theory."""

import numpy as np
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.records.units import METRES


def scale_translation(record: xr.Dataset, mass: float, natural_frequency: float, load: float) -> xr.Dataset:
    """Turn the position of a translational tribometer into the dimensionless angle of the theory.

    Parameters
    ----------
    record : Dataset
        `angle(time)` in a unit of length.
    mass : float, kg
        m.
    natural_frequency : float, rad/s
        w0.
    load : float, N
        P.

    Returns
    -------
    Dataset
        `angle(time)` = m w0^2 x / P; a friction force T then acts as f = -T/P (Le Bot et al. 2019, Sec. 2).

    Raises
    ------
    UsageError
        The record is not a position in a unit of length, or a value is not positive.
    """
    source = record.attrs.get("source", "record")
    unit = str(record["angle"].attrs.get("units"))
    if unit not in METRES:
        raise UsageError(f"{source}: only a position can be scaled; read the record with units=m (or mm).")
    for name, value in (("mass", mass), ("natural frequency", natural_frequency), ("load", load)):
        if not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} of {value}: give a positive number.")
    factor = METRES[unit] * mass * natural_frequency**2 / load
    scaled = record.copy()
    scaled["angle"] = (record["angle"] * factor).assign_attrs(units="rad", long_name="scaled position")
    scaled.attrs = record.attrs | {
        "translation": f"angle = m w0^2 x / P with m = {mass:g} kg, w0 = {natural_frequency:g} rad/s, "
        f"P = {load:g} N",
        "translation_factor": factor,
    }
    return scaled
