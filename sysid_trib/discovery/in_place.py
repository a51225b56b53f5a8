"""What candidates would score in the place of effects, along the present path: nothing is fitted."""

from collections.abc import Sequence

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discovery.columns_beside import correlation_of, each_beside, projected
from sysid_trib.discovery.screen import Screening
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.likelihood import Likelihood, likelihood


def in_place(
    current: Screening, gone: Sequence[str], *, by_chance: bool = False
) -> list[tuple[float, list[int]]]:
    """Scores along the present path of nothing, and of each candidate, in the place of effects.

    Relative to the present model; the best trial of each candidate, the best first, without what is far.
    `by_chance` : with those that gain there no more than chance may.
    """
    model, kept = current.model, current.model.columns_without(gone)
    bare = likelihood(current.products, kept)
    here = current.whole.deviance
    without = bare.deviance - here
    scores = [(without - len(gone) * _of_effect(model), list[int]())]
    trials = _testable_in_place(current, gone, kept, bare)
    beside = each_beside(current.products, kept, [current.first_trial + at for at in trials], bare)
    gains, coefficients, rows = bare.deviance - beside.deviance, beside.coefficients, beside.effective_rows
    for at, gain, coefficient, of_error in zip(trials, gains, coefficients, rows, strict=True):
        p_value = current.p_value_of(float(gain), current.trials[at].force, float(of_error))
        if (by_chance or p_value < model.settings.level) and current.allows(at, coefficient):
            scores.append((without - float(gain) + (1 - len(gone)) * _of_effect(model), [at]))
    in_model = [model.trials[model.columns_of(symbol)[0]].force for symbol in gone]

    def is_near(score: float, at: Sequence[int]) -> bool:
        slack = current.slack(at[0], in_model) if at else model.settings.slack
        return score < slack * max(0.0, without) + model.settings.far

    near = [scored for scored in sorted(scores, key=lambda scored: scored[0]) if is_near(*scored)]
    best = current.first_fine([at[0] for _, at in near if at])
    return [scored for scored in near if not scored[1] or scored[1][0] in best]


def pairs_in_place(current: Screening, gone: Sequence[str]) -> list[tuple[float, list[int]]]:
    """The same of two candidates in the place of effects; which, by the noise of the present model.

    Of any two shapes of theirs: beside another one a candidate may have a shape that gains nothing alone.
    """
    model, kept = current.model, current.model.columns_without(gone)
    part, rest = projected(current.products, model.likelihood, kept, [0, *_columns(current)])
    trials = _testable(current, part[1:])
    # Of the target, and of these among all that may stand in the place of effects.
    place = {at: 1 + number for number, at in enumerate(current.in_place)}
    inside = [0, *(place[at] for at in trials)]
    gains = _gains_of_pairs(current, trials, rest[np.ix_(inside, inside)])
    symbols = [current.trials[at].force.symbol for at in trials]
    likeliest: dict[tuple[str, str], list[int]] = {}
    for flat in np.argsort(-gains, axis=None).tolist():
        i, j = divmod(flat, len(trials))
        if gains[i, j] <= 0.0 or len(likeliest) == model.settings.pairs:
            break
        likeliest.setdefault((symbols[i], symbols[j]), [trials[i], trials[j]])
    seen = sorted({at for pair in likeliest.values() for at in pair})
    known = {at for at, fine in zip(seen, current.are_fine(seen), strict=True) if fine}
    scores = []
    for pair in (pair for pair in likeliest.values() if known.issuperset(pair)):
        likelier = likelihood(current.products, [*kept, *(current.first_trial + at for at in pair)])
        coefficients = likelier.coefficients[-2:]
        able = all(current.allows(at, c) for at, c in zip(pair, coefficients, strict=True))
        score = likelier.deviance - current.whole.deviance + (2 - len(gone)) * _of_effect(model)
        if able and score < model.settings.far:
            scores.append((score, pair))
    return scores


def _of_effect(model: FittedModel) -> float:
    """What an effect costs in the evidence, its sign and its shapes aside."""
    return float(np.log(sum(rows.path.form.rows for rows in model.rows)))


def _columns(current: Screening) -> list[int]:
    """Columns of the trials that may stand in the place of effects."""
    return [current.first_trial + at for at in current.in_place]


def _testable(current: Screening, part: Array) -> list[int]:
    """Those of these trials of whose columns such parts are outside of the columns that stay."""
    least = current.model.settings.testable
    return [at for at, outside in zip(current.in_place, part, strict=True) if outside >= least]


def _testable_in_place(
    current: Screening, gone: Sequence[str], kept: Sequence[int], bare: Likelihood
) -> list[int]:
    """Trials that can be tested in the place of effects, or whose column is that of one of these.

    Of a magnet beside a cubic force there is hardly more than a quintic one: a part that is too small to be
    tested, but no error of the path, which would not be like an effect that is seen.
    """
    effects = [1 + current.model.columns_of(symbol)[0] for symbol in gone]
    part, rest = projected(current.products, bare, kept, [*effects, *_columns(current)])
    alike = np.max(np.abs(correlation_of(rest)[: len(gone), len(gone) :]), axis=0)
    part = np.where(alike >= np.sqrt(1.0 - current.model.settings.slack), np.inf, part[len(gone) :])
    return _testable(current, part)


def _gains_of_pairs(current: Screening, trials: Sequence[int], products: Array) -> Array:
    """What two trials gain together, (trial, trial); 0 of one candidate twice, or where physics forbids.

    Once each: i < j. `products` : of the target and the trials, in the noise of the model.
    """
    along, inner = products[0, 1:], products[1:, 1:]
    size = np.maximum(np.diag(inner), 1e-300)
    outside = np.outer(size, size) - inner**2
    distinct = outside > current.model.settings.testable**2 * np.outer(size, size)
    outside = np.where(distinct, outside, 1.0)
    # Coefficient of the first beside the second.
    first = (along[:, None] * size - inner * along) / outside
    gains = first * along[:, None] + first.T * along
    symbols = np.array([current.trials[at].force.symbol for at in trials])
    rows = zip(trials, first, strict=True)
    able = np.array([current.allows(at, row) for at, row in rows], dtype=bool).reshape(distinct.shape)
    possible = np.triu(distinct & able & able.T & (symbols[:, None] != symbols), 1)
    return np.where(possible, gains, 0.0)
