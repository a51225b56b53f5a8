"""Smooth curve through rows with noise of unknown size: splines as a mixed model.

The curve is a line plus random bends (second differences of B-splines, Eilers and Marx 1996). The noise of
the rows is s (A + r B), with A of the sensor and B of a random walk. Restricted likelihood weighs each size
of the bends and each r. The curve is the mean over them, and its errors include their uncertainty.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline
from scipy.linalg import cholesky_banded, eigh
from scipy.linalg.lapack import dtbtrs

from sysid_trib.arrays import Array
from sysid_trib.results.variables import CONFIDENCE

CURVE_SPLINES, CURVE_DEGREE = 40, 3
# Grid of the fit: variances of the bends in units of the noise, and of the walk in units of the sensor's
# noise.
BENDS = np.logspace(-5, 9, 15)
WALKS = np.append(0.0, np.logspace(-2, 3, 11))
# A curve may be smooth in one place and bend sharply in another: the bends have the size of their neighbours,
# but at least this fraction of the mean.
NEAREST, LEAST_BEND = 5, 0.1
BAND_DRAWS = 2000
ROUNDING_PART = 1e-10


class CurveRows(NamedTuple):
    """Values of a curve and their noise.

    Attributes
    ----------
    target : (row,) array of float
        The values.
    of_sensor, of_walk : (row, draw) sparse matrix
        Change of each value by unit draws of the sensor's noise and of a random force (a random walk).
    """

    target: Array
    of_sensor: sp.csr_matrix
    of_walk: sp.csr_matrix


@dataclass(frozen=True)
class SmoothCurve:
    """A curve at points, with its errors.

    Attributes
    ----------
    mean, standard_error : (point,) array of float
    factor : float
        Number of standard errors within which 95 % of all curves lie everywhere.
    weights : (point, row) array of float
        The mean is ``weights @ target``.
    noise : float
        Standard deviation of the sensor's noise in units of the given one.
    bends : (bend,) array of float
        Relative variances of the bends along the coordinate, for the next round.
    """

    mean: Array
    standard_error: Array
    factor: float
    weights: Array
    noise: float
    bends: Array


@dataclass(frozen=True)
class _WhitePeriods:
    """Rows whose noise is white at one ratio, without the line, and the bends along principal axes."""

    determinant: float
    line: Array
    axes: Array
    information: Array
    score: Array
    rest: float
    across: Array
    under: Array
    factor: Array

    def deviances(self, bends: Array, count: int) -> tuple[Array, Array]:
        """Return minus twice the log restricted likelihood, and the variance, for each size of the bends.

        The prior is flat in the standard deviation of the bends.
        """
        information = bends[:, None] * self.information
        squares = self.rest - (bends[:, None] / (1.0 + information)) @ self.score**2
        variance = np.maximum(1.0, squares / count)
        determinant = self.determinant + np.log1p(information).sum(axis=1) - 0.5 * np.log(bends)
        return count * np.log(variance) + squares / variance + determinant, variance

    def curve(self, at: Array, bend: float) -> tuple[Array, Array]:
        """Return a root of the covariance of the curve at points, at unit noise, and its gain.

        Both are (point, direction), for bends of one size. The gain maps `across` to the curve.
        """
        shrunk = bend / (1.0 + bend * self.information)
        along = (at[:, 2:] - at[:, :2] @ self.line[:, 2:]) @ self.axes
        line = at[:, :2] @ self.line[:, :2]
        return np.hstack([along * np.sqrt(shrunk), line]), np.hstack([along * shrunk, line])

    def expected_bends(self, bend: float, variance: float) -> Array:
        """Return the expected squares of the bends, given the rows."""
        shrunk = bend / (1.0 + bend * self.information)
        return (self.axes @ (shrunk * self.score)) ** 2 + variance * (self.axes**2 @ shrunk)


def smooth_curve(
    rows: CurveRows,
    position: Array,
    points: Array,
    bends: Array | None,
    walks: Array,
) -> SmoothCurve:
    """Return the curve through rows, its standard error, and its simultaneous band.

    Parameters
    ----------
    rows : CurveRows
        At least three values of the curve with noise; the size of the sensor's noise is at least one.
    position, points : (row,) and (point,) arrays of float
        Positions of the rows along the curve, and of the wanted points, from 0 to 1.
    bends : (bend,) array of float, optional
        Relative variances of the bends from the round before; without them all are equal.
    walks : (walk,) array of float
        Variances of the walk that are tried, the first 0; a coarse grid is enough to estimate the bends.
    """
    relative = np.ones(CURVE_SPLINES - 2) if bends is None else bends
    scale = np.concatenate([[1.0, 1.0], np.sqrt(relative)])
    columns, at = (_line_and_bends(where) * scale for where in (position, points))
    target, *noise = rows
    sensor, walk = _bands(*noise)
    count = len(target) - 2
    unit = float(np.median(sensor[0]) / np.median(np.sum(_line_and_bends(position)[:, 2:] ** 2, axis=1)))
    per_walk = float(np.median(sensor[0] / np.maximum(walk[0], np.finfo(float).tiny)))
    white = [_whitened(sensor + ratio * per_walk * walk, columns, target) for ratio in walks]
    tried = [part.deviances(BENDS * unit, count) for part in white]
    # The prior of the walk is flat in its standard deviation too.
    prior = 0.5 * np.log(np.append(0.5 * walks[1], walks[1:]))
    deviance = np.array([d for d, _ in tried]) - prior[:, None]
    weight = np.exp(-0.5 * (deviance - deviance.min()))
    # Ignore likelihoods below this fraction of the largest.
    weight[weight < 0.01] = 0.0
    weight /= weight.sum()
    k, b = np.unravel_index(int(np.argmax(weight)), weight.shape)
    expected = white[k].expected_bends(float(BENDS[b] * unit), float(tried[k][1][b]))
    # Add bends to the most likely curve: even at a kink, its error is smaller than its noise (Hall 1992).
    likely = [(white[k], tried[k][1][b], 10.0 * BENDS[b] * unit) for k, b in np.argwhere(weight)]
    return _averaged(weight[weight > 0.0], likely, at, count, _smoothed(expected * relative))


def _line_and_bends(position: Array) -> Array:
    """Return a constant, a line, and bends of unit variance each, (position, column)."""
    inner = np.linspace(0.0, 1.0, CURVE_SPLINES - CURVE_DEGREE + 1)
    knots = np.concatenate([[0.0] * CURVE_DEGREE, inner, [1.0] * CURVE_DEGREE])
    splines = BSpline.design_matrix(np.clip(position, 0.0, 1.0), knots, CURVE_DEGREE)
    difference = np.diff(np.eye(CURVE_SPLINES), 2, axis=0)
    bends = difference.T @ np.linalg.inv(difference @ difference.T)
    line = np.linspace(-1.0, 1.0, CURVE_SPLINES)
    return np.asarray(splines @ np.column_stack([np.ones(CURVE_SPLINES), line, bends]))


def _bands(*roots: sp.csr_matrix) -> list[Array]:
    """Return the covariances of the rows as lower bands of equal width, in the form of scipy.linalg."""
    covariances = [root @ root.T for root in roots]
    width = 1 + max(int(np.max(np.subtract(*c.nonzero()), initial=0)) for c in covariances)
    return [np.stack([np.pad(c.diagonal(-k), (0, k)) for k in range(width)]) for c in covariances]


def _whitened(band: Array, columns: Array, target: Array) -> _WhitePeriods:
    band = band.copy()
    band[0] *= 1.0 + ROUNDING_PART
    factor = cholesky_banded(band, lower=True)
    white, _ = dtbtrs(factor, np.column_stack([columns, target]), uplo="L")
    q, r = np.linalg.qr(white[:, :2])
    bends, y = white[:, 2:-1], white[:, -1]
    by_line = q.T @ bends
    free = bends - q @ by_line
    information, axes = eigh(free.T @ free)
    along = (free @ axes).T
    rest = y - q @ (q.T @ y)
    determinant = 2.0 * float(np.sum(np.log(factor[0])) + np.sum(np.log(np.abs(np.diag(r)))))
    return _WhitePeriods(
        determinant=determinant,
        line=np.linalg.solve(r, np.column_stack([np.eye(2), by_line])),
        axes=axes,
        information=np.maximum(information, 0.0),
        score=along @ rest,
        rest=float(rest @ rest),
        across=np.concatenate([along @ y, q.T @ y]),
        under=np.vstack([along, q.T]),
        factor=factor,
    )


def _smoothed(bends: Array) -> Array:
    """Return the relative variances: averaged over neighbours, with mean one, and none far below one."""
    kernel = np.ones(NEAREST)
    local = np.convolve(bends, kernel, "same") / np.convolve(np.ones_like(bends), kernel, "same")
    return LEAST_BEND + (1.0 - LEAST_BEND) * local / local.mean()


def _averaged(
    weight: Array, likely: Sequence[tuple[_WhitePeriods, float, float]], at: Array, count: int, bends: Array
) -> SmoothCurve:
    """Average over plausible smoothness, and draw from it for the band.

    Parameters
    ----------
    weight : (likely,) array of float
    likely : sequence of (_WhitePeriods, float, float)
        Rows at one ratio, their variance, and one size of the bends.
    at : (point, column) array of float
    count : int
        Degrees of freedom of the variances.
    bends : (bend,) array of float
        Relative variances of the bends for the next round.
    """
    roots, gains = zip(*(rows.curve(at, bend) for rows, _, bend in likely), strict=True)
    means = np.array([gain @ rows.across for gain, (rows, *_) in zip(gains, likely, strict=True)])
    variances = np.array([variance for _, variance, _ in likely])
    mean = np.sum(weight[:, None] * means, axis=0)
    squares = np.array([np.sum(root**2, axis=1) for root in roots])
    variance_of = variances[:, None] * squares + (means - mean) ** 2
    error = np.sqrt(np.sum(weight[:, None] * variance_of, axis=0))
    random = np.random.default_rng(0)
    draws, apart = random.multinomial(BAND_DRAWS, weight), []
    for root, variance, m, several in zip(roots, variances, means, draws, strict=True):
        # Degrees of freedom of the variance.
        size = np.sqrt(np.maximum(1.0, variance * count / random.chisquare(count, several)))
        bent = root @ random.standard_normal((root.shape[1], several)) * size
        apart.append((bent.T + (m - mean)) / error)
    factor = simultaneous_factor(np.concatenate(apart))
    of_rows = [
        part * dtbtrs(rows.factor, (gain @ rows.under).T, uplo="L", trans="T")[0].T
        for part, gain, (rows, *_) in zip(weight, gains, likely, strict=True)
    ]
    noise = float(np.sqrt(weight @ variances))
    return SmoothCurve(mean, error, factor, np.sum(of_rows, axis=0), noise, bends)


def simultaneous_factor(apart: Array) -> float:
    """Return the number of errors within which 95 % of the drawn curves lie completely (sup-t).

    Parameters
    ----------
    apart : (draw, point) array of float
        Draws minus the curve, over its pointwise errors; nan if a draw, or the curve, has no value.

    Notes
    -----
    Montiel Olea and Plagborg-Møller (2019), doi 10.1002/jae.2656.
    """
    largest = np.max(np.nan_to_num(np.abs(apart)), axis=1)
    return float(np.quantile(largest, CONFIDENCE))
