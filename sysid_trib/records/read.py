"""Records: an angle over time from a file, with its units and provenance."""

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array
from sysid_trib.decays.equilibrium import find_swing
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.columns import LENGTH_UNITS, UNITS, choose_columns, refuse_rate, si_numbers
from sysid_trib.records.tables import read_table

LARGEST_AMPLITUDE = 4.0 * np.pi


def read_record(
    path: str | os.PathLike[str],
    *,
    time: str | int | None = None,
    angle: str | int | None = None,
    signal: str = "angle",
    units: str | None = None,
    sampling_rate: float | None = None,
    time_units: str | None = None,
) -> xr.Dataset:
    """Read an oscillation from a file.

    Parameters
    ----------
    path : str or path
        Text or CSV, MATLAB, Excel, netCDF, HDF5, Parquet or TDMS; the content decides, not the name.
    time : str or int, optional
        Name of the time column, or its number from 0. If not given, it is recognised by its usual names, else
        it is the first column. The columns of MATLAB and HDF5 files are named like `data.Y[0]`.
    angle : str or int, optional
        Name or number of the angle column; else recognised, or the second.
    signal : {"angle", "rate"}
        What the column `angle` holds. The rate of a gyroscope is integrated, without its bias.
    units : {"rad", "deg", "mrad", "m", "mm"}, optional
        Unit of that column (of a rate: per second), where the file does not say it; if not given either, rad.
        A position in m is for `scale_translation`.
    sampling_rate : float, Hz, optional
        Instead of a time column.
    time_units : {"s", "ms", "us", "min"}, optional
        Where the file does not say it; if not given either, s.

    Returns
    -------
    Dataset
        `angle(time)` and, for a gyroscope, `rate(time)` as measured. Times are those of the file.

    Raises
    ------
    UsageError
        An unknown column, option or file; an option that contradicts the header.
    RecordError
        A file without such a record: malformed, not finite, times out of order, impossible units.
    """
    path = Path(path)
    _check_options(signal, units, sampling_rate, time_units)
    if time is not None and sampling_rate is not None:
        raise UsageError(f"{path.name}: give a time column or a sampling rate, not both.")
    table, source = read_table(path), path.name
    time_name, angle_name = choose_columns(
        table, source, time=time, angle=angle, signal=signal, timeless=sampling_rate is not None
    )
    if signal == "angle":
        refuse_rate(table, angle_name, source)
    values, unit = si_numbers(table, angle_name, source, option="units", wanted=units)
    time_unit = "s"
    if time_name is not None:
        instants, time_unit = si_numbers(table, time_name, source, option="time_units", wanted=time_units)
    elif sampling_rate is not None:
        instants = np.arange(values.size) / sampling_rate
    else:
        raise RecordError(f"{source}: there is no time column; give the sampling rate (--sampling-rate HZ).")
    check_times(instants, source, samples=values.size)
    attrs: dict[str, Any] = {
        "source": source,
        "record_checksum": hashlib.sha256(path.read_bytes()).hexdigest(),
        "signal": signal,
        "time_column": time_name or f"none, {sampling_rate:g} Hz",
        "time_unit_in_file": time_unit,
        "angle_column": angle_name,
        "angle_unit_in_file": unit if signal == "angle" else f"{unit}/s",
    }
    return _record(instants, values, "m" if unit in LENGTH_UNITS else "rad", attrs)


def _check_options(
    signal: str, units: str | None, sampling_rate: float | None, time_units: str | None
) -> None:
    if signal not in ("angle", "rate"):
        raise UsageError(f"signal {signal!r} is unknown: give angle or rate.")
    for option, wanted in (("units", units), ("time_units", time_units)):
        known, _, offered = UNITS[option]
        if wanted is not None and wanted not in known:
            raise UsageError(f"{option.replace('_', ' ')} {wanted!r} are unknown: give {offered}.")
    if sampling_rate is not None and not 1e-9 <= sampling_rate <= 1e9:
        raise UsageError(f"sampling rate {sampling_rate:g}: give a positive number of samples a second.")


def _record(time: Array, values: Array, unit: str, attrs: dict[str, Any]) -> xr.Dataset:
    record = xr.Dataset(coords={"time": ("time", time, {"units": "s", "long_name": "time"})}, attrs=attrs)
    if attrs["signal"] == "rate":
        record["rate"] = ("time", values, {"units": f"{unit}/s", "long_name": "rate as measured"})
        swing = find_swing(time, values)
        bias = float(np.median(values)) if swing is None else swing.equilibrium
        values = CubicSpline(time, values - bias).antiderivative()(time)
        record.attrs["rate_bias"] = bias
        record.attrs["integration"] = (
            f"angle integrated (spline) from the rate less its bias of {bias:.6g} {unit}/s"
        )
    name = "angle" if unit == "rad" else "position"
    record["angle"] = ("time", values, {"units": unit, "long_name": name})
    amplitude = 0.5 * float(np.ptp(values))
    if unit == "rad" and amplitude > LARGEST_AMPLITUDE:
        raise RecordError(
            f"{attrs['source']}: an amplitude of {amplitude:.3g} rad (column {attrs['angle_column']}) is too "
            "much for an oscillation; if it is in degrees say so, --units deg (units= in Python), "
            "else choose another column, --angle NAME (angle=)."
        )
    return record


def check_times(time: Array, source: str, *, samples: int) -> None:
    """Refuse times that are not as many as the samples, or that stand still or run backwards.

    Parameters
    ----------
    time : (sample,) array of float, s
        The times.
    source : str
        Name of the file, for messages.
    samples : int
        Number of angles.

    Raises
    ------
    RecordError
        With the row (from 1) and the time at which it happens.
    """
    if time.size != samples:
        raise RecordError(
            f"{source}: {time.size} times but {samples} angles; choose columns that belong together."
        )
    if samples < 2:
        raise RecordError(f"{source}: a single sample is not a record.")
    bad = np.flatnonzero(np.diff(time) <= 0)
    if bad.size:
        row = int(bad[0])
        what = "is repeated" if time[row + 1] == time[row] else f"is followed by {time[row + 1]:.9g} s"
        raise RecordError(
            f"{source}: time must rise, but {time[row]:.9g} s in row {row + 1} {what}; "
            "sort the rows, drop the repeated ones, or give the sampling rate instead."
        )


def scale_translation(record: xr.Dataset, mass: float, natural_frequency: float, load: float) -> xr.Dataset:
    """Turn the position of a translational tribometer into the dimensionless angle of the theory.

    Parameters
    ----------
    record : Dataset
        `angle(time)` in m.
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
        The record is not a position in m, or a value is not positive.
    """
    source = record.attrs.get("source", "record")
    if record["angle"].attrs.get("units") != "m":
        raise UsageError(f"{source}: only a position can be scaled; read the record with units=m (or mm).")
    for name, value in (("mass", mass), ("natural frequency", natural_frequency), ("load", load)):
        if not (np.isfinite(value) and value > 0):
            raise UsageError(f"{name} of {value}: give a positive number.")
    factor = mass * natural_frequency**2 / load
    scaled = record.copy()
    meanings = {"angle": ("rad", "scaled position"), "rate": ("rad/s", "scaled rate as measured")}
    for name, (unit, meaning) in meanings.items():
        if name in record:
            scaled[name] = (record[name] * factor).assign_attrs(units=unit, long_name=meaning)
    scaled.attrs = record.attrs | {
        "translation": f"angle = m w0^2 x / P with m = {mass:g} kg, w0 = {natural_frequency:g} rad/s, "
        f"P = {load:g} N",
        "translation_factor": factor,
    }
    return scaled
