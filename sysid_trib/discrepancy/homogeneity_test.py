"""Whether the runs differ: a test that gives each run coefficients of its own."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import xarray as xr
from scipy.linalg import orth

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline, project_out
from sysid_trib.results.variables import chi_square_test, text_variable, variable
from sysid_trib.trajectory_fit.parameters import FREQUENCY

# Directions so much shorter than the longest are what a run alone cannot tell.
DISTINCT = 1e-6


def homogeneity(models: Sequence[Baseline], level: float) -> xr.Dataset:
    """Score test of each model for runs that differ, by small deviations.

    Parameters
    ----------
    models : sequence of Baseline
        Of several runs each; the last is the final one.
    level : float
        Significance level below which the runs differ.

    Returns
    -------
    xr.Dataset
        Over `model`: `chi_square` that coefficients, shapes and frequency of each run would explain of the
        residual, with `degrees_of_freedom`, `p_value` and `differ`; `most`, the parameter that explains most
        of it by itself; and `gain`, the chi-square that the effect added next explains, nan of the last.

    Notes
    -----
    Rao's score test. A force of another form than the model's changes from run to run with the amplitude: the
    test says that the runs ask for different coefficients, not why.
    """
    rows = [_differing(model) for model in models]
    gains = [_gain(before, after) for before, after in pairwise(models)]
    chi_square, count, most = zip(*rows, strict=True)
    test = chi_square_test("model", list(chi_square), list(count), "chi-square explained by runs that differ")
    return xr.Dataset(
        {
            **test,
            "differ": variable("model", test["p_value"][1] < level, "whether the p-value is below the level"),
            "most": text_variable("model", most, "parameter that differs most"),
            "gain": variable("model", [*gains, np.nan], "chi-square explained by the next effect", "1"),
        }
    )


def _differing(model: Baseline) -> tuple[float, int, str]:
    """What parameters of each run explain, how many there are, and the name of the one that explains most."""
    parameters = model.problem.parameters
    table = parameters.of_common(model.table)
    table = table / np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    ends = np.cumsum([len(part) for part in model.split_by_run(model.residual)])
    columns = []
    for start, end in pairwise(ends):
        of_run = np.zeros_like(table)
        of_run[start:end] = table[start:end]
        columns.append(project_out(of_run, model.column_space))
    names = [name.replace(FREQUENCY, "w") for name in parameters.common]
    single = [_explained([run[:, [at]] for run in columns], model.residual)[0] for at in range(len(names))]
    return *_explained(columns, model.residual), names[int(np.argmax(single))]


def _explained(columns: Sequence[Array], residual: Array) -> tuple[float, int]:
    space = orth(np.concatenate(columns, axis=1), rcond=DISTINCT)
    return float(np.sum((space.T @ residual) ** 2)), space.shape[1]


def _gain(before: Baseline, after: Baseline) -> float:
    """Fall of chi-square between two models, in the noise of the first."""
    residual = before.problem.white(after.problem.residuals(after.values))
    return before.chi_square - float(residual @ residual)
