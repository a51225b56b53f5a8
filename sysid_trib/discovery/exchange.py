"""Exchange: what may stand in the place of effects, and whether it is likelier."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discovery.fits import Fits, evidence, least_penalty
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.single_columns import correlation_of, each_column, projected
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.likelihood import Likelihood, likelihood


def replacing(
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
    trials = _testable_replacing(current, gone, kept, bare)
    single = each_column(current.products, kept, [current.first_trial + at for at in trials], bare)
    gains, coefficients, rows = bare.deviance - single.deviance, single.coefficients, single.effective_rows
    for at, gain, coefficient, of_error in zip(trials, gains, coefficients, rows, strict=True):
        p_value = current.p_value_of(float(gain), current.trials[at].force, float(of_error))
        if (by_chance or p_value < model.settings.level) and current.allows(at, coefficient):
            scores.append((without - float(gain) + (1 - len(gone)) * _of_effect(model), [at]))
    in_model = [model.trials[model.columns_of(symbol)[0]].force for symbol in gone]

    def is_near(score: float, at: Sequence[int]) -> bool:
        tolerance = current.tolerance(at[0], in_model) if at else model.settings.tolerance
        return score < tolerance * max(0.0, without) + model.settings.far

    near = [scored for scored in sorted(scores, key=lambda scored: scored[0]) if is_near(*scored)]
    best = current.first_fine([at[0] for _, at in near if at])
    return [scored for scored in near if not scored[1] or scored[1][0] in best]


def replacing_pairs(current: Screening, gone: Sequence[str]) -> list[tuple[float, list[int]]]:
    """Pairs of candidates in the place of effects; which, by the noise of the present model.

    Of any two shapes of theirs: with another one a candidate may have a shape that gains nothing alone.
    """
    model, kept = current.model, current.model.columns_without(gone)
    part, rest = projected(current.products, model.likelihood, kept, [0, *_columns(current)])
    trials = _testable(current, part[1:])
    # Of the target, and of these among all that may stand in the place of effects.
    place = {at: 1 + number for number, at in enumerate(current.replacing)}
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
    return [current.first_trial + at for at in current.replacing]


def _testable(current: Screening, part: Array) -> list[int]:
    """Trials of whose columns such parts are outside of the columns that stay."""
    least = current.model.settings.testable
    return [at for at, outside in zip(current.replacing, part, strict=True) if outside >= least]


def _testable_replacing(
    current: Screening, gone: Sequence[str], kept: Sequence[int], bare: Likelihood
) -> list[int]:
    """Trials that can be tested in the place of effects, or whose column is that of one of these.

    Of a magnet with a cubic force there is hardly more than a quintic one: a part that is too small to be
    tested, but no error of the path, which would not be like an effect that is seen.
    """
    effects = [1 + current.model.columns_of(symbol)[0] for symbol in gone]
    part, rest = projected(current.products, bare, kept, [*effects, *_columns(current)])
    alike = np.max(np.abs(correlation_of(rest)[: len(gone), len(gone) :]), axis=0)
    part = np.where(alike >= np.sqrt(1.0 - current.model.settings.tolerance), np.inf, part[len(gone) :])
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
    # Coefficient of the first with the second.
    first = (along[:, None] * size - inner * along) / outside
    gains = first * along[:, None] + first.T * along
    symbols = np.array([current.trials[at].force.symbol for at in trials])
    rows = zip(trials, first, strict=True)
    able = np.array([current.allows(at, row) for at, row in rows], dtype=bool).reshape(distinct.shape)
    possible = np.triu(distinct & able & able.T & (symbols[:, None] != symbols), 1)
    return np.where(possible, gains, 0.0)


class Move(NamedTuple):
    """A step of a search: a model, its effects besides the start model's, and its evidence."""

    evidence: float
    effects: tuple[str, ...]
    model: FittedModel


def exchange_effects(current: Screening, effects: tuple[str, ...], fits: Fits) -> Move | None:
    """The most likely model without an effect or two, or with as many others or fewer in their place.

    Parameters
    ----------
    current : Screening
        Of the present model.
    effects : tuple of str
        Its effects besides the start model's.
    fits : Fits

    Returns
    -------
    Move or None
        None if no such model is more likely than the present one.
    """
    model, settings = current.model, current.model.settings
    here = evidence(model, effects) if effects else 0.0
    aim = here - settings.least_gain
    proposed = list[tuple[float, list[int], tuple[str, ...]]]()
    for gone in (*((symbol,) for symbol in effects), *combinations(effects, 2)):
        pairs = replacing_pairs(current, gone) if len(gone) == 2 else []
        proposed += [(*place, gone) for place in replacing(current, gone) + pairs]
    best: Move | None = None
    for score, at, gone in sorted(proposed, key=lambda scored: scored[0])[: settings.fitted]:
        if score > aim - here + settings.far:
            break
        move = move_of(current, effects, gone, at, fits, aim)
        if move is not None and move.evidence < aim:
            best, aim = move, move.evidence
    return best


