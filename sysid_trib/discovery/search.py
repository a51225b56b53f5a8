"""The search: candidates are screened as columns, a few models are fitted exactly, one evidence decides."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sysid_trib.discovery.exchange import (
    Move,
    better_rival,
    chance_in_set,
    decisive_p_values,
    exchange_effects,
    move_of,
    not_beyond_chance,
    rivals_of,
)
from sysid_trib.discovery.final_models import (
    Final,
    Growth,
    final_of_set,
    likelier_pair,
    nested_models,
    pairs_of,
)
from sysid_trib.discovery.fits import Fits, evidence
from sysid_trib.discovery.missing_force import collinear_effects
from sysid_trib.discovery.screen import Screening, screen
from sysid_trib.errors import Tell, silent
from sysid_trib.forces.force import Force
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.likelihood import likelihood


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
    failed : tuple of str
        Candidates whose fits failed.
    outstanding : tuple of str
        Candidates that would gain more than chance, and are not in the model: no more effects were asked for,
        they do not improve what was held out, their fits failed, or the search ended before.
    next_best : Move or None
        The likeliest model with one of them, where `outstanding` has any that can be fitted.
    collinear : list of str
        Effects that are not separately identifiable.
    converged : bool
        Whether no move was left that raises the evidence.
    out_of_time : bool
        Whether the search ended at its deadline.
    followed : bool
        Whether the last model moves as its path does.
    known : dict of frozenset of str to Screening
        All that were made, by the effects of the model.
    fits : Fits
        All that were made.
    """

    screenings: list[Screening]
    models: list[FittedModel]
    effects: tuple[str, ...]
    p_values: list[float]
    rivals: dict[str, dict[str, float]]
    pairs: dict[str, dict[tuple[str, str], float]]
    failed: tuple[str, ...]
    outstanding: tuple[str, ...]
    next_best: Move | None
    collinear: list[str]
    converged: bool
    out_of_time: bool
    followed: bool
    known: dict[frozenset[str], Screening]
    fits: Fits


class Begin(NamedTuple):
    """Where a search begins.

    `model` : the first one. `most` : effects at most, by default as the settings say. `near` : a search from
    the same start, of which what was fitted is not fitted again.
    """

    model: FittedModel
    most: int | None = None
    near: Search | None = None


def search(
    start: FittedModel,
    candidates: Sequence[Force],
    *,
    begin: Begin | None = None,
    growth: Growth | None = None,
    deadline: float = np.inf,
    tell: Tell = silent,
) -> Search:
    """Add, exchange and drop effects until no move raises the evidence of the model.

    An effect is added where what it gains is beyond chance, corrected for the number of tests,
    and nothing in its place is outside of its credible set; where that no longer holds it is dropped. The
    first model is that of `begin`, which has the noise of `start`, if any; there are no more effects than
    `growth` lets there be. After `deadline`, by `time.monotonic`, no further model is fitted.
    """
    near = None if begin is None else begin.near
    fits = Fits(start, deadline) if near is None else near.fits
    most = start.settings.max_effects if begin is None or begin.most is None else begin.most
    model, effects = start, tuple[str, ...]()
    fits.kept[frozenset()] = start
    known = {trial.force.symbol for trial in start.trials}
    if begin is not None and (fitted := fits.of(begin.model, (), ())) is not None:
        model, effects = fitted, tuple(t.force.symbol for t in fitted.trials if t.force.symbol not in known)
    known_screenings = {} if near is None else dict(near.known)

    def screened(model: FittedModel, named: Sequence[str]) -> Screening:
        return _screened(known_screenings, candidates, model, named)

    rivals: dict[str, dict[str, float]] = {}
    converged = False
    for _ in range(start.settings.most_fits):
        tell(f"candidates beside {', '.join(effects) or 'the start model'}")
        current = screened(model, effects)
        exchange = exchange_effects(current, effects, fits)
        step = None if exchange is None else (exchange.model, exchange.effects)
        if step is None and len(effects) < most and may_gain(current):
            if growth is None or growth.goes_on(model):
                step = _likeliest(_beyond_chance(current, effects, fits))
            elif growth.best is not None:
                best = growth.best[0]
                step = best, tuple(t.force.symbol for t in best.trials if t.force.symbol not in known)
                most = len(step[1])
        if step is None:
            step = not_beyond_chance(current, effects, fits)
        if step is None:
            tell("rivals of each effect")
            rivals = {symbol: rivals_of(current, effects, symbol, fits) for symbol in effects}
            step = better_rival(current, effects, rivals, fits) or chance_in_set(effects, rivals, fits)
        if step is None:
            step = likelier_pair(current, effects, fits, most)
        converged = step is None and not fits.ended
        if step is None:
            break
        model, effects = step
    if not converged:
        rivals = {symbol: rivals_of(screened(model, effects), effects, symbol, fits) for symbol in effects}
    return _ended(final_of_set(model, effects, rivals, fits), screened, fits, converged, known_screenings)


