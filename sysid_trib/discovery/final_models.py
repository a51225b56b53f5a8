"""How a search ends: how far a model grows, and the models that remain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.free_motion import free_motions, model_identification
from sysid_trib.discovery.omnibus_test import FAMILIES
from sysid_trib.discovery.unseen import Prediction
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.library import load_library
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.model_fit import fit_model, fitted_along
from sysid_trib.likelihood.sensor_noise import white_p_value
from sysid_trib.likelihood.start_model import refitted
from sysid_trib.motion_fit.tracked import FollowedRuns
from sysid_trib.records.decay import root_mean_square
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.validation.random_force_test import dependence_on_motion

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

    def foretold(self, model: FittedModel) -> Prediction:
        """How a model predicts what was held out."""
        key = model.coefficients.tobytes()
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
        key = model.coefficients.tobytes()
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


Rivals = dict[str, dict[str, float]]


def plainest(model: FittedModel, rivals: Rivals, fits: Fits) -> tuple[FittedModel, FittedModel, Rivals, bool]:
    """The plainest of the models that are as likely; where that is not followed, the likeliest that is.

    Of those in a credible set with the model. A force of the user's own is plainer than one of the usual
    candidates, and then one of fewer shapes.

    Returns
    -------
    The model as the search has it; with its frequency as the reference; the rivals of its effects; and
    whether it is followed.
    """
    referred, settings, effects = refitted(model), model.settings, fits.effects_of(model)
    followed = not effects or _is_followed(referred)
    others = list[tuple[tuple[bool, int], float, str, str, FittedModel]]()
    for symbol, costs in rivals.items():
        for name, excess in costs.items():
            fitted = fits.kept.get(frozenset(effects) - {symbol} | {name})
            if name in ("", symbol) or excess >= settings.outside_of_set or fitted is None:
                continue
            plain = _plainness(fitted, name) if followed else (False, 0)
            if not followed or (excess < settings.tie and plain < _plainness(model, symbol)):
                others.append((plain, excess, symbol, name, fitted))
    for _, excess, symbol, name, fitted in sorted(others, key=lambda other: other[:2]):
        other = refitted(fitted)
        if _is_followed(other):
            costs = {tied: its_excess - excess for tied, its_excess in rivals[symbol].items()}
            kept = {s: of_effect for s, of_effect in rivals.items() if s != symbol} | {name: costs}
            return plainest(fitted, kept, fits) if followed else (fitted, other, kept, True)
    return model, referred, rivals, followed


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
