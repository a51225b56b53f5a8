"""How much of the noise of weak rows is a random force, by restricted likelihood of each run."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid_trib.errors import DecayError
from sysid_trib.noise.random_force import RandomForce, RandomForceOption
from sysid_trib.noise.variance_ratio import VarianceRatio, WhiteRows, held_ratio, ratio_span, variance_ratio
from sysid_trib.regression.constraint_map import ConstraintMap
from sysid_trib.regression.linearisation import DeviationOperator, linearised
from sysid_trib.regression.problem import RunRegression, Runs
from sysid_trib.regression.rows import weak_regression, weak_rows
from sysid_trib.regression.solution import solve
from sysid_trib.regression.weak_form import whiten, whitener

# Rounds in which forces, operators and ratio follow each other.
RATIO_ROUNDS = 3
# Samples a period below which errors of quadrature exceed the sensor's noise: at 25 they were four times
# 0.2 mrad of a swing of 0.3 rad, at 50 not to be seen.
FEWEST_SAMPLES = 45


def with_random_force(
    runs: Runs, constraints: ConstraintMap, option: RandomForceOption
) -> tuple[Runs, Sequence[VarianceRatio]]:
    """Estimate a random force beside the sensor's noise in each run, and the forces with both.

    Parameters
    ----------
    runs : tuple of RunRegression
        With a first estimate, along the smoothed records.
    constraints : ConstraintMap
    option : "auto" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, held.

    Returns
    -------
    runs : tuple of RunRegression
        With their `random_ratio`.
    ratios : sequence of VarianceRatio

    Raises
    ------
    DecayError
        The samples are too few: along a smoothed record the sums of the weak form are not exact then.
    """
    for run in runs:
        samples = 2.0 * np.pi / float(np.median(np.diff(run.problem.form.tau)))
        if samples < FEWEST_SAMPLES:
            raise DecayError(
                f"Direct wants {FEWEST_SAMPLES} samples a period beside a random force, not {samples:.0f}; "
                "take Trajectory(random_force='auto')."
            )
    every = np.ones(len(runs[0].problem.library), bool)
    ratios: list[VarianceRatio | None] = [None] * len(runs)
    for _ in range(RATIO_ROUNDS):
        operators = [linearised(run) for run in runs]
        ratios = [
            _ratio(run, operator, constraints, option, last)
            for run, operator, last in zip(runs, operators, ratios, strict=True)
        ]
        runs = tuple(
            replace(run, random_ratio=ratio.ratio) for run, ratio in zip(runs, ratios, strict=True) if ratio
        )
        rows = weak_regression(runs, [linearised(run) for run in runs])
        runs = solve(rows, runs[0], every, constraints).applied_to(runs)
    return runs, [ratio for ratio in ratios if ratio]


def _ratio(
    run: RunRegression,
    operator: DeviationOperator,
    constraints: ConstraintMap,
    option: RandomForceOption,
    last: VarianceRatio | None,
) -> VarianceRatio:
    """The ratio of one run by its own rows."""
    weak, form = weak_rows(run, operator), run.problem.form
    free = weak.columns @ (weak.scale[:, None] * constraints.matrix)
    target = weak.target - weak.columns @ (weak.scale * constraints.constant)
    table = np.column_stack([free, weak.nuisances, target])

    def rows(ratio: float) -> WhiteRows:
        factor = whitener(operator.matrix, form.gram, ratio)
        white = whiten(factor, table)
        return WhiteRows(white[:, -1], white[:, :-1], 2.0 * float(np.sum(np.log(factor[0]))))

    if isinstance(option, str):
        low, high = ratio_span(float(form.tau[-1] - form.tau[0]), float(np.median(np.diff(form.tau))))
        return variance_ratio(rows, low, high, last.ratio if last else None)
    per_tau = RandomForce(float(option)).per_tau(run.problem.nominal_frequency)
    return held_ratio(rows, per_tau, last.variance if last else None)
