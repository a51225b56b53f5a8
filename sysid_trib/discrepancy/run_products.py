"""Products of a run's columns in the covariance of its rows, for a grid of the ratios of both noises."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array, Mask
from sysid_trib.discrepancy.settings import DEFAULTS, Settings
from sysid_trib.noise.variance_ratio import ratio_span
from sysid_trib.regression.weak_form import WeakForm, cholesky_factor, log_determinant, whiten

# Squares of columns above which the products of products overflow, and below which they vanish.
LEAST_SQUARES, MOST_SQUARES = 1e-200, 1e200


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

    def at(self, ratio: float, columns: Array) -> Array:
        """Products of the target and some columns in the covariance of any ratio, (column + 1, column + 1).

        A spline over those tried: each is the same sum, so that a target which the columns explain stays
        explained.
        """
        tried = np.flatnonzero(self.ratios == ratio)
        if len(tried):
            at = np.concatenate([[0], columns])
            return np.asarray(self.products[tried[0]][np.ix_(at, at)])
        return np.asarray(np.tensordot(self._weights(ratio), self.of(columns)[1:], 1))

    def scaled(self, factors: Array) -> "RunProducts":
        """The same of columns times factors, (column,)."""
        with_target = np.concatenate([[1.0], factors])
        return replace(self, products=self.products * np.outer(with_target, with_target))

    def log_determinant_at(self, ratio: float) -> float:
        """The same of the covariance, over that of white noise of the sensor alone."""
        tried = np.flatnonzero(self.ratios == ratio)
        if len(tried):
            return float(self.log_determinant[tried[0]])
        return float(self._weights(ratio) @ self.log_determinant[1:])

    def _weights(self, ratio: float) -> Array:
        return np.asarray(CubicSpline(np.log(self.ratios[1:]), np.eye(len(self.ratios) - 1))(np.log(ratio)))

    def of(self, columns: Array) -> Array:
        """Products of the target and some columns, (ratio, column + 1, column + 1)."""
        at = np.concatenate([[0], columns])
        return self.products[:, at[:, None], at]


def products_of(
    band: Array, white_band: Array, table: Array, form: WeakForm, level: float, settings: Settings = DEFAULTS
) -> RunProducts:
    """Products of a run's columns.

    Parameters
    ----------
    band, white_band : (diagonal, row) array of float
        Covariance of the rows by noise of the sensor of unit size, with its colour and white.
    table : (row, column) array of float
        The target, then columns.
    form : WeakForm
    level : float, rad
    settings : Settings
    """
    steps = np.diff(form.tau)
    low, high = ratio_span(float(form.tau[-1] - form.tau[0]), float(np.median(steps)))
    logs = np.arange(np.log(low), np.log(high), settings.ratio_step)
    ratios = np.concatenate([[0.0], np.exp(logs)])
    reference = log_determinant(cholesky_factor(white_band))
    table = np.where(np.sum(table**2, axis=0) < LEAST_SQUARES, 0.0, table)
    products, determinants = [], []
    for ratio in ratios:
        factor = cholesky_factor(band, form.gram, float(ratio))
        white = whiten(factor, table)
        products.append(white.T @ white)
        determinants.append(log_determinant(factor) - reference)
    return RunProducts(
        np.array(products), np.array(determinants), ratios, len(table), level, settings.level_rows
    )


def has_products(columns: Array) -> Mask:
    """Whether the squares of columns, of which products are made, are far from overflowing, (column,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sum(columns**2, axis=0) < MOST_SQUARES)
