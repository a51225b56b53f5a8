"""Which forces a regression keeps: by significance, or by a sparsifying pysindy optimiser."""

from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from sysid_trib.regression.rows import Rows

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def significant(rows: Rows, level: float) -> Mask:
    """Forces that the rows demand at a family-wise level of error.

    Parameters
    ----------
    level : probability of keeping any force that is not there (Bonferroni over the forces offered).

    Returns
    -------
    (force,) the set that minimises ``RSS/sigma^2 + t^2 * size``, t^2 the chi-square of one force at the
    level: no force can be dropped, added or exchanged.

    Notes
    -----
    Correlated forces make one-way elimination drop true ones for combinations of others; exchanges, from the
    empty and from the full set, do not stop there (Miller, Subset Selection in Regression, 2002, Sec. 3.4).
    """
    columns, y = _without_nuisances(rows)
    count = columns.shape[1]
    triangle: Array = np.asarray(np.linalg.qr(np.column_stack([columns, y]), mode="r"))
    table, target = triangle[:count, :count], triangle[:count, count]
    # Forces may be dependent: what all of them leave is the noise, by as many as are independent.
    freedom = max(1, len(y) - rows.nuisances.shape[1] - int(np.linalg.matrix_rank(table)))
    left = float(y @ y - target @ target) + _residual(table, target, np.ones(count, bool))
    noise = max(left / freedom, 1e-300)
    price = float(chi2.isf(level / max(1, count), 1))
    found = [_exchanged(table, target, noise, price, np.full(count, full)) for full in (False, True)]
    return min(found, key=lambda kept: _cost(table, target, noise, price, kept))


def by_optimizer(rows: Rows, optimizer: Any) -> Mask:
    """Forces to which a pysindy optimiser gives a coefficient, on columns scaled to their RMS force (rad)."""
    return np.asarray(solved_by(rows, optimizer) != 0.0)


def solved_by(rows: Rows, optimizer: Any) -> Array:
    """Scaled coefficients (rad) by a pysindy optimiser; nuisances are taken out first, never thresholded."""
    columns, y = _without_nuisances(rows)
    # The optimiser is the user's: it must not come back changed.
    return np.asarray(deepcopy(optimizer).fit(columns, y[:, None]).coef_[0], dtype=float)


def _without_nuisances(rows: Rows) -> tuple[Array, Array]:
    basis, _ = np.linalg.qr(rows.nuisances)
    return rows.columns - basis @ (basis.T @ rows.columns), rows.y - basis @ (basis.T @ rows.y)


def _exchanged(table: Array, target: Array, noise: float, price: float, kept: Mask) -> Mask:
    """Take the best of all drops, additions and exchanges until none helps."""
    best = _cost(table, target, noise, price, kept)
    while True:
        trials = []
        for i in range(len(kept)):
            trials.append(_flipped(kept, i))
            trials += [_flipped(kept, i, j) for j in range(i) if kept[i] != kept[j]]
        costs = [_cost(table, target, noise, price, trial) for trial in trials]
        lowest = int(np.argmin(costs))
        if costs[lowest] >= best - 1e-9:
            return kept
        kept, best = trials[lowest], costs[lowest]


def _flipped(kept: Mask, *members: int) -> Mask:
    other = kept.copy()
    other[list(members)] ^= True
    return other


def _cost(table: Array, target: Array, noise: float, price: float, kept: Mask) -> float:
    return _residual(table, target, kept) / noise + price * float(np.sum(kept))


def _residual(table: Array, target: Array, kept: Mask) -> float:
    if not kept.any():
        return float(target @ target)
    solution, *_ = np.linalg.lstsq(table[:, kept], target, rcond=1e-12)
    gap = target - table[:, kept] @ solution
    return float(gap @ gap)
