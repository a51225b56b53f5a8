"""Error of a model: the change of its coefficients between parts of a record."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.scope import Method
from sysid_trib.motion_fit.least_squares import sensitivities
from sysid_trib.records.sensor import coarse_step, rounded_noise
from sysid_trib.results import schema, variables
from sysid_trib.results.models import library_of
from sysid_trib.simulation import initial_conditions, motions
from sysid_trib.validation import holdout, refits
from sysid_trib.validation.residuals import FollowedRuns, fitted_motion

RunList = Sequence[xr.Dataset]
FREQUENCIES = ("reference_frequency", "asymptotic_frequency")
ESTIMATED = ("coefficient", *FREQUENCIES)
STATED = ("standard_error", *(f"{name}_standard_error" for name in FREQUENCIES))


def with_error_of_model(
    followed: FollowedRuns, method: Method, library: ForceLibrary, widening: float
) -> FollowedRuns:
    """Include in the errors of an identification the error of its model.

    Parameters
    ----------
    followed : FollowedRuns
        The identification of the whole runs.
    method : Method
        Method of the identification.
    library : ForceLibrary
        The offered forces.
    widening : float
        Factor of the errors if no part can be fitted.

    Returns
    -------
    FollowedRuns
        In its result `covariance`, `standard_error` and the errors of both frequencies are the total ones;
        `error_of_noise(force)` is the error stated by the method, `error_of_model(force)` the rest.
        `held_out_rms` (rad) is the geometric mean of the residuals of samples that the parts do not contain:
        contiguous 15 and 30 % of a run, and for several runs the other half of the runs, with fitted starts;
        nan if a part predicts no motion.

    Notes
    -----
    The first, the middle and the last 70 % of each run are fitted separately. For a complete model, their
    coefficients differ from those of the whole only as much as fewer data explain: the squared error of the
    part minus that of the whole (Hausman 1978). A larger change is the error of the model. If no part can be
    fitted, it is the error that the Birge ratio adds (Birge 1932).
    """
    runs, result = [*followed.runs.values()], followed.result
    whole, own = (_numbers(result, names) for names in (ESTIMATED, STATED))
    parts = fitted_parts(runs, method, library, result)
    if parts.results:
        changes = [_numbers(part, ESTIMATED) - whole for part in parts.results]
        errors = [np.nan_to_num(_numbers(part, STATED)) for part in parts.results]
        of_model = covariance_by_parts(changes, errors, np.nan_to_num(own))
    else:
        of_model = np.diag((widening**2 - 1.0) * np.nan_to_num(own) ** 2)
    model, count = np.sqrt(np.diag(of_model)), result.sizes["force"]
    of = {
        "error_of_noise": own[:count],
        "error_of_model": model[:count],
        "held_out_rms": parts.held_out_rms if parts.results else float("nan"),
    }
    total = _with_errors(result, np.ones(len(own)), of_model)
    return followed.with_result(total.assign(variables.described("identification", of)))


class FittedParts(NamedTuple):
    """Identifications of parts of the runs.

    Attributes
    ----------
    results : list of Dataset
        Identifications of the parts that could be fitted.
    held_out_rms : float, rad
        Geometric mean of the residuals outside of the parts; nan if a part predicts no motion.
    """

    results: list[xr.Dataset]
    held_out_rms: float


def fitted_parts(
    runs: RunList, method: Method, library: ForceLibrary, result: xr.Dataset, *, later_only: bool = False
) -> FittedParts:
    """Identify each of `PARTS_OF_RECORD` of the runs, and every other run, and predict the rest.

    With `later_only` a part predicts only later samples, in which a decay is within the part's range.
    """
    limits = variables.PARTS_OF_RECORD.values()
    parts = [part_fit(method, runs, library, ends, result) for ends in limits]
    # Include each run's copies of its separate forces.
    whole = library_of(result)
    missed = [
        rms
        for part, ends in zip(parts, limits, strict=True)
        for number, run in enumerate(runs)
        for rms in _held_out(part, run, number, whole, ends, later_only)
    ]
    has_own = any(force.run is not None for force in whole)
    for taken, others in ((runs[::2], runs[1::2]), (runs[1::2], runs[::2])):
        # No run determines the separate forces of another one.
        if taken and others and not has_own:
            part = _same_forces(refits.refit(method, taken, library)[0], result)
            begun = None if part is None else part.drop_vars(["start_angle", "start_rate"], errors="ignore")
            missed += [_missed(run, begun) for run in others]
    held_out = float("nan")
    if missed and np.all(np.isfinite(missed)):
        # Without noise the residual of a part may be zero.
        held_out = float(scipy.stats.gmean(missed))
    return FittedParts([part for part in parts if part is not None], held_out)


def with_error_by_another_fit(result: xr.Dataset, other: xr.Dataset) -> xr.Dataset:
    """Return an identification whose errors include another, equally plausible fit of the same forces.

    Parameters
    ----------
    result, other : Dataset
        Identifications of the same forces and records, with different noises.

    Returns
    -------
    Dataset
        `covariance`, `standard_error` and the errors of both frequencies are the total ones; `error_of_model`
        is the distance to the other fit plus that fit's errors; `error_of_noise` is the original error of the
        result. Held values have no error.
    """
    own, count = np.nan_to_num(_numbers(result, STATED)), result.sizes["force"]
    free = own > 0.0
    changes = np.where(free, _numbers(other, ESTIMATED) - _numbers(result, ESTIMATED), 0.0)
    errors = np.where(free, np.nan_to_num(_numbers(other, STATED)), 0.0)
    of_model = np.outer(changes, changes) + np.diag(errors**2)
    of = {"error_of_noise": own[:count], "error_of_model": np.sqrt(np.diag(of_model))[:count]}
    total = _with_errors(result, np.ones(len(own)), of_model)
    return total.assign(variables.described("identification", of))


def covariance_by_parts(
    changes: Sequence[Array], errors: Sequence[Array], stated: Array, *, equal_parts: bool = False
) -> Array:
    """Return the covariance of the model error: changes between parts beyond those due to fewer data.

    Parameters
    ----------
    changes, errors : sequence of (number,) array of float
        For each part: its values minus those of the whole, and their standard errors due to the noise.
    stated : (number,) array of float
        Standard errors of the whole due to the noise.
    equal_parts : bool
        Whether all parts have equal weights; otherwise each is weighted by its information on each number.
    """
    # Each part is weighted by its information on a coefficient; a coefficient held at a bound there has no
    # error.
    largest = np.max(errors, axis=0)
    known = np.where(np.array(errors) > 0.0, errors, np.where(largest > 0.0, largest, 1.0))
    weights = 1.0 / known**2
    if equal_parts:
        weights = np.ones_like(known)
    weights /= weights.sum(axis=0)
    steps = np.sqrt(weights) * np.array(changes)
    movement, expected = steps.T @ steps, (weights * (np.square(errors) - stated**2)).sum(axis=0)
    size = np.diag(movement)
    excess = np.maximum(size - np.maximum(expected, 0.0), 0.0)
    factor = np.sqrt(np.divide(excess, size, out=np.zeros_like(size), where=size > 0.0))
    return np.asarray(movement * np.outer(factor, factor))


def part_fit(
    method: Method, runs: RunList, library: ForceLibrary, limits: tuple[float, float], result: xr.Dataset
) -> xr.Dataset | None:
    """Return the identification of a part of each run; None if it fails, or has other forces."""
    parts = [run.isel(time=refits.between(run, limits)) for run in runs]
    return _same_forces(refits.refit(method, parts, library, runs)[0], result)


def _same_forces(part: xr.Dataset | None, result: xr.Dataset) -> xr.Dataset | None:
    """Return identification of a part where it has finite coefficients of the same forces as the result."""
    if part is None or part.force.values.tolist() != result.force.values.tolist():
        return None
    return part if np.all(np.isfinite(_numbers(part, ESTIMATED))) else None


def _held_out(
    part: xr.Dataset | None,
    run: xr.Dataset,
    number: int,
    library: ForceLibrary,
    limits: tuple[float, float],
    later_only: bool,
) -> Iterator[float]:
    """Yield the RMS residual (rad) of the model of a part before and after it; nan without a motion."""
    kept, size = refits.between(run, limits), run.sizes["time"]
    earlier, later = slice(0, kept.start), slice(kept.stop, size)
    for held_out in (later,) if later_only else (earlier, later):
        # With fewer samples, a motion with fitted start and zero is not tested.
        if held_out.stop - held_out.start < 8:
            continue
        rest, before = run.isel(time=held_out), run.isel(time=slice(0, held_out.start + 1))
        yield _missed(rest, None if part is None else holdout.carried_on(part, library, before), number)


def _missed(rest: xr.Dataset, result: xr.Dataset | None, number: int = 0) -> float:
    """Return the residual RMS (rad) of a model with fitted start and zero; nan without a motion."""
    if result is None:
        return float("nan")
    # A very stiff model gives no prediction: limit its steps.
    motion = fitted_motion(rest, result, number, most_steps=motions.FEW_STEPS_A_PERIOD)
    if motion is None:
        return float("nan")
    return root_mean_square(rest.angle.values - motion.offset - motion.x)


def _numbers(result: xr.Dataset, names: Sequence[str]) -> Array:
    """Return the variables `ESTIMATED` or `STATED` of an identification; nan if missing."""
    return np.concatenate([np.ravel(result[name].values) for name in names])


def _with_errors(result: xr.Dataset, factor: Array, added: Array) -> xr.Dataset:
    """Return a result whose `STATED` errors are multiplied by factors, with a covariance added."""
    count = result.sizes["force"]
    of_forces, errors = factor[:count], np.hypot(factor * _numbers(result, STATED), np.sqrt(np.diag(added)))
    changed = {
        "covariance": result["covariance"] * np.outer(of_forces, of_forces) + added[:count, :count],
        "frequency_covariance": result.frequency_covariance * of_forces * factor[-1] + added[:count, -1],
    }
    for name, values in zip(STATED, (errors[:count], *errors[count:]), strict=True):
        changed[name] = result[name].copy(data=values)
    return result.assign({name: values.assign_attrs(result[name].attrs) for name, values in changed.items()})


def with_rounding(followed: FollowedRuns) -> FollowedRuns:
    """Include the coarse step of a sensor, whose rounding is not white, in the errors of an identification.

    They come from least squares, to first order, on simulated motions of the (complete) model, which the
    sensor rounds with a random zero.
    """
    result, squares = followed.result, []
    stated, runs = _numbers(result, STATED), followed.runs
    for (at, run), motion in zip(runs.items(), followed.motions, strict=True):
        noise = variables.noise_of_run(result, at)
        step = coarse_step(run, noise)
        if step and motion is not None:
            squares.append(_squares_by_rounding(result, run, motion, rounded_noise(motion.x, step, noise)))
    if not squares:
        return followed
    by_rounding = np.sqrt(np.mean(squares, axis=0) / len(runs))
    factor = np.maximum(1.0, np.divide(by_rounding, stated, out=np.ones_like(stated), where=stated > 0.0))
    return followed.with_result(_with_errors(result, factor, np.zeros((len(factor), len(factor)))))


def _squares_by_rounding(
    result: xr.Dataset, run: xr.Dataset, motion: initial_conditions.FittedMotion, noises: Iterable[Array]
) -> Array:
    """Return the mean squared effect of noises on `ESTIMATED` in least squares of a motion; 0 if none."""
    model, free = schema.model_of(result), _numbers(result, STATED)[:-1] > 0.0
    squares = np.zeros(len(free) + 1)
    try:
        columns = sensitivities(model, run.time.values, np.array([motion.angle, motion.rate]), True)
    except SysidTribError:
        return squares
    count = len(model.coefficients)
    places = [*np.flatnonzero(np.isin(result.force.values, list(model.coefficients))), len(free) - 1]
    by, kept = [*range(count), count + 2], free[places]
    start = np.column_stack([columns[:, count : count + 2], np.ones(len(columns))])
    design = np.column_stack([columns[:, by][:, kept], start])
    size = np.linalg.norm(design, axis=0)
    steps = np.linalg.lstsq(design / size, np.column_stack(list(noises)), rcond=1e-10)[0] / size[:, None]
    squares[np.array(places)[kept]] = np.mean(steps[: np.count_nonzero(kept)] ** 2, axis=1)
    squares[-1] = squares[-2]
    return squares
