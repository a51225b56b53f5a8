"""Integration of a rate or an acceleration to a position, in pieces on a uniform grid."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.linalg import solveh_banded

from sysid_trib.arrays import Array
from sysid_trib.records.signal import (
    LONGEST_FILLED,
    NOISE_IS_WHITE_IN,
    PARTED_STEP,
    clamped_knots,
    is_uniform,
    usual_step,
)

FILL_DEGREE = 7
DRIFT_DEGREE = 3
# Harmonics of a mode that are fitted with the drift: those of a stiff joint or of friction pass for drift at
# the ends otherwise. Each has so many samples at least.
HARMONICS_OF_A_MODE, SAMPLES_OF_A_WAVE = 3, 6.0
SMALLEST_PIVOT = 1e-13


class Piece(NamedTuple):
    """A part of a record without a long gap.

    Attributes
    ----------
    time : (sample,) array of float, s
        Times with steps that differ by at most 2 %.
    signal : (sample,) array of float
    changes : str
        Description of the changes that made the steps uniform; empty if they were uniform.
    """

    time: Array
    signal: Array
    changes: str


def uniform_pieces(time: Array, signal: Array, period: float, breaks: tuple[float, ...] = ()) -> list[Piece]:
    """Split a record at long gaps and put each piece on a uniform clock.

    Parameters
    ----------
    time : (sample,) array of float, s
        Increasing times, with any steps.
    signal : (sample,) array of float
    period : float, s
        Period of the oscillation: a gap longer than a quarter of it divides the record.
    breaks : tuple of float, s
        Additional times at which a piece starts.

    Notes
    -----
    If steps differ by more than 2 %, samples on a uniform grid are interpolated by the cubic spline through
    the measured ones. In a short gap they follow the polynomial of degree 7 that best fits a quarter of a
    period on either side. The mean step is unchanged, and so is the density of the noise at low frequency.
    """
    steps = np.diff(time)
    usual = usual_step(steps)
    longest = max(LONGEST_FILLED * period, PARTED_STEP * usual)
    bounds = np.union1d(np.flatnonzero(steps > longest) + 1, np.searchsorted(time, breaks)).astype(int)
    parts = np.split(np.arange(time.size), bounds)
    return [_on_a_grid(time[part], signal[part], usual, period) for part in parts if part.size > 1]


def _on_a_grid(time: Array, signal: Array, usual: float, period: float) -> Piece:
    if is_uniform(time):
        return Piece(time, signal, "")
    count = max(1, round((time[-1] - time[0]) / usual))
    grid = np.linspace(time[0], time[-1], count + 1)
    value = CubicSpline(time, signal)(grid)
    filled = 0
    for start in np.flatnonzero(np.diff(time) > PARTED_STEP * usual):
        low = time[start]
        high = time[start + 1]
        # Include the samples at the ends of a gap: rounding may move a grid point beyond one of them.
        inside = (grid > low + 0.5 * usual) & (grid < high - 0.5 * usual)
        near = (time >= low - LONGEST_FILLED * period) & (time <= high + LONGEST_FILLED * period)
        if np.count_nonzero(near) > 2 * FILL_DEGREE:
            fit = np.polynomial.Polynomial.fit(time[near], signal[near], FILL_DEGREE)
            value[inside] = fit(grid[inside])
        filled += int(np.count_nonzero(inside))
    uneven = f"uneven steps: interpolated to {1.0 / (grid[1] - grid[0]):.5g} Hz"
    samples = f"{filled} missing sample{'s' * (filled > 1)}"
    gaps = f"{samples} filled by a polynomial through a quarter of a period on either side"
    steps = np.diff(time)
    jitters = not is_uniform(np.cumsum(steps[steps <= PARTED_STEP * usual]))
    said = [text for text, is_so in ((uneven, jitters or not filled), (gaps, filled > 0)) if is_so]
    return Piece(grid, value, " and ".join(said))


def integrated(time: Array, signal: Array, period: float, harmonics: int = 1) -> Array:
    """Return the integral of an oscillation over time, about its slow mean.

    Parameters
    ----------
    time : (sample,) array of float, s
        Increasing times.
    signal : (sample,) array of float
    period : float, s
        Period of the oscillation.
    harmonics : int
        Harmonics of the oscillation that are fitted with the drift, fewer if they have few samples.

    Returns
    -------
    (sample,) array of float
        Integral, in the signal's unit times s.

    Notes
    -----
    It is the antiderivative of the quintic spline through the samples, minus its drift. The drift is the slow
    part of a least-squares fit of splines (knots two periods apart) times 1, cos and sin. Without cos and
    sin, the ends of the swing would count as drift.
    """
    centred = signal - np.median(signal)
    spline = make_interp_spline(time, centred, 5) if time.size > 6 else CubicSpline(time, signal)
    whole = np.asarray(spline.antiderivative()(time), dtype=float)
    return whole - _drift(time, whole, period, harmonics)


def _drift(time: Array, signal: Array, period: float, harmonics: int) -> Array:
    # Periods between the knots of drift and envelope: longer than the swing, shorter than the drift of a
    # bias.
    spans = int((time[-1] - time[0]) / (2.0 * period))
    slow = BSpline.design_matrix(time, clamped_knots(time, spans, DRIFT_DEGREE), DRIFT_DEGREE).tocsr()
    phase = 2.0 * np.pi * (time - time[0]) / period
    resolved = int(time.size * period / (time[-1] - time[0]) / SAMPLES_OF_A_WAVE)
    numbers = range(1, max(1, min(harmonics, resolved)) + 1)
    waves = [np.ones_like(phase)]
    waves += [wave(number * phase) for number in numbers for wave in (np.cos, np.sin)]
    # The columns of each spline are adjacent, so the normal equations are banded, and the solution time is
    # proportional to the number of periods.
    columns = sp.hstack([sp.diags_array(wave) @ slow for wave in waves], format="csc")
    splines = slow.shape[1]
    design = columns[:, np.arange(len(waves) * splines).reshape(len(waves), splines).T.ravel()].tocsr()
    normal = design.T @ design
    width = len(waves) * (DRIFT_DEGREE + 1)
    band = np.stack([np.pad(normal.diagonal(-k), (0, k)) for k in range(width)])
    # With few samples a column may be a sum of others: pivots below this fraction are ignored.
    band[0] += SMALLEST_PIVOT * band[0].max()
    solution = solveh_banded(band, design.T @ signal, lower=True)
    return np.asarray(slow @ solution[:: len(waves)])


def as_position(time: Array, measured: Array, period: float, attrs: Mapping[Any, Any]) -> Array:
    """Return the angle or displacement of a measured quantity, about its mean, by the record's attributes.

    Parameters
    ----------
    time, measured : (sample,) array of float
    period : float, s
        Period of the oscillation.
    attrs : mapping
        `integrations`, the number of integrations; `felt_per_sine` for an accelerometer on a pendulum, its
        reading per sine of the angle; `NOISE_IS_WHITE_IN` of a mode.
    """
    harmonics = HARMONICS_OF_A_MODE if attrs.get(NOISE_IS_WHITE_IN) else 1
    for _ in range(int(attrs["integrations"])):
        measured = integrated(time, measured, period, harmonics)
    if "felt_per_sine" in attrs:
        return np.asarray(np.arcsin(np.clip(measured / float(attrs["felt_per_sine"]), -1.0, 1.0)))
    return measured
