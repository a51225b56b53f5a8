"""The next run: which release and duration tell competing models apart, or give a wanted error."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SysidTribError, Tell, UsageError, silent
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.methods import Direct
from sysid_trib.motion_fit.cramer_rao import sensitivities
from sysid_trib.results.effects import added_effects, candidates_of, credible_set, shapes_of
from sysid_trib.results.files import kind_of
from sysid_trib.results.references import stated_covariance
from sysid_trib.results.schema import library_of, model_of
from sysid_trib.results.variables import Variables, signal_units, variable
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.validation.findings import main_result
from sysid_trib.validation.model_error import error_parts

Span: TypeAlias = tuple[float | None, float | None]
# Releases and durations that are tried between the limits, in equal ratios.
RELEASES, DURATIONS = 7, 4
# Without limits: these parts of the release and the duration of the record.
AMPLITUDE_LIMITS, DURATION_LIMITS = (0.3, 1.5), (0.5, 2.0)
# Models are distinguished where the odds of the right one are so high.
ODDS = 10.0


class Sensor(NamedTuple):
    """How runs are sampled: rate (Hz), how often each is made, noise of their mean, unit of the signal."""

    rate: float
    repeats: int
    noise: float
    unit: str


@dataclass(frozen=True)
class Rival:
    """A model that may be the truth.

    Attributes
    ----------
    name : str
    model : Model
    covariance : (parameter, parameter) array of float
        Of its coefficients and its frequency, by what is known.
    probability : float
    """

    name: str
    model: Model
    covariance: Array
    probability: float

    def motion(self, time: Array, amplitude: float) -> tuple[Array, Array]:
        """Angle after a release from rest, (sample,), and its derivatives by parameters, start and zero."""
        angle = trajectory(self.model, time, amplitude, 0.0).angle
        columns = sensitivities(self.model, time, np.array([amplitude, 0.0]), True)
        count = len(self.model.coefficients)
        order = [*range(count), count + 2, count, count + 1]
        return angle, np.column_stack([columns[:, order], np.ones(len(time))])


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
    return [_rival("the model", main, 1.0)]


def _rival(name: str, result: xr.Dataset, probability: float) -> Rival:
    symbols = [s for s in result.force.values.tolist() if s in model_of(result).coefficients]
    return Rival(name, model_of(result), stated_covariance(result, symbols), probability)


def _of_discovery(tree: xr.DataTree) -> list[Rival]:
    """The final model, and those with another of the last credible set in the place of its last effect."""
    step = tree["steps"].to_dataset().isel(step=-1)
    likely, offered, after = credible_set(step), candidates_of(tree), tree["after"].to_dataset()
    named, decay = step.symbol.item(), tree["record" if "record" in tree else "record_1"].to_dataset()
    ranking = tree["ranking"].to_dataset().isel(selection_step=-1, missing_dims="ignore")
    rivals = [_rival(named, after, likely[named])]
    rest = [force for force in library_of(after) if force.symbol != named]
    for symbol in [other for other in likely if other != named and other in offered.symbols]:
        library = ForceLibrary("rival", (*rest, offered[symbol]))
        shapes = {f"{symbol}.{key}": value for key, value in shapes_of(ranking, symbol).items()}
        try:
            result_of_rival = Direct(shapes=shapes, random_force="off").identify(decay, library)
        except SysidTribError:
            continue
        rivals.append(_rival(symbol, result_of_rival, likely[symbol]))
    total = sum(rival.probability for rival in rivals)
    return [replace(rival, probability=rival.probability / total) for rival in rivals]


def plan(
    result: xr.Dataset | xr.DataTree,
    *,
    amplitude: Span = (None, None),
    duration: Span = (None, None),
    sampling_rate: float | None = None,
    repeats: int = 1,
    wanted: Mapping[str, float] | None = None,
    tell: Tell = silent,
) -> xr.Dataset:
    """Rank runs that may be made next by what they would tell.

    Parameters
    ----------
    result : Dataset or DataTree
        Of `identify`, or of `discover`, whose last effect may be any of its credible set.
    amplitude, duration : (float, float)
        Limits of the release (in the unit of the record) and of the time that is recorded (s); None for 0.3
        and 1.5 times the record's release, half of and twice its duration.
    sampling_rate : float, Hz
        That of the record where left out.
    repeats : int
        How often each run is made.
    wanted : mapping of str to float
        Standard errors that are wanted, `{"delta": 0.0005}`.
    tell : callable
        Called with each run.

    Returns
    -------
    Dataset
        Over `run`, the best first: `amplitude`, `duration` (s), `samples`; `entropy` that is left of the
        models (nats; 0 of one model) and the `probability` that the right one has odds of 10 against each
        other; `standard_error(run, force)` of the model's coefficients by all records together, the error
        of the model added, and whether it `meets` what is wanted. `parting(time)` of the best run: by how
        much the two likeliest models part up to each time, as the logarithm of their likelihood ratio.
        attrs: `models` with their `probabilities`, `sampling_rate`, `repeats`; `random_force`, 1 where one
        pushes what is known: it is left out of the noise, and the next run tells less than is said.

    Raises
    ------
    UsageError
        No limits can be had from the result, or a coefficient is wanted that the model has not.
    DecayError
        No run within the limits has a motion.

    Notes
    -----
    A run tells two models apart by D = r' V^-1 r: r the difference of their motions, V the noise, and what
    the wrong one can make of r within what the record left of its parameters, its start and the sensor's
    zero. The logarithm of their likelihood ratio is then normal with mean D/2 and variance D, parameters
    integrated out (Box and Hill 1967). Errors are the inverse of Fisher's informations of all runs.
    """
    rivals = rivals_of(result)
    main = main_result(result) if isinstance(result, xr.DataTree) else result
    assert main is not None
    wanted = dict(wanted or {})
    if missing := set(wanted) - set(rivals[0].model.coefficients):
        raise UsageError(f"There is no coefficient '{min(missing)}' in this model to want an error of.")
    releases, durations, rate = _limits(result, amplitude, duration, sampling_rate)
    noise = float(np.ravel(main.noise)[0]) / np.sqrt(repeats)
    runs = list(itertools.product(releases, durations))
    rows = []
    for at, (release, length) in enumerate(runs):
        tell(f"release {release:.3g}, {length:.3g} s", at / len(runs))
        rows.append(_worth(rivals, main, release, length, rate, noise))
    if not any(np.isfinite(row[0]) for row in rows):
        raise DecayError("No run within these limits has a motion; take others.")
    stochastic = any(random_force_of(main, run) for run in range(main.sizes.get("run", 1)))
    made = _dataset(rivals, runs, rows, wanted, Sensor(rate, repeats, noise, signal_units(main)))
    return made.assign_attrs(random_force=int(stochastic))


def _limits(
    result: xr.Dataset | xr.DataTree, amplitude: Span, duration: Span, sampling_rate: float | None
) -> tuple[Array, Array, float]:
    """Releases, durations (s) and sampling rate (Hz) that are tried."""
    known = (np.nan, np.nan, np.nan)
    group = next((k for k in ("record", "record_1") if k in getattr(result, "children", ())), None)
    if group is not None:
        record = result[group]
        time, angle = record.time.values, record.angle.values
        known = float(np.abs(angle).max()), float(time[-1] - time[0]), 1.0 / float(np.median(np.diff(time)))
    releases = _between(amplitude, AMPLITUDE_LIMITS, known[0], RELEASES, "amplitude")
    durations = _between(duration, DURATION_LIMITS, known[1], DURATIONS, "duration")
    rate = known[2] if sampling_rate is None else sampling_rate
    if not rate > 0.0:
        raise UsageError("Give the sampling_rate: the result keeps no record that has one.")
    return releases, durations, rate


def _between(limits: Span, parts: tuple[float, float], known: float, count: int, name: str) -> Array:
    """Values in equal ratios between limits, those left out by what the record has."""
    low, high = (part * known if end is None else end for end, part in zip(limits, parts, strict=True))
    if not 0.0 < low <= high:
        raise UsageError(f"Give limits of {name}, LOW:HIGH, both above zero and the lower one first.")
    return np.geomspace(low, high, count if high > low else 1)


def _times(length: float, rate: float) -> tuple[Array, float]:
    """Times of a run, no more than the design needs, and of how many samples each stands for."""
    samples = int(length * rate) + 1
    # A run has no more samples than this in the design: what it tells grows with them alike in all.
    every = max(1, -(-samples // 4000))
    return np.arange(0, samples, every) / rate, float(every)


def _worth(
    rivals: Sequence[Rival], main: xr.Dataset, release: float, length: float, rate: float, noise: float
) -> tuple[float, float, Array]:
    """Entropy that is left, probability of odds for the right model, and errors by all records together."""
    time, every = _times(length, rate)
    level = noise / np.sqrt(every)
    errors = np.full(len(rivals[0].model.coefficients), np.nan)
    try:
        motions = [rival.motion(time, release) for rival in rivals]
    except SysidTribError:
        return np.nan, np.nan, errors
    errors = _errors_after(rivals[0], motions[0][1] / level, main)
    apart = np.zeros((len(rivals), len(rivals)))
    for (first, truth), (other, motion) in itertools.permutations(enumerate(motions), 2):
        apart[first, other] = _parting(truth, motion, rivals[other], level)[-1]
    return *_informed(np.array([rival.probability for rival in rivals]), apart), errors


def _errors_after(rival: Rival, columns: Array, main: xr.Dataset) -> Array:
    """Standard errors of the coefficients by what is known and a run, its start and zero unknown."""
    count, size = len(rival.covariance), np.sqrt(np.diag(rival.covariance))
    free = np.flatnonzero(size > 0.0)
    own, start = columns[:, free] * size[free], columns[:, count:]
    own = own - start @ np.linalg.lstsq(start, own, rcond=None)[0]
    before = np.linalg.pinv(rival.covariance[np.ix_(free, free)] / np.outer(size[free], size[free]))
    of_noise = np.zeros(count)
    of_noise[free] = size[free] * np.sqrt(np.diag(np.linalg.inv(before + own.T @ own)))
    of_model = error_parts(main)[1]
    return np.hypot(of_noise[:-1], of_model if len(of_model) == count - 1 else 0.0)


def _parting(truth: tuple[Array, Array], motion: tuple[Array, Array], rival: Rival, level: float) -> Array:
    """D of a run up to each time, (sample,): one motion is the truth, a rival is to explain it."""
    residual = (truth[0] - motion[0]) / level
    count = len(rival.covariance)
    size = np.sqrt(np.diag(rival.covariance))
    free = np.flatnonzero(size > 0.0)
    scaled = rival.covariance[np.ix_(free, free)] / np.outer(size[free], size[free])
    prior = np.zeros((len(free) + 3, len(free) + 3))
    prior[: len(free), : len(free)] = np.linalg.pinv(scaled, hermitian=True)
    design = np.column_stack([motion[1][:, free] * size[free], motion[1][:, count:]]) / level
    norm_of = np.linalg.norm(design, axis=0)
    norm_of[norm_of == 0.0] = 1.0
    design, prior = design / norm_of, prior / np.outer(norm_of, norm_of)
    best = np.linalg.lstsq(design.T @ design + prior, design.T @ residual, rcond=1e-12)[0]
    # r' V^-1 r by the identity of Woodbury.
    return np.maximum(0.0, np.cumsum(residual * (residual - design @ best)))


def _informed(probabilities: Array, apart: Array) -> tuple[float, float]:
    """Entropy (nats) that a run is expected to leave, and the probability of odds for the right model."""
    count = len(probabilities)
    if count == 1:
        return 0.0, 1.0
    rng = np.random.default_rng(0)
    entropy = right = 0.0
    for at, probability in enumerate(probabilities):
        distance = apart[at]
        # Drawings of what a run may say, for the entropy that is left.
        normal = rng.standard_normal((400, count))
        gains = -(0.5 * distance + np.sqrt(distance) * normal)
        gains[:, at] = 0.0
        logs = np.log(np.maximum(probabilities, 1e-300)) + gains
        logs -= logs.max(axis=1, keepdims=True)
        posterior = np.exp(logs) / np.exp(logs).sum(axis=1, keepdims=True)
        entropy += probability * float(
            -np.sum(posterior * np.log(np.maximum(posterior, 1e-300)), axis=1).mean()
        )
        others = np.delete(gains, at, axis=1).max(axis=1)
        right += probability * float(np.mean(others < -np.log(ODDS)))
    return entropy, right


def _dataset(
    rivals: Sequence[Rival],
    runs: Sequence[tuple[float, float]],
    rows: Sequence[tuple[float, float, Array]],
    wanted: Mapping[str, float],
    sensor: Sensor,
) -> xr.Dataset:
    """The Dataset of `plan`, the best run first."""
    symbols = list(rivals[0].model.coefficients)
    entropy, probability = (np.array([row[at] for row in rows]) for at in (0, 1))
    errors = np.array([row[2] for row in rows])
    limits = np.array([wanted.get(symbol, np.inf) for symbol in symbols])
    meets = np.all(errors <= limits, axis=1)
    release, length = np.array(runs).T
    # How far a run is from what is wanted; of runs that tell as much the shorter is the better.
    lacking = np.max(np.where(np.isfinite(limits), errors / limits, 0.0), axis=1)
    open_names = (
        np.round(entropy, 3) if len(rivals) > 1 else np.prod(errors / np.nanmin(errors, axis=0), axis=1)
    )
    first = np.where(meets, 0.0, lacking) if wanted else open_names
    order = np.array([at for at in np.lexsort((length, open_names, first)) if np.isfinite(entropy[at])])
    if wanted:
        order = order[np.lexsort((np.where(meets, length, 0.0)[order], first[order]))]
    per_force = ("run", "force")
    variables: Variables = {
        "amplitude": variable("run", release[order], "release", sensor.unit),
        "duration": variable("run", length[order], "time that is recorded", "s"),
        "samples": variable("run", (length[order] * sensor.rate).astype(int) + 1, "samples"),
        "entropy": variable("run", entropy[order], "entropy of the models that is left", "nat"),
        "probability": variable("run", probability[order], "probability of odds for the right model", "1"),
        "standard_error": variable(per_force, errors[order], "standard error by all records", "of the force"),
        "meets": variable("run", meets[order], "whether it meets what is wanted"),
    }
    data = xr.Dataset(variables, {"force": symbols})
    if len(rivals) > 1:
        time, every = _times(length[order[0]], sensor.rate)
        first, second = sorted(rivals, key=lambda rival: -rival.probability)[:2]
        motions = [rival.motion(time, release[order[0]]) for rival in (first, second)]
        parting = _parting(motions[0], motions[1], second, sensor.noise / np.sqrt(every))
        data = data.assign_coords(time=time).assign(
            parting=variable("time", 0.5 * parting, "logarithm of the likelihood ratio up to a time", "nat")
        )
    return data.assign_attrs(
        models=[rival.name for rival in rivals],
        probabilities=[float(rival.probability) for rival in rivals],
        odds=ODDS,
        sampling_rate=sensor.rate,
        repeats=sensor.repeats,
        wanted=dict(wanted),
    )
