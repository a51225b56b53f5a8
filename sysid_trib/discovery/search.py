"""The search: candidates are screened as columns, a few models are fitted exactly, one evidence decides."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_trib.discovery.exchange import (
    better_rival,
    extended,
    likelier_exchange,
    likelier_pair,
    pairs_of,
    rivals_of,
)
from sysid_trib.discovery.final_models import Growth, nested_models, plainest
from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.single_columns import projected
from sysid_trib.discovery.unseen import Prediction
from sysid_trib.errors import Tell, silent
from sysid_trib.likelihood.fitted_model import FittedModel


@dataclass(frozen=True)
class Search:
    """A whole search.

    Attributes
    ----------
    screenings : list of Screening
        With each of the models.
    models : list of FittedModel
        The final one, referring to its frequency; of `with_steps` the start model before it, and those with
        one, two, ... of the effects.
    effects : tuple of str
        Added, in the order of what each explains.
    p_values : list of float
        Of each of them, of a larger gain by chance with the others, corrected: these keep it in the model.
    rivals : dict of str to dict of str to float
        Of each effect: minus twice the logarithm of the evidence with each candidate in its place, over its
        own; of nothing in its place under "".
    pairs : dict of str to dict of (str, str) to float
        Of each effect the pairs of candidates that may be the truth in its place, likewise.
    outstanding : list of str
        Candidates that would gain more than chance, and are not in the model: no more effects were asked for,
        they do not improve what was held out, their fits failed, or the search ended before.
    next_best : FittedModel or None
        The likeliest model with one of them, where `outstanding` has any that can be fitted.
    collinear : list of str
        Effects that are not separately identifiable.
    converged : bool
        Whether no move was left that raises the evidence.
    out_of_time : bool
        Whether the search ended at its deadline.
    followed : bool
        Whether the last model moves as its path does.
    fits : Fits
        All that were made.
    predictions : sequence of Prediction
        Of what was held out, by its models.
    noise_p_value : float
        Of what the final model leaves (see `Growth`); nan where the time ran out.
    """

    screenings: list[Screening]
    models: list[FittedModel]
    effects: tuple[str, ...]
    p_values: list[float]
    rivals: dict[str, dict[str, float]]
    pairs: dict[str, dict[tuple[str, str], float]]
    outstanding: list[str]
    next_best: FittedModel | None
    collinear: list[str]
    converged: bool
    out_of_time: bool
    followed: bool
    fits: Fits
    predictions: Sequence[Prediction] = ()
    noise_p_value: float = 1.0

    @property
    def failed(self) -> list[str]:
        """Candidates whose fits failed."""
        compared = {name for of_effect in self.rivals.values() for name in of_effect}
        return sorted({*self.fits.failed} - {*self.effects} - compared)


def search(
    fits: Fits,
    *,
    begin: FittedModel | None = None,
    most: int | None = None,
    growth: Growth | None = None,
    tell: Tell = silent,
) -> Search:
    """Add, exchange and drop effects until no move raises the evidence of the model.

    An effect is added where what it gains is beyond chance, corrected for the number of tests,
    and nothing in its place is outside of its credible set; where that no longer holds it is dropped.

    Parameters
    ----------
    fits : Fits
        The start model, the candidates, and what of them was fitted already.
    begin : FittedModel, optional
        The first model, in the noise of the start model; by default that.
    most : int, optional
        Effects at most, by default as the settings say.
    growth : Growth, optional
        Lets there be no more effects than improve what was held out.
    tell : Tell
    """
    model = start = fits.start
    most = start.settings.max_effects if most is None else most
    fits.kept[frozenset()] = start
    if begin is not None and (fitted := fits.of(begin, (), ())) is not None:
        model = fitted
    rivals: dict[str, dict[str, float]] = {}
    converged = False
    for _ in range(start.settings.most_fits):
        tell(f"candidates beside {', '.join(fits.effects_of(model)) or 'the start model'}")
        current = fits.screened(model)
        step = likelier_exchange(current, fits)
        if step is None and len(current.effects) < most and may_gain(current):
            if growth is None or growth.goes_on(model):
                step = min(extended(current, fits), key=fits.evidence, default=None)
            elif growth.best is not None:
                step = growth.best[0]
                most = len(fits.effects_of(step))
        if step is None:
            step = _not_beyond_chance(current, fits)
        if step is None:
            tell("rivals of each effect")
            rivals = {symbol: rivals_of(current, fits, symbol) for symbol in current.effects}
            step = better_rival(current, fits, rivals) or _chance_in_set(current.effects, rivals, fits)
        if step is None:
            step = likelier_pair(current, fits, most)
        converged = step is None and not fits.ended
        if step is None:
            break
        model = step
    if not converged:
        current = fits.screened(model)
        rivals = {symbol: rivals_of(current, fits, symbol) for symbol in current.effects}
    return _ended(model, rivals, fits, converged)


def _ended(model: FittedModel, rivals: dict[str, dict[str, float]], fits: Fits, converged: bool) -> Search:
    """A search that ends with a model, or one that is as likely."""
    model, referred, rivals, followed = plainest(model, rivals, fits)
    last = fits.screened(model)
    effects = _by_weight(last)
    further = extended(last, fits)
    return Search(
        [last],
        [referred if referred.follows else model],
        effects,
        [_decisive_p_value(last, symbol, fits) for symbol in effects],
        rivals,
        {symbol: pairs_of(last, fits, symbol) for symbol in effects},
        _outstanding(last, further, fits),
        min(further, key=fits.evidence, default=None),
        _collinear(last),
        converged,
        fits.out_of_time,
        followed,
        fits,
    )


def with_steps(search: Search, tell: Tell = silent) -> Search:
    """A search with the models of none, one, two, ... of its effects, and the candidates with each."""
    models = nested_models(search.models[-1], search.effects)
    tell("candidates beside each model")
    before = [search.fits.screened(model) for model in models[:-1]]
    return replace(search, screenings=[*before, search.screenings[-1]], models=models)


def _by_weight(last: Screening) -> tuple[str, ...]:
    """The effects in the order in which each lowers the deviance most with those before it."""
    ordered, rest = list[str](), list(last.effects)
    while rest:
        gains = {symbol: last.gain_of([other for other in rest if other != symbol]) for symbol in rest}
        ordered.append(min(rest, key=gains.__getitem__))
        rest.remove(ordered[-1])
    return tuple(ordered)


def _outstanding(last: Screening, further: Sequence[FittedModel], fits: Fits) -> list[str]:
    """Candidates that are missing from the final model, or whose fits with it failed or were not made."""
    settings = last.model.settings
    gaining = [last.trials[at].force.symbol for at in last.best() if last.p_values[at] < settings.level]
    not_fitted = [name for name in gaining[: settings.fitted] if name in fits.failed or fits.ended]
    return [*(fits.effects_of(model)[-1] for model in further), *not_fitted]


def may_gain(current: Screening) -> bool:
    """True if the column of any candidate gains more than chance."""
    return any(current.p_values[at] < current.model.settings.level for at in current.best())


def _not_beyond_chance(current: Screening, fits: Fits) -> FittedModel | None:
    """The model without the effect that chance would do as well as most likely; None if there is none."""
    model, level = current.model, current.model.settings.level
    chances = [current.p_value_of_effect(symbol) for symbol in current.effects]
    if max(chances, default=0.0) < level:
        return None
    worst = current.effects[int(np.argmax(chances))]
    # Along the present path it is as likely: a fit that is less so came to a worse optimum.
    fitted = fits.of(model, (worst,), (), model.deviance + current.gain_of((worst,)))
    if fitted is None or current.p_value_of_effect(worst, fitted.deviance - model.deviance) < level:
        return None
    fits.by_chance.add(frozenset(current.effects))
    return fitted


def _chance_in_set(
    effects: Sequence[str], rivals: Mapping[str, Mapping[str, float]], fits: Fits
) -> FittedModel | None:
    """The model without the effect whose credible set chance is in; None if there is none."""
    single = {symbol: costs.get("", np.inf) for symbol, costs in rivals.items()}
    symbol = min(single, key=single.__getitem__, default="")
    if not symbol or single[symbol] >= fits.start.settings.outside_of_set:
        return None
    fitted = fits.kept.get(frozenset(effects) - {symbol})
    if fitted is not None:
        fits.by_chance.add(frozenset(effects))
    return fitted


def _decisive_p_value(current: Screening, symbol: str, fits: Fits) -> float:
    """P-value of an effect with the others, by the deviance without it: that which keeps it in the model.

    Along the model's path; where chance would do as well along that, by the fit without the effect, if any.
    """
    p_value, fitted = current.p_value_of_effect(symbol), fits.kept.get(frozenset(current.effects) - {symbol})
    if p_value < current.model.settings.level or fitted is None:
        return p_value
    return current.p_value_of_effect(symbol, fitted.deviance - current.model.deviance)


def _collinear(last: Screening) -> list[str]:
    """Effects of a model that are collinear with others and not well enough determined to be named.

    Several flexible forces fit nearly anything: that they do is no evidence for any of them.
    """
    model, settings, collinear = last.model, last.model.settings, list[str]()
    errors = np.sqrt(np.diag(model.likelihood.covariance))
    for symbol in last.effects if len(last.effects) > 1 else ():
        at = model.columns_of(symbol)[0]
        without_others, with_others = (
            projected(last.products, model.likelihood, model.columns_without(gone), [1 + at])[0].item()
            for gone in (last.effects, (symbol,))
        )
        z = abs(model.coefficients[at]) / max(errors[at], 1e-300)
        if with_others < settings.independent * without_others and z < settings.determined:
            collinear.append(symbol)
    return collinear
