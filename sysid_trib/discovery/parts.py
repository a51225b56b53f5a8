"""Tests of whether runs differ, and whether names and coefficients stand in parts of the record."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.discovery.fits import evidence, probabilities
from sysid_trib.discovery.search import Search
from sysid_trib.discovery.unseen import Prediction
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.weak_form import cholesky_factor
from sysid_trib.records.decay import RECORD_PARTS
from sysid_trib.results.variables import chi_square_test, text_variable, variable


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
    # Directions so much shorter than the longest are what a run alone cannot tell.
    basis = basis[:, singular > 1e-5 * singular[0]]
    return float(target @ target - np.sum((basis.T @ target) ** 2)), basis.shape[1]


class InParts(NamedTuple):
    """An effect in parts of the record.

    `costs` : of each rival (part,) minus twice the logarithm of its evidence over the effect's, on rows along
    its own path, its coefficients those of the part; `stands` : (part,) whether the effect is in the set.
    """

    costs: dict[str, Array]
    stands: Array

    @property
    def likeliest(self) -> list[str]:
        """The likeliest name by each part, "" for no force in the effect's place."""
        names = list(self.costs)
        return [names[at] for at in np.argmin([*self.costs.values()], axis=0)]

    def probabilities(self, whole: dict[str, float]) -> Array:
        """Probability of each rival, (rival,): the mean over the whole record and its parts."""
        table = [
            np.append(self.costs.get(name, np.full(len(RECORD_PARTS), np.inf)), whole[name]) for name in whole
        ]
        return np.asarray(np.mean([probabilities(costs) for costs in np.transpose(table)], axis=0))


class Stability(NamedTuple):
    """How a search stands in parts of the record.

    `names` : each of its effects there. `predictions` : of what was held out, by its models.
    `noise_p_value` : see `Growth`; where the final model leaves more than noise (not `is_complete`), sets and
    errors allow for how names and coefficients move between parts.
    `model_error` : (trial + 1,) of the coefficients and the frequency (rad/s), by that alone.
    """

    names: dict[str, InParts]
    predictions: Sequence[Prediction]
    noise_p_value: float
    model_error: Array

    @property
    def is_complete(self) -> bool:
        """True if the model follows the record to the noise."""
        return self.noise_p_value >= 1.0


def stability_of(search: Search, predictions: Sequence[Prediction], noise_p_value: float) -> Stability:
    """How the effects and the final model of a search stand in parts of the record."""
    last = search.models[-1]
    error = np.zeros(len(last.trials) + 1)
    # Nor is it known whether a search that ran out of time leaves but noise.
    if not noise_p_value >= 1.0:
        error = _error_of_model(last)
        error[-1] *= 0.5 * last.rows[0].path.frequency
    return Stability(names_in_parts(search), predictions, noise_p_value, error)


def names_in_parts(search: Search) -> dict[str, InParts]:
    """Each effect of a search against its rivals in parts of the record."""
    outside, kept, names = search.models[0].settings.outside_of_set, search.fits.kept, dict[str, InParts]()
    for symbol, rivals in search.rivals.items():
        rest = frozenset(search.effects) - {symbol}
        models = {name: kept.get(rest | ({name} if name else set())) for name in rivals}
        scores = {
            name: _deviances(model) + evidence(model, [*rest, *[name] * bool(name)]) - model.deviance
            for name, model in models.items()
            if model is not None
        }
        reference = scores.get(symbol, np.zeros(len(RECORD_PARTS)))
        costs = {name: score - reference for name, score in scores.items()} | {
            symbol: np.zeros(len(RECORD_PARTS))
        }
        names[symbol] = InParts(costs, np.min([*costs.values()], axis=0) > -outside)
    return names


def _error_of_model(model: FittedModel) -> Array:
    """Part of the errors of coefficients and stiffness that no noise explains, (trial + 1,).

    By how much they move between parts of the record beyond what less data does; shapes are held.
    """
    count = len(model.trials)
    tables, shapes = model.white_tables(), len(model.shape_columns)
    kept = [0, *range(1, 1 + model.columns - shapes)]
    fits = [
        _solved([table[_rows(table, *part), :][:, kept] for table in tables])
        for part in ((0.0, 1.0), *RECORD_PARTS.values())
    ]
    values, variances = (np.array(part)[:, : count + 1] for part in zip(*fits, strict=True))
    expected = np.maximum(np.mean(variances[1:], axis=0) - variances[0], 0.0)
    movement = np.mean((values[1:] - values[0]) ** 2, axis=0)
    error = np.sqrt(np.maximum(movement - expected, 0.0))
    return error if model.frequency_free else np.append(error[:count], 0.0)


def _rows(table: Array, low: float, high: float) -> slice:
    return slice(round(low * len(table)), round(high * len(table)))


def _deviances(model: FittedModel) -> Array:
    """Deviance of a model on the rows of each part, (part,), in the noises of the whole."""
    tables = model.white_tables()
    logarithms = [
        2.0 * np.log(cholesky_factor(rows.band, rows.path.form.gram, float(ratio))[0]) + np.log(variance)
        for rows, ratio, variance in zip(
            model.rows, model.likelihood.ratios, model.likelihood.variances, strict=True
        )
    ]
    deviances = []
    for part in RECORD_PARTS.values():
        inside = [table[_rows(table, *part)] for table in tables]
        target, design = np.concatenate(inside)[:, 0], np.concatenate(inside)[:, 1:]
        residual = target - design @ _least_squares(design, target)
        determinant = sum(float(np.sum(of_run[_rows(of_run, *part)])) for of_run in logarithms)
        deviances.append(float(residual @ residual) + determinant)
    return np.array(deviances)


def _least_squares(design: Array, target: Array) -> Array:
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(design / size, target, rcond=1e-10)[0] / size)


def _solved(tables: Sequence[Array]) -> tuple[Array, Array]:
    """Coefficients by least squares of white rows, and their variances."""
    whole = np.concatenate(tables)
    size = np.maximum(np.linalg.norm(whole[:, 1:], axis=0), 1e-300)
    design = whole[:, 1:] / size
    inverse = np.linalg.pinv(design.T @ design, rcond=1e-10, hermitian=True)
    return inverse @ (design.T @ whole[:, 0]) / size, np.diag(inverse) / size**2
