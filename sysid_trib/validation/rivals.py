"""The models that a result leaves, what each predicts of a run, and what the run would tell of them."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.likelihood.trials import slope_of_unit
from sysid_trib.methods import Direct
from sysid_trib.motion_fit.least_squares import covariance_root
from sysid_trib.motion_fit.linearised import whitened
from sysid_trib.results.effects import (
    added_effects,
    candidates_of,
    credible_set,
    misnamed_effects,
)
from sysid_trib.results.files import kind_of
from sysid_trib.results.references import stated_covariance
from sysid_trib.results.schema import library_of, model_of, shape_values_of
from sysid_trib.results.variables import noise_of_run, record_groups
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.motions import BY_ANGLE, BY_RATE, FREQUENCY
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.validation.findings import main_result
from sysid_trib.validation.model_error import error_parts
from sysid_trib.validation.random_force_test import orthonormal

# Name of the model of an identification.
STATED = "the model"
# Models are distinguished where the odds of the right one are so high.
ODDS = 10.0
# Of what each model may make a run, its parameters and the noise, as many are drawn.
DRAWINGS = 400


class RunPrediction(NamedTuple):
    """A motion and what may move it, over the noise.

    `angle` : (sample,). `known` : (sample, direction), by one standard error each. `free` : (sample, 3), by
    the start and the sensor's zero, of which nothing is known.
    """

    angle: Array
    known: Array
    free: Array


@dataclass(frozen=True)
class Rival:
    """A model that may be the truth.

    Attributes
    ----------
    name : str
    model : Model
    directions : (parameter, direction) array of float
        Of its coefficients, shapes and frequency; their product with their transpose is the covariance.
    probability : float
    """

    name: str
    model: Model
    directions: Array
    probability: float

    @property
    def shapes(self) -> slice:
        """Where the shapes are among the parameters."""
        first = len(self.model.coefficients)
        return slice(first, first + len(self.model.shapes))

    @property
    def fitted(self) -> list[str]:
        """Its coefficients that are not held."""
        errors = np.linalg.norm(self.directions, axis=1)
        return [s for s, error in zip(self.model.coefficients, errors, strict=False) if error > 0.0]

    def predicted(self, time: Array, start: tuple[float, float], noise: float) -> tuple[RunPrediction, float]:
        """What it predicts after a start (angle, rad, and rate, rad/s), in noise of this standard deviation.

        Beside it when the motion stops (s), infinite if it does not.

        Raises
        ------
        SimulationError
            The model has no such motion.
        """
        *motion, stop = _columns(self.model, time, start)
        angle, columns, free = (part / noise for part in motion)
        return RunPrediction(angle, columns @ self.directions, free), stop


def _columns(model: Model, time: Array, start: tuple[float, float]) -> tuple[Array, Array, Array, float]:
    """A motion (sample,), its derivatives by parameters, and by its start and the sensor's zero; its stop."""
    names = [*model.coefficients, *model.shapes, FREQUENCY, BY_ANGLE, BY_RATE]
    motion = trajectory(model, time, *start, by=names)
    by = motion.derivatives["angle"]
    free = np.column_stack([by[:, -2:], np.ones(len(time))])
    return motion.angle, by[:, :-2], free, float(np.nan_to_num(motion.stop_time, nan=np.inf))


def rivals_of(result: xr.Dataset | xr.DataTree) -> list[Rival]:
    """The models that a result leaves: one of an identification, of a discovery those of its last set.

    Raises
    ------
    UsageError
        Nothing was identified.
    """
    if isinstance(result, xr.DataTree) and kind_of(result) == "discover" and added_effects(result):
        return _of_discovery(result)
    main = main_result(result) if isinstance(result, xr.DataTree) else result
    if main is None or "coefficient" not in main:
        raise UsageError("plan wants a result that identified a model.")
    return [stated_rival(main)]


