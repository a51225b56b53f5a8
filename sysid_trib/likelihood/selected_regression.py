"""Regression of records on the columns of their forces: rounds of selection, refinement of the columns."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sysid_trib.arrays import Array, Mask
from sysid_trib.likelihood.least_squares import ConstraintMap
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.likelihood.refined_columns import refine_columns
from sysid_trib.likelihood.regression import Runs, common_values, shifted
from sysid_trib.likelihood.rows import (
    Rows,
    Solution,
    select,
    solve,
    strong_rows,
    weak_rows,
    with_errors_of_bounded,
    with_errors_of_dropped,
)
from sysid_trib.likelihood.stochastic_columns import regress_stochastic

MAX_SELECTIONS = 5
# Number of first estimates: the first has columns at a roughly known frequency and an operator without free
# forces.
FIRST_ESTIMATES = 2


@dataclass(frozen=True)
class RegressionOptions:
    """Options of `regress`.

    Attributes
    ----------
    optimizer : pysindy optimiser or None
        Selects the forces that are kept (see `select`).
    significance : float or None
        Significance level at which a force is kept.
    strong : bool
        Whether the rows are those of the strong form.
    refine : bool
        Whether the columns are computed along the motion of the identified model.
    random_force : RandomForceOption or None
        Random force that is estimated or held; None without one.
    """

    optimizer: Any
    significance: float | None
    strong: bool
    refine: bool
    random_force: RandomForceOption | None


class Regressed(NamedTuple):
    """Result of `regress`.

    Attributes
    ----------
    solution : Solution
    active : (force,) array of bool
        The forces that are kept.
    refined : bool
        Whether the columns are from the motion of the model.
    """

    solution: Solution
    active: Mask
    refined: bool


def regress(
    runs: Runs,
    constraints: ConstraintMap,
    options: RegressionOptions,
    nearer: Callable[[], Array | None],
) -> Regressed:
    """Return the solution with the forces that are kept, and the errors of all forces.

    Parameters
    ----------
    runs : tuple of RunRegression
        As `begin` returns them.
    constraints : ConstraintMap
    options : RegressionOptions
    nearer : callable
        Called if the columns could not be refined: returns coefficients and frequency, (force + 1,), nearer
        to the solution, or None.
    """
    for _ in range(FIRST_ESTIMATES):
        after = solve(weak_rows(runs), constraints).runs
        runs = tuple(run.along_own_path() for run in after)
    begun = rows = strong_rows(runs) if options.strong else weak_rows(runs)
    chosen = np.ones(len(runs[0].library), bool)
    if options.random_force is None:
        chosen = select(rows, constraints, options.optimizer, options.significance)
    # Repeat the selection: along the motion of the kept forces it is more reliable than along that of all
    # forces.
    for _ in range(MAX_SELECTIONS):
        active = chosen
        solution, refined = _solved(begun, rows, constraints.keep(active), options)
        rows = solution.rows
        chosen = select(rows, constraints, options.optimizer, options.significance)
        if np.array_equal(chosen, active):
            break
    if not refined and (values := nearer()) is not None:
        after = shifted(rows.runs, values - common_values(rows.runs), constraints)
        kept = constraints.keep(active)
        again = refine_columns(after, after, kept)
        solution, refined = again or solve(replace(rows, runs=after), kept), again is not None
    solution = with_errors_of_bounded(solution, constraints.keep(active))
    solution = with_errors_of_dropped(solution, active, constraints)
    return Regressed(solution, active, refined)


def _solved(
    begun: Rows, last: Rows, constraints: ConstraintMap, options: RegressionOptions
) -> tuple[Solution, bool]:
    """Return the solution with the forces in the model, and whether it has converged.

    The solution starts from the rows of the first estimate, or from the last rows.
    """
    if options.random_force is not None:
        return regress_stochastic(begun.runs, constraints, options.random_force)
    solution, linear_about = solve(last, constraints), begun.runs
    if options.strong:
        return solution, False
    # Dropped forces do not contribute to stiffness and damping.
    if linear_about[0].coefficients[~constraints.in_model].any():
        pairs = zip(solution.runs, linear_about, strict=True)
        linear_about = tuple(replace(run, x=at.x, v=at.v) for run, at in pairs)
    refined = refine_columns(solution.runs, linear_about, constraints) if options.refine else None
    # Without refinement, the next rows improve the frequency and the sensor's zero by one step.
    return refined or solve(replace(last, runs=solution.runs), constraints), refined is not None
