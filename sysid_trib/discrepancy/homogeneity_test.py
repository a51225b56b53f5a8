"""Whether the runs differ: a test that gives each run coefficients of its own."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.results.variables import chi_square_test, text_variable, variable

# Directions so much shorter than the longest are what a run alone cannot tell.
DISTINCT = 1e-10


def homogeneity(models: Sequence[FittedModel]) -> xr.Dataset:
    """Test of each model for runs that differ, by small deviations.

    Parameters
    ----------
    models : sequence of FittedModel
        Of several runs each; the last is the final one.

    Returns
    -------
    xr.Dataset
        Over `model`: `chi_square` that coefficients, shapes and frequency of each run would explain of the
        residual, with `degrees_of_freedom`, `p_value` and `differ`; `most`, the parameter that explains most
        of it by itself; and `gain`, by how much the effect added next lowers the deviance, nan of the last.

    Notes
    -----
    Rao's score test, in both noises of each run. A force of another form than the model's changes from run to
    run with the amplitude: the test says that the runs ask for different coefficients, not why.
    """
    rows = [_differing(model) for model in models]
    gains = [before.deviance - after.deviance for before, after in pairwise(models)]
    chi_square, count, most = zip(*rows, strict=True)
    test = chi_square_test("model", list(chi_square), list(count), "chi-square explained by runs that differ")
    return xr.Dataset(
        {
            **test,
            "differ": variable(
                "model",
                test["p_value"][1] < models[0].settings.level,
                "whether the p-value is below the level",
            ),
            "most": text_variable("model", most, "parameter that differs most"),
            "gain": variable("model", [*gains, np.nan], "deviance explained by the next effect", "1"),
        }
    )


def _differing(model: FittedModel) -> tuple[float, int, str]:
    """What parameters of each run explain, how many there are, and the name of the one that explains most."""
    trials = len(model.trials)
    shapes = {column: f"{model.trials[at].force.symbol}.{name}" for at, name, column in model.shape_columns}
    names = dict(enumerate(trial.force.symbol for trial in model.trials)) | shapes
    names |= {trials: "w"} if model.frequency_free else {}
    tables = model.white_tables()
    single = {name: _explained(tables, [column])[0] for column, name in names.items()}
    return *_explained(tables, list(names)), max(single, key=lambda name: single[name])


def _explained(tables: Sequence[Array], columns: Sequence[int]) -> tuple[float, int]:
    """Squares explained by columns that act in each run but the first on their own, and how many they are."""
    common = np.concatenate([table[:, 1:] for table in tables])
    target = np.concatenate([table[:, 0] for table in tables])
    ends = np.cumsum([0, *(len(table) for table in tables)])
    of_runs = []
    for at in range(1, len(tables)):
        of_run = np.zeros((len(target), len(columns)))
        of_run[ends[at] : ends[at + 1]] = tables[at][:, 1:][:, list(columns)]
        of_runs.append(of_run)
    scaled = [
        part / np.maximum(np.linalg.norm(part, axis=0), 1e-300) for part in (common, np.hstack(of_runs))
    ]
    squares, rank = _squares_left(scaled[0], target)
    more, full = _squares_left(np.hstack(scaled), target)
    return max(0.0, squares - more), max(1, full - rank)


def _squares_left(design: Array, target: Array) -> tuple[float, int]:
    """Squares that least squares leave, and the rank of the design."""
    basis, singular, _ = np.linalg.svd(design, full_matrices=False)
    basis = basis[:, singular > DISTINCT**0.5 * singular[0]]
    return float(target @ target - np.sum((basis.T @ target) ** 2)), basis.shape[1]
