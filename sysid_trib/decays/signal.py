"""What every function of a record asks of it: `angle(time)`, numbers over times that rise."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import DecayError, UsageError

# Squares and cubes of larger numbers overflow, those of numbers below its inverse are lost.
LARGEST_NUMBER = 1e75
FEWEST_SAMPLES = 4
ANGLE_UNIT = "rad"
SPELT_SECONDS = ("", "1", "s", "sec", "second", "seconds")
# Units of an angle that files may have, and a record in memory may not: its forces are functions of radians.
OTHER_ANGLES = (
    "deg",
    "degree",
    "degrees",
    "°",
    "mrad",
    "µrad",
    "rev",
    "turn",
    "turns",
    "gon",
    "arcmin",
    "arcsec",
)


def unit_of_signal(record: xr.Dataset) -> str:
    """Unit of the `angle` of a record or decay; rad where none is stated."""
    return str(record["angle"].attrs.get("units") or ANGLE_UNIT)


def checked_signal(record: Any, *names: str) -> None:
    """Refuse what is no record.

    Parameters
    ----------
    record : Dataset
        With `angle(time)`, in rad or a unit of length, over s.
    names : str
        Variables over time that it needs besides.

    Raises
    ------
    UsageError
        It is no Dataset, has no `angle(time)`, or no numbers in it.
    DecayError
        A number that is none, or vast, all numbers tiny, times that do not rise, or next to no samples; or an
        angle or a time in a unit of its own.
    """
    if not isinstance(record, xr.Dataset) or "angle" not in record:
        raise UsageError(
            f"A decay is a Dataset with angle(time), not {type(record).__name__}: free_decay(record)."
        )
    source = str(record.attrs.get("source", "record"))
    for name in ("time", "angle", *names):
        variable = record.variables.get(name)
        if variable is None or variable.dims != ("time",):
            raise UsageError(
                f"{source}: a record has {name}(time), one number for each sample; this one has none."
            )
        if variable.dtype.kind not in "fiu":
            raise UsageError(
                f"{source}: {name}(time) holds {variable.dtype}; give numbers (time in s, angles in rad)."
            )
        # Whatever is not finite is not below either.
        bad = np.flatnonzero(~(np.abs(variable.values) <= LARGEST_NUMBER))
        if bad.size:
            first, instant = bad[0], record.variables["time"].values[bad[0]]
            where = f"sample {first + 1} of {name}" if name == "time" else f"{name} at {instant:g} s"
            raise DecayError(
                f"{source}: {where} is not a finite number that can be computed with "
                f"({variable.values[first]:g}); cut it out."
            )
    _check_units(record, source)
    if record.sizes["time"] < FEWEST_SAMPLES:
        raise DecayError(f"{source}: only {record.sizes['time']} samples are no oscillation; record longer.")
    if np.any(np.diff(record.variables["time"].values.astype(float)) <= 0.0):
        raise DecayError(f"{source}: its times do not rise; sort them.")
    for name in ("time", "angle"):
        values = record.variables[name].values
        extent = float(np.max(values) - np.min(values))
        if 0.0 < extent < 1.0 / LARGEST_NUMBER:
            raise DecayError(
                f"{source}: {name} is flat at {values[0]:.3g} but for {extent:.3g}, too little; scale it."
            )


def _check_units(record: xr.Dataset, source: str) -> None:
    """Refuse times that are not in s and angles that are not in rad; a displacement has any unit."""
    time_unit = str(record["time"].attrs.get("units", "")).strip()
    if time_unit.lower() not in SPELT_SECONDS:
        raise DecayError(
            f"{source}: its times are in {time_unit}, where s are needed; convert them "
            '(record.assign_coords(time=...)), with units="s".'
        )
    angle_unit = unit_of_signal(record).strip()
    if angle_unit.lower() in OTHER_ANGLES:
        raise DecayError(
            f'{source}: its angle is in {angle_unit}, where rad are needed; convert it, with units="rad".'
        )
