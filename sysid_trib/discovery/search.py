"""Search: screen all candidates as columns, fit a few models exactly, and decide by the evidence."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_trib.discovery import exchange, free_motion
from sysid_trib.discovery.engine import model_fit, start_model
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.fits import Fits, evidence
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.single_columns import projected
from sysid_trib.discovery.unseen import Prediction
from sysid_trib.errors import Tell, silent
from sysid_trib.forces.library import load_library

Rivals = dict[str, dict[str, float]]
# A smaller difference of evidence (-2 ln) is not worth mentioning (Kass, Raftery 1995): the simplest model is
# named.
BARE_MENTION = 2.0


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Attributes
    ----------
    screenings : list of Screening
        Screening of the candidates with each of the models.
    models : list of FittedModel
        The final model, with its own frequency as the reference. After `with_steps` also the models before
        it: the start model, and the models with one, two, ... of the effects.
    effects : tuple of str
        Added effects, ordered by the deviance that they explain.
    p_values : list of float
        Corrected p-value of each effect given the others; these p-values decide that it stays in the model.
    rivals : dict of str to dict of str to float
        For each effect: minus twice the logarithm of the evidence with each candidate in its place, relative
        to the effect; "" is no force in its place.
    pairs : dict of str to dict of (str, str) to float
        Pairs of candidates that compete with each effect, in the same form.
    outstanding : list of str
        Candidates with a significant gain that are not in the model: `max_effects` is reached, they do not
        improve the held-out prediction, their fits failed, or the search ended before.
    next_best : FittedModel or None
        The most likely model with one of the candidates in `outstanding`, if any of them can be fitted.
    collinear : list of str
        Effects that are not separately identifiable.
    converged : bool
        Whether no move remained that raises the evidence.
    out_of_time : bool
        Whether the search ended at its deadline.
    followed : bool
        Whether the free motion of the last model follows the path.
    fits : Fits
        All fits of the search.
    predictions : sequence of Prediction
        Predictions of the held-out part, by the models of the search.
    noise_p_value : float
        P-value that the residual is noise (see `noise_p_value`); nan if the time ran out.
    """

    screenings: list[Screening]
    models: list[FittedModel]
    effects: tuple[str, ...]
    p_values: list[float]
    rivals: Rivals
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
        return sorted({*self.fits.failed}.difference(self.effects, *self.rivals.values()))


def search(
    fits: Fits,
    *,
    begin: FittedModel | None = None,
    most: int | None = None,
    growing: bool = False,
    tell: Tell = silent,
) -> Search:
    """Add, exchange and drop effects until no move raises the evidence of the model.

    An effect is added if its gain is significant, corrected for the number of tests, and if "no force" is
    outside of its credible set. It is dropped when this no longer holds.

    Parameters
    ----------
    fits : Fits
        The start model, the candidates, and the models fitted so far.
    begin : FittedModel, optional
        The first model, with the noise of the start model; by default the start model itself.
    most : int, optional
        Largest number of effects; by default that of the settings.
    growing : bool
        Whether effects are added only while they improve the held-out prediction.
    tell : Tell
    """
    model = start = fits.start
    most = start.settings.max_effects if most is None else most
    fits.kept[frozenset()] = start
    if begin is not None and (fitted := fits.of(begin, (), ())) is not None:
        model = fitted
    rivals: Rivals = {}
    converged = False
    for _ in range(start.settings.most_fits):
        tell(f"candidates in addition to {', '.join(model.effects) or 'the start model'}")
        current = fits.screened(model)
        step = exchange.likelier_exchange(current, fits)
        if step is None and len(current.effects) < most and may_gain(current):
            if not growing or fits.goes_on(model):
                step = min(exchange.extended(current, fits), key=evidence, default=None)
            elif fits.best is not None:
                step = fits.best
                most = len(step.effects)
        if step is None:
            step = exchange.not_beyond_chance(current, fits)
        if step is None:
            tell("competitors of each effect")
            rivals = {symbol: exchange.rivals_of(current, fits, symbol) for symbol in current.effects}
            step = exchange.better_rival(current, fits, rivals)
            step = step or exchange.chance_in_set(current.effects, rivals, fits)
        if step is None:
            step = exchange.likelier_pair(current, fits, most)
        converged = step is None and not fits.ended
        if step is None:
            break
        model = step
    if not converged:
        current = fits.screened(model)
        rivals = {symbol: exchange.rivals_of(current, fits, symbol) for symbol in current.effects}
    return _ended(model, rivals, fits, converged)


def _ended(model: FittedModel, rivals: Rivals, fits: Fits, converged: bool) -> Search:
    """Return the finished search, with this model or a simpler one that is equally likely."""
    model, referred, rivals, followed = plainest(model, rivals, fits)
    last = fits.screened(model)
    effects = _by_weight(last)
    further = exchange.extended(last, fits)
    return Search(
        [last],
        [referred if referred.follows else model],
        effects,
        [_decisive_p_value(last, symbol, fits) for symbol in effects],
        rivals,
        {symbol: exchange.pairs_of(last, fits, symbol) for symbol in effects},
        _outstanding(last, further, fits),
        min(further, key=evidence, default=None),
        _collinear(last),
        converged,
        fits.out_of_time,
        followed,
        fits,
    )


