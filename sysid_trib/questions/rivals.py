"""Competing models of a result: their predictions of a run, and the information of the run."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import Direct
from sysid_trib.motion_fit.least_squares import covariance_root
from sysid_trib.motion_fit.linearised import whitened
from sysid_trib.results import effects, judged, kinds, references, schema, variables
from sysid_trib.results.models import library_of, shape_values_of
from sysid_trib.results.random_force import random_force_of
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE, FREQUENCY, Model
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation import random_force_test

# Odds of the true model at which models are distinguished.
ODDS = 10.0
# Number of draws of parameters and noise for each model's run.
DRAWINGS = 400


# A motion and its derivatives over the noise, (sample, 1 + direction + 3): the angle, its changes by one
# standard error in each direction of the model, and by the unknown start and sensor's zero.
RunPrediction = Array


@dataclass(frozen=True)
class Rival:
    """A competing model.

    Attributes
    ----------
    name : str
    model : Model
    directions : (parameter, direction) array of float
        Directions of its coefficients, shapes and frequency, in this order; their product with their
        transpose is the covariance.
    probability : float
    """

    name: str
    model: Model
    directions: Array
    probability: float

    @property
    def fitted(self) -> list[str]:
        """Coefficients that are not held."""
        errors = np.linalg.norm(self.directions, axis=1)
        return [s for s, error in zip(self.model.coefficients, errors, strict=False) if error > 0.0]


def predicted(
    rival: Rival, time: Array, start: tuple[float, float], noise: float, forcing: tuple[Model, float]
) -> tuple[RunPrediction, float]:
    """Predict a rival after a start (rad, rad/s), in units of the noise, and return its stop time (s).

    The stop time is infinite if the motion continues. `forcing` : model with a random force, and its ratio to
    the noise of a sample; then innovations are predicted.

    Raises
    ------
    SimulationError
        The model has no such motion.
    """
    model, (of_model, ratio) = rival.model, forcing
    names = [*model.coefficients, *model.shapes, FREQUENCY, BY_ANGLE, BY_RATE]
    motion = trajectory(model, time, *start, by=names)
    by = motion.derivatives["angle"]
    columns = np.column_stack([motion.angle, by, np.ones(len(time))]) / noise
    columns = whitened(of_model, time, start, ratio, columns)
    run = np.column_stack([columns[:, 0], columns[:, 1:-3] @ rival.directions, columns[:, -3:]])
    return run, float(np.nan_to_num(motion.stop_time, nan=np.inf))


def _own(run: RunPrediction) -> Array:
    """Remove from a prediction the directions of start and zero, (sample, direction)."""
    known, free = run[:, 1:-3], run[:, -3:]
    return np.asarray(known - free @ np.linalg.lstsq(free, known, rcond=None)[0])


def rivals_of(result: xr.Dataset | xr.DataTree) -> tuple[xr.Dataset, list[Rival], Rival]:
    """Return the competing models of a result: one for an identification, the last set for a discovery.

    Return also the identification of these models, and the model with the stated errors: for a search, that
    of coefficients and shapes together.

    Raises
    ------
    UsageError
        Nothing was identified.
    """
    if isinstance(result, xr.DataTree):
        kinds.check_is_model(result)
    main = judged.main_result(result) if isinstance(result, xr.DataTree) else result
    if main is None or "coefficient" not in main:
        raise UsageError("plan needs a result that identified a model.")
    stated = _stated(main)
    tree = result if isinstance(result, xr.DataTree) and kinds.kind_of(result) == "discover" else None
    if tree is None or not effects.added_effects(tree):
        return main, [stated], stated
    rivals = _of_discovery(tree)
    return main, rivals, next((rival for rival in rivals if rival.name in main.force), stated)


def _stated(result: xr.Dataset) -> Rival:
    """Return the model of an identification with its stated covariance, without the error of the model."""
    model = schema.model_of(result)
    symbols = [s for s in result.force.values.tolist() if s in model.coefficients]
    covariance, total = references.stated_covariance(result, symbols), result.standard_error.values
    of_noise = np.divide(judged.error_parts(result)[0], total, out=np.zeros(len(total)), where=total > 0.0)
    part = np.append(of_noise[np.isin(result.force.values, symbols)], 1.0)
    count, shapes = len(symbols), len(model.shapes)
    directions = np.zeros((count + shapes + 1, count + 1))
    directions[[*range(count), count + shapes]] = covariance_root(covariance * np.outer(part, part))
    return Rival("the model", model, directions, 1.0)


def _of_discovery(tree: xr.DataTree) -> list[Rival]:
    """Return the models with each candidate of the last credible set in place of the last effect."""
    step, after = tree["steps"].to_dataset().isel(step=-1), tree["after"].to_dataset()
    offered, options = effects.candidates_of(tree), json.loads(tree.attrs["options"])
    rest = [force for force in library_of(after) if force.symbol != step.symbol.item()]
    # The evidence of an effect is lower if its coefficient differs from the known physical value.
    misnamed = effects.misnamed_effects(tree)
    known = {f.symbol: f.coefficient for f in offered if f.coefficient and f.symbol not in misnamed}
    records = [tree[group].to_dataset() for group in variables.record_groups(tree)]
    likely, rivals = effects.credible_set(step), list[Rival]()
    for symbol in [symbol for symbol in likely if symbol in offered.symbols]:
        library = ForceLibrary("rival", (*rest, offered[symbol]))
        held = {symbol: c for symbol, c in known.items() if symbol in library.symbols}
        method = Direct(
            options["reference_frequency"],
            shapes=_shapes(step, after, library),
            random_force=random_force_of(after).density or "off",
            constraints=options["constraints"] | held,
        )
        with suppress(SysidTribError):
            rivals.append(_by_records(symbol, method.identify(records, library), records, likely[symbol]))
    total = sum(rival.probability for rival in rivals)
    return [replace(rival, probability=rival.probability / total) for rival in rivals]


def _shapes(step: xr.Dataset, after: xr.Dataset, library: ForceLibrary) -> dict[str, float]:
    """Return a rival's shape parameters from the search, with those of its candidate from the last step."""
    # Results of an older version contain no shapes of candidates.
    shapes = library.shape_values() | shape_values_of(after, library)
    for name in shapes.keys() & set(step.get("competing_shape_parameter", xr.DataArray([])).values.tolist()):
        value = step.competing_shape.sel(competing_shape_parameter=name).item()
        shapes[name] = value if np.isfinite(value) else shapes[name]
    return shapes


