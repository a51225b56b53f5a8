"""Products of a run's columns in the covariance of its rows, for a grid of the ratios of both noises."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.likelihood.variance_ratio import ratio_span
from sysid_trib.likelihood.weak_form import cholesky_factor, log_determinant, whiten

# Squares of columns above which the products of products overflow, and below which they vanish.
LEAST_SQUARES, MOST_SQUARES = 1e-200, 1e200
# Steps in the logarithm of a ratio from a likely one to those that are tried about it.
ABOUT_LIKELY = np.array([-3.0, -1.2, -0.4, 0.0, 0.4, 1.2, 3.0])
# Distance of two ratios up to which a spline between them is as good as a sum. Likely ones that are nearer
# than half of it have the same about them.
CLOSE = 0.5
# Distance from the ends of their span in which no other is tried.
LEAST_APART = 0.1


@dataclass(frozen=True)
class RunProducts:
    """Products of a run's columns in the covariance of each ratio.

    Attributes
    ----------
    products : (ratio, column, column) array of float
        The first column is the target.
    log_determinant : (ratio,) array of float
        Of the covariance, over that of white noise of the sensor alone.
    ratios : (ratio,) array of float
        The first is 0.
    rows : int
    level : float, rad
        Of the innovations of the sensor's noise, as its spectrum has it.
    level_rows : float
        As which that level counts.
    """

    products: Array
    log_determinant: Array
    ratios: Array
    rows: int
    level: float
    level_rows: float

    @property
    def degrees_of_freedom(self) -> float:
        """Rows, with those that the level counts."""
        return self.rows + self.level_rows

    def at(self, ratio: float, columns: Array) -> "RunProducts":
        """Products of the target and some columns in the covariance of any ratio alone.

        A spline over those tried: each is the same sum, so that a target which the columns explain stays
        explained.
        """
        kept, (at, weights) = np.concatenate([[0], columns]), self._weighed(ratio)
        determinant = np.array([weights @ self.log_determinant[at]])
        products = self.block(ratio, kept, kept)[None]
        return replace(self, products=products, log_determinant=determinant, ratios=np.array([ratio]))

    def block(self, ratio: float, rows: Array, columns: Array) -> Array:
        """Products of any columns, the target among them, with others, (row, column)."""
        at, weights = self._weighed(ratio)
        return np.asarray(np.tensordot(weights, self.products[np.ix_(at, rows, columns)], 1))

    def squares(self, ratio: float, columns: Array) -> Array:
        """Products of columns with themselves, (column,)."""
        at, weights = self._weighed(ratio)
        return np.asarray(weights @ self.products[at[:, None], columns, columns])

    def is_close(self, ratio: float) -> bool:
        """True if a ratio is tried, or between others that are close to each other."""
        logs = np.log(self.ratios[1:])
        above = int(np.clip(np.searchsorted(logs, np.log(ratio)), 1, len(logs) - 1)) if ratio else 0
        return bool(not ratio or logs[above] - logs[above - 1] < CLOSE)

    def scaled(self, factors: Array) -> "RunProducts":
        """The products of columns times factors, (column,)."""
        with_target = np.concatenate([[1.0], factors])
        return replace(self, products=self.products * np.outer(with_target, with_target))

    def _weighed(self, ratio: float) -> tuple[Index, Array]:
        """Numbers of ratios, and weights by which what is known at these is summed up to that at any one."""
        tried = np.flatnonzero(self.ratios == ratio)[:1]
        if len(tried):
            return tried, np.ones(1)
        spline = _cardinal_splines(self.ratios.tobytes())
        return np.arange(1, len(self.ratios)), np.asarray(spline(np.log(ratio)))

    def of(self, columns: Array) -> Array:
        """Products of the target and some columns, (ratio, column + 1, column + 1)."""
        at = np.concatenate([[0], columns])
        return self.products[:, at[:, None], at]


def spline_over_ratios(ratios: Array, values: Array) -> PPoly:
    """Spline of values at ratios (ratio,), but at the first, 0, over their logarithms."""
    cardinal = _cardinal_splines(ratios.tobytes())
    return PPoly(cardinal.c @ values[1:], cardinal.x)


@lru_cache(maxsize=16)
def _cardinal_splines(ratios: bytes) -> CubicSpline:
    """Splines that are 1 at one of the ratios and 0 at others: the same grid serves all models of a run."""
    logs = np.log(np.frombuffer(ratios)[1:])
    return CubicSpline(logs, np.eye(len(logs)))


def products_of(band: Array, gram: Array, table: Array, ratios: Array) -> tuple[Array, Array]:
    """Products of a run's columns, (ratio, column, column), and the log determinant of their covariance.

    Parameters
    ----------
    band, gram : (diagonal, row) array of float
        Covariance of the rows by the innovations of the sensor's noise, and by a random force, of unit size.
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
    """Ratios that are tried, 0 among them; `near` as of `RunRows.products`."""
    span = np.log(ratio_span(float(tau[-1] - tau[0]), float(np.median(np.diff(tau)))))
    logs = np.arange(span[0], span[1], step)
    if near:
        # None beyond the ends of all, with which columns are screened; the ends where they are near.
        middle = np.clip(0.5 * CLOSE * np.round(np.log(near) / (0.5 * CLOSE)), logs[0], logs[-1])
        tried = np.unique(np.clip(middle + ABOUT_LIKELY, logs[0], logs[-1]))
        inside = np.minimum(tried - tried[0], tried[-1] - tried)[1:-1] > LEAST_APART
        logs = tried[np.concatenate([[True], inside, [True]])]
    elif near == 0.0:
        logs = logs[::2]
    return np.concatenate([[0.0], np.exp(logs)])


def has_products(columns: Array) -> Mask:
    """True if the squares of columns, of which products are made, are far from overflowing, (column,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sum(columns**2, axis=0) < MOST_SQUARES)
