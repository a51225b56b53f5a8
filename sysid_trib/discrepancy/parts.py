"""Whether names and coefficients stand in parts of the record: rivals scored on each, none refitted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.evidence import evidence, probabilities
from sysid_trib.discrepancy.holdout import Prediction
from sysid_trib.discrepancy.search import Search
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.records.runs import RECORD_PARTS
from sysid_trib.regression.weak_form import cholesky_factor


class InParts(NamedTuple):
    """An effect in parts of the record.

    `costs` : of each rival (part,) minus twice the logarithm of its evidence over the effect's, on rows along
    its own path, its coefficients those of the part; `stands` : (part,) whether the effect is in the set.
    """

    costs: dict[str, Array]
    stands: Array

    @property
    def likeliest(self) -> list[str]:
        """Of each part the likeliest name, "" of no force in the effect's place."""
        names = list(self.costs)
        return [names[at] for at in np.argmin([*self.costs.values()], axis=0)]

    def probabilities(self, whole: dict[str, float]) -> Array:
        """Of each rival, (rival,): the mean of those by the whole record and by its parts."""
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
        """Whether the model follows the record to the noise."""
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