def _by_records(name: str, result: xr.Dataset, records: Sequence[xr.Dataset], probability: float) -> Rival:
    """Return a competing model with the covariance of its parameters from the records.

    A shape has a Gaussian prior with the density of a uniform prior over its range, as in the evidence.
    """
    model, library = schema.model_of(result), library_of(result)
    shapes = [(name.partition("."), value) for name, value in model.shapes.items()]
    unit = np.array([library[force].shape[name].slope(value) for (force, _, name), value in shapes])
    held = result.standard_error.sel(force=list(model.coefficients)).values == 0.0
    fitted = result.reference_frequency_standard_error.item() > 0.0
    is_free = np.flatnonzero([*~held, *np.full(len(unit), True), fitted])
    count, at = len(held) + len(unit) + 1, np.arange(len(held), len(held) + len(unit))
    directions = np.eye(count)[:, is_free]
    prior = np.zeros(count)
    prior[at] = 2.0 * np.pi / unit**2
    information, rival = np.diag(prior[is_free]), Rival(name, model, directions, probability)
    for run, record in enumerate(records):
        start = (float(np.ravel(result.start_angle)[run]), float(np.ravel(result.start_rate)[run]))
        noise = variables.noise_of_run(result, run)
        ratio = random_force_of(result, run).per_tau(model.reference_frequency) / noise**2
        own = _own(predicted(rival, record.time.values, start, noise, (model, ratio))[0])
        information += own.T @ own
    size = np.sqrt(np.diag(information))
    covariance = np.linalg.pinv(information / np.outer(size, size), rcond=1e-12, hermitian=True)
    return replace(rival, directions=directions @ covariance_root(covariance / np.outer(size, size)))