def stated_rival(result: xr.Dataset) -> Rival:
    """The model of an identification, with the covariance that it states but for the error of the model."""
    model = model_of(result)
    symbols = [s for s in result.force.values.tolist() if s in model.coefficients]
    covariance, total = stated_covariance(result, symbols), result.standard_error.values
    of_noise = np.divide(error_parts(result)[0], total, out=np.zeros(len(total)), where=total > 0.0)
    part = np.append(of_noise[np.isin(result.force.values, symbols)], 1.0)
    count, shapes = len(symbols), len(model.shapes)
    directions = np.zeros((count + shapes + 1, count + 1))
    at = [*range(count), count + shapes]
    directions[at] = covariance_root(covariance * np.outer(part, part))
    return Rival(STATED, model, directions, 1.0)


def _of_discovery(tree: xr.DataTree) -> list[Rival]:
    """The models with each candidate of the last credible set in the place of the last effect."""
    step = tree["steps"].to_dataset().isel(step=-1)
    offered, after = candidates_of(tree), tree["after"].to_dataset()
    rest = [force for force in library_of(after) if force.symbol != step.symbol.item()]
    records = [tree[group].to_dataset() for group in record_groups(tree)]
    likely, rivals = credible_set(step), list[Rival]()
    for symbol in [symbol for symbol in likely if symbol in offered.symbols]:
        library = ForceLibrary("rival", (*rest, offered[symbol]))
        with suppress(SysidTribError):
            fitted = _fitted(tree, library, records)
            rivals.append(Rival(symbol, model_of(fitted), _by_records(fitted, records), likely[symbol]))
    total = sum(rival.probability for rival in rivals)
    return [replace(rival, probability=rival.probability / total) for rival in rivals]


def _fitted(tree: xr.DataTree, library: ForceLibrary, records: Sequence[xr.Dataset]) -> xr.Dataset:
    """The identification of a rival by the records, as the search asks for it."""
    step, after = tree["steps"].to_dataset().isel(step=-1), tree["after"].to_dataset()
    offered, misnamed = candidates_of(tree), misnamed_effects(tree)
    options = json.loads(tree.attrs["options"])
    # The evidence of an effect falls where its coefficient is not the one that physics knows.
    known = {
        force.symbol: force.coefficient
        for force in library
        if force.symbol in offered.symbols and force.coefficient and force.symbol not in misnamed
    }
    # A result that an older version saved has no shapes of candidates.
    shapes = library.shape_values() | shape_values_of(after, library)
    for name in shapes.keys() & set(step.get("competing_shape_parameter", xr.DataArray([])).values.tolist()):
        value = step.competing_shape.sel(competing_shape_parameter=name).item()
        shapes[name] = value if np.isfinite(value) else shapes[name]
    method = Direct(
        options["reference_frequency"],
        shapes=shapes,
        random_force=random_force_of(after).density or "off",
        constraints={**options["constraints"], **known},
    )
    return method.identify(records, library)


def _by_records(result: xr.Dataset, records: Sequence[xr.Dataset]) -> Array:
    """Directions of what records leave of the parameters of a model: by the inverse of their information.

    A shape has a Gaussian prior whose density is that of even ones over its range, as in the evidence.
    """
    model = model_of(result)
    shapes = [(name.partition("."), value) for name, value in model.shapes.items()]
    library = library_of(result)
    unit = np.array([slope_of_unit(library[force].shape[name], value) for (force, _, name), value in shapes])
    held = result.standard_error.sel(force=list(model.coefficients)).values == 0.0
    count = len(held) + len(unit) + 1
    information = np.zeros((count, count))
    at = np.arange(len(held), count - 1)
    information[at, at] = 2.0 * np.pi / unit**2
    for run, record in enumerate(records):
        angle, rate = (float(np.ravel(result[f"start_{name}"])[run]) for name in ("angle", "rate"))
        time, noise = record.time.values, noise_of_run(result, run)
        _, columns, free, _ = _columns(model, time, (angle, rate))
        push = random_force_of(result, run).per_tau(model.reference_frequency)
        columns = whitened(model, time, (angle, rate), push / noise**2, np.hstack([columns, free]))
        columns, free = columns[:, :-3], columns[:, -3:]
        columns = columns - free @ np.linalg.lstsq(free, columns, rcond=None)[0]
        information += columns.T @ columns / noise**2
    fitted = result.reference_frequency_standard_error.item() > 0.0
    is_free = np.flatnonzero([*~held, *np.full(len(unit), True), fitted])
    information = information[np.ix_(is_free, is_free)]
    size = np.sqrt(np.diag(information))
    covariance = np.linalg.pinv(information / np.outer(size, size), rcond=1e-12, hermitian=True)
    directions = np.zeros((count, len(is_free)))
    directions[is_free] = covariance_root(covariance / np.outer(size, size))
    return directions


