"""What was measured as an angle or a displacement: axes combined, rates and accelerations integrated."""

import re
from typing import Any

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.equilibrium import find_swing
from sysid_trib.records.inputs import PER_KIND
from sysid_trib.records.signal import clamped_knots
from sysid_trib.records.units import ACCELEROMETER, INTEGRATIONS, METRES, STANDARD_GRAVITY, SignalUnit

_AXIS = re.compile(r"^[xyz](?=[ _-])|(?<![^\W\d_]{2})[xyz]$|(?<=[ _-])[xyz]$|(?<=acc)[xyz]$|(?<=gyro)[xyz]$")


def are_axes(first: str, second: str) -> bool:
    """True if two names differ by their axis alone: `gyroscope x` and `gyroscope y`, `ax` and `az`."""
    plain = [_AXIS.sub("", name) for name in (first, second)]
    return first != second and plain[0] == plain[1] and first not in plain and second not in plain


def in_phase(first: Array, second: Array, least: float = 0.8) -> bool:
    """True if two columns are one motion, of either sign, but for their noise: by their correlation."""
    if first.size != second.size:
        return False
    good = np.isfinite(first) & np.isfinite(second)
    x, y = first[good], second[good]
    return bool(x.size > 1 and np.ptp(x) and np.ptp(y) and abs(np.corrcoef(x, y)[0, 1]) > least)


def is_magnitude(values: Array) -> bool:
    """True if a column is never negative but near zero to the end: a magnitude, not a signal with a sign."""
    good = values[np.isfinite(values)]
    if good.size < 2 or good.min() < 0.0:
        return False
    parts = [part for part in np.array_split(good, 4) if part.size]
    # Of its range: a magnitude comes back to zero as near as this in every swing.
    allowed = 0.05 * max(float(part.max()) for part in parts)
    return all(part.min() < allowed for part in parts)


DRIFT_DEGREE = 3


def integrated(time: Array, signal: Array, period: float) -> Array:
    """Integral of an oscillation over time, about its slow mean.

    Parameters
    ----------
    time : (sample,) array of float, s
        Rising.
    signal : (sample,) array of float
    period : float, s
        Of the oscillation.

    Returns
    -------
    (sample,) array of float
        In the signal's unit times s.

    Notes
    -----
    The antiderivative of the quintic spline through the samples, less its drift: the slow part of the least
    squares fit of splines (knots two periods apart) times 1, cos and sin. Without the waves the ends of the
    swing would pass for drift.
    """
    spline = (
        make_interp_spline(time, signal - np.median(signal), 5)
        if time.size > 6
        else CubicSpline(time, signal)
    )
    whole = np.asarray(spline.antiderivative()(time), dtype=float)
    return whole - _drift(time, whole, period)


def _drift(time: Array, signal: Array, period: float) -> Array:
    # Knots of drift and envelope are so many periods apart: slower than the swing, faster than a bias
    # drifts.
    spans = int((time[-1] - time[0]) / (2.0 * period))
    slow = BSpline.design_matrix(time, clamped_knots(time, spans, DRIFT_DEGREE), DRIFT_DEGREE).tocsr()
    phase = 2.0 * np.pi * (time - time[0]) / period
    design = sp.hstack([slow, *(sp.diags_array(wave(phase)) @ slow for wave in (np.cos, np.sin))]).tocsr()
    # Normal equations: a few hundred unknowns of many thousand samples.
    normal = (design.T @ design).toarray()
    solution = np.linalg.lstsq(normal, design.T @ signal, rcond=1e-12)[0]
    return np.asarray(slow @ solution[: slow.shape[1]])


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
    position, times, scale = unit.position, INTEGRATIONS[unit.quantity], 1.0
    if length is not None and position in METRES:
        position, scale, attrs = "rad", METRES[position] / length, attrs | {"length": length}
    record = xr.Dataset(coords={"time": ("time", time, {"units": "s", "long_name": "time"})}, attrs=attrs)
    if times:
        measured = {"units": position + PER_KIND[unit.quantity], "long_name": f"{unit.quantity} as measured"}
        record[unit.quantity] = ("time", values * scale, measured)
        swing = find_swing(time, values)
        bias = float(np.median(values)) if swing is None else swing.equilibrium
        period = float(np.ptp(time)) if swing is None else swing.oscillation.period
        values = values - bias
        for _ in range(times):
            values = integrated(time, values, period)
        said = f"integrated {'once' if times == 1 else 'twice'}, without the drift of its bias"
        record.attrs |= {
            "measured": unit.quantity,
            f"{unit.quantity}_bias": bias,
            "integrations": times,
            "integration": f"{said} (splines, knots two periods apart)",
        }
    name = "angle" if position == "rad" else "displacement"
    record["angle"] = ("time", values * scale, {"units": position, "long_name": name})
    return record


def as_felt(time: Array, values: Array, attrs: dict[str, Any], distance: float) -> xr.Dataset:
    """The record of an accelerometer on a pendulum, with the angle to first order.

    It feels g sin(x) + r x'' along its path. Without friction x'' = -w^2 sin(x): the angle is the arcsine of
    what it feels over g - r w^2.
    """
    swing = find_swing(time, values)
    source = attrs["source"]
    if swing is None:
        raise RecordError(f"{source}: no oscillation stands out of the noise; choose another axis.")
    felt = STANDARD_GRAVITY - distance * (2.0 * np.pi / swing.oscillation.period) ** 2
    # An accelerometer that feels less of gravity than this part shows no angle.
    if felt < 0.02 * STANDARD_GRAVITY:
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
