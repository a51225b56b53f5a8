"""Products of a run's columns in the covariance of its rows, for a grid of the ratios of both noises."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.interpolate import CubicSpline, PPoly

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.likelihood.sensor_noise import covariance_band
from sysid_trib.likelihood.variance_ratio import ratio_span
from sysid_trib.likelihood.weak_form import WeakForm, cholesky_factor, log_determinant, noise_operator, whiten

# Column sums of squares above which their products overflow, and below which they underflow.
LEAST_SQUARES, MOST_SQUARES = 1e-200, 1e200
# Steps, in the logarithm of the ratio, from a likely ratio to the grid ratios about it.
ABOUT_LIKELY = np.array([-3.0, -1.2, -0.4, 0.0, 0.4, 1.2, 3.0])
# Distance of two ratios up to which a spline between them is as accurate as the sum itself. Likely ratios
# closer than half of it share one grid.
CLOSE = 0.5
# Least distance of a grid ratio from the ends of the span.
LEAST_APART = 0.1


@dataclass(frozen=True)
class RunProducts:
    """Products of a run's columns in the covariance of each ratio.

    Attributes
    ----------
    products : (ratio, column, column) array of float
        The first column is the target.
    log_determinant : (ratio,) array of float
        Log determinant of the covariance, over that of white noise of the sensor alone.
    ratios : (ratio,) array of float
        The first is 0.
    rows : int
    level : float, rad
        Level of the innovations of the sensor's noise, by its spectrum.
    level_rows : float
        Number of rows that the level of the spectrum counts as.
    """

    products: Array
    log_determinant: Array
    ratios: Array
    rows: int
    level: float
    level_rows: float

    @property
    def degrees_of_freedom(self) -> float:
        """Number of rows, with those that the prior of the level adds."""
        return self.rows + self.level_rows

    def at(self, ratio: float, columns: Array) -> "RunProducts":
        """Return the products of the target and some columns for a single ratio of any value.

        They are interpolated by a spline over the grid ratios. All products use the same weights, so a target
        that the columns explain completely stays explained.
        """
        kept, (at, weights) = np.concatenate([[0], columns]), self._weighed(ratio)
        determinant = np.array([weights @ self.log_determinant[at]])
        products = self.block(ratio, kept, kept)[None]
        return replace(self, products=products, log_determinant=determinant, ratios=np.array([ratio]))

    def block(self, ratio: float, rows: Array, columns: Array) -> Array:
        """Return the products of some columns, which may include the target, with others, (row, column)."""
        at, weights = self._weighed(ratio)
        return np.asarray(np.tensordot(weights, self.products[np.ix_(at, rows, columns)], 1))

    def squares(self, ratio: float, columns: Array) -> Array:
        """Return the products of columns with themselves, (column,)."""
        at, weights = self._weighed(ratio)
        return np.asarray(weights @ self.products[at[:, None], columns, columns])

    def is_close(self, ratio: float) -> bool:
        """Return true if a ratio is on the grid, or between grid values that are close."""
        logs = np.log(self.ratios[1:])
        above = int(np.clip(np.searchsorted(logs, np.log(ratio)), 1, len(logs) - 1)) if ratio else 0
        return bool(not ratio or logs[above] - logs[above - 1] < CLOSE)

    def scaled(self, factors: Array) -> "RunProducts":
        """Return the products of columns times factors, (column,)."""
        with_target = np.concatenate([[1.0], factors])
        return replace(self, products=self.products * np.outer(with_target, with_target))

    def _weighed(self, ratio: float) -> tuple[Index, Array]:
        """Return the indices of grid ratios, and the weights that interpolate their products to any ratio."""
        tried = np.flatnonzero(self.ratios == ratio)[:1]
        if len(tried):
            return tried, np.ones(1)
        spline = _cardinal_splines(self.ratios.tobytes())
        return np.arange(1, len(self.ratios)), np.asarray(spline(np.log(ratio)))

    def of(self, columns: Array) -> Array:
        """Return the products of the target and some columns, (ratio, column + 1, column + 1)."""
        at = np.concatenate([[0], columns])
        return self.products[:, at[:, None], at]


def spline_over_ratios(ratios: Array, values: Array) -> PPoly:
    """Return the spline of values at ratios (ratio,) over their logarithms, without the first ratio, 0."""
    cardinal = _cardinal_splines(ratios.tobytes())
    return PPoly(cardinal.c @ values[1:], cardinal.x)


@lru_cache(maxsize=16)
def _cardinal_splines(ratios: bytes) -> CubicSpline:
    """Return the splines that are 1 at one ratio and 0 at the others, the same for all models of a run."""
    logs = np.log(np.frombuffer(ratios)[1:])
    return CubicSpline(logs, np.eye(len(logs)))


def products_of(band: Array, gram: Array, table: Array, ratios: Array) -> tuple[Array, Array]:
    """Return the products of a run's columns, (ratio, column, column), and the covariance's log determinant.

    Parameters
    ----------
    band, gram : (diagonal, row) array of float
        Covariance of the rows due to innovations of the sensor's noise, and due to a random force, of unit
        size.
    table : (row, column) array of float
        The target, then columns.
    ratios : (ratio,) array of float
    """
    table = np.where(np.sum(table**2, axis=0) < LEAST_SQUARES, 0.0, table)
    products, determinants = np.empty((len(ratios), *2 * table.shape[1:])), np.empty(len(ratios))
    for at, ratio in enumerate(ratios.tolist()):
        factor = cholesky_factor(band, gram, ratio)
        white = whiten(factor, table)
        np.matmul(white.T, white, out=products[at])
        determinants[at] = log_determinant(factor)
    return products, determinants


def tried_ratios(tau: Array, step: float, near: float | None) -> Array:
    """Return the grid of ratios with 0 among them; `near` as in `RunRows.products`."""
    span = np.log(ratio_span(float(tau[-1] - tau[0]), float(np.median(np.diff(tau)))))
    logs = np.arange(span[0], span[1], step)
    if near:
        # Stay within the ends that screening uses; include an end if it is near.
        middle = np.clip(0.5 * CLOSE * np.round(np.log(near) / (0.5 * CLOSE)), logs[0], logs[-1])
        tried = np.unique(np.clip(middle + ABOUT_LIKELY, logs[0], logs[-1]))
        inside = np.minimum(tried - tried[0], tried[-1] - tried)[1:-1] > LEAST_APART
        logs = tried[np.concatenate([[True], inside, [True]])]
    elif near == 0.0:
        logs = logs[::2]
    return np.concatenate([[0.0], np.exp(logs)])


def has_products(columns: Array) -> Mask:
    """Return true if the squares of columns do not overflow, (column,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sum(columns**2, axis=0) < MOST_SQUARES)


