"""Fits of forces to the motions of driven runs, with errors and predictions of left-out parts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import monotonic
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.discovery.engine.trials import Settings
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import forces_to_identify
from sysid_trib.likelihood.sensor_noise import white_p_value
from sysid_trib.methods.trajectory import Trajectory, first_values
from sysid_trib.motion_fit.least_squares import (
    SINGULAR_PART,
    Fit,
    fitted,
    grown,
    nearby_best,
)
from sysid_trib.motion_fit.moving_samples import MovingSamples, points_of, regressed
from sysid_trib.motion_fit.parameters import PER_RUN
from sysid_trib.motion_fit.problem import FitProblem
from sysid_trib.records.smoothing import first_frequency, nominal_frequency
from sysid_trib.simulation.model import FREQUENCY, Model

# Samples that a search keeps of a run, if a period still has those of the settings.
KEPT_SAMPLES = 1500
# Relative step at which a fit of a search ends, and its largest number of evaluations.
SEARCH_TOLERANCE = 1e-4
SEARCH_EVALUATIONS = 15
# Samples of motions, or of their derivatives, that a search computes at most: about 3 min of processor time.
MOST_COMPUTED = 14_000_000


class OutOfTimeError(SysidTribError):
    """The budget of a search is spent."""


class Budget:
    """Limits of a search: a time, and a number of computed samples.

    The number does not depend on the speed of the computer, so that the result does not.

    Parameters
    ----------
    deadline : float
        Largest `time.monotonic()`.
    samples : int
        Largest number of samples of motions.
    """

    def __init__(self, deadline: float, samples: int) -> None:
        self.deadline = deadline
        self.samples = samples

    @property
    def late(self) -> bool:
        """Return true if the deadline has passed."""
        return monotonic() > self.deadline

    @property
    def spent(self) -> bool:
        """Return true if the deadline has passed or no samples are left."""
        return self.late or self.samples <= 0

    def spend(self, samples: int) -> None:
        """Subtract samples that will be computed.

        Raises
        ------
        OutOfTimeError
            The budget is spent.
        """
        if self.spent:
            raise OutOfTimeError("The time of the search is used up.")
        self.samples -= samples


@dataclass(frozen=True)
class LimitedProblem(FitProblem):
    """A fit that ends with an `OutOfTimeError` if the budget of its search is spent."""

    budget: Budget

    @classmethod
    def of(cls, problem: FitProblem, budget: Budget) -> "LimitedProblem":
        """Return a problem with a limit."""
        return cls(problem.parameters, problem.records, problem.runs, problem.offered, budget)

    @property
    def _samples(self) -> int:
        return sum(len(record.time) for record in self.records)

    def residuals(self, values: Array) -> list[Array]:
        """Return the motion minus record of each run; see `FitProblem`."""
        self.budget.spend(self._samples)
        return super().residuals(values)

    def white_sensitivity(self, values: Array, residuals: Sequence[Array]) -> Array:
        """Return the derivatives of the whitened residuals; see `FitProblem`."""
        self.budget.spend(self._samples)
        return super().white_sensitivity(values, residuals)


class Gain(NamedTuple):
    """A candidate by one linear step from a model.

    Attributes
    ----------
    coefficient, error : float
    p_value : float
        Corrected for the number of candidates.
    fall : float
        Fraction of the sum of squares that the candidate explains.
    outside : float
        Norm of the part of the candidate's column that is orthogonal to the columns of the model.
    direction : (sample,) array of float
        That orthogonal part, divided by its norm.
    step : mapping of str to float
        Values of all common parameters after the step.
    """

    coefficient: float
    error: float
    p_value: float
    fall: float
    outside: float
    direction: Array
    step: Mapping[str, float]


@dataclass(frozen=True)
class MotionModel:
    """A model with some effects, fitted to all runs.

    Attributes
    ----------
    effects : tuple of str
        Candidates that it has, in the order in which they were added.
    fit : Fit
    tests : int
        Number of candidates.
    level : float
        Significance level.
    """

    effects: tuple[str, ...]
    fit: Fit
    tests: int
    level: float

    @cached_property
    def values(self) -> dict[str, float]:
        """Return the common parameters by their names."""
        return dict(zip(self.fit.parameters.common, self.fit.values.tolist(), strict=False))

    @property
    def per_run(self) -> Array:
        """Return angle (rad), rate (rad/s) and zero (rad) of each run, (run, 3)."""
        return self.fit.parameters.per_run(self.fit.values)

    @cached_property
    def residuals(self) -> list[Array]:
        """Return motion minus record of each run, (sample,) array of float each, rad."""
        return np.split(self.fit.residual, _ends(self.fit, 1))

    @property
    def rms(self) -> float:
        """Return the RMS of the residual, rad."""
        return root_mean_square(self.fit.residual)

    @cached_property
    def noise_p_value(self) -> float:
        """Return the p-value of the hypothesis that the residual of every run is white noise."""
        return min(1.0, len(self.residuals) * min(map(white_p_value, self.residuals)))

    @property
    def is_complete(self) -> bool:
        """Return true if the residual is noise."""
        return self.noise_p_value >= self.level

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance of all parameters, by the noise, or by the scatter between runs."""
        return self.covariance_of(self.fit)

    def covariance_of(self, fit: Fit) -> Array:
        """Return the covariance of all parameters of a fit near this one, by the noise of this one."""
        if not self.is_complete:
            return fit.clustered_covariance
        degrees_of_freedom = max(1, len(fit.residual) - len(fit.parameters.free))
        return np.asarray(fit.residual @ fit.residual / degrees_of_freedom * fit.covariance)

    def error(self, name: str) -> float:
        """Return the standard error of a parameter."""
        at = self.fit.parameters.index(name)
        return float(np.sqrt(self.covariance[at, at]))

    def p_value(self, symbol: str) -> float:
        """Return the p-value of an effect at its shapes, corrected for the number of candidates."""
        parameters = self.fit.parameters
        shapes = {k: v for k, v in self.values.items() if k.startswith(f"{symbol}.")}
        at_shapes = replace(self.fit.problem, parameters=parameters.fix(shapes))
        kept = np.isin(parameters.free, at_shapes.parameters.free)
        fit = replace(self.fit, problem=at_shapes, sensitivity=self.fit.sensitivity[:, kept])
        at = parameters.index(symbol)
        return self.p_value_of(self.values[symbol], float(np.sqrt(self.covariance_of(fit)[at, at])))

    def p_value_of(self, coefficient: float, error: float) -> float:
        """Return the p-value of a coefficient with an error, corrected for the number of candidates."""
        if not error > 0.0:
            return 1.0
        z = abs(coefficient) / error
        tail = scipy.stats.norm.sf(z) if self.is_complete else scipy.stats.t.sf(z, self.clusters - 1)
        return min(1.0, self.tests * 2.0 * float(tail))

    @property
    def threshold(self) -> float:
        """Return the least significant ratio of a coefficient to its error, for all candidates together."""
        tail = self.level / (2.0 * self.tests)
        if self.is_complete:
            return float(scipy.stats.norm.isf(tail))
        return float(scipy.stats.t.isf(tail, self.clusters - 1))

    @property
    def clusters(self) -> int:
        """Return the number of independent parts whose scatter gives errors: runs, or parts of few runs."""
        return self.fit.clusters

    @cached_property
    def left_out_squares(self) -> Array:
        """Return the squares of the residual of each cluster, predicted by the others, (cluster,).

        The prediction is to first order, and the start of each run is fitted (PRESS; Allen 1974).
        """
        fit = self.fit
        parameters = fit.parameters
        names = [parameters.names[at] for at in parameters.free]
        common = [at for at, name in enumerate(names) if name in parameters.common]
        parts = self.clusters // len(fit.problem.records)
        table = fit.sensitivity / _size(fit.sensitivity)
        ends = _ends(fit, 1)
        clusters = list[tuple[Array, Array]]()
        pairs = zip(np.split(table, ends), np.split(fit.residual, ends), strict=True)
        for run, (rows, residual) in enumerate(pairs):
            own = [at for at, name in enumerate(names) if name in _names_of_run(run)]
            basis, _ = np.linalg.qr(rows[:, own])
            rest = rows[:, common] - basis @ (basis.T @ rows[:, common])
            residual = residual - basis @ (basis.T @ residual)
            clusters += zip(np.array_split(rest, parts), np.array_split(residual, parts), strict=True)
        whole = np.sum([rows.T @ rows for rows, _ in clusters], axis=0)
        # A parameter that one cluster alone determines stays where it is.
        ridge = 1e-9 * np.trace(whole) / max(1, len(whole)) * np.eye(len(whole))
        squares = []
        for rows, residual in clusters:
            change = np.linalg.pinv(whole - rows.T @ rows + ridge, hermitian=True) @ (rows.T @ residual)
            squares.append(float(np.sum((residual + rows @ change) ** 2)))
        return np.array(squares)

    @property
    def left_out_rms(self) -> float:
        """Return the RMS of the residual that the other clusters predict, rad."""
        return float(np.sqrt(np.sum(self.left_out_squares) / len(self.fit.residual)))


