"""The exact fits of a search: of each model the likeliest is kept."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from time import monotonic

import numpy as np

from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.model_fit import NOT_FITTED, ROUNDS_AGREE, Limits, fit_model
from sysid_trib.likelihood_fit.trials import TrialEffect
from sysid_trib.screening.physical import are_physical, strengths


@dataclass
class Fits:
    """Exact fits of a search: by the symbols of the effects the likeliest; and what could not be fitted.

    After the deadline, by `time.monotonic`, none is done. `by_chance` has the effects of models where chance
    does as well as one: a search does not come back to them. `tried` has from where each fit started, and the
    deviance that it was asked to reach if it was given up above that: for a higher one it is tried again.
    """

    start: FittedModel
    deadline: float = np.inf
    kept: dict[frozenset[str], FittedModel] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    by_chance: set[frozenset[str]] = field(default_factory=set)
    tried: dict[tuple[tuple[str, tuple[float, ...]], ...], float] = field(default_factory=dict)

    @property
    def out_of_time(self) -> bool:
        """Whether the deadline has passed."""
        return monotonic() > self.deadline

    @property
    def ended(self) -> bool:
        """Whether no further model is fitted: it is too late, or as many were as the settings say."""
        return self.out_of_time or len(self.tried) >= self.start.settings.most_fits

    def of(
        self, near: FittedModel, drop: Sequence[str], add: Sequence[TrialEffect], worst: float = np.inf
    ) -> FittedModel | None:
        """A model near another one, with forces dropped and added; None if there is no fit.

        One that does not reach the deviance `worst` may be given up, and is tried from other starts; where
        forces are dropped alone from the shapes of the near model too: its optimum may be a better one.
        """
        stay = [t for t in near.trials if t.force.symbol not in drop]
        key = self._key([*stay, *add])
        fitted = self.kept.get(key)
        if (
            fitted is not None
            and not any(trial.starts for trial in add)
            and (add or fitted.deviance <= worst)
        ):
            return fitted
        failed_before = len(self.failed)
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
        """A fit from these shapes, once; None if it does not settle."""
        trials = [*stay, *added]
        key = self._key(trials)
        place = tuple(sorted((t.force.symbol, tuple(t.shapes.values())) for t in trials))
        if self.ended or self.tried.get(place, -np.inf) >= worst:
            return None

        def possible(fitted: FittedModel) -> bool:
            return _is_physical(fitted, len(self.start.trials))

        limits = Limits(worst, possible)
        model = self._fitted(near, trials, limits)
        if self._is_astray(model, key):
            # Whole steps may lead there, where the first ones are far.
            model = self._fitted(near, trials, limits, part=0.5)
            model = None if self._is_astray(model, key) else model
        # A fit that leaves what is physical has not failed: the effect does not explain the record.
        physical = model is None or possible(model)
        settled = model is not None and model.settled and physical
        given_up = model is not None and not model.settled and model.deviance > worst
        self.tried[place] = worst if given_up else np.inf
        if physical and not settled and not given_up:
            self.failed += [trial.force.symbol for trial in added]
        return model.light() if model is not None and settled else None

    def _key(self, trials: Sequence[TrialEffect]) -> frozenset[str]:
        """Symbols of the effects of a model, those beside the start model's."""
        return frozenset(t.force.symbol for t in trials) - {t.force.symbol for t in self.start.trials}

    def _is_astray(self, model: FittedModel | None, key: frozenset[str]) -> bool:
        """Whether a fit has settled where it is less likely than a model that it contains."""
        deviances = [kept.deviance for symbols, kept in self.kept.items() if symbols <= key]
        contained = min(deviances, default=np.inf)
        return model is not None and model.settled and model.deviance > contained + ROUNDS_AGREE

    def _fitted(
        self,
        near: FittedModel,
        trials: Sequence[TrialEffect],
        limits: Limits,
        part: float = 1.0,
    ) -> FittedModel | None:
        known = dict(zip([t.force.symbol for t in near.trials], near.coefficients.tolist(), strict=True))
        first = np.array([*(known.get(t.force.symbol, 0.0) for t in trials), near.stiffness])
        paths = [rows.path for rows in near.rows]
        try:
            model = fit_model(
                paths,
                trials,
                frequency_free=near.frequency_free,
                first=first,
                limits=limits,
                part=part,
            )
        except NOT_FITTED:
            return None
        return model if model.is_finite else None


def _from_each_start(trials: Sequence[TrialEffect]) -> Iterator[list[TrialEffect]]:
    """The trials, then with each of the other starts of one of them."""
    yield list(trials)
    for at, trial in enumerate(trials):
        for start in trial.starts:
            yield [*trials[:at], start, *trials[at + 1 :]]


def _is_physical(model: FittedModel, base: int) -> bool:
    """Whether the forces beside the first ones, those of the start model, may have their coefficients."""
    relative_force = strengths(model, [table[:, : len(model.trials)] for table in model.tables])
    physical = are_physical(model.trials, model.coefficients, relative_force, model.settings.strongest)
    return bool(np.all(physical[base:]))
