"""The models that a search ends with: the last one moves as its record does, or that is said."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid_trib.discrepancy.fits import Fits
from sysid_trib.discrepancy.free_motion import free_motions
from sysid_trib.forces.library import load_library
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.model_fit import fit_model, fitted_along
from sysid_trib.likelihood_fit.reference import refitted


class Final(NamedTuple):
    """A model that a search ends with.

    `model` as the search has it, and `referred`, the same with its frequency as the reference; its effects
    and their rivals, as `Search` has them; whether it is followed.
    """

    model: FittedModel
    referred: FittedModel
    effects: tuple[str, ...]
    rivals: dict[str, dict[str, float]]
    followed: bool


def final_of_set(
    model: FittedModel, effects: tuple[str, ...], rivals: dict[str, dict[str, float]], fits: Fits
) -> Final:
    """The plainest of the models that are as likely; where that is not followed, the likeliest that is.

    Of those in a credible set with the model. A force of the user's own is plainer than one of the usual
    candidates, and then one of fewer shapes.
    """
    referred, settings = refitted(model), model.settings
    followed = not effects or _is_followed(referred)
    others = [
        (excess, symbol, name, fitted)
        for symbol, costs in rivals.items()
        for name, excess in costs.items()
        if name not in ("", symbol) and excess < settings.outside_of_set
        if (fitted := fits.kept.get(frozenset(effects) - {symbol} | {name})) is not None
    ]
    if followed:
        others = [
            other
            for other in others
            if other[0] < settings.tie and _plainness(other[3], other[2]) < _plainness(model, other[1])
        ]

    def order(other: tuple[float, str, str, FittedModel]) -> tuple[bool, int, float]:
        return (*(_plainness(other[3], other[2]) if followed else (False, 0)), other[0])

    for excess, symbol, name, fitted in sorted(others, key=order):
        other = refitted(fitted)
        if _is_followed(other):
            after = tuple(name if named == symbol else named for named in effects)
            costs = {tied: its_excess - excess for tied, its_excess in rivals[symbol].items()}
            kept = {s: of_effect for s, of_effect in rivals.items() if s != symbol}
            named = Final(fitted, other, after, kept | {name: costs}, followed=True)
            return final_of_set(named.model, named.effects, named.rivals, fits) if followed else named
    return Final(model, referred, effects, rivals, followed)


def _plainness(model: FittedModel, symbol: str) -> tuple[bool, int]:
    """Whether an effect is a usual candidate, and the number of its shapes: the least is plainest."""
    force = model.trials[model.columns_of(symbol)[0]].force
    usual = {(other.symbol, other.formula.text) for other in load_library("candidate_effects")}
    return (force.symbol, force.formula.text) in usual, len(force.shape)


def _is_followed(model: FittedModel) -> bool:
    """Whether the fit has settled, and without a random force moves as its path does.

    Rows say how a motion deviates, and not that it stops before the record does.
    """
    if not model.settled or np.any(model.likelihood.ratios > 0.0):
        return model.settled
    return all(motion.over_noise < model.settings.free_residual for motion in free_motions(model))


def nested_models(final: FittedModel, effects: Sequence[str]) -> list[FittedModel]:
    """The models with none, one, ... all of the effects, in this order."""
    models = [final]
    for symbol in reversed(effects):
        last = models[0]
        kept = [at for at, trial in enumerate(last.trials) if trial.force.symbol != symbol]
        first = np.append(last.coefficients[kept], last.stiffness)
        paths = [rows.path for rows in last.rows]
        trials = [last.trials[at] for at in kept]
        fewer = refitted(fit_model(paths, trials, frequency_free=last.frequency_free, first=first))
        # With so much missing it may have no motion of its own: then along that of the model with more.
        models.insert(0, fewer if fewer.follows else fitted_along(paths, trials, first, last.frequency_free))
    return models
