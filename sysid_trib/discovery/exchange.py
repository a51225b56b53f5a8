"""Moves of a search: candidates in place of effects or in addition, and whether they are more likely."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.likelihood import likelihood
from sysid_trib.discovery.fits import Fits, evidence, least_penalty, log_rows
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.single_columns import correlation_of, each_column, projected


class ScoredTrials(NamedTuple):
    """Trials in the place of effects, and their evidence relative to that of the present model."""

    score: float
    trials: list[int]


def replacing(current: Screening, gone: Sequence[str], *, by_chance: bool = False) -> list[ScoredTrials]:
    """Return no trial and the best trial of each candidate as replacements of effects, best first.

    Replacements that are far less likely are left out. `by_chance` : include trials whose gain is not
    significant.
    """
    model, kept = current.model, current.model.columns_without(gone)
    bare = likelihood(current.products, kept)
    without, penalty = bare.deviance - current.whole.deviance, log_rows(model)
    # A magnet with a cubic force is nearly a quintic force: its independent part is too small to be tested.
    # Yet this part is not an error of the path, which would not resemble a significant effect.
    effects = [1 + model.columns_of(symbol)[0] for symbol in gone]
    columns = [current.first_trial + at for at in current.replacing]
    part, rest = projected(current.products, bare, kept, [*effects, *columns])
    alike = np.max(np.abs(correlation_of(rest)[: len(gone), len(gone) :]), axis=0)
    part = np.where(alike >= np.sqrt(1.0 - model.settings.tolerance), np.inf, part[len(gone) :])
    trials = _testable(current, part)
    columns = [current.first_trial + at for at in trials]
    deviance, coefficients, _, rows = each_column(current.products, kept, columns, bare)
    gains = (bare.deviance - deviance).tolist()
    scores = [ScoredTrials(without - len(gone) * penalty, [])]
    for i, at in enumerate(trials):
        p_value = current.p_value_of(gains[i], current.trials[at].force, rows[i])
        if (by_chance or p_value < model.settings.level) and current.allows(at, coefficients[i]):
            scores.append(ScoredTrials(without - gains[i] + (1 - len(gone)) * penalty, [at]))
    in_model = [model.trials[model.columns_of(symbol)[0]].force for symbol in gone]

    def is_near(score: float, at: Sequence[int]) -> bool:
        tolerance = current.tolerance(at[0], in_model) if at else model.settings.tolerance
        return score < tolerance * max(0.0, without) + model.settings.far

    near = [scored for scored in sorted(scores, key=lambda scored: scored.score) if is_near(*scored)]
    best = current.first_fine([scored.trials[0] for scored in near if scored.trials])
    return [scored for scored in near if not scored.trials or scored.trials[0] in best]


def replacing_pairs(current: Screening, gone: Sequence[str]) -> list[ScoredTrials]:
    """Return pairs of candidates as replacements of effects, in the noise of the present model.

    All combinations of the shapes of both are tried: the best shapes of a pair may gain nothing alone.
    """
    model, kept = current.model, current.model.columns_without(gone)
    columns = [current.first_trial + at for at in current.replacing]
    part, rest = projected(current.products, model.likelihood, kept, [0, *columns])
    trials = _testable(current, part[1:])
    # Products of the target and of all trials that may replace effects.
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
        able = all(current.allows(at, c) for at, c in zip(pair, likelier.coefficients[-2:], strict=True))
        score = likelier.deviance - current.whole.deviance + (2 - len(gone)) * log_rows(model)
        if able and score < model.settings.far:
            scores.append(ScoredTrials(score, pair))
    return scores


def _testable(current: Screening, part: Array) -> list[int]:
    """Return the trials whose columns are not spanned by the columns kept in the model."""
    least = current.model.settings.testable
    return [at for at, outside in zip(current.replacing, part, strict=True) if outside >= least]


def _gains_of_pairs(current: Screening, trials: Sequence[int], products: Array) -> Array:
    """Return the joint gain of two trials, (trial, trial); 0 for equal candidates or a forbidden sign.

    Each pair has one entry: i < j. `products` : products of the target and the trials, in the model's noise.
    """
    along, inner = products[0, 1:], products[1:, 1:]
    size = np.maximum(np.diag(inner), 1e-300)
    outside = np.outer(size, size) - inner**2
    distinct = outside > current.model.settings.testable**2 * np.outer(size, size)
    outside = np.where(distinct, outside, 1.0)
    # Coefficient of the first trial in the presence of the second.
    first = (along[:, None] * size - inner * along) / outside
    gains = first * along[:, None] + first.T * along
    symbols = np.array([current.trials[at].force.symbol for at in trials])
    rows = zip(trials, first, strict=True)
    able = np.array([current.allows(at, row) for at, row in rows], dtype=bool).reshape(distinct.shape)
    possible = np.triu(distinct & able & able.T & (symbols[:, None] != symbols), 1)
    return np.where(possible, gains, 0.0)


def move_of(
    current: Screening, fits: Fits, gone: Sequence[str], at: Sequence[int], aim: float
) -> FittedModel | None:
    """Return the model with trials in the place of effects; None if it is not fitted.

    A fit whose evidence cannot reach `aim` is abandoned.
    """
    model, trials = current.model, [current.trials[i] for i in at]
    after = {*current.effects} - {*gone} | {trial.force.symbol for trial in trials}
    forces = [trial.force for trial in (*model.trials, *trials) if trial.force.symbol in after]
    return fits.of(model, gone, trials, worst=aim - least_penalty(model, forces))


def likelier_exchange(current: Screening, fits: Fits) -> FittedModel | None:
    """Return the most likely model with one or two effects removed or replaced.

    The replacements are at most as many as the removed effects. Return None if no such model is more likely
    than the present one.
    """
    settings, here = current.model.settings, evidence(current.model)
    aim, best = here - settings.least_gain, None
    proposed = list[tuple[float, list[int], tuple[str, ...]]]()
    for gone in (*((symbol,) for symbol in current.effects), *combinations(current.effects, 2)):
        pairs = replacing_pairs(current, gone) if len(gone) == 2 else []
        proposed += [(*place, gone) for place in replacing(current, gone) + pairs]
    for score, at, gone in sorted(proposed, key=lambda scored: scored[0])[: settings.fitted]:
        if score > aim - here + settings.far:
            break
        move = move_of(current, fits, gone, at, aim)
        if move is not None and evidence(move) < aim:
            best, aim = move, evidence(move)
    return best


def extended(current: Screening, fits: Fits) -> list[FittedModel]:
    """Return models with one more candidate, for the most likely candidates.

    The gain of the candidate is significant, and its credible set excludes chance. The error of gains by
    columns is estimated from the fits so far; it is large for strong effects.
    """
    model, settings = current.model, current.model.settings
    likeliest = [at for at in current.best() if current.p_values[at] < settings.level]
    limit, gain_of_column, off = evidence(model) - settings.outside_of_set, 0.0, 0.0
    models = list[FittedModel]()
    # Try twice as many as are fitted, because the trials of largest gain may be unphysical, and all those
    # whose column is not informative.
    few = 2 * settings.fitted
    for at in (*likeliest[:few], *(at for at in likeliest[few:] if current.tolerance(at, ()) >= 1.0)):
        force, of_column = current.trials[at].force, float(current.gains[at])
        tolerance = max(off, current.tolerance(at, [added.trials[-1].force for added in models]))
        by_chance = frozenset((*current.effects, force.symbol)) in fits.by_chance
        if by_chance or of_column <= (1.0 - tolerance) * gain_of_column:
            continue
        added = move_of(current, fits, (), [at], min([limit, *map(evidence, models)]))
        if added is None:
            continue
        gain = model.deviance - added.deviance
        p_value = current.p_value_of(gain, force, current.effective_rows[at])
        if p_value < settings.level and evidence(added) < limit:
            gain_of_column = gain_of_column if models else of_column
            off = max(off, abs(gain / of_column - 1.0))
            models.append(added)
    return models


def rivals_of(current: Screening, fits: Fits, symbol: str) -> dict[str, float]:
    """Return the evidence with each candidate in place of an effect, relative to the effect; "" is no force.

    The settings limit the number of fits, except for candidates in the credible set along the present path.
    """
    settings, here = current.model.settings, evidence(current.model)
    likelier = {symbol: 0.0}
    for place, (score, at) in enumerate(replacing(current, (symbol,), by_chance=True)):
        if place >= settings.fitted and score > settings.outside_of_set:
            break
        move = move_of(current, fits, (symbol,), at, here + settings.far)
        # None: the candidate is outside of every credible set, its fit failed, or the time is up.
        if move is not None:
            likelier["".join(current.trials[i].force.symbol for i in at)] = evidence(move) - here
    return likelier


def better_rival(
    current: Screening, fits: Fits, rivals: Mapping[str, Mapping[str, float]]
) -> FittedModel | None:
    """Return the model with a more likely and significant candidate in place of an effect, or with none.

    If two are equally likely, the one with fewer shapes is taken.
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
            return fits.kept[frozenset(current.effects) - {symbol} | {name} - {""}]
    return None


