"""The models that a search ends with: the last one moves as its record does, or that is said."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid_trib.discrepancy.fits import Fits
from sysid_trib.discrepancy.free_motion import free_motions
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.model_fit import fit_model, fitted_along
from sysid_trib.likelihood_fit.reference import refitted
from sysid_trib.records.runs import root_mean_square


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


def followed_of_set(
    model: FittedModel, effects: tuple[str, ...], rivals: dict[str, dict[str, float]], fits: Fits
) -> Final:
    """The model; where that is not followed, the likeliest of those in a credible set with it that is."""
    referred = refitted(model)
    if not effects or _is_followed(referred):
        return Final(model, referred, effects, rivals, followed=True)
    every = [(excess, symbol, name) for symbol, costs in rivals.items() for name, excess in costs.items()]
    for excess, symbol, name in sorted(every):
        after = tuple(name if other == symbol else other for other in effects)
        fitted = fits.kept.get(frozenset(after))
        if not name or name == symbol or fitted is None or excess >= model.settings.outside_of_set:
            continue
        other = refitted(fitted)
        if _is_followed(other):
            costs = {tied: its_excess - excess for tied, its_excess in rivals[symbol].items()}
            kept = {s: of_effect for s, of_effect in rivals.items() if s != symbol}
            return Final(fitted, other, after, kept | {name: costs}, followed=True)
    return Final(model, referred, effects, rivals, followed=False)


def _is_followed(model: FittedModel) -> bool:
    """Whether the fit has settled, and without a random force moves as its path does.

    Rows say how a motion deviates, and not that it stops before the record does.
    """
    if not model.settled or np.any(model.likelihood.ratios > 0.0):
        return model.settled
    return all(
        root_mean_square(motion.residual) < model.settings.free_residual * motion.noise.standard_deviation
        for motion in free_motions(model)
    )


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