def covariance_after(run: RunPrediction) -> Array:
    """Return the directions' covariance after a run with unknown start and zero, relative to that before."""
    own = _own(run)
    return np.asarray(np.linalg.inv(np.eye(own.shape[1]) + own.T @ own))


def _explained_space(run: RunPrediction) -> Array:
    """Return the basis of differences of the motion that a competing model can explain."""
    costs = np.eye(run.shape[1] - 4, run.shape[1] - 1)
    return random_force_test.orthonormal(np.vstack([run[:, 1:], costs]))[: len(run)]


def _sharpened(rival: Rival, run: RunPrediction) -> float:
    """Return half the decrease of the log determinant of the shapes' covariance in a run, negative."""
    # The frequency is the last of the parameters.
    shapes, after = rival.directions[len(rival.model.coefficients) : -1], covariance_after(run)
    was, becomes = (np.linalg.slogdet(shapes @ c @ shapes.T)[1] for c in (np.eye(len(after)), after))
    return float(0.5 * (becomes - was))


def log_odds(pairs: Sequence[tuple[Rival, RunPrediction]]) -> Array:
    """Return the log weights of competing models after a run, (truth, drawing, rival)."""
    rng, (rivals, runs) = np.random.default_rng(0), zip(*pairs, strict=True)
    apart = [np.column_stack([run[:, 0] - runs[0][:, 0], run[:, 1:]]) for run in runs]
    # The part outside of these columns is noise that all models have in common.
    axes = random_force_test.orthonormal(np.column_stack(apart))
    inside = [axes.T @ run for run in apart]
    spaces = [_explained_space(run) for run in inside]
    own = zip(rivals, inside, strict=True)
    weights = [np.log(rival.probability) + _sharpened(rival, run) for rival, run in own]
    normal = rng.standard_normal((DRAWINGS, axes.shape[1]))
    logs = np.empty((len(rivals), DRAWINGS, len(rivals)))
    for at, truth in enumerate(inside):
        by_parameters = rng.standard_normal((DRAWINGS, truth.shape[1] - 4)) @ truth[:, 1:-3].T
        for other, (run, space) in enumerate(zip(inside, spaces, strict=True)):
            residual = truth[:, 0] - run[:, 0] + by_parameters + normal
            deviance = np.sum(residual**2, axis=1) - np.sum((residual @ space) ** 2, axis=1)
            logs[at, :, other] = weights[other] - 0.5 * deviance
    return logs


def informed(probabilities: Array, logs: Array) -> tuple[float, float]:
    """Return the expected entropy (nats) after a run, and the probability of the odds for the true model."""
    logs = logs - logs.max(axis=2, keepdims=True)
    posterior = np.exp(logs) / np.exp(logs).sum(axis=2, keepdims=True)
    entropy = -np.sum(posterior * np.log(np.maximum(posterior, 1e-300)), axis=2).mean(axis=1)
    pairs = enumerate(logs)
    ahead = [of_truth[:, at] - np.delete(of_truth, at, axis=1).max(axis=1) for at, of_truth in pairs]
    right = np.mean(np.array(ahead) > np.log(ODDS), axis=1)
    return float(probabilities @ entropy), float(probabilities @ right)


def parting_of(truth: RunPrediction, run: RunPrediction) -> Array:
    """Return the discrimination D of a run up to each time, (sample,), between two motions."""
    residual, space = truth[:, 0] - run[:, 0], _explained_space(run)
    # r' V^-1 r by Woodbury's identity.
    return np.maximum(0.0, np.cumsum(residual * (residual - space @ (space.T @ residual))))
