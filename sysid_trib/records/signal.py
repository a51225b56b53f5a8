"""The signal of a record for other functions: `angle(time)`, integrated or not, in parts without gaps."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records.unit_tables import ANGLE_UNITS

# Squares and cubes of larger numbers overflow; those of numbers below its inverse underflow.
LARGEST_NUMBER = 1e75
FEWEST_SAMPLES = 4
ANGLE_UNIT = "rad"
SPELT_SECONDS = ("", "1", "s", "sec", "second", "seconds")
# Attribute of an integrated record with the name of the variable that has white noise.
NOISE_IS_WHITE_IN = "white_noise_in"


def unit_of_signal(record: xr.Dataset) -> str:
    """Return the unit of the `angle` of a record or decay; rad if none is stated."""
    return str(record["angle"].attrs.get("units") or ANGLE_UNIT)


def checked_signal(record: Any, *names: str) -> None:
    """Raise an error for an object that is not a record.

    Parameters
    ----------
    record : Dataset
        Record with `angle(time)`, in rad or a unit of length, over s.
    names : str
        Further variables over time that it needs.

    Raises
    ------
    UsageError
        It is not a Dataset, has no `angle(time)`, or no numbers in it.
    DecayError
        A value is not finite or too large, all values are tiny, the times do not increase, or there are
        almost no samples; or an angle or a time has another unit.
    """
    if not isinstance(record, xr.Dataset) or "angle" not in record:
        kind = type(record).__name__
        raise UsageError(f"A decay is a Dataset with angle(time), not {kind}: free_decay(record).")
    source = str(record.attrs.get("source", "record"))
    for name in ("time", "angle", *names):
        variable = record.variables.get(name)
        if variable is None or variable.dims != ("time",):
            raise UsageError(f"{source}: a record has {name}(time), one number a sample; this one has none.")
        if variable.dtype.kind not in "fiu":
            raise UsageError(f"{source}: {name}(time) contains {variable.dtype}; give numbers in s and rad.")
        # This also finds values that are not finite. Compare in double precision, because single precision
        # has no numbers as large as the limit.
        bad = np.flatnonzero(~(np.abs(variable.values.astype(float)) <= LARGEST_NUMBER))
        if bad.size:
            first = bad[0]
            instant = record.variables["time"].values[bad[0]]
            where = f"sample {first + 1} of {name}" if name == "time" else f"{name} at {instant:g} s"
            wrong = f"{source}: {where} is not a finite number, or too large ({variable.values[first]:g})"
            raise DecayError(f"{wrong}; cut it out.")
    _check_units(record, source)
    if record.sizes["time"] < FEWEST_SAMPLES:
        raise DecayError(f"{source}: only {record.sizes['time']} samples are no oscillation; record longer.")
    if np.any(np.diff(record.variables["time"].values.astype(float)) <= 0.0):
        raise DecayError(f"{source}: its times do not rise; sort them.")
    for name in ("time", "angle"):
        values = record.variables[name].values.astype(float)
        extent = float(np.max(values) - np.min(values))
        if 0.0 < extent < 1.0 / LARGEST_NUMBER:
            raise DecayError(f"{source}: {name} is flat at {values[0]:.3g} but for {extent:.3g}; scale it.")


def _check_units(record: xr.Dataset, source: str) -> None:
    """Raise an error for times not in s and angles not in rad; a displacement may have any unit."""
    time_unit = str(record["time"].attrs.get("units", "")).strip()
    if time_unit.lower() not in SPELT_SECONDS:
        raise DecayError(
            f"{source}: its times are in {time_unit}, not in s; convert them "
            '(record.assign_coords(time=...)), with units="s".'
        )
    angle_unit = unit_of_signal(record).strip()
    # Files may have other units of an angle, records in memory may not: the forces are functions of radians.
    if ANGLE_UNITS.get(angle_unit.lower(), ANGLE_UNIT) != ANGLE_UNIT:
        raise DecayError(f'{source}: its angle is in {angle_unit}, not in rad; convert it, with units="rad".')


# A gap longer than this fraction of a period divides a record: no polynomial predicts the motion in it.
LONGEST_FILLED = 0.25
# A step longer than this multiple of the usual one has missing samples.
PARTED_STEP = 1.5


def usual_step(steps: Array) -> float:
    """Return the mean of steps, without those that have missing samples."""
    return float(np.mean(steps[steps <= PARTED_STEP * np.median(steps)]))


def clamped_knots(time: Array, intervals: int, degree: int) -> Array:
    """Return uniform knots from first to last sample, for a number of intervals and a spline degree."""
    inner = np.linspace(time[0], time[-1], max(1, intervals) + 1)
    return np.concatenate([np.full(degree, time[0]), inner, np.full(degree, time[-1])])


def is_uniform(time: Array) -> bool:
    """Return true if all steps are within 2 % of the median (the limit itself is on the good side)."""
    steps = np.diff(time)
    median = float(np.median(steps))
    # Largest relative deviation of a step from the median that needs no resampling.
    return bool(np.abs(steps - median).max(initial=0.0) <= (1.0 + 1e-6) * 0.02 * median)