def with_steps(search: Search, tell: Tell = silent) -> Search:
    """Return the search with models of zero, one, two, ... of its effects, and the candidates with each."""
    models = nested_models(search.models[-1], search.effects)
    tell("candidates with each model")
    before = [search.fits.screened(model) for model in models[:-1]]
    return replace(search, screenings=[*before, search.screenings[-1]], models=models)


def _by_weight(last: Screening) -> tuple[str, ...]:
    """Order the effects so that each lowers the deviance most, given those before it."""
    ordered, rest = list[str](), list(last.effects)
    while rest:
        ordered.append(min(rest, key=lambda symbol: last.gain_of([s for s in rest if s != symbol])))
        rest.remove(ordered[-1])
    return tuple(ordered)


def _outstanding(last: Screening, further: Sequence[FittedModel], fits: Fits) -> list[str]:
    """Return the candidates missing from the final model, with those whose fit failed."""
    settings = last.model.settings
    gaining = [last.trials[at].force.symbol for at in last.best() if last.p_values[at] < settings.level]
    not_fitted = [name for name in gaining[: settings.fitted] if name in fits.failed or fits.ended]
    return [*(model.effects[-1] for model in further), *not_fitted]


def may_gain(current: Screening) -> bool:
    """Return true if the column of any candidate has a significant gain."""
    return any(current.p_values[at] < current.model.settings.level for at in current.best())


def _decisive_p_value(current: Screening, symbol: str, fits: Fits) -> float:
    """Return the p-value of an effect given the others, which decides whether it stays in the model.

    It is computed along the model's path. If it is not significant there, the fit without the effect decides,
    if any.
    """
    p_value, fitted = current.p_value_of_effect(symbol), fits.kept.get(frozenset(current.effects) - {symbol})
    if p_value < current.model.settings.level or fitted is None:
        return p_value
    return current.p_value_of_effect(symbol, fitted.deviance - current.model.deviance)


def _collinear(last: Screening) -> list[str]:
    """Return effects of a model that are collinear with others and not well enough determined to be named.

    Several flexible forces fit almost anything; a good fit is then no evidence for any of them.
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


def plainest(model: FittedModel, rivals: Rivals, fits: Fits) -> tuple[FittedModel, FittedModel, Rivals, bool]:
    """Return the simplest of equally likely models; the most likely one if the motion does not follow it.

    The models are those in a credible set with the given one. Forces of the user are simpler than the usual
    candidates; otherwise fewer shapes are simpler.

    Returns
    -------
    The model as the search has it; the model with its frequency as the reference; the rivals of its effects;
    and whether its motion follows the path.
    """
    referred, settings, effects = start_model.refitted(model), model.settings, model.effects
    followed = not effects or _is_followed(referred)
    others = list[tuple[tuple[bool, int], float, str, str, FittedModel]]()
    for symbol, costs in rivals.items():
        for name, excess in costs.items():
            fitted = fits.kept.get(frozenset(effects) - {symbol} | {name})
            if name in ("", symbol) or excess >= settings.outside_of_set or fitted is None:
                continue
            plain = _plainness(fitted, name) if followed else (False, 0)
            if not followed or (excess < BARE_MENTION and plain < _plainness(model, symbol)):
                others.append((plain, excess, symbol, name, fitted))
    for _, excess, symbol, name, fitted in sorted(others, key=lambda other: other[:2]):
        other = start_model.refitted(fitted)
        if _is_followed(other):
            costs = {tied: its_excess - excess for tied, its_excess in rivals[symbol].items()}
            kept = {s: of_effect for s, of_effect in rivals.items() if s != symbol} | {name: costs}
            return plainest(fitted, kept, fits) if followed else (fitted, other, kept, True)
    return model, referred, rivals, followed


def _plainness(model: FittedModel, symbol: str) -> tuple[bool, int]:
    """Return the complexity of an effect: whether it is a usual candidate, and its number of shapes."""
    force = model.trials[model.columns_of(symbol)[0]].force
    usual = {(other.symbol, other.formula.text) for other in load_library("candidate_effects")}
    return (force.symbol, force.formula.text) in usual, len(force.shape)


def _is_followed(model: FittedModel) -> bool:
    """Return true if the fit has converged, and its motion without a random force follows its path.

    The rows describe small deviations of a motion; they do not show that it stops before the record does.
    """
    if not model.settled or np.any(model.likelihood.ratios > 0.0):
        return model.settled
    return all(motion.over_noise < model.settings.free_residual for motion in free_motion.free_motions(model))


def nested_models(final: FittedModel, effects: Sequence[str]) -> list[FittedModel]:
    """Return the models with none, one, ... all of the effects, in this order."""
    models = [final]
    for symbol in reversed(effects):
        last = models[0]
        kept = [at for at, trial in enumerate(last.trials) if trial.force.symbol != symbol]
        first = np.append(last.coefficients[kept], last.stiffness)
        paths = [rows.path for rows in last.rows]
        trials = [last.trials[at] for at in kept]
        fewer = start_model.refitted(model_fit.fit_model(paths, trials, first))
        # A model without this effect may not oscillate: then use the path of the larger model.
        models.insert(0, fewer if fewer.follows else model_fit.fitted_along(paths, trials, first))
    return models