def _ended(
    final: Final,
    screened: Callable[[FittedModel, Sequence[str]], Screening],
    fits: Fits,
    converged: bool,
    known: dict[frozenset[str], Screening],
) -> Search:
    """A search that ends with a model."""
    last = screened(final.model, final.effects)
    effects = _by_weight(last, final.effects)
    further = _beyond_chance(last, effects, fits)
    compared = {name for of_effect in final.rivals.values() for name in of_effect}
    failed = sorted({*fits.failed} - {*effects} - compared)
    return Search(
        [last],
        [final.referred if final.referred.follows else final.model],
        effects,
        decisive_p_values(last, effects, fits),
        final.rivals,
        {symbol: pairs_of(last, effects, symbol, fits) for symbol in effects},
        tuple(failed),
        _outstanding(last, further, fits),
        min(further, key=lambda move: move.evidence, default=None),
        collinear_effects(last.model, last.products, effects),
        converged,
        fits.out_of_time,
        final.followed,
        known,
        fits,
    )


def with_steps(search: Search, candidates: Sequence[Force], tell: Tell = silent) -> Search:
    """A search with the models of none, one, two, ... of its effects, and the candidates with each."""
    effects, last = search.effects, search.screenings[-1]
    models = nested_models(search.models[-1], effects)
    tell("candidates beside each model")
    before = [_screened(search.known, candidates, models[at], effects[:at]) for at in range(len(effects))]
    return replace(search, screenings=[*before, last], models=models, known={})


def _screened(
    known: dict[frozenset[str], Screening],
    candidates: Sequence[Force],
    model: FittedModel,
    named: Sequence[str],
) -> Screening:
    """The candidates that are not in a model of these effects, held against it, once."""
    if frozenset(named) not in known:
        rest = [force for force in candidates if force.symbol not in named]
        known[frozenset(named)] = screen(model, rest, named)
    return known[frozenset(named)]


def _by_weight(last: Screening, effects: Sequence[str]) -> tuple[str, ...]:
    """The effects in the order in which each lowers the deviance most with those before it."""
    model, ordered = last.model, list[str]()
    while len(ordered) < len(effects):
        rest = [symbol for symbol in effects if symbol not in ordered]

        def deviance_of(symbol: str, rest: Sequence[str] = tuple(rest)) -> float:
            gone = [other for other in rest if other != symbol]
            return likelihood(last.products, model.columns_without(gone)).deviance

        ordered.append(min(rest, key=deviance_of))
    return tuple(ordered)


def _outstanding(last: Screening, further: Sequence[Move], fits: Fits) -> tuple[str, ...]:
    """Candidates that are missing from the final model, or whose fits with it failed or were not made."""
    failed = [
        last.trials[at].force.symbol for at in last.best() if last.p_values[at] < last.model.settings.level
    ]
    missing = [move.effects[-1] for move in further]
    return (
        *missing,
        *(symbol for symbol in failed[: last.model.settings.fitted] if symbol in fits.failed or fits.ended),
    )


def _likeliest(moves: Sequence[Move]) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The most likely of some moves, if there are any."""
    best = min(moves, key=lambda move: move.evidence, default=None)
    return None if best is None else (best.model, best.effects)


def may_gain(current: Screening) -> bool:
    """True if the column of any candidate gains more than chance."""
    return any(current.p_values[at] < current.model.settings.level for at in current.best())


def _beyond_chance(current: Screening, effects: tuple[str, ...], fits: Fits) -> list[Move]:
    """Models with one candidate more, of those that may be the most likely.

    What it gains is beyond chance, and leaves that no place in its credible set. What columns gain is taken
    to be as far off as it was in the fits that were done: much where effects are strong.
    """
    model, settings = current.model, current.model.settings
    likeliest = [at for at in current.best() if current.p_values[at] < settings.level]
    here, gain_of_column, tried, off = evidence(model, effects), 0.0, list[Move](), 0.0
    # As many again as are fitted, since those that gain most may be what no sample can be; and those of
    # which a column says little.
    few = 2 * settings.fitted
    for at in (*likeliest[:few], *(at for at in likeliest[few:] if current.tolerance(at, ()) >= 1.0)):
        tolerance = max(off, current.tolerance(at, [move.model.trials[-1].force for move in tried]))
        if current.gains[at] <= (1.0 - tolerance) * gain_of_column:
            continue
        trial = current.trials[at]
        if frozenset((*effects, trial.force.symbol)) in fits.by_chance:
            continue
        aim = min([here - settings.outside_of_set, *(move.evidence for move in tried)])
        move = move_of(current, effects, (), [at], fits, aim)
        if move is None:
            continue
        gain = model.deviance - move.model.deviance
        p_value = current.p_value_of(gain, trial.force, float(current.effective_rows[at]))
        if p_value < settings.level and move.evidence < here - settings.outside_of_set:
            if not tried:
                gain_of_column = float(current.gains[at])
            off = max(off, abs(gain / float(current.gains[at]) - 1.0))
            tried.append(move)
    return tried