def _size(table: Array) -> Array:
    """Return the norm of each column; 1 if the column is zero."""
    size = np.linalg.norm(table, axis=0)
    return np.where(size > 0.0, size, 1.0)


def _ends(fit: Fit, parts: int) -> list[int]:
    """Return the samples at which parts of runs end, without the last one."""
    counts = [len(record.time) - record.uncounted for record in fit.problem.records]
    lengths = [len(part) for count in counts for part in np.array_split(np.arange(count), parts)]
    return np.cumsum(lengths)[:-1].tolist()


def _names_of_run(run: int) -> list[str]:
    return [f"{name} of run {run}" for name in PER_RUN]


def decimated_run(run: xr.Dataset, frequency: float, per_period: int) -> xr.Dataset:
    """Return a run with fewer samples, which makes the fits faster; its attribute `decimated` states them.

    Parameters
    ----------
    run : Dataset
    frequency : float, rad/s
        Of small swings.
    per_period : int
        Samples of a period of it that remain at least.
    """
    time = run.time.values.astype(float)
    period = 2.0 * np.pi / (frequency * float(np.median(np.diff(time))))
    step = int(max(1, min(len(time) // KEPT_SAMPLES, period // per_period)))
    if step == 1:
        return run
    fewer = run.isel(time=slice(None, None, step))
    said = f"{len(time)} samples to {fewer.sizes['time']}, by single samples"
    return fewer.assign_attrs(decimated=said, decimation=float(step))


@dataclass
class MotionFits:
    """Fits of a start model with candidates to driven runs.

    Attributes
    ----------
    runs : sequence of Dataset
    start, offered : ForceLibrary
        The forces of the start model, and the candidates.
    fixed : mapping of str to float
        Coefficients that are held.
    frequency : float or None, rad/s
        w, where it is held.
    settings : Settings
    budget : Budget
        After it is spent, no model is fitted.
    kept : dict of frozenset of str to MotionModel
        Fitted models by their effects; None where the fit failed.
    failed : list of str
    known_gains : dict of frozenset of str to (Fit, dict of str to Gain)
        Candidates in addition to a fitted model, by its effects.
    """

    runs: Sequence[xr.Dataset]
    start: ForceLibrary
    offered: ForceLibrary
    fixed: Mapping[str, float]
    frequency: float | None
    settings: Settings
    budget: Budget
    kept: dict[frozenset[str], MotionModel | None] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    known_gains: dict[frozenset[str], tuple[Fit, dict[str, Gain]]] = field(default_factory=dict)

    @cached_property
    def whole(self) -> ForceLibrary:
        """Return all forces: those of the start model, then the candidates."""
        both = replace(self.start, forces=(*self.start, *self.offered))
        return forces_to_identify(both, self.frequency, sensors=True)

    @cached_property
    def _points(self) -> MovingSamples:
        return points_of(self.runs, self.whole)

    def method(self, effects: Sequence[str]) -> Trajectory:
        """Return the method that fits the start model with some effects, their shapes too."""
        shapes = tuple(name for name in self.whole.shape_values() if name.partition(".")[0] in effects)
        return Trajectory(self.frequency, random_force="off", constraints=dict(self.fixed), fit_shapes=shapes)

    def library(self, effects: Sequence[str]) -> ForceLibrary:
        """Return the start model's forces and some effects."""
        return self.whole.select([*self.start.symbols, *effects])

    def _problem(self, effects: Sequence[str], library: ForceLibrary) -> FitProblem:
        problem = self.method(effects).problem(self.runs, library)
        # A control loop uses the sensor: its zero is a force of the library, or there is none.
        zeros = {f"{PER_RUN[-1]} of run {run}": 0.0 for run in range(len(self.runs))}
        return replace(problem, parameters=problem.parameters.fix(zeros))

    def first(self) -> MotionModel:
        """Fit the start model.

        Raises
        ------
        DecayError
            No motion of it follows the records.
        """
        problem = self._problem((), self.library(()))
        begun = replace(self.method(()), start=self._regressed(()))
        fit = fitted(problem, grown(problem, first_values(begun, problem, None)), tolerance=SEARCH_TOLERANCE)
        model = self.kept[frozenset()] = self._model((), fit)
        return model

    def _model(self, effects: Sequence[str], fit: Fit) -> MotionModel:
        return MotionModel(tuple(effects), fit, len(self.offered), self.settings.level)

    def _regressed(self, effects: Sequence[str]) -> Model:
        """Return the model of a regression over the moving samples."""
        library = self.library(effects)
        regression = regressed(self._points, library, self.fixed)
        coefficients = {symbol: regression.coefficients.get(symbol, 0.0) for symbol in library.symbols}
        return Model(library, coefficients, self.frequency or regression.frequency)

    def of(
        self, effects: Sequence[str], near: MotionModel, step: Mapping[str, float] | None = None
    ) -> MotionModel | None:
        """Fit the start model with effects, once; None if the fit fails or the coefficients are unphysical.

        The fit starts near another model or at the regression, whichever motion is nearer to the records. If
        friction sticks, the sum of squares has many minima.

        Parameters
        ----------
        effects : sequence of str
        near : MotionModel
        step : mapping of str to float, optional
            Common parameters in place of those of the near model.
        """
        key = frozenset(effects)
        if key in self.kept or self.budget.spent:
            return self.kept.get(key)
        whole = self._problem(effects, self.library(effects))
        problem = LimitedProblem.of(whole, self.budget)
        places = [{**problem.parameters.library.shape_values(), **near.values, **(step or {})}]
        with np.errstate(all="ignore"):
            try:
                model = self._regressed(effects)
                places.append({**places[0], **model.coefficients, FREQUENCY: model.reference_frequency})
                starts = [problem.parameters.pack(place, near.per_run) for place in places]
                starts = [problem.parameters.expand(start[problem.parameters.free]) for start in starts]
                begin = min(starts, key=lambda start: _squares(problem, start))
                fit = fitted(problem, begin, tolerance=SEARCH_TOLERANCE, most_evaluations=SEARCH_EVALUATIONS)
            except OutOfTimeError:
                return None
            except (SysidTribError, np.linalg.LinAlgError, ValueError):
                self.failed += [symbol for symbol in effects if symbol not in near.effects]
                self.kept[key] = None
                return None
        model_with = self._model(effects, replace(fit, problem=whole))
        passive = [symbol for symbol in effects if self.whole[symbol].passive]
        physical = all(model_with.values[symbol] > 0.0 for symbol in passive)
        self.kept[key] = model_with if physical else None
        return self.kept[key]

    def from_larger(self, model: MotionModel, larger: MotionModel) -> MotionModel:
        """Return the fit of a model that starts at one with further effects; the model itself if not better.

        If friction sticks, the sum of squares has many minima: the model may have stopped at a worse one.
        """
        limited = LimitedProblem.of(model.fit.problem, self.budget)
        start = limited.parameters.pack({**model.values, **larger.values}, larger.per_run)
        start = limited.parameters.expand(start[limited.parameters.free])
        return self._better(model, lambda: fitted(limited, start, tolerance=SEARCH_TOLERANCE))

    def best_nearby(self, model: MotionModel) -> MotionModel:
        """Return the best fit of a model from several starts; the model itself if none is better.

        The starts are at the best fit of a model with further effects, and near the model. A complete model
        is not fitted again.
        """
        larger = [other for other in self.kept.values() if other and {*model.effects} < {*other.effects}]
        if larger and not model.is_complete:
            model = self.from_larger(model, min(larger, key=lambda other: other.rms))
        if model.is_complete:
            return model
        near = replace(model.fit, problem=LimitedProblem.of(model.fit.problem, self.budget))
        return self._better(model, lambda: nearby_best(near))

    def _better(self, model: MotionModel, fit_again: Callable[[], Fit]) -> MotionModel:
        """Return a model or its other fit, whichever is better, and keep it."""
        try:
            with np.errstate(all="ignore"):
                fit = fit_again()
        except (SysidTribError, np.linalg.LinAlgError):
            return model
        better = self._model(model.effects, replace(fit, problem=model.fit.problem))
        if better.rms > (1.0 - SEARCH_TOLERANCE) * model.rms:
            return model
        self.kept[frozenset(model.effects)] = better
        return better

    def gains(self, model: MotionModel) -> dict[str, Gain]:
        """Return the candidates that the runs can test, by one linear step each from a model."""
        known = self.known_gains.get(frozenset(model.effects))
        if known is not None and known[0] is model.fit:
            return known[1]
        added = [symbol for symbol in self.offered.symbols if symbol not in model.effects]
        problem = self._problem(model.effects, self.library([*model.effects, *added]))
        shapes = problem.parameters.library.shape_values()
        here = problem.parameters.pack({**shapes, **model.values}, model.per_run)
        residuals = problem.residuals(here)
        table, residual = problem.white_sensitivity(here, residuals), problem.white(residuals)
        names = [problem.parameters.names[at] for at in problem.parameters.free]
        size = _size(table)
        kept = [at for at, name in enumerate(names) if name not in added]
        basis, singular, _ = np.linalg.svd((table / size)[:, kept], full_matrices=False)
        basis = basis[:, singular > SINGULAR_PART * singular[0]]
        gains = dict[str, Gain]()
        for symbol in added:
            column = table[:, names.index(symbol)] / size[names.index(symbol)]
            rest = column - basis @ (basis.T @ column)
            outside = float(np.linalg.norm(rest))
            if outside > self.settings.testable and np.all(np.isfinite(column)):
                others = dict.fromkeys([other for other in added if other != symbol], 0.0)
                held = replace(problem, parameters=problem.parameters.fix(others))
                columns = [at for at, name in enumerate(names) if name not in others]
                start = Fit(held, here, residual, table[:, columns])
                gains[symbol] = _gain_of(model, start, symbol, outside, rest / outside)
        self.known_gains[frozenset(model.effects)] = (model.fit, gains)
        return gains


def _gain_of(model: MotionModel, start: Fit, symbol: str, outside: float, direction: Array) -> Gain:
    """Return a candidate by one linear step.

    `start` : the model with the sensitivity to the candidate, whose coefficient is free.
    """
    size, parameters = _size(start.sensitivity), start.parameters
    step = -np.linalg.lstsq(start.sensitivity / size, start.residual, rcond=1e-9)[0] / size
    residual = start.residual + start.sensitivity @ step
    after = parameters.expand(start.values[parameters.free] + step)
    own = parameters.index(symbol)
    stepped = replace(start, values=after, residual=residual)
    error = float(np.sqrt(model.covariance_of(stepped)[own, own]))
    coefficient = float(after[own])
    return Gain(
        coefficient,
        error,
        model.p_value_of(coefficient, error),
        1.0 - float(residual @ residual / (start.residual @ start.residual)),
        outside,
        direction,
        dict(zip(parameters.common, after.tolist(), strict=False)),
    )


def _squares(problem: FitProblem, values: Array) -> float:
    residual = problem.white(problem.residuals(values))
    return float(np.nan_to_num(residual @ residual, nan=np.inf))


def swing_frequency_of(runs: Sequence[xr.Dataset]) -> float:
    """Return the frequency (rad/s) by which the samples of driven runs are counted."""
    return nominal_frequency(first_frequency(runs))