def move_of(
    current: Screening, effects: Sequence[str], gone: Sequence[str], at: Sequence[int], fits: Fits, aim: float
) -> Move | None:
    """The model with trials in the place of effects; None where it is not fitted.

    A fit whose evidence cannot come below `aim` is given up.
    """
    model, trials = current.model, [current.trials[i] for i in at]
    after = tuple(s for s in effects if s not in gone) + tuple(t.force.symbol for t in trials)
    forces = [trial.force for trial in (*model.trials, *trials) if trial.force.symbol in after]
    fitted = fits.of(model, gone, trials, worst=aim - least_penalty(model, forces))
    return None if fitted is None else Move(evidence(fitted, after), after, fitted)


def not_beyond_chance(
    current: Screening, effects: tuple[str, ...], fits: Fits
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model without the effect that chance would do as well as most likely; None if there is none."""
    model = current.model
    chances = _p_values(current, effects)
    if max(chances, default=0.0) < model.settings.level:
        return None
    worst = effects[int(np.argmax(chances))]
    # Along the present path it is as likely: a fit that is less so came to a worse optimum.
    along = _without(current, worst).deviance - current.whole.deviance
    fitted = fits.of(model, (worst,), (), model.deviance + along)
    if fitted is None or _p_value(current, worst, fitted.deviance - model.deviance) < model.settings.level:
        return None
    fits.by_chance.add(frozenset(effects))
    return fitted, tuple(symbol for symbol in effects if symbol != worst)


def chance_in_set(
    effects: tuple[str, ...], rivals: dict[str, dict[str, float]], fits: Fits
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model without the effect whose credible set chance is in; None if there is none."""
    single = {symbol: costs.get("", np.inf) for symbol, costs in rivals.items()}
    symbol = min(single, key=single.__getitem__, default="")
    if not symbol or single[symbol] >= fits.start.settings.outside_of_set:
        return None
    after = tuple(other for other in effects if other != symbol)
    fitted = fits.kept.get(frozenset(after))
    if fitted is None:
        return None
    fits.by_chance.add(frozenset(effects))
    return fitted, after


def decisive_p_values(current: Screening, effects: Sequence[str], fits: Fits) -> list[float]:
    """P-value of each effect with the others, by the deviance without it: those that keep it in the model.

    Along the model's path; where chance would do as well along that, by the fit without the effect, if any.
    """
    chances = _p_values(current, effects)
    for at, symbol in enumerate(effects):
        fitted = fits.kept.get(frozenset(effects) - {symbol})
        if chances[at] >= current.model.settings.level and fitted is not None:
            chances[at] = _p_value(current, symbol, fitted.deviance - current.model.deviance)
    return chances


def _p_values(current: Screening, effects: Sequence[str]) -> list[float]:
    """Probability that chance explains as much as each effect with the others, along the model's path."""
    return [_p_value(current, symbol) for symbol in effects]


def _p_value(current: Screening, symbol: str, gain: float | None = None) -> float:
    """Probability that chance lowers the deviance as much as an effect of the model does.

    By default as it does in the rows along the model's path.
    """
    model = current.model
    column, kept = model.columns_of(symbol)[0], model.columns_without((symbol,))
    bare = _without(current, symbol)
    single = each_column(current.products, kept, [1 + column], bare)
    gain = bare.deviance - current.whole.deviance if gain is None else gain
    return current.p_value_of(gain, model.trials[column].force, float(single.effective_rows[0]))


def _without(current: Screening, symbol: str) -> Likelihood:
    """The likelihood of the rows along the model's path without an effect."""
    return likelihood(current.products, current.model.columns_without((symbol,)))


def better_rival(
    current: Screening, effects: tuple[str, ...], rivals: dict[str, dict[str, float]], fits: Fits
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model with a rival in an effect's place that is more likely and beyond chance, or with nothing.

    Of two that are as likely the one of fewer shapes is taken.
    """
    model, equal = current.model, current.model.settings.least_gain
    shapes = {t.force.symbol: len(t.force.shape) for t in (*current.trials, *model.trials)} | {"": 0}
    every = [
        (excess + 2.0 * equal * (shapes[name] - shapes[symbol]), symbol, name)
        for symbol, costs in rivals.items()
        for name, excess in costs.items()
    ]
    for excess, symbol, name in sorted(every):
        if excess > -equal:
            return None
        likely = {current.trials[at[0]].force.symbol if at else "" for _, at in replacing(current, (symbol,))}
        if name in likely:
            after = tuple(s for s in effects if s != symbol) + ((name,) if name else ())
            return fits.kept[frozenset(after)], after
    return None


def rivals_of(current: Screening, effects: tuple[str, ...], symbol: str, fits: Fits) -> dict[str, float]:
    """Evidence with each candidate in an effect's place, over its own; of nothing in its place under "".

    Fitted are as many as the settings say, and all that would be in the set along the present path.
    """
    model, settings = current.model, current.model.settings
    here = evidence(model, effects)
    likelier = {symbol: 0.0}
    for place, (score, at) in enumerate(replacing(current, (symbol,), by_chance=True)):
        if place >= settings.fitted and score > settings.outside_of_set:
            break
        move = move_of(current, effects, (symbol,), at, fits, here + settings.far)
        if move is None:
            # Outside of every credible set, or it failed, or there was no time.
            continue
        likelier["".join(current.trials[i].force.symbol for i in at)] = move.evidence - here
    return likelier
