"""Exact fits of a search, and the evidence that names, shortens and ranks models."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from time import monotonic

import numpy as np
import xarray as xr
from scipy.special import log_ndtr, softmax

from sysid_trib.arrays import Array, Mask
from sysid_trib.discovery import single_columns, unseen
from sysid_trib.discovery.engine import model_fit, start_model
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.trials import TrialEffect, reference_power
from sysid_trib.discovery.free_motion import free_motions
from sysid_trib.discovery.plain_start import PlainStart, residual_of_motions
from sysid_trib.discovery.screen import Screening, screen
from sysid_trib.forces.force import Force


def evidence(model: FittedModel) -> float:
    """Return minus twice the logarithm of the evidence of a model, for the effects that were added.

    Notes
    -----
    Laplace's approximation (MacKay 1992; Kass and Raftery 1995). The prior of a coefficient has the
    information of one row (unit information), so its factor is the number of rows. If physics fixes the sign,
    the prior covers that half line only. If physics gives the value, the penalty of a deviation is the rise
    of the deviance when the coefficient is held at this value. The prior of a shape is uniform in its range,
    or in the logarithm if the range spans a decade. The factor of a shape is the fraction of its range that
    the record allows, at most 1; for a shape at an end of its range it is the fraction inside.
    """
    total = model.deviance
    for symbol in model.effects:
        at, *shapes = model.columns_of(symbol)
        total += least_penalty(model, [model.trials[at].force]) + errors_off(model, symbol) ** 2
        if shapes:
            covariance = model.likelihood.covariance[np.ix_(shapes, shapes)]
            within = np.linalg.pinv(2.0 * np.pi * covariance, hermitian=True)
            total += float(np.linalg.slogdet(np.eye(len(shapes)) + within)[1])
            total += sum(_at_end(*model.at_ends[shape]) for shape in shapes if shape in model.at_ends)
    return float(total)


def errors_off(model: FittedModel, symbol: str) -> float:
    """Return the difference of a coefficient from its known value, in standard errors; 0 if none is known.

    Both refer to the model's own frequency, which may be far from that of its paths.
    """
    at, count = model.columns_of(symbol)[0], len(model.trials)
    force, squared = model.trials[at].force, 1.0 + model.stiffness
    if force.coefficient is None or squared <= 0.0:
        return 0.0
    half = 0.5 * reference_power(force)
    referred, slope = model.coefficients[at] * squared**half, np.zeros(model.columns)
    slope[at] = squared**half
    if model.frequency_free:
        slope[count] = referred * half / squared
    error = float(np.sqrt(slope @ model.likelihood.covariance @ slope))
    return abs(float(referred) - force.coefficient) / error if error > 0.0 else 0.0


def _at_end(beyond_end: float, error: float) -> float:
    """Return the penalty -2 ln(fraction of its range that the record allows) of a shape at the range's end.

    The fraction is the integral of a Gaussian likelihood with its centre outside, over its value at the end.
    """
    if not 0.0 < error < np.inf:
        return 0.0
    near, far = log_ndtr(-beyond_end / error), log_ndtr(-(1.0 + beyond_end) / error)
    inside = near + np.log1p(-np.exp(far - near))
    return float(
        -2.0 * (np.log(error) + 0.5 * np.log(2.0 * np.pi) + 0.5 * (beyond_end / error) ** 2 + inside)
    )


def log_rows(model: FittedModel) -> float:
    """Return the penalty of an effect in the evidence, without its sign and shapes."""
    return float(np.log(sum(rows.path.form.rows for rows in model.rows)))


def least_penalty(model: FittedModel, forces: Sequence[Force]) -> float:
    """Return the penalty of these effects in the evidence, without their shapes."""
    return float(sum(log_rows(model) - 2.0 * np.log(2.0) * force.passive for force in forces))


def probabilities(costs: Sequence[float]) -> Array:
    """Return the probability of each model, (model,), if one of them is true and all have equal priors.

    `costs` : (model,) minus twice the logarithm of the evidence of each, up to a common constant.
    """
    return np.asarray(softmax(-0.5 * np.asarray(costs, dtype=float)))


def credible(probability: Array, part: float) -> Mask:
    """Return the mask of the smallest set of models that contains the truth with the probability `part`."""
    order = np.argsort(-probability, kind="stable")
    before = np.cumsum(probability[order]) - probability[order]
    return np.isin(np.arange(len(probability)), order[before < part])


@dataclass
class Fits:
    """Exact fits of a search, and the screened candidates.

    Attributes
    ----------
    start : FittedModel
        The model that effects are added to.
    candidates : sequence of Force
    deadline : float
        Time by `time.monotonic` after which no further model is fitted.
    kept : dict of frozenset of str to FittedModel
        The most likely model of each set of effects.
    screenings : dict of frozenset of str to Screening
        Screenings of the candidates with a model of each set of effects.
    failed : list of str
        Models that could not be fitted.
    by_chance : set of frozenset of str
        Sets of effects of which one was not significant: a search does not return to them.
    tried : dict
        Start of each fit, and the deviance that the fit had to reach if it was abandoned: it is repeated if a
        higher deviance is enough.
    runs : sequence of Dataset
        Runs to which the models are fitted.
    predict : callable
        Function that predicts the held-out parts with a model.
    best : FittedModel or None
        Best model found by adding, at each step, the effect that predicts best.
    plain : PlainStart or None
        The start model fitted without a random force, if its motion is nearer to the records.
    """

    start: FittedModel
    candidates: Sequence[Force] = ()
    deadline: float = np.inf
    kept: dict[frozenset[str], FittedModel] = field(default_factory=dict)
    screenings: dict[frozenset[str], Screening] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    by_chance: set[frozenset[str]] = field(default_factory=set)
    tried: dict[tuple[tuple[str, tuple[float, ...]], ...], float] = field(default_factory=dict)
    runs: Sequence[xr.Dataset] = ()
    predict: Callable[[FittedModel], unseen.Prediction] | None = None
    best: FittedModel | None = None
    plain: PlainStart | None = None
    # `_known`: for the forces of a model, whether the model may be extended. `_refused`: number of successive
    # models that did not predict better than the best one. `_least_rms`: RMS of the best one. The others hold
    # predictions and p-values of noise by the model's coefficients.
    _known: dict[tuple[str, ...], bool] = field(default_factory=dict)
    _refused: int = 0
    _least_rms: float = np.inf
    _predictions: dict[bytes, unseen.Prediction] = field(default_factory=dict)
    _p_values: dict[bytes, float] = field(default_factory=dict)

    def screened(self, model: FittedModel) -> Screening:
        """Return the screening of the candidates that are not in a model, once for each set of effects."""
        key = frozenset(model.effects)
        if key not in self.screenings:
            rest = [force for force in self.candidates if force.symbol not in key]
            self.screenings[key] = screen(model, rest)
        return self.screenings[key]

    @property
    def out_of_time(self) -> bool:
        """True if the deadline has passed."""
        return monotonic() > self.deadline

    @property
    def ended(self) -> bool:
        """True if no further model may be fitted: time or number of fits is used up."""
        return self.out_of_time or len(self.tried) >= self.start.settings.most_fits

    def of(
        self, near: FittedModel, drop: Sequence[str], add: Sequence[TrialEffect], worst: float = np.inf
    ) -> FittedModel | None:
        """Fit a model near another one, with forces dropped and added; return None if there is no fit.

        A fit that does not reach the deviance `worst` may be abandoned; then other starts are tried. If
        forces are only dropped, the shapes of the near model are a start too, because that optimum may be
        better.
        """
        stay = [t for t in near.trials if t.force.symbol not in drop]
        key = frozenset(trial.force.symbol for trial in (*stay, *add) if trial.added)
        fitted, failed_before = self.kept.get(key), len(self.failed)
        if fitted is not None and add and not any(trial.starts for trial in add):
            return fitted
        for added in _from_each_start(add):
            if fitted is not None and fitted.deviance <= worst:
                break
            other = self._settled(near, stay, added, worst)
            if other is not None and (fitted is None or other.deviance < fitted.deviance):
                fitted = self.kept[key] = other
        if fitted is not None:
            del self.failed[failed_before:]
        return fitted

    def _settled(
        self, near: FittedModel, stay: Sequence[TrialEffect], added: Sequence[TrialEffect], worst: float
    ) -> FittedModel | None:
        """Fit once from these shapes; return None if the fit does not converge."""
        trials, paths = [*stay, *added], [rows.path for rows in near.rows]
        place = tuple(sorted((t.force.symbol, tuple(t.shapes.values())) for t in trials))
        if self.ended or self.tried.get(place, -np.inf) >= worst:
            return None

        def possible(fitted: FittedModel) -> bool:
            """Return true if the added forces may have their coefficients."""
            columns = [table[:, : len(fitted.trials)] for table in fitted.tables]
            physical = single_columns.are_physical(fitted, fitted.trials, fitted.coefficients, columns)
            return bool(np.all(physical[len(self.start.trials) :]))

        known = dict(zip([t.force.symbol for t in near.trials], near.coefficients.tolist(), strict=True))
        first = np.array([*(known.get(t.force.symbol, 0.0) for t in trials), near.stiffness])

        def fit(part: float) -> FittedModel | None:
            """Fit from the coefficients and paths of the near model; None without a finite likelihood."""
            try:
                fitted = model_fit.fit_model(paths, trials, first, worst=worst, possible=possible, part=part)
            except model_fit.NOT_FITTED:
                return None
            return fitted if fitted.is_finite else None

        model = fit(1.0)
        if self._is_local_optimum(model):
            # Whole first steps, being far, may lead to a local optimum: take half steps.
            model = fit(0.5)
            model = None if self._is_local_optimum(model) else model
        # A fit outside of the physical range has not failed: the effect does not explain the record.
        physical = model is None or possible(model)
        settled = model is not None and model.settled and physical
        given_up = model is not None and not model.settled and model.deviance > worst
        self.tried[place] = worst if given_up else np.inf
        if physical and not settled and not given_up:
            self.failed += [trial.force.symbol for trial in added]
        return model.without_caches() if model is not None and settled else None

    def _is_local_optimum(self, model: FittedModel | None) -> bool:
        """Return true if a fit has converged, but is less likely than a model that it contains."""
        if model is None or not model.settled:
            return False
        effects, kept = {*model.effects}, self.kept.items()
        contained = [fitted.deviance for symbols, fitted in kept if symbols <= effects]
        return model.deviance > min(contained, default=np.inf) + model_fit.ROUNDS_AGREE

    def foretold(self, model: FittedModel) -> unseen.Prediction:
        """Return the prediction of the held-out part by a model."""
        assert self.predict is not None
        key = model.coefficients.tobytes()
        if key not in self._predictions:
            self._predictions[key] = self.predict(model)
        return self._predictions[key]

    def goes_on(self, model: FittedModel) -> bool:
        """Return true if a model may be extended; if not, the search ends with `best`."""
        symbols = tuple(trial.force.symbol for trial in model.trials)
        if symbols not in self._known:
            referred = start_model.refitted(model)
            rms = self.foretold(referred).rms
            # It predicts better than all before it, or its residual is noise.
            better = self.best is None or bool(rms < self._least_rms) or self.is_complete(referred)
            self._refused = 0 if better else self._refused + 1
            # A correct effect may predict worse while another is missing: one such step does not end a
            # search.
            self._known[symbols] = self._refused <= 1
            if better:
                self.best, self._least_rms = model, rms
        return self._known[symbols]

    def beats_plain_start(self, model: FittedModel) -> bool:
        """Return true if a model's motion is no farther from the records than the plain start model's."""
        return self.plain is None or residual_of_motions(free_motions(model)) <= self.plain.residual

    def noise_p_value(self, model: FittedModel) -> float:
        """Return `noise_p_value` of a model, computed once."""
        key = model.coefficients.tobytes()
        if key not in self._p_values:
            self._p_values[key] = unseen.noise_p_value(model, self.runs, lambda: self.foretold(model).rms)
        return self._p_values[key]

    def is_complete(self, model: FittedModel) -> bool:
        """Return true if the residual of a model is noise in every run."""
        return self.noise_p_value(model) >= model.settings.level


def _from_each_start(trials: Sequence[TrialEffect]) -> Iterator[list[TrialEffect]]:
    """Yield the trials, then the trials with one of them at each of its other starts."""
    yield list(trials)
    for at, trial in enumerate(trials):
        for start in trial.starts:
            yield [*trials[:at], start, *trials[at + 1 :]]
