"""By how much columns raise the likelihood of a record, the ratio of its two variances free on both sides.

The gain of columns without effect is no chi-square where few cycles show the random force: they take a good
part of what tells its size. Records of the model without them calibrate it (parametric bootstrap about the
same path).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr
from scipy.signal import lfilter
from scipy.stats import chi2

from sysid_trib.arrays import Array, Index
from sysid_trib.likelihood.sensor_noise import memory_samples
from sysid_trib.likelihood.variance_ratio import VarianceRatio
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.linearised import random_walk_about

# Distances from the most likely ratio at which likelihoods are computed, in standard errors of its logarithm.
NEAR = np.array([-3.0, -1.5, 0.0, 1.5, 3.0])
# Below these they double, down to so many e-folds; then comes none at all.
E_FOLDS = 12.0


@dataclass(frozen=True)
class Gains:
    """Gains of several sets of columns in the record and in records of the null model.

    Attributes
    ----------
    record : float
        Twice the logarithm of the ratio of the likelihoods.
    null : (draw,) array of float
        The same of each simulated record.
    columns : int
        Number of columns that are not combinations of the model's nuisances.
    """

    record: float
    null: Array
    columns: int

    @property
    def chi_square(self) -> float:
        """The gain with the mean that a chi-square has (Bartlett 1937)."""
        return self.record * self.columns / float(np.mean(self.null)) if self.columns else 0.0

    @property
    def p_value(self) -> float:
        """p-value of columns without effect."""
        return float(chi2.sf(self.chi_square, self.columns)) if self.columns else 1.0


def simulated_records(linear: LinearModel, ratio: float, draws: int, random: np.random.Generator) -> Array:
    """Records of noise alone, (sample, draw), in units of the innovations of the sensor's noise."""
    random_walk = random_walk_about(linear, ratio, random, draws)
    # Coloured noise has a past before the first sample.
    past = memory_samples(linear.sensor_filter)
    white = random.standard_normal((past + len(random_walk), draws))
    return np.asarray(random_walk + lfilter([1.0], linear.sensor_filter, white, axis=0)[past:])


@dataclass(frozen=True)
class TrialModel:
    """A record with the model's columns (nuisances), columns that are tried, and records of noise alone.

    Attributes
    ----------
    linear : LinearModel
        Its columns are the nuisances, those tried, the simulated records.
    nuisances, tried : int
        How many there are of the first two.
    """

    linear: LinearModel
    nuisances: int
    tried: int

    def white(self, ratio: float) -> tuple[Array, Array, Array, float]:
        """Rows at a ratio: nuisances, columns tried, records (the measured one first); log determinant."""
        rows = self.linear.rows(ratio)
        nuisances, tried, draws = np.split(rows.design, [self.nuisances, self.nuisances + self.tried], axis=1)
        return nuisances, tried, np.column_stack([rows.target, draws]), rows.log_determinant

    def deviances(self, sets: Sequence[Index], ratio: float) -> Array:
        """Minus twice the logarithm of the likelihood at a ratio, variance and columns profiled.

        Without the columns that are tried, then with each of the sets: (1 + set, 1 + draw).
        """
        nuisances, tried, records, log_determinant = self.white(ratio)
        basis = orthonormal(nuisances)
        rest = records - basis @ (basis.T @ records)
        squares = [np.sum(rest**2, axis=0)]
        for index in sets:
            further = tried[:, index] - basis @ (basis.T @ tried[:, index])
            squares.append(squares[0] - np.sum((orthonormal(further).T @ rest) ** 2, axis=0))
        return np.asarray(len(rest) * np.log(np.maximum(squares, 1e-300)) + log_determinant)


