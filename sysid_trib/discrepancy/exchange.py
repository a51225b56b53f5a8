"""Moves of a search that take effects out of a model, or put others in their place; and their rivals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from time import monotonic
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.columns_beside import correlation_of, each_beside, projected
from sysid_trib.discrepancy.evidence import evidence, least_penalty
from sysid_trib.discrepancy.likelihood import Likelihood, likelihood
from sysid_trib.discrepancy.model_fit import NOT_FITTED, FittedModel, fit_model
from sysid_trib.discrepancy.screening import Screening, is_physical, strengths
from sysid_trib.discrepancy.trials import TrialEffect


@dataclass
class Fits:
    """Exact fits of a search, each done once: by the symbols of the effects; and what could not be fitted.

    After the deadline, by `time.monotonic`, none is done. What does not reach the deviance that was asked
    for is not kept, but `unlikely`, with that deviance, from where it started: from other shapes it may.
    """

    start: FittedModel
    deadline: float = np.inf
    kept: dict[frozenset[str], FittedModel] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    unlikely: dict[tuple[tuple[str, tuple[float, ...]], ...], float] = field(default_factory=dict)

    @property
    def out_of_time(self) -> bool:
        """Whether the deadline has passed."""
        return monotonic() > self.deadline

    def of(
        self, near: FittedModel, drop: Sequence[str], add: Sequence[TrialEffect], worst: float = np.inf
    ) -> FittedModel | None:
        """A model near another one, with forces dropped and added; None if it does not reach `worst`."""
        trials = [t for t in near.trials if t.force.symbol not in drop] + list(add)
        base = {t.force.symbol for t in self.start.trials}
        key = frozenset(t.force.symbol for t in trials) - base
        if key in self.kept:
            return self.kept[key]
        place = tuple(sorted((t.force.symbol, tuple(t.shapes.values())) for t in trials))
        if self.out_of_time or self.unlikely.get(place, -np.inf) >= worst:
            return None

        def possible(fitted: FittedModel) -> bool:
            return _is_physical(fitted, len(base))

        model = self._fitted(near, trials, worst, possible)
        # A fit that leaves what is physical has not failed: the effect does not explain the record.
        physical = model is None or possible(model)
        if model is not None and model.settled and physical:
            self.kept[key] = model.light()
            return self.kept[key]
        given_up = model is not None and not model.settled and model.deviance > worst
        self.unlikely[place] = worst if given_up else np.inf
        if physical and not given_up:
            self.failed += [trial.force.symbol for trial in add]
        return None

    def _fitted(
        self,
        near: FittedModel,
        trials: Sequence[TrialEffect],
        worst: float,
        possible: Callable[[FittedModel], bool],
    ) -> FittedModel | None:
        known = dict(zip([t.force.symbol for t in near.trials], near.coefficients.tolist(), strict=True))
        first = np.array([*(known.get(t.force.symbol, 0.0) for t in trials), near.stiffness])
        paths = [rows.path for rows in near.rows]
        try:
            model = fit_model(
                paths,
                trials,
                frequency_free=near.frequency_free,
                first=first,
                worst=worst,
                possible=possible,
            )
        except NOT_FITTED:
            return None
        return model if np.isfinite(model.likelihood.deviance) else None


def _is_physical(model: FittedModel, base: int) -> bool:
    """Whether the forces beside the first ones, those of the start model, may have their coefficients."""
    relative_force = strengths(model, [table[:, : len(model.trials)] for table in model.tables])
    effects = zip(model.trials, model.coefficients.tolist(), relative_force.tolist(), strict=True)
    strongest = model.settings.strongest
    return all(is_physical(trial.force, c, size, strongest) for trial, c, size in list(effects)[base:])


class Move(NamedTuple):
    """A step of a search: a model, its effects beside the start model's, and its evidence."""

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
        Its effects beside the start model's.
    fits : Fits

    Returns
    -------
    Move or None
        None if no such model is more likely than the present one.
    """
    proposed = list[tuple[float, list[int], tuple[str, ...]]]()
    for gone in (*((symbol,) for symbol in effects), *combinations(effects, 2)):
        pairs = _pairs_in_place(current, gone) if len(gone) == 2 else []
        proposed += [(*place, gone) for place in _in_place(current, gone) + pairs]
    return _likeliest(current, effects, fits, proposed, current.model.settings.least_gain)


def two_for_one(current: Screening, effects: tuple[str, ...], fits: Fits) -> Move | None:
    """The most likely model with two candidates in one effect's place, of which it is outside of the set.

    An effect may be named for two of which each alone explains less: a one-sided spring for a curve of the
    sensor beside an equilibrium that drifts. Of the pairs, too, chance would not have gained as much in any.
    """
    proposed = [(*pair, (symbol,)) for symbol in effects for pair in _pairs_in_place(current, (symbol,))]
    step = _likeliest(current, effects, fits, proposed, current.model.settings.outside_of_set)
    if step is None:
        return None
    pair = [at for at, trial in enumerate(current.trials) if trial.force.symbol in step.effects[-2:]]
    rows, gain = float(np.min(current.effective_rows[pair])), current.model.deviance - step.model.deviance
    p_value = current.tests * current.p_value_of(gain, step.model.trials[-1].force, rows)
    return step if p_value < current.model.settings.level else None


def _likeliest(
    current: Screening,
    effects: tuple[str, ...],
    fits: Fits,
    proposed: Sequence[tuple[float, list[int], tuple[str, ...]]],
    by: float,
) -> Move | None:
    """The most likely fit of proposed moves (score, trials, effects that go), if `by` that much."""
    model, settings = current.model, current.model.settings
    here = evidence(model, effects) if effects else 0.0
    aim = here - by
    best: Move | None = None
    for score, at, gone in sorted(proposed, key=lambda scored: scored[0])[: settings.fitted]:
        if score > aim - here + settings.far:
            break
        trials = [current.trials[i] for i in at]
        after = tuple(s for s in effects if s not in gone) + tuple(t.force.symbol for t in trials)
        fitted = fits.of(model, gone, trials, worst=deviance_of(aim, model, after, trials))
        if fitted is not None and (exact := evidence(fitted, after)) < aim:
            best, aim = Move(exact, after, fitted), exact
    return best


def not_beyond_chance(
    current: Screening, effects: tuple[str, ...], fits: Fits
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model without the effect that chance would do as well as most likely; None if there is none."""
    model = current.model
    chances = _p_values(current, effects)
    if max(chances, default=0.0) < model.settings.level:
        return None
    worst = effects[int(np.argmax(chances))]
    fitted = fits.of(model, (worst,), ())
    if fitted is None or _p_value(current, worst, fitted.deviance - model.deviance) < model.settings.level:
        return None
    return fitted, tuple(symbol for symbol in effects if symbol != worst)


