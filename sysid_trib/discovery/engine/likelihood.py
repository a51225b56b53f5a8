"""Likelihood of the rows of all runs, with the noise of the sensor and a random force in each.

The rows of a run have the covariance variance * (A S A' + ratio * G): A S A' is due to the sensor's noise of
colour S, and G to a white random force. The products of the columns on a grid of ratios hold all that is
needed to judge any set of columns with small matrices. Both variances of each run take their most likely
values.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.discovery.engine.run_products import RunProducts, spline_over_ratios

# Step, in the logarithm of the ratio, at which the spline between the grid ratios is evaluated.
BETWEEN_STEP = 0.03
# Most rounds in which the variances of several runs are iterated together, and the decrease of the deviance
# at which they have converged.
RATIO_ROUNDS, DEVIANCE_SETTLED = 20, 0.01
# Fraction of the information added to its diagonal, so that collinear columns have a solution.
RIDGE = 1e-13


def of_many_rows(rows: ArrayLike, columns: int) -> Array:
    """Return the factor that gives the deviance gained by one column the tail of a chi-square.

    The gain has the tail of Student's t with `rows` degrees of freedom (Wallace 1959), while the most likely
    variance also counts the `columns` as rows. With few rows, random gains are larger.
    """
    dof = np.asarray(rows)
    return np.asarray(dof / (dof + columns) * ((8.0 * dof + 1.0) / (8.0 * dof + 3.0)) ** 2)


@dataclass(frozen=True)
class Likelihood:
    """Maximum-likelihood values of a model.

    Attributes
    ----------
    deviance : float
        Minus twice the logarithm of the likelihood.
    coefficients : (column,) array of float
    covariance : (column, column) array of float
    variances : (run,) array of float, rad^2
        Variances of the innovations of the sensor's noise.
    ratios : (run,) array of float
        Ratios of the random force to that noise.
    ratio_errors : (run,) array of float
        Standard errors of the logarithms of the ratios; nan if a ratio is 0.
    gains : (run,) array of float
        Decrease of the deviance by the random force of each run.
    """

    deviance: float
    coefficients: Array
    covariance: Array
    variances: Array
    ratios: Array
    ratio_errors: Array
    gains: Array

    def among(self, columns: Sequence[int], count: int) -> "Likelihood":
        """Return this fit as one of `count` columns; columns other than `columns` have zero coefficients."""
        if len(columns) == count:
            return self
        coefficients, covariance = np.zeros(count), np.zeros((count, count))
        coefficients[list(columns)] = self.coefficients
        covariance[np.ix_(columns, columns)] = self.covariance
        return replace(self, coefficients=coefficients, covariance=covariance)


def likelihood(runs: Sequence[RunProducts], columns: Sequence[int]) -> Likelihood:
    """Return the maximum likelihood of the model of these columns, with the variances of each run profiled.

    Parameters
    ----------
    runs : sequence of RunProducts
        Products of each run; all runs have the same columns.
    columns : sequence of int
        Columns of the table, from 1.

    Notes
    -----
    For one run the coefficients are solved at each ratio. For several runs, the ratio of one run after
    another is optimised, with the other ratios held, until the deviance converges.
    """
    places = np.asarray(columns, dtype=int)
    squares = sum(np.einsum("gii->i", run.of(places)) for run in runs)
    # Do not scale a column of zeros; the ridge bounds its coefficient.
    size = np.where(squares > 0.0, np.sqrt(np.maximum(squares, 0.0)), 1.0)
    size[0] = 1.0
    parts = [run.of(places) / np.outer(size, size) for run in runs]
    at = [len(run.ratios) // 2 for run in runs]
    _, at, variances = _settled(runs, parts, at, [run.level**2 for run in runs])
    ratios, errors, gains = np.zeros((3, len(runs)))
    for r, run in enumerate(runs):
        deviances, _ = _over_ratios(runs, parts, at, variances, r)
        ratios[r], deviance, errors[r] = _between(run.ratios, deviances, at[r])
        gains[r] = deviances[0] - deviance
    there = [run.at(ratio, places) for run, ratio in zip(runs, ratios.tolist(), strict=True)]
    parts = [run.products / np.outer(size, size) for run in there]
    # Evaluate several runs at these ratios, not at the nearest grid ratios: otherwise a fit may not converge.
    settled, _, variances = _settled(there, parts, [0] * len(runs), variances)
    coefficients, covariance = _solution([part[0] for part in parts], variances)
    return Likelihood(
        deviance if len(runs) == 1 else settled,
        coefficients / size[1:],
        covariance / np.outer(size[1:], size[1:]),
        np.array(variances),
        ratios,
        errors,
        gains,
    )


def _settled(
    runs: Sequence[RunProducts], parts: Sequence[Array], at: list[int], variances: list[float]
) -> tuple[float, list[int], list[float]]:
    """Return the smallest deviance, and the index of the ratio and the variance of each run there."""
    best = np.inf
    for _ in range(RATIO_ROUNDS):
        before = best
        for r in range(len(runs)):
            deviances, of_each = _over_ratios(runs, parts, at, variances, r)
            least = int(np.argmin(deviances))
            at = [*at[:r], least, *at[r + 1 :]]
            best, variances = float(deviances[least]), list(of_each[:, least])
        if len(runs) == 1 or before - best < DEVIANCE_SETTLED:
            break
    return best, at, variances


def _solution(parts: Sequence[Array], variances: Sequence[float]) -> tuple[Array, Array]:
    """Return coefficients and their covariance from the products of each run."""
    total = np.sum([part / variance for part, variance in zip(parts, variances, strict=True)], axis=0)
    diagonal = np.diag(total)[1:]
    information = total[1:, 1:] + RIDGE * np.diag(diagonal + np.max(diagonal, initial=1e-300))
    covariance = np.linalg.inv(information)
    return covariance @ total[1:, 0], covariance


def most_likely_variance(run: RunProducts, squares: ArrayLike, target: ArrayLike) -> Array:
    """Return the most likely variance of a run from the residual sum of squares and that of the target.

    If the columns explain the target completely, the residual is rounding error.
    """
    least = np.finfo(float).eps * np.asarray(target)
    return np.asarray((np.maximum(squares, least) + run.level_rows * run.level**2) / run.degrees_of_freedom)


def _over_ratios(
    runs: Sequence[RunProducts], parts: Sequence[Array], at: Sequence[int], variances: Sequence[float], r: int
) -> tuple[Array, Array]:
    """Return the deviance for each ratio of one run, and the variances of all runs, (run, ratio)."""
    of_run = parts[r]
    others = [q for q in range(len(runs)) if q != r]
    information = of_run[:, 1:, 1:] / variances[r]
    right = of_run[:, 1:, 0] / variances[r]
    for q in others:
        information = information + parts[q][at[q], 1:, 1:] / variances[q]
        right = right + parts[q][at[q], 1:, 0] / variances[q]
    diagonal = np.einsum("gii->gi", information)
    diagonal = diagonal + np.max(diagonal, axis=1, keepdims=True, initial=1e-300)
    information = information + RIDGE * diagonal[:, :, None] * np.eye(diagonal.shape[1])
    b = np.linalg.solve(information, right[:, :, None])[:, :, 0] if right.shape[1] else right
    deviance, variance_of = np.zeros(len(of_run)), np.empty((len(runs), len(of_run)))
    for q, run in enumerate(runs):
        part = of_run if q == r else parts[q][at[q]][None]
        squares = part[:, 0, 0] - 2.0 * np.einsum("gi,gi->g", b, np.broadcast_to(part[:, 1:, 0], b.shape))
        squares = squares + np.einsum(
            "gi,gij,gj->g", b, np.broadcast_to(part[:, 1:, 1:], information.shape), b
        )
        variance_of[q] = most_likely_variance(run, squares, part[:, 0, 0])
        determinant = run.log_determinant if q == r else run.log_determinant[at[q]]
        deviance = deviance + run.degrees_of_freedom * np.log(variance_of[q]) + determinant
    return deviance, variance_of


def _between(ratios: Array, deviance: Array, at: int) -> tuple[float, float, float]:
    """Return the most likely ratio, its deviance, and the error of its logarithm, by a spline."""
    if at == 0:
        return float(ratios[0]), float(deviance[0]), float("nan")
    logs, spline = np.log(ratios[1:]), spline_over_ratios(ratios, deviance)
    low, high = logs[max(0, at - 2)], logs[min(len(logs) - 1, at)]
    fine = np.linspace(low, high, 1 + round((high - low) / BETWEEN_STEP))
    best = float(fine[np.argmin(spline(fine))])
    bend = float(spline(best, 2))
    error = float(np.sqrt(2.0 / bend)) if bend > 0.0 and low < best < high else float("nan")
    return float(np.exp(best)), float(spline(best)), error


# Products of a run on a grid of ratios about a given likely ratio; the argument is 0 if no likely ratio is
# known.
ProductsNear: TypeAlias = Callable[[float], RunProducts]
# Rounds of the joint search for the most likely ratios of several runs.
TURNS = 6


def likeliest_near(
    runs: Sequence[ProductsNear], near: Sequence[float], columns: Sequence[int]
) -> tuple[list[RunProducts], Likelihood]:
    """Return the products of runs on fine grids near the maximum, and the likelihood of some columns.

    Parameters
    ----------
    runs : sequence of callable
        Each returns the products of one run for ratios about a given likely ratio.
    near : sequence of float
        Likely ratio of each run, 0 if none is known.
    columns : sequence of int
        Columns of the table, from 1.

    Notes
    -----
    A spline between distant ratios may be wrong by several units of deviance, which is as much as models
    differ. The whole span of ratios is tried if no likely ratio is known, and if the estimate is 0 although a
    likely ratio was given.
    """
    everywhere = [not ratio for ratio in near]
    products = [run(ratio) for run, ratio in zip(runs, near, strict=True)]
    likeliest = likelihood(products, columns)
    for _ in range(TURNS):
        settled = True
        for at, ratio in enumerate(likeliest.ratios.tolist()):
            vanished = not ratio and not everywhere[at]
            if vanished or not products[at].is_close(ratio):
                everywhere[at] |= vanished
                products[at] = runs[at](ratio)
                settled = False
        if settled:
            break
        likeliest = likelihood(products, columns)
    return products, likeliest