def pairs_of(current: Screening, fits: Fits, symbol: str) -> dict[tuple[str, str], float]:
    """Return the pairs in an effect's credible set, with their relative evidence, most likely first.

    Notes
    -----
    A force with a fitted shape may imitate the sum of two forces without shapes: damping of the power 2.25
    with viscous damping imitates dry and quadratic friction. A pair has no more parameters than the effect,
    and each of its members is significant given the other. An effect without shapes has no pairs.
    """
    model, settings = current.model, current.model.settings
    shapes = len(model.columns_of(symbol)) - 1
    if not shapes:
        return {}
    here, likelier = evidence(model), dict[tuple[str, str], float]()
    scored = [
        (score, pair)
        for score, pair in sorted(replacing_pairs(current, (symbol,)))
        if sum(1 + len(current.trials[at].force.shape) for at in pair) <= 1 + shapes
    ]
    for _, pair in scored[: settings.fitted]:
        if not _both_add(current, symbol, pair):
            continue
        move = move_of(current, fits, (symbol,), pair, here + settings.outside_of_set)
        if move is not None and (excess := evidence(move) - here) < settings.outside_of_set:
            first, second = (current.trials[at].force.symbol for at in pair)
            likelier[first, second] = excess
    return dict(sorted(likelier.items(), key=lambda scored: scored[1]))