def trial_model(linear: LinearModel, by_column: Array, records: Array) -> TrialModel:
    """A record with columns that act in each step, (step, 2, column), and records (sample, draw)."""
    nuisances, tried = linear.start.shape[1], by_column.shape[2]
    count = nuisances + tried + records.shape[1]
    steps, size = linear.by_column.shape[:2]
    start, by = np.zeros((size, count)), np.zeros((steps, size, count))
    observed = np.zeros((len(linear.record), count))
    start[:, :nuisances] = linear.start
    by[:, :, :nuisances] = linear.by_column
    observed[:, :nuisances] = linear.observed_parameters
    by[:, : by_column.shape[1], nuisances : nuisances + tried] = by_column
    observed[:, nuisances + tried :] = records
    whole = replace(linear, start=start, by_column=by, observed_parameters=observed)
    return TrialModel(whole, nuisances, tried)


def likelihood_gains(trial: TrialModel, sets: Mapping[str, Index], null: VarianceRatio) -> dict[str, Gains]:
    """Gains of sets of columns over the nuisances alone.

    Parameters
    ----------
    trial : TrialModel
        With records of noise alone at the null model's ratio.
    sets : mapping of str to (index,) array of int
        Which of the columns are tried together.
    null : VarianceRatio
        Of the model without them; where that has no random force, none is with the columns either.

    Returns
    -------
    dict of str to Gains
        By the names of the sets.
    """
    nuisances, tried, _, _ = trial.white(null.ratio)
    further = _independent(nuisances, tried)
    chosen = {name: np.intersect1d(index, further) for name, index in sets.items()}
    least = trial.deviances(list(chosen.values()), 0.0)
    if null.ratio > 0.0:
        logarithms = _logarithms(null)
        table = [trial.deviances(list(chosen.values()), float(ratio)) for ratio in np.exp(logarithms)]
        least = np.minimum(_least(logarithms, np.array(table)), least)
    gains = np.maximum(least[0] - least[1:], 0.0)
    return {
        name: Gains(float(gain[0]), gain[1:], len(index))
        for (name, index), gain in zip(chosen.items(), gains, strict=True)
    }


def orthonormal(columns: Array) -> Array:
    """An orthonormal basis of the space of some columns."""
    size = np.linalg.norm(columns, axis=0)
    return np.asarray(np.linalg.qr(columns / np.where(size > 0.0, size, 1.0))[0])


def _independent(nuisances: Array, tried: Array) -> Index:
    """Which of the columns are no combinations of the nuisances and of each other."""
    size = np.linalg.norm(tried, axis=0)
    unit = tried / np.where(size > 0.0, size, 1.0)
    basis = orthonormal(nuisances)
    _, r, order = qr(unit - basis @ (basis.T @ unit), mode="economic", pivoting=True)
    # Part of a column that others must leave for it to be a further one.
    return np.asarray(np.sort(order[np.abs(np.diag(r)) > 1e-2]))


def _logarithms(null: VarianceRatio) -> Array:
    """Logarithms of the ratios at which likelihoods are computed, ascending."""
    error = float(np.clip(np.nan_to_num(null.relative_error, nan=1.0), 0.02, 1.0))
    doublings = int(np.ceil(np.log2(E_FOLDS / (3.0 * error))))
    far = NEAR[0] * 2.0 ** np.arange(max(1, doublings), 0, -1)
    return float(np.log(null.ratio)) + error * np.concatenate([far, NEAR])


def _least(logarithms: Array, table: Array) -> Array:
    """Least of each curve over the ratios, by the parabola through its three lowest neighbours."""
    at = np.clip(np.argmin(table, axis=0), 1, len(table) - 2)
    x = [logarithms[at + side] for side in (-1, 0, 1)]
    y = [np.take_along_axis(table, (at + side)[None], axis=0)[0] for side in (-1, 0, 1)]
    left, right = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = (right - left) / (x[2] - x[0])
    curved = np.where(curvature > 0.0, curvature, 1.0)
    middle = 0.5 * (x[0] + x[1])
    best = np.clip(middle - 0.5 * left / curved, x[0], x[2])
    value = y[0] + (best - x[0]) * (left + curvature * (best - x[1]))
    return np.where(curvature > 0.0, value, np.min(table, axis=0))