def unresolved(
    form: WeakForm, tau: Array, stiffness: Array, damping: Array, operator: sp.csr_matrix
) -> float:
    """Return the excess of the log determinant of the white noise of the rows.

    Parameters
    ----------
    form : WeakForm
    tau : (point,) array of float
    stiffness, damping : (point,) array of float
        Coefficients of the equation of small deviations.
    operator : (row, sample) sparse array of float
        Operator of these deviations.

    Returns
    -------
    float
        0 if the stiffness is constant, or if the rows resolve it.

    Notes
    -----
    A slow modulation of the swing leaves almost no residual in the rows, so a small random force is detected.
    Smooth test functions cannot follow a stiffness that jumps; then a residual remains, and only a larger
    random force is detected. But the determinant of the equation of small deviations is known: it is
    proportional to that of the Gram matrix of its free motions with unit starts (Gelfand and Yaglom 1960;
    Forman 1987). The determinant of the rows is therefore compared with that for the mean stiffness and
    damping, which the rows resolve.
    """
    even = np.linspace(tau[0], tau[-1], len(tau))
    k, d = (np.interp(even, tau, values) for values in (stiffness, damping))
    means = [np.full_like(values, np.mean(values)) for values in (k, d)]
    samples = operator.shape[1]
    constant = noise_operator(form, *(np.full(samples, mean[0]) for mean in means))
    with np.errstate(all="ignore"):
        # A motion that grows until it overflows gives no excess.
        free = _log_determinant_of_free_motions(even, k, d) - _log_determinant_of_free_motions(even, *means)
    noise, resolved = (
        log_determinant(cholesky_factor(covariance_band(rows))) for rows in (operator, constant)
    )
    excess = noise - resolved - free
    return max(0.0, excess) if np.isfinite(excess) else 0.0


def _log_determinant_of_free_motions(tau: Array, stiffness: Array, damping: Array) -> float:
    """Return the log determinant of the Gram matrix of the free motions with unit angle and unit rate."""
    step, count = tau[1] - tau[0], len(tau)
    half = 0.5 * step * damping
    # Central differences, each angle from the two before it: a lower triangular band.
    band = np.zeros((3, count))
    band[0, :2], band[0, 2:] = 1.0, 1.0 + half[1:-1]
    band[1, 1:-1], band[2, :-2] = step**2 * stiffness[1:-1] - 2.0, 1.0 - half[1:-1]
    start = np.zeros((count, 2))
    start[0] = 1.0, 0.0
    start[1] = 1.0 - 0.5 * step**2 * stiffness[0], step * (1.0 - half[0])
    try:
        motions = scipy.linalg.solve_banded((2, 0), band, start, check_finite=False)
    except np.linalg.LinAlgError:
        # A force too strong for the steps gives no free motions.
        return float("nan")
    return float(np.linalg.slogdet(motions.T @ motions)[1])
