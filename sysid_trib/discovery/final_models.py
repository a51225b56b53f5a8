"""How a search ends: how far a model grows, pairs in the place of one effect, the models that remain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.discovery.exchange import move_of, replacing_pairs
from sysid_trib.discovery.fits import Fits, evidence
from sysid_trib.discovery.free_motion import free_motions, model_identification
from sysid_trib.discovery.omnibus_test import FAMILIES
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.single_columns import each_column
from sysid_trib.discovery.unseen import Prediction
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.library import load_library
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.likelihood import likelihood
from sysid_trib.likelihood.model_fit import fit_model, fitted_along
from sysid_trib.likelihood.sensor_noise import white_p_value
from sysid_trib.likelihood.start_model import refitted
from sysid_trib.motion_fit.tracked import FollowedRuns
from sysid_trib.records.decay import root_mean_square
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.validation.random_force_test import dependence_on_motion


def pairs_of(
    current: Screening, effects: tuple[str, ...], symbol: str, fits: Fits
) -> dict[tuple[str, str], float]:
    """Pairs in an effect's credible set, or likelier: their evidence over its own, the likeliest first.

    Parameters
    ----------
    current : Screening
        Of the final model.
    effects : tuple of str
        Its effects besides the start model's.
    symbol : str
        One of these: of no shape it has no pairs.
    fits : Fits

    Notes
    -----
    A force whose shape is fitted may follow the sum of two that have none: a damping of the power 2.25 with
    a viscous one that of dry and quadratic friction. Pairs have no more parameters than the effect, and what
    either adds to the other is beyond chance.
    """
    model, settings = current.model, current.model.settings
    shapes = len(model.trials[model.columns_of(symbol)[0]].force.shape)
    here, likelier = evidence(model, effects), dict[tuple[str, str], float]()
    if not shapes:
        return {}
    scored = [
        (score, pair)
        for score, pair in sorted(replacing_pairs(current, (symbol,)))
        if sum(1 + len(current.trials[at].force.shape) for at in pair) <= 1 + shapes
    ]
    for _, pair in scored[: settings.fitted]:
        if not _both_add(current, symbol, pair):
            continue
        move = move_of(current, effects, (symbol,), pair, fits, here + settings.outside_of_set)
        if move is not None and (excess := move.evidence - here) < settings.outside_of_set:
            first, second = (current.trials[at].force.symbol for at in pair)
            likelier[first, second] = excess
    return dict(sorted(likelier.items(), key=lambda scored: scored[1]))


def likelier_pair(
    current: Screening, effects: tuple[str, ...], fits: Fits, most: int
) -> tuple[FittedModel, tuple[str, ...]] | None:
    """The model with a pair in an effect's place of whose credible set the effect is outside, if any.

    `most` : effects that a model may have.
    """
    settings = current.model.settings
    if len(effects) >= most:
        return None
    for symbol in effects:
        for pair, excess in pairs_of(current, effects, symbol, fits).items():
            after = (*(s for s in effects if s != symbol), *pair)
            if excess < -settings.outside_of_set and frozenset(after) not in fits.by_chance:
                return fits.kept[frozenset(after)], after
    return None


def _both_add(current: Screening, symbol: str, pair: Sequence[int]) -> bool:
    """True if each of two trials in the place of an effect explains more with the other than chance."""
    kept = current.model.columns_without((symbol,))
    columns = [current.first_trial + at for at in pair]
    for at, other in zip(pair, reversed(columns), strict=True):
        base = [*kept, other]
        bare = likelihood(current.products, base)
        single = each_column(current.products, base, [current.first_trial + at], bare)
        gain = float(bare.deviance - single.deviance[0])
        force = current.trials[at].force
        if current.p_value_of(gain, force, float(single.effective_rows[0])) >= current.model.settings.level:
            return False
    return True


# A right effect may predict worse while another is missing: so many in a row do not end a search.
MOST_REFUSED = 1


@dataclass
class Growth:
    """The models to which a search came by adding, and how they predict what none has seen.

    Attributes
    ----------
    runs : sequence of Dataset
        To which the models are fitted.
    predict : callable
        How a model predicts what was held out.
    best : tuple of FittedModel and Prediction, or None
        Of the models that were asked for.
    known, predictions, tested : dict
        Whether a model of these forces goes on; by the coefficients predictions, and p-values of noise.
    refused : int
        Models in a row that were no better.
    """

    runs: Sequence[xr.Dataset]
    predict: Callable[[FittedModel], Prediction]
    best: tuple[FittedModel, Prediction] | None = None
    known: dict[tuple[str, ...], bool] = field(default_factory=dict)
    predictions: dict[bytes, Prediction] = field(default_factory=dict)
    tested: dict[bytes, float] = field(default_factory=dict)
    refused: int = 0

    def anew(self) -> "Growth":
        """For another search."""
        return Growth(self.runs, self.predict)

    def foretold(self, model: FittedModel) -> Prediction:
        """How a model predicts what was held out."""
        key = _key(model)
        if key not in self.predictions:
            self.predictions[key] = self.predict(model)
        return self.predictions[key]

    def goes_on(self, model: FittedModel) -> bool:
        """True if a model may grow: not so many in a row were no better; else `best` is that to end with."""
        symbols = tuple(trial.force.symbol for trial in model.trials)
        if symbols not in self.known:
            referred = refitted(model)
            after = self.foretold(referred)
            # It predicts better than another one, or leaves nothing that another could explain.
            better = self.best is None or bool(after.rms < self.best[1].rms) or self.is_complete(referred)
            self.refused = 0 if better else self.refused + 1
            self.known[symbols] = self.refused <= MOST_REFUSED
            if better:
                self.best = model, after
        return self.known[symbols]

    def is_complete(self, model: FittedModel) -> bool:
        """True if a model leaves nothing of any run but noise."""
        return self.noise_p_value(model) >= model.settings.level

    def noise_p_value(self, model: FittedModel) -> float:
        """P-value of a model that leaves of each run but the sensor's noise, or a random force without cause.

        1 where the free motion follows them and what was held out to the noise, 0 where it does not follow
        them and nothing pushes it. With a random force a free motion wanders off and predicts what is far
        by chance, and noise of a colour of its own may hide a force: there the record must leave nothing
        that goes with angle, speed or time (`dependence_on_motion`; Bonferroni). A driven motion may have
        what no spline follows, so that no noise is known without a model: what is left is white then.
        """
        key = _key(model)
        if key not in self.tested:
            self.tested[key] = self._noise_p_value(model)
        return self.tested[key]

    def _noise_p_value(self, model: FittedModel) -> float:
        motions, most = free_motions(model), model.settings.free_residual
        if any(map(inputs_of, self.runs)):
            return min(1.0, len(motions) * min(white_p_value(motion.residual) for motion in motions))
        stochastic = model.likelihood.ratios > 0.0
        if any(not motion.over_noise < most and not stochastic[at] for at, motion in enumerate(motions)):
            return 0.0
        noises = [sensor_noise(run) for run in self.runs]
        sizes = zip([root_mean_square(motion.residual) for motion in motions], noises, strict=True)
        follows = all(size < most * noise for size, noise in sizes)
        if follows and self.foretold(model).rms < most * root_mean_square(noises):
            return 1.0
        result = model_identification(model, motions, self.runs, None)
        followed = FollowedRuns(dict(enumerate(self.runs)), result)
        try:
            tested = [dependence_on_motion(followed, at).p_value.item() for at in range(len(self.runs))]
        except SysidTribError:
            return 0.0
        return float(min(1.0, FAMILIES * len(tested) * min(tested)))


def _key(model: FittedModel) -> bytes:
    return model.coefficients.tobytes()


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
    """True of a usual candidate, and the number of its shapes: the least is plainest."""
    force = model.trials[model.columns_of(symbol)[0]].force
    usual = {(other.symbol, other.formula.text) for other in load_library("candidate_effects")}
    return (force.symbol, force.formula.text) in usual, len(force.shape)


def _is_followed(model: FittedModel) -> bool:
    """True if the fit has settled, and without a random force moves as its path does.

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
