"""What every function of a record asks of it: `angle(time)`, numbers over times that rise."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import DecayError, UsageError

# Squares and cubes of larger numbers overflow, those of numbers below its inverse are lost.
LARGEST_NUMBER = 1e75
FEWEST_SAMPLES = 4
ANGLE_UNIT = "rad"


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
        A number that is none, or vast, all numbers tiny, times that do not rise, or next to no samples.
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