def covariance_after(run: RunPrediction) -> Array:
    """Covariance of the directions after a run, its start and zero unknown; before it that is one."""
    own = run.known - run.free @ np.linalg.lstsq(run.free, run.known, rcond=None)[0]
    return np.asarray(np.linalg.inv(np.eye(own.shape[1]) + own.T @ own))


def _explained_space(run: RunPrediction) -> Array:
    """Basis of what a rival can make of a difference to its motion, and behind it of what that costs."""
    count = run.known.shape[1]
    return orthonormal(
        np.vstack([np.hstack([run.known, run.free]), np.eye(count, count + run.free.shape[1])])
    )


def _sharpened(rival: Rival, run: RunPrediction) -> float:
    """Half the logarithm by which the covariance of a rival's shapes falls in a run, negative."""
    shapes, after = rival.directions[rival.shapes], covariance_after(run)
    was, becomes = (np.linalg.slogdet(shapes @ c @ shapes.T)[1] for c in (np.eye(len(after)), after))
    return float(0.5 * (becomes - was))


def log_odds(pairs: Sequence[tuple[Rival, RunPrediction]]) -> Array:
    """Logarithms of the weights of rivals after a run, (truth, drawing, rival), each the truth in turn."""
    rng, (rivals, runs) = np.random.default_rng(0), zip(*pairs, strict=True)
    apart = [RunPrediction(run.angle - runs[0].angle, run.known, run.free) for run in runs]
    # What is outside of these columns is noise that all rivals share.
    axes = orthonormal(np.column_stack([column for run in apart for column in run]))
    inside = [RunPrediction(*(axes.T @ part for part in run)) for run in apart]
    spaces = [_explained_space(run)[: axes.shape[1]] for run in inside]
    own = zip(rivals, inside, strict=True)
    weights = [np.log(rival.probability) + _sharpened(rival, run) for rival, run in own]
    normal = rng.standard_normal((DRAWINGS, axes.shape[1]))
    logs = np.empty((len(rivals), DRAWINGS, len(rivals)))
    for at, truth in enumerate(inside):
        by_parameters = rng.standard_normal((DRAWINGS, truth.known.shape[1])) @ truth.known.T
        for other, (run, space) in enumerate(zip(inside, spaces, strict=True)):
            residual = truth.angle - run.angle + by_parameters + normal
            deviance = np.sum(residual**2, axis=1) - np.sum((residual @ space) ** 2, axis=1)
            logs[at, :, other] = weights[other] - 0.5 * deviance
    return logs


def informed(probabilities: Array, logs: Array) -> tuple[float, float]:
    """Entropy (nats) that a run is expected to leave, and the probability of odds for the right model."""
    logs = logs - logs.max(axis=2, keepdims=True)
    posterior = np.exp(logs) / np.exp(logs).sum(axis=2, keepdims=True)
    entropy = -np.sum(posterior * np.log(np.maximum(posterior, 1e-300)), axis=2).mean(axis=1)
    right = [
        np.mean(of_truth[:, at] - np.delete(of_truth, at, axis=1).max(axis=1) > np.log(ODDS))
        for at, of_truth in enumerate(logs)
    ]
    return float(probabilities @ entropy), float(probabilities @ right)


def parting_of(truth: RunPrediction, run: RunPrediction) -> Array:
    """D of a run up to each time, (sample,): one motion is the truth, a rival is to explain it."""
    residual, space = truth.angle - run.angle, _explained_space(run)[: len(run.angle)]
    # r' V^-1 r by the identity of Woodbury.
    return np.maximum(0.0, np.cumsum(residual * (residual - space @ (space.T @ residual))))