def _both_add(current: Screening, symbol: str, pair: Sequence[int]) -> bool:
    """Return true if each of two trials in place of an effect is significant given the other."""
    kept, columns = current.model.columns_without((symbol,)), [current.first_trial + at for at in pair]
    p_values = [current.p_value_with([*kept, other], at) for at, other in (columns, columns[::-1])]
    return max(p_values) < current.model.settings.level


def likelier_pair(current: Screening, fits: Fits, most: int) -> FittedModel | None:
    """Return the model with a pair whose credible set excludes the effect, if there is one.

    `most` : largest number of effects in a model.
    """
    if len(current.effects) >= most:
        return None
    for symbol in current.effects:
        for pair, excess in pairs_of(current, fits, symbol).items():
            after = frozenset(current.effects) - {symbol} | {*pair}
            if excess < -current.model.settings.outside_of_set and after not in fits.by_chance:
                return fits.kept[after]
    return None


def not_beyond_chance(current: Screening, fits: Fits) -> FittedModel | None:
    """Return the model without the least significant effect; None if all are significant."""
    model, level = current.model, current.model.settings.level
    chances = [current.p_value_of_effect(symbol) for symbol in current.effects]
    if max(chances, default=0.0) < level:
        return None
    worst = current.effects[int(np.argmax(chances))]
    # The fit without the effect must reach the likelihood along the present path; else it is a worse optimum.
    fitted = fits.of(model, (worst,), (), model.deviance + current.gain_of((worst,)))
    if fitted is None or current.p_value_of_effect(worst, fitted.deviance - model.deviance) < level:
        return None
    fits.by_chance.add(frozenset(current.effects))
    return fitted


def chance_in_set(
    effects: Sequence[str], rivals: Mapping[str, Mapping[str, float]], fits: Fits
) -> FittedModel | None:
    """Return the model without an effect whose credible set contains "no effect"; None if there is none."""
    excess, symbol = min(((of.get("", np.inf), at) for at, of in rivals.items()), default=(np.inf, ""))
    in_set = excess < fits.start.settings.outside_of_set
    fitted = fits.kept.get(frozenset(effects) - {symbol}) if in_set else None
    if fitted is not None:
        fits.by_chance.add(frozenset(effects))
    return fitted
