"""How far a model grows: as long as what it has not seen is predicted better, or it leaves noise alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import xarray as xr

from sysid_trib.discrepancy.free_motion import free_motions, model_identification
from sysid_trib.discrepancy.holdout import Prediction
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.reference import refitted
from sysid_trib.noise.level import sensor_noise
from sysid_trib.records.runs import root_mean_square
from sysid_trib.screening.omnibus_test import FAMILIES
from sysid_trib.state_space.tracked import FollowedRuns
from sysid_trib.validation.random_force import dependence_on_motion

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
        """Whether a model may grow: not so many in a row were no better; else `best` is that to end with."""
        symbols = tuple(trial.force.symbol for trial in model.trials)
        if symbols not in self.known:
            referred = refitted(model)
            after = self.foretold(referred)
            better = self.best is None or self.is_better(referred, after, self.best[1])
            self.refused = 0 if better else self.refused + 1
            self.known[symbols] = self.refused <= MOST_REFUSED
            if better:
                self.best = model, after
        return self.known[symbols]

    def is_better(self, model: FittedModel, after: Prediction, before: Prediction) -> bool:
        """Whether a model predicts better than another one, or leaves nothing that another could explain."""
        return bool(after.rms < before.rms) or self.is_complete(model)

    def is_complete(self, model: FittedModel) -> bool:
        """Whether a model leaves nothing of any run but noise."""
        return self.noise_p_value(model) >= model.settings.level

    def noise_p_value(self, model: FittedModel) -> float:
        """P-value of a model that leaves of each run but the sensor's noise, or a random force without cause.

        1 where the free motion follows them and what was held out to the noise, 0 where it does not follow
        them and nothing pushes it. Beside a random force a free motion wanders off and predicts what is far
        by chance, and noise of a colour of its own may hide a force: there the record must leave nothing
        that goes with angle, speed or time (`dependence_on_motion`; Bonferroni).
        """
        key = _key(model)
        if key not in self.tested:
            self.tested[key] = self._noise_p_value(model)
        return self.tested[key]

    def _noise_p_value(self, model: FittedModel) -> float:
        motions, most = free_motions(model), model.settings.free_residual
        pushed = model.likelihood.ratios > 0.0
        if any(not motion.over_noise < most and not pushed[at] for at, motion in enumerate(motions)):
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
