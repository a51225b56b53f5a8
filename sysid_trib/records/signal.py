"""The signal of a record for other functions: `angle(time)`, integrated or not, in parts without gaps."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.linalg import solveh_banded

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records.units import ANGLE_UNITS

# Squares and cubes of larger numbers overflow, those of numbers below its inverse are lost.
LARGEST_NUMBER = 1e75
FEWEST_SAMPLES = 4
ANGLE_UNIT = "rad"
SPELT_SECONDS = ("", "1", "s", "sec", "second", "seconds")
# Attribute with the name of the variable with white noise, of a record that was integrated from it.
NOISE_IS_WHITE_IN = "white_noise_in"


def unit_of_signal(record: xr.Dataset) -> str:
    """Return the unit of the `angle` of a record or decay; rad where none is stated."""
    return str(record["angle"].attrs.get("units") or ANGLE_UNIT)


def checked_signal(record: Any, *names: str) -> None:
    """Raise an error for an object that is no record.

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
        kind = type(record).__name__
        raise UsageError(f"A decay is a Dataset with angle(time), not {kind}: free_decay(record).")
    source = str(record.attrs.get("source", "record"))
    for name in ("time", "angle", *names):
        variable = record.variables.get(name)
        if variable is None or variable.dims != ("time",):
            raise UsageError(f"{source}: a record has {name}(time), one number a sample; this one has none.")
        if variable.dtype.kind not in "fiu":
            raise UsageError(f"{source}: {name}(time) contains {variable.dtype}; give numbers in s and rad.")
        # A value that is not finite is not below the limit either.
        # In double precision: single has no numbers as large as the limit.
        bad = np.flatnonzero(~(np.abs(variable.values.astype(float)) <= LARGEST_NUMBER))
        if bad.size:
            first, instant = bad[0], record.variables["time"].values[bad[0]]
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
    """Refuse times that are not in s and angles that are not in rad; a displacement has any unit."""
    time_unit = str(record["time"].attrs.get("units", "")).strip()
    if time_unit.lower() not in SPELT_SECONDS:
        raise DecayError(
            f"{source}: its times are in {time_unit}, not in s; convert them "
            '(record.assign_coords(time=...)), with units="s".'
        )
    angle_unit = unit_of_signal(record).strip()
    # Files may have other units of an angle, a record in memory may not: its forces are functions of radians.
    if ANGLE_UNITS.get(angle_unit.lower(), ANGLE_UNIT) != ANGLE_UNIT:
        raise DecayError(f'{source}: its angle is in {angle_unit}, not in rad; convert it, with units="rad".')


# A gap of more than this part of a period divides a record: no polynomial predicts the motion in it.
LONGEST_FILLED = 0.25
FILL_DEGREE = 7
# A step longer than this many usual ones has samples missing in it.
PARTED_STEP = 1.5


class Piece(NamedTuple):
    """A part of a record without a long gap.

    Attributes
    ----------
    time : (sample,) array of float, s
        In steps that differ by 2 % at most.
    signal : (sample,) array of float
    changes : str
        Changes that made the steps even; empty if they were even.
    """

    time: Array
    signal: Array
    changes: str


def usual_step(steps: Array) -> float:
    """Return the mean of steps, without those that have samples missing in them."""
    return float(np.mean(steps[steps <= PARTED_STEP * np.median(steps)]))


def clamped_knots(time: Array, intervals: int, degree: int) -> Array:
    """Return uniform knots from first to last sample, with a number of intervals, of splines of a degree."""
    inner = np.linspace(time[0], time[-1], max(1, intervals) + 1)
    return np.concatenate([np.full(degree, time[0]), inner, np.full(degree, time[-1])])


def uniform_pieces(time: Array, signal: Array, period: float, breaks: tuple[float, ...] = ()) -> list[Piece]:
    """Split a record at long gaps and put each piece on a uniform clock.

    Parameters
    ----------
    time : (sample,) array of float, s
        Rising, in any steps.
    signal : (sample,) array of float
    period : float, s
        Period of the oscillation: a gap of more than a quarter of it parts the record.
    breaks : tuple of float, s
        Further times at which a piece starts.

    Notes
    -----
    Where steps differ by more than 2 %, samples on a uniform grid are those of the cubic spline through the
    measured ones. In a short gap they are those of the polynomial of degree 7 that fits a quarter of a period
    on either side best. The mean step stays, and so does the density of the noise at low frequency.
    """
    steps = np.diff(time)
    usual = usual_step(steps)
    longest = max(LONGEST_FILLED * period, PARTED_STEP * usual)
    bounds = np.union1d(np.flatnonzero(steps > longest) + 1, np.searchsorted(time, breaks)).astype(int)
    parts = np.split(np.arange(time.size), bounds)
    return [_on_a_grid(time[part], signal[part], usual, period) for part in parts if part.size > 1]


