"""Search by fits of driven motions: for forces whose formulas hold coefficients of other forces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_trib.discovery.motion_fits import Gain, MotionFits, MotionModel
from sysid_trib.errors import Tell

# Candidates that are fitted in addition to a model; half as many in place of an effect.
FITTED_CANDIDATES = 4
# Least relative reduction by an exchange of the squared residuals of the left-out parts.
EXCHANGE_GAIN = 0.02


@dataclass(frozen=True)
class MotionSearch:
    """Result of a search by motions.

    Attributes
    ----------
    fits : MotionFits
    models : list of MotionModel
        The start model, then those with one, two, ... of the effects, the last one the final model.
    gains : list of dict of str to Gain
        The candidates with each of the models.
    rivals : dict of str to dict of str to float
        For each effect and candidate: minus twice the log odds of the candidate in place of the effect. The
        key "" means no force.
    converged : bool
        Whether no move was left.
    """

    fits: MotionFits
    models: list[MotionModel]
    gains: list[dict[str, Gain]]
    rivals: dict[str, dict[str, float]]
    converged: bool

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the effects of the final model, the most significant one first."""
        return self.models[-1].effects

    @property
    def is_complete(self) -> bool:
        """Return true if the residual of the final model is noise."""
        return self.models[-1].is_complete


def search_by_motions(fits: MotionFits, tell: Tell) -> MotionSearch:
    """Add, exchange and drop effects of driven motions until none is significant and predicts better.

    Models are compared in the sensor's noise alone, without a random force: one would explain the residual of
    the start model. An effect is significant if its coefficient is significant, corrected for the number of
    candidates. Its error is that of the noise if the residual is noise, and otherwise the scatter between
    runs. An effect predicts better if it reduces the residual of runs that are left out.

    Raises
    ------
    DecayError
        No motion of the start model follows the records.
    """
    most = fits.settings.max_effects
    tell("fit of the start model")
    model, seen, converged = fits.first(), {frozenset[str]()}, False
    for _ in range(fits.settings.most_fits):
        tell(f"candidates in addition to {', '.join(model.effects) or 'the start model'}")
        moves = _without_chance(fits, model) or _exchanges(fits, model) or _additions(fits, model, most)
        moves = [move for move in moves if frozenset(move.effects) not in seen]
        if moves:
            model = min(moves, key=lambda move: move.left_out_rms)
            seen.add(frozenset(model.effects))
            continue
        better = fits.best_nearby(model)
        converged = better is model and not fits.budget.spent
        if better is model:
            break
        model = better
    tell("competitors of each effect")
    rivals = {symbol: _rivals(fits, model, symbol) for symbol in model.effects}
    models = _nested(fits, model)
    return MotionSearch(fits, models, [fits.gains(of) for of in models], rivals, converged)


def _without_chance(fits: MotionFits, model: MotionModel) -> list[MotionModel]:
    """Return models without an effect that is not significant."""
    by_chance = [symbol for symbol in model.effects if model.p_value(symbol) >= fits.settings.level]
    fewer = (fits.of(_without(model.effects, symbol), model) for symbol in by_chance)
    return [fits.from_larger(of, model) for of in fewer if of is not None]


def _exchanges(fits: MotionFits, model: MotionModel) -> list[MotionModel]:
    """Return models that predict better with another effect in place of one of theirs."""
    moves = [move for symbol in model.effects for move in _in_place(fits, model, symbol).values()]
    least = (1.0 - EXCHANGE_GAIN) * np.sum(model.left_out_squares)
    return [move for move in moves if np.sum(move.left_out_squares) < least and _is_significant(fits, move)]


def _additions(fits: MotionFits, model: MotionModel, most: int) -> list[MotionModel]:
    """Return models with one more effect that is significant and predicts better.

    A complete model gets no further effect.
    """
    if model.is_complete or len(model.effects) >= most:
        return []
    gains, moves = fits.gains(model), list[MotionModel]()
    for symbol in _largest(gains)[:FITTED_CANDIDATES]:
        move = fits.of((*model.effects, symbol), model, gains[symbol].step)
        better = move is not None and move.left_out_rms < model.left_out_rms
        if move is not None and better and move.p_value(symbol) < fits.settings.level:
            moves.append(move)
            if move.is_complete:
                break
    return moves


def _is_significant(fits: MotionFits, model: MotionModel) -> bool:
    return all(model.p_value(symbol) < fits.settings.level for symbol in model.effects)


def _largest(gains: dict[str, Gain]) -> list[str]:
    """Return candidates, with the one that explains most first."""
    return sorted(gains, key=lambda symbol: -gains[symbol].fall)


def _without(effects: Sequence[str], symbol: str) -> tuple[str, ...]:
    return tuple(other for other in effects if other != symbol)


def _in_place(fits: MotionFits, model: MotionModel, symbol: str) -> dict[str, MotionModel]:
    """Return models with candidates in place of an effect, by the candidate."""
    rest = fits.of(_without(model.effects, symbol), model)
    if rest is None:
        return {}
    gains = fits.gains(rest)
    places = [other for other in _largest(gains) if other not in model.effects]
    # Those that are fitted already are compared too.
    fitted_before = [other for other in places if fits.kept.get(frozenset((*rest.effects, other)))]
    chosen = dict.fromkeys([*places[: FITTED_CANDIDATES // 2], *fitted_before])
    moves = {other: fits.of((*rest.effects, other), rest, gains[other].step) for other in chosen}
    return {other: move for other, move in moves.items() if move is not None}


def _rivals(fits: MotionFits, model: MotionModel, symbol: str) -> dict[str, float]:
    """Return minus twice the logarithm of the odds of each candidate in place of an effect.

    The odds are those of the residuals that are left out. If the residual is noise, every sample is
    independent. If not, each run, or each part of few runs, counts once.
    """
    moves = _in_place(fits, model, symbol)
    count = len(model.fit.residual) if model.is_complete else model.clusters
    rest = fits.kept.get(frozenset(_without(model.effects, symbol)))
    placed = moves | ({"": rest} if rest is not None else {})
    here = np.sum(model.left_out_squares)
    excess = {name: count * float(np.log(np.sum(of.left_out_squares) / here)) for name, of in placed.items()}
    return {symbol: 0.0, **excess}


def _nested(fits: MotionFits, model: MotionModel) -> list[MotionModel]:
    """Return the models with none, one, ... all of the effects, the most significant first."""
    final = MotionModel(
        tuple(sorted(model.effects, key=lambda symbol: -abs(model.values[symbol]) / model.error(symbol))),
        model.fit,
        model.tests,
        model.level,
    )
    models = [final]
    while models[0].effects:
        fewer = fits.of(models[0].effects[:-1], models[0])
        if fewer is None:
            # The smaller model has no motion, or the time is used up: take the start model instead.
            fewer = fits.kept[frozenset()]
            assert fewer is not None
            fewer = MotionModel(models[0].effects[:-1], fewer.fit, fewer.tests, fewer.level)
        models.insert(0, MotionModel(models[0].effects[:-1], fewer.fit, fewer.tests, fewer.level))
    return models