def chance_in_set(
    effects: tuple[str, ...], rivals: dict[str, dict[str, float]], fits: Fits
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model without the effect whose credible set chance is in; None if there is none."""
    beside = {symbol: costs.get("", np.inf) for symbol, costs in rivals.items()}
    symbol = min(beside, key=beside.__getitem__, default="")
    if not symbol or beside[symbol] >= fits.start.settings.outside_of_set:
        return None
    after = tuple(other for other in effects if other != symbol)
    fitted = fits.kept.get(frozenset(after))
    return None if fitted is None else (fitted, after)


def decisive_p_values(current: Screening, effects: Sequence[str], fits: Fits) -> list[float]:
    """P-value of each effect beside the others, by the deviance without it: those that keep it in the model.

    Along the model's path; where chance would do as well along that, by the fit without the effect, if any.
    """
    chances = _p_values(current, effects)
    for at, symbol in enumerate(effects):
        fitted = fits.kept.get(frozenset(effects) - {symbol})
        if chances[at] >= current.model.settings.level and fitted is not None:
            chances[at] = _p_value(current, symbol, fitted.deviance - current.model.deviance)
    return chances


def _p_values(current: Screening, effects: Sequence[str]) -> list[float]:
    """Probability that chance explains as much as each effect beside the others, along the model's path."""
    model = current.model
    kept = [model.columns_without((symbol,)) for symbol in effects]
    # In the same rows.
    here = model.likelihood.deviance
    gains = [likelihood(current.products, columns).deviance - here for columns in kept]
    return [_p_value(current, symbol, gain) for symbol, gain in zip(effects, gains, strict=True)]


def _p_value(current: Screening, symbol: str, gain: float) -> float:
    """Probability that chance lowers the deviance as much as an effect of the model does."""
    model = current.model
    column, kept = model.columns_of(symbol)[0], model.columns_without((symbol,))
    beside = each_beside(current.products, kept, [1 + column], likelihood(current.products, kept))
    return current.p_value_of(gain, model.trials[column].force, float(beside.effective_rows[0]))


def better_rival(
    current: Screening,
    effects: tuple[str, ...],
    rivals: dict[str, dict[str, float]],
    fits: Fits,
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model with a rival in an effect's place that is more likely; None if there is none."""
    every = [(excess, symbol, name) for symbol, costs in rivals.items() for name, excess in costs.items()]
    excess, symbol, name = min(every, default=(0.0, "", ""))
    if excess > -current.model.settings.least_gain:
        return None
    after = tuple(s for s in effects if s != symbol) + ((name,) if name else ())
    return fits.kept[frozenset(after)], after


def rivals_of(current: Screening, effects: tuple[str, ...], symbol: str, fits: Fits) -> dict[str, float]:
    """Evidence with each candidate in an effect's place, over its own; of nothing in its place under "".

    Fitted are as many as the settings say, and all that would be in the set along the present path.
    """
    model, settings = current.model, current.model.settings
    here = evidence(model, effects)
    likelier = {symbol: 0.0}
    for place, (score, at) in enumerate(_in_place(current, (symbol,))):
        if place >= settings.fitted and score > settings.outside_of_set:
            break
        trials = [current.trials[i] for i in at]
        names = [trial.force.symbol for trial in trials]
        after = (*(s for s in effects if s != symbol), *names)
        worst = deviance_of(here + settings.far, model, after, trials)
        fitted = fits.of(model, (symbol,), trials, worst)
        if fitted is None:
            # Outside of every credible set, or it failed, or there was no time.
            continue
        likelier["".join(names)] = evidence(fitted, after) - here
    return likelier


def deviance_of(
    score: float, model: FittedModel, effects: Sequence[str], added: Sequence[TrialEffect]
) -> float:
    """Deviance above which a model of these effects does not reach an evidence, whatever its shapes."""
    forces = [trial.force for trial in (*model.trials, *added) if trial.force.symbol in effects]
    return score - least_penalty(model, forces)


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


def _in_place(current: Screening, gone: Sequence[str]) -> list[tuple[float, list[int]]]:
    """Scores along the present path of nothing, and of each candidate, in the place of effects.

    Relative to the present model; the best trial of each candidate, the best first, without what is far or
    what chance would do as well.
    """
    model, kept = current.model, current.model.columns_without(gone)
    bare = likelihood(current.products, kept)
    here = model.likelihood.deviance
    without = bare.deviance - here
    scores = [(without - len(gone) * _of_effect(model), list[int]())]
    trials = _testable_in_place(current, gone, kept, bare)
    beside = each_beside(current.products, kept, [current.first_trial + at for at in trials], bare)
    gains, coefficients, rows = bare.deviance - beside.deviance, beside.coefficients, beside.effective_rows
    for at, gain, coefficient, of_error in zip(trials, gains, coefficients, rows, strict=True):
        p_value = current.p_value_of(float(gain), current.trials[at].force, float(of_error))
        if p_value < model.settings.level and current.allows(at, coefficient):
            scores.append((without - float(gain) + (1 - len(gone)) * _of_effect(model), [at]))
    best: dict[str, tuple[float, list[int]]] = {}
    for scored in sorted(scores, key=lambda scored: scored[0]):
        best.setdefault(current.trials[scored[1][0]].force.symbol if scored[1] else "", scored)
    in_model = [model.trials[model.columns_of(symbol)[0]].force for symbol in gone]

    def is_near(score: float, at: Sequence[int]) -> bool:
        slack = current.slack(at[0], in_model) if at else model.settings.slack
        return score < slack * max(0.0, without) + model.settings.far

    return [scored for scored in best.values() if is_near(*scored)]


def _pairs_in_place(current: Screening, gone: Sequence[str]) -> list[tuple[float, list[int]]]:
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
    scores = []
    for pair in likeliest.values():
        likelier = likelihood(current.products, [*kept, *(current.first_trial + at for at in pair)])
        coefficients = likelier.coefficients[-2:]
        able = all(current.allows(at, c) for at, c in zip(pair, coefficients, strict=True))
        score = likelier.deviance - model.likelihood.deviance + (2 - len(gone)) * _of_effect(model)
        if able and score < model.settings.far:
            scores.append((score, pair))
    return scores


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
