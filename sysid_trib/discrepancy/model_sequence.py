"""The models on the way from the start to the end of a search, and how each predicts what it has not seen."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline, fit, fit_records
from sysid_trib.discrepancy.candidate_fits import without_force
from sysid_trib.discrepancy.stepwise_search import Search
from sysid_trib.errors import SysidTribError
from sysid_trib.noise.level import sensor_noise
from sysid_trib.results.birge import birge_ratio
from sysid_trib.trajectory_fit.initial_conditions import first_guess, fit_start
from sysid_trib.trajectory_fit.least_squares import rms
from sysid_trib.trajectory_fit.problem import WhitenedRecord
from sysid_trib.trajectory_fit.result import FitEstimate
from sysid_trib.validation.holdout import counted_from, first_held_out

# Evaluations of a fit between two models.
EVALUATIONS = 20
# A hold-out residual that grows by more than this factor is flagged.
WORSE = 1.05


def model_sequence(
    search: Search, runs: Sequence[xr.Dataset], unseen: Sequence[xr.Dataset]
) -> tuple[list[Baseline], Array]:
    """The start model, and the models with one, two, ... of the effects that were added.

    Parameters
    ----------
    search : Search
        The search.
    runs : sequence of xr.Dataset
        Its decays.
    unseen : sequence of xr.Dataset
        Runs, or other parts of the same records, that took no part. Without any the models are fitted again
        on the first two thirds of each run, and predict the rest.

    Returns
    -------
    models : list of Baseline
        The start model, and one with each effect more.
    holdout : (model,) array of float, rad
        RMS residual of each on the hold-out.

    Notes
    -----
    A model that predicts has its initial conditions and the sensor's zero fitted to what it predicts, nothing
    else.
    """
    models = [search.selection_steps[0].before]
    for count in range(1, len(search.added)):
        models.append(_between(search, count, models[-1]))
    if search.added:
        models.append(search.final)
    return models, np.array([_held_out(model, runs, unseen) for model in models])


def _between(search: Search, count: int, before: Baseline) -> Baseline:
    """The model with the first effects: the best that the search had, else a fit from below or from above."""
    wanted = {*search.selection_steps[0].before.problem.parameters.library.symbols, *search.added[:count]}
    models = [
        step.before
        for step in search.selection_steps
        if set(step.before.problem.parameters.library.symbols) == wanted
    ]
    if models:
        return min(models, key=lambda model: model.chi_square)
    problem, values = search.final.problem, search.final.values
    model = search.final
    for symbol in search.added[count:]:
        problem, values = without_force(model, symbol)
        model = replace(model, problem=problem, values=values)
    # From below: the parameters of the model before, and those of the new effect as they are in the end.
    first = dict(zip(problem.parameters.common, values.tolist(), strict=False))
    mixed = problem.parameters.take(before.problem.parameters, before.values, first)
    below = fit(problem, mixed, search.final.noises, evaluations=EVALUATIONS)
    if residual_rms(below) <= residual_rms(before):
        return below
    above = fit(problem, values, search.final.noises, far=True)
    return min(below, above, key=residual_rms)


def residual_rms(model: Baseline) -> float:
    """RMS residual of a model over all runs (rad)."""
    return rms(np.concatenate(model.problem.residuals(model.values)))


def _held_out(model: Baseline, runs: Sequence[xr.Dataset], unseen: Sequence[xr.Dataset]) -> float:
    """RMS residual (rad) of a model on the hold-out, nan if it has no motion there."""
    starts = [float(record.time[0]) for record in model.problem.records]
    try:
        if unseen:
            return _predicted(model, fit_records(unseen), [_origin(part, runs) for part in unseen])
        cut = [first_held_out(record.time) for record in model.problem.records]
        first, last = zip(*map(_split, model.problem.records, cut), strict=True)
        trained = fit(replace(model.problem, records=first), model.values, model.noises, far=True)
        return _predicted(trained, last, starts)
    except SysidTribError:
        return float("nan")


def _origin(part: xr.Dataset, runs: Sequence[xr.Dataset]) -> float:
    """Time from which `t` counts: the first sample of the record that the part is from, else its own."""
    name = part.attrs.get("record_checksum")
    same = [run for run in runs if name and run.attrs.get("record_checksum") == name]
    return float((same or [part])[0].time.values[0])


def _split(record: WhitenedRecord, cut: int) -> tuple[WhitenedRecord, WhitenedRecord]:
    return (
        replace(record, time=record.time[:cut], angle=record.angle[:cut]),
        replace(record, time=record.time[cut:], angle=record.angle[cut:]),
    )


def _predicted(trained: Baseline, records: Sequence[WhitenedRecord], origins: Sequence[float]) -> float:
    """RMS residual on records, their initial conditions fitted; `t` counts from an origin of each."""
    model = trained.problem.parameters.model(trained.values)
    residuals = []
    for record, origin in zip(records, origins, strict=True):
        time, angle = record.time, record.angle
        later = replace(model, library=counted_from(model.library, float(time[0] - origin)))
        motion = fit_start(later, time, angle, first_guess(time, angle, model.reference_frequency))
        residuals.append(angle - motion.offset - motion.x)
    return rms(np.concatenate(residuals))


def model_identification(model: Baseline, runs: Sequence[xr.Dataset]) -> xr.Dataset:
    """A model as an identification; where its residual is larger than the noise, its errors are too."""
    from sysid_trib.methods.trajectory import Trajectory

    parameters = model.problem.parameters
    ratio = birge_ratio(model.chi_square, len(model.residual) - len(parameters))
    covariance = model.covariance * max(1.0, ratio) ** 2
    innovations = [noise.innovation for noise in model.noises]
    method = Trajectory(parameters.reference_frequency, "coloured", parameters.fit_shapes, random_force="off")
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (ratio, "1", "Birge ratio of the whitened residual"),
        "innovation_noise": (innovations, "rad", "standard deviation of the noise model's innovations"),
    }
    estimate = FitEstimate(model.problem, model.values, covariance, [sensor_noise(run) for run in runs])
    return estimate.identification(method, runs, parameters.library, extra)
