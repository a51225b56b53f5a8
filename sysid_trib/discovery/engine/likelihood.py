"""Likelihood of the rows of all runs, with the noise of the sensor and a random force in each.

Rows of a run have the covariance variance * (A S A' + ratio * G): of the sensor's noise of colour S, and of a
white random force. Everything about a model is in the products of its columns for a grid of the ratios, so
that any set of columns is judged by small matrices, both variances of each run at their most likely values.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.discovery.engine.run_products import RunProducts, spline_over_ratios

# Distance of the ratios, in their logarithm, at which a spline between those tried is evaluated.
BETWEEN_STEP = 0.03
# Rounds in which the variances of several runs settle together, and the fall of the deviance at
# which they have.
RATIO_ROUNDS, DEVIANCE_SETTLED = 20, 0.01
# Part of the information that is added, so that columns which nothing tells apart have a solution.
RIDGE = 1e-13


def of_many_rows(rows: ArrayLike, columns: int) -> Array:
    """Return the factor that gives a gain of one column the tail of a chi-square.

    The gain has the tail of Student's t with `rows` degrees of freedom (Wallace 1959), while the most likely
    variance also counts the `columns` as rows. With few rows chance gains more.
    """
    dof = np.asarray(rows)
    return np.asarray(dof / (dof + columns) * ((8.0 * dof + 1.0) / (8.0 * dof + 3.0)) ** 2)


@dataclass(frozen=True)
class Likelihood:
    """The most likely values of a model.

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
        Standard errors of their logarithms, nan of a ratio of 0.
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
        """Return this fit as one of `count` columns; columns that are not among these are zero."""
        if len(columns) == count:
            return self
        coefficients, covariance = np.zeros(count), np.zeros((count, count))
        coefficients[list(columns)] = self.coefficients
        covariance[np.ix_(columns, columns)] = self.covariance
        return replace(self, coefficients=coefficients, covariance=covariance)


def likelihood(runs: Sequence[RunProducts], columns: Sequence[int]) -> Likelihood:
    """Return the maximum likelihood of the model of these columns, the variances of each run profiled.

    Parameters
    ----------
    runs : sequence of RunProducts
        With the same columns.
    columns : sequence of int
        Columns of the table, from 1.

    Notes
    -----
    For one run the coefficients are solved at each ratio. For several runs this is done for one after the
    other, with the other ratios held, until the deviance converges.
    """
    places = np.asarray(columns, dtype=int)
    squares = sum(np.einsum("gii->i", run.of(places)) for run in runs)
    # A column without effect keeps its size; the ridge bounds it.
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
    # Evaluate several runs at these ratios, not at the nearest tried ones: otherwise a fit may not converge.
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
    """Return the least deviance, and the place of the ratio and the variance of each run with it."""
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
    """Return coefficients and their covariance by the products of each run."""
    total = np.sum([part / variance for part, variance in zip(parts, variances, strict=True)], axis=0)
    diagonal = np.diag(total)[1:]
    information = total[1:, 1:] + RIDGE * np.diag(diagonal + np.max(diagonal, initial=1e-300))
    covariance = np.linalg.inv(information)
    return covariance @ total[1:, 0], covariance


def most_likely_variance(run: RunProducts, squares: ArrayLike, target: ArrayLike) -> Array:
    """Return the most likely variance of a run by the residual squares of its rows and the target's squares.

    The residual of a completely explained target is rounding.
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


# Index of a likely ratio, 0 if none is known; see `products_of`.
ProductsNear: TypeAlias = Callable[[float], RunProducts]
# Rounds of the joint search for the most likely ratios of several runs.
TURNS = 6


def likeliest_near(
    runs: Sequence[ProductsNear], near: Sequence[float], columns: Sequence[int]
) -> tuple[list[RunProducts], Likelihood]:
    """Return products of runs, exact near the maximum, and the likelihood of some columns.

    Parameters
    ----------
    runs : sequence of callable
        Products of each run, of ratios about a likely one.
    near : sequence of float
        Likely ratios, 0 where none is known.
    columns : sequence of int
        Columns of the table, from 1.

    Notes
    -----
    Between ratios that are far from each other a spline may be off by several units of the deviance, in which
    models are compared. Ratios all over the span are tried where none is known to be likely, and where the
    random force vanishes with one that is.
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
