"""The models on the way from the start to the end of a search, and how each predicts what it has not seen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sysid_trib.discrepancy.baseline import Baseline, fit
from sysid_trib.discrepancy.naming import without_force
from sysid_trib.discrepancy.search import Search
from sysid_trib.errors import SysidTribError
from sysid_trib.methods.fitting import rms
from sysid_trib.methods.motions import Problem, Record
from sysid_trib.results import Estimate, identification
from sysid_trib.runs import one_or_all, root_mean_square, run_noise, start_variables
from sysid_trib.start import first_guess

Array = NDArray[np.float64]

# Part of each run on which a model is fitted that then predicts the rest.
TRAINED = 2.0 / 3.0
# A hold-out gap that grows by more than this part is flagged.
WORSE = 1.05


@dataclass(frozen=True)
class Stages:
    """Models of a search: the start, and with each effect more; hold-out RMS (rad) and noise of each."""

    models: list[Baseline]
    holdout: Array


def stages_of(found: Search, unseen: Sequence[xr.Dataset]) -> Stages:
    """The start model, and the models with one, two, ... of the effects found.

    `unseen` : runs that took no part; without any the models are fitted again on the first two thirds of
    each run, and predict the rest. What predicts has its start and the sensor's zero fitted to what it
    predicts, nothing else.
    """
    models = [found.final]
    for symbol in found.added[:0:-1]:
        problem, unknown = without_force(models[0], symbol)
        models.insert(0, fit(problem, unknown, found.final.noises, far=True))
    if found.added:
        models.insert(0, found.scans[0].before)
    return Stages(models, np.array([_held_out(model, unseen) for model in models]))


def _held_out(model: Baseline, unseen: Sequence[xr.Dataset]) -> float:
    if unseen:
        records = tuple(Record(u.time.values.astype(float), u.angle.values.astype(float)) for u in unseen)
        trained = model
    else:
        cut = [round(TRAINED * len(record.time)) for record in model.problem.records]
        first, records = zip(*map(_split, model.problem.records, cut), strict=True)
        problem = replace(model.problem, records=first)
        trained = fit(problem, model.unknown, model.noises, far=True)
    try:
        return rms(np.concatenate(_predicted(trained, records)))
    except SysidTribError:
        return float("nan")


def _split(record: Record, cut: int) -> tuple[Record, Record]:
    return (
        replace(record, time=record.time[:cut], angle=record.angle[:cut]),
        replace(record, time=record.time[cut:], angle=record.angle[cut:]),
    )


def _predicted(trained: Baseline, records: Sequence[Record]) -> list[Array]:
    """What the model leaves of records whose start alone is fitted."""
    problem, shared = trained.problem, trained.unknown[: trained.problem.shared]
    model = problem.model(trained.unknown)
    left = []
    for record in records:
        guess = first_guess(record.time, record.angle, model.reference_frequency)
        alone = _Held(replace(problem, records=(record,)), shared)
        left.append(alone.residual(np.array([*guess, 0.0])))
    return left


@dataclass(frozen=True)
class _Held:
    """A record whose start and zero are the only unknowns."""

    problem: Problem
    shared: Array

    def residual(self, own: Array) -> Array:
        def whole(own: Array) -> Array:
            return np.concatenate([self.shared, own])

        count = len(self.shared)
        found = least_squares(
            lambda own: self.problem.white_residual(whole(own)),
            own,
            jac=lambda own: self.problem.white_sensitivity(whole(own))[:, count:],
            x_scale="jac",
            max_nfev=20,
        )
        return self.problem.residuals(whole(found.x))[0]


def labelled(model: Baseline, runs: Sequence[xr.Dataset]) -> xr.Dataset:
    """A stage as an identification; errors are raised by what the model leaves beyond the noise."""
    from sysid_trib.methods.trajectory import Trajectory

    problem, unknown = model.problem, model.unknown
    count, named = len(problem.library), len(problem.names)
    misfit = np.sqrt(model.chi_square / max(1, len(model.residual) - len(unknown)))
    spread = model.covariance * max(1.0, misfit) ** 2
    keep = [*range(count), *([named] if problem.free else [])]
    covariance = np.zeros((count + 1, count + 1))
    covariance[np.ix_(range(len(keep)), range(len(keep)))] = spread[np.ix_(keep, keep)]
    own = problem.own(unknown)
    levels = [noise.level for noise in model.noises]
    extra = {
        "misfit": (misfit, "1", "RMS of the whitened residual over the noise"),
        **run_noise(levels),
        **start_variables([(angle, rate) for angle, rate, _ in own], own[:, 2]),
    }
    fitted = problem.model(unknown)
    method = Trajectory(
        problem.reference_frequency, "coloured", problem.fit_shapes, shapes=dict(fitted.shapes)
    )
    estimate = Estimate(
        unknown[:count], covariance, fitted.reference_frequency, root_mean_square(levels), extra
    )
    result = identification(
        method, one_or_all(list(runs)), problem.library, estimate, offered=problem.library
    )
    if "shape" in result:
        errors = dict(zip(problem.fit_shapes, np.sqrt(np.diag(spread))[count:named], strict=True))
        values = [errors.get(name, np.nan) for name in result.shape_parameter.values.tolist()]
        result["shape_standard_error"] = result.shape_standard_error.copy(data=values)
    return result