def is_uniform(time: Array) -> bool:
    """Return true if all steps are within 2 % of the median (the limit itself is on the good side)."""
    steps = np.diff(time)
    median = float(np.median(steps))
    # Largest relative deviation of a step from the usual one that needs no resampling.
    return bool(np.abs(steps - median).max(initial=0.0) <= (1.0 + 1e-6) * 0.02 * median)


def _on_a_grid(time: Array, signal: Array, usual: float, period: float) -> Piece:
    if is_uniform(time):
        return Piece(time, signal, "")
    count = max(1, round((time[-1] - time[0]) / usual))
    grid = np.linspace(time[0], time[-1], count + 1)
    value = CubicSpline(time, signal)(grid)
    filled = 0
    for start in np.flatnonzero(np.diff(time) > PARTED_STEP * usual):
        low, high = time[start], time[start + 1]
        # The samples at its ends are there: by rounding a point of the grid may be after one.
        inside = (grid > low + 0.5 * usual) & (grid < high - 0.5 * usual)
        near = (time >= low - LONGEST_FILLED * period) & (time <= high + LONGEST_FILLED * period)
        if np.count_nonzero(near) > 2 * FILL_DEGREE:
            fit = np.polynomial.Polynomial.fit(time[near], signal[near], FILL_DEGREE)
            value[inside] = fit(grid[inside])
        filled += int(np.count_nonzero(inside))
    uneven = f"uneven steps: interpolated to {1.0 / (grid[1] - grid[0]):.5g} Hz"
    gaps = f"{filled} missing samples filled from a quarter of a period on either side"
    steps = np.diff(time)
    jitters = not is_uniform(np.cumsum(steps[steps <= PARTED_STEP * usual]))
    said = [text for text, is_so in ((uneven, jitters or not filled), (gaps, filled > 0)) if is_so]
    return Piece(grid, value, " and ".join(said))


DRIFT_DEGREE = 3
SMALLEST_PIVOT = 1e-13


def integrated(time: Array, signal: Array, period: float) -> Array:
    """Return the integral of an oscillation over time, about its slow mean.

    Parameters
    ----------
    time : (sample,) array of float, s
        Rising.
    signal : (sample,) array of float
    period : float, s
        Period of the oscillation.

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
    centred = signal - np.median(signal)
    spline = make_interp_spline(time, centred, 5) if time.size > 6 else CubicSpline(time, signal)
    whole = np.asarray(spline.antiderivative()(time), dtype=float)
    return whole - _drift(time, whole, period)


def _drift(time: Array, signal: Array, period: float) -> Array:
    # Periods between the knots of drift and envelope: slower than the swing, faster than the drift of a bias.
    spans = int((time[-1] - time[0]) / (2.0 * period))
    slow = BSpline.design_matrix(time, clamped_knots(time, spans, DRIFT_DEGREE), DRIFT_DEGREE).tocsr()
    phase = 2.0 * np.pi * (time - time[0]) / period
    waves = (np.ones_like(phase), np.cos(phase), np.sin(phase))
    # The columns of each spline are adjacent: the normal equations are banded, and the solution time is
    # proportional to the number of periods.
    columns = sp.hstack([sp.diags_array(wave) @ slow for wave in waves], format="csc")
    splines = slow.shape[1]
    design = columns[:, np.arange(len(waves) * splines).reshape(len(waves), splines).T.ravel()].tocsr()
    normal = design.T @ design
    width = len(waves) * (DRIFT_DEGREE + 1)
    band = np.stack([np.pad(normal.diagonal(-k), (0, k)) for k in range(width)])
    # With few samples a wave may be a sum of others: smaller parts than this are ignored.
    band[0] += SMALLEST_PIVOT * band[0].max()
    solution = solveh_banded(band, design.T @ signal, lower=True)
    return np.asarray(slow @ solution[:: len(waves)])


def as_position(time: Array, measured: Array, period: float, attrs: Mapping[Any, Any]) -> Array:
    """Return angle or displacement of a measured quantity, about its mean, as the record's attrs state it.

    Parameters
    ----------
    time, measured : (sample,) array of float
    period : float, s
        Period of the oscillation.
    attrs : mapping
        `integrations`, how often it is integrated; `felt_per_sine` of an accelerometer on a pendulum, which
        feels so much times the sine of the angle.
    """
    for _ in range(int(attrs["integrations"])):
        measured = integrated(time, measured, period)
    if "felt_per_sine" in attrs:
        return np.asarray(np.arcsin(np.clip(measured / float(attrs["felt_per_sine"]), -1.0, 1.0)))
    return measured
