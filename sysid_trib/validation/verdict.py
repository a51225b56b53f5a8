"""Verdict on a record and the preferred method: noise of the identification, and its errors."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib import forces
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary, LibraryLike
from sysid_trib.forces.library import load_library
from sysid_trib.forces.offered import with_inputs_acting
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, sensor_noise_of
from sysid_trib.methods import Averaging, method_of
from sysid_trib.methods.options import with_random_force
from sysid_trib.methods.scope import Method, scope_of
from sysid_trib.records import inputs, smoothing
from sysid_trib.records.roles import INPUT
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.results import effects, models, signal_scale, variables
from sysid_trib.results.models import forces_in_model
from sysid_trib.results.random_force import DEPENDENCE_LEVEL, is_found, random_force_of
from sysid_trib.validation import judge, model_error
from sysid_trib.validation.judge import Evidence, evidence_of
from sysid_trib.validation.random_force_test import ASPECTS, ON, dependence, dependence_on_motion
from sysid_trib.validation.residuals import FollowedRuns, residuals

# Families of methods that fit the motion, and so can detect a random force in it.
DECIDING = ("direct", "trajectory")
# Level at which the residual of a free motion depends on the amplitude, tested before a random force is
# estimated.
AMPLITUDE_LEVEL = 1e-6
# Noise above this multiple of the sensor's is more than an estimation error.
MARKED = 1.5


def widening(result: xr.Dataset, residual_over_noise: float) -> float:
    """Return the factor by which stated errors are widened if a model is incomplete; at least 1.

    Parameters
    ----------
    result : Dataset
        An identification.
    residual_over_noise : float
        RMS of record minus model over the noise.

    Notes
    -----
    Birge 1932: errors due to noise alone times the residual over the noise. Errors that a method has already
    multiplied by the Birge ratio of its equations are not widened twice. A random force is already included
    in the errors.
    """
    # This uses the residual of the free motion. `discovery.screen.Screening.widening` uses scores of the
    # omnibus test, because with a random force the free motion departs from the record even for a complete
    # model.
    stated = max(1.0, float(result.get("birge_ratio", 1.0)))
    return 1.0 if random_force_of(result) else max(1.0, residual_over_noise / stated)


def tested_runs(followed: FollowedRuns) -> xr.Dataset:
    """Return `random_force_dependence` over `run`; `reason` if the motion does not converge.

    Parameters
    ----------
    followed : FollowedRuns
        All runs of an identification with a random force.
    """
    tested = [_dependence(followed, at, bool(random_force_of(followed.result, at))) for at in followed.runs]
    return xr.concat(tested, "run", combine_attrs="override")


def _dependence(followed: FollowedRuns, run: int, stochastic: bool = True) -> xr.Dataset:
    """Return `dependence_on_motion` of a run, computed once; nan if the motion does not converge."""
    nothing, reason = np.full((len(ASPECTS), len(ON)), np.nan), ""
    # Without a random force in a run, no dependence can be tested.
    tested = dependence((1.0, *[np.nan] * 4), nothing)
    try:
        followed.tracked(run)
        if stochastic:
            tested = followed.once(f"dependence {run}", lambda: dependence_on_motion(followed, run))
    except SysidTribError as error:
        tested, reason = dependence([np.nan] * 5, nothing), str(error)
    return tested.assign(variables.described("random_force", {"reason": reason}))


def evidence_of_models(table: xr.Dataset, followed: Mapping[str, FollowedRuns]) -> dict[str, Evidence]:
    """Return the evidence on each model of `judged`; evidence on the noise is from the last one.

    Parameters
    ----------
    table : Dataset
        Result of `judged`.
    followed : mapping of str to FollowedRuns
        All runs of each identification, by the name of its model.
    """
    last = [*followed.values()][-1]
    random = is_found(random_force_of(last.result))
    white = bool(np.nanmax(table.p_value.values) >= WHITE_LEVEL)
    hides = white and not random and _noise_hides_a_force(last)
    evidence = {}
    for name, of in followed.items():
        evidence[name] = evidence_of(
            table.sel(model=name),
            has_random_force=random,
            noise_hides_a_force=hides,
            determines=effects.determines(of.result),
            rows_are_noise=float(of.result.get("birge_ratio", np.inf)) <= MARKED,
        )
    return evidence


def judged_models(
    followed: Mapping[str, FollowedRuns],
    records: Sequence[xr.Dataset],
    tested: xr.Dataset,
    *,
    preferred: str | Callable[[xr.Dataset], str],
    made_by: str,
    random_force_p: float | None = None,
    replaced: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Judge the models of a result and give each its verdict.

    Parameters
    ----------
    followed : mapping of str to FollowedRuns
        All runs of each identification, by the name of its model; the noise is that of the last.
    records, tested
        See `judge.judged`.
    preferred : str or callable
        Name of the preferred model, or a function that returns it for a table of `judge.judged`.
    made_by : str
        Name of the function that made the result.
    random_force_p : float, optional
        P-value that the random force of the last model is independent of motion and time, if known.
    replaced : mapping of str to array_like, optional
        Variables of the table that the caller has computed better.
    """
    last = [*followed.values()][-1]
    if random_force_p is None:
        random_force_p = float("nan")
        if is_found(random_force_of(last.result)):
            random_force_p = p_value_of_dependence(tested_runs(last))
    results = {name: of.result for name, of in followed.items()}
    table = judge.judged(records, results, tested, random_force_p=random_force_p)
    table = table.assign(variables.described("judged", replaced or {}))
    name = preferred if isinstance(preferred, str) else preferred(table)
    return judge.with_verdicts(table, evidence_of_models(table, followed), name, made_by)


def is_random(followed: FollowedRuns) -> bool:
    """Return true if the random force and coloured noise of an identification are really random.

    Parameters
    ----------
    followed : FollowedRuns
        All runs of an identification with a random force.
    """
    if is_found(random_force_of(followed.result)):
        return p_value_of_dependence(tested_runs(followed)) >= DEPENDENCE_LEVEL
    coloured = any(sensor_noise_of(followed.result, at).warm_up for at in followed.runs)
    return coloured and not _noise_hides_a_force(followed)


def _noise_hides_a_force(followed: FollowedRuns) -> bool:
    """Return true if the estimated sensor noise is too large and depends on the motion.

    A method that estimates the colour of the noise with a random force mistakes a slow force for one of them.
    """
    if "random_force_density" not in followed.result:
        return False
    for at, decay in followed.runs.items():
        if _unfound_random_force_hides_more(followed, at):
            return True
        if variables.noise_of_run(followed.result, at) > MARKED * smoothing.sensor_noise(decay):
            tested = _dependence(followed, at)
            if tested.reason.item() or len(followed.runs) * tested.p_value.item() < DEPENDENCE_LEVEL:
                return True
    return False


def _unfound_random_force_hides_more(followed: FollowedRuns, run: int) -> bool:
    """Return True if a fit allows for a random force that was not found, and its motion misses the record."""
    force = random_force_of(followed.result, run)
    if not force or is_found(force):
        return False
    motion = followed.motions[list(followed.runs).index(run)]
    if motion is None:
        return True
    residual = followed.runs[run].angle.values - motion.offset - motion.x
    return float(np.std(residual)) > MARKED * variables.noise_of_run(followed.result, run)


def p_value_of_dependence(tested: xr.Dataset) -> float:
    """Return the p-value of an independent random force in all runs (Bonferroni); nan if untested."""
    return min(1.0, tested.sizes["run"] * float(tested.p_value.min(skipna=False)))


def checked_library(function: str, library: LibraryLike | None, decay: Decays) -> ForceLibrary:
    """Return the offered library.

    By default it is that of the contact forces, with the first force of each input of the records.

    Raises
    ------
    UsageError
        The argument is not a library.
    """
    if library is None:
        runs = [decay] if isinstance(decay, xr.Dataset) else [*decay]
        of_runs = (inputs.inputs_of(run) for run in runs if isinstance(run, xr.Dataset))
        names = [name for known in of_runs for name in known if name != INPUT]
        library = with_inputs_acting(load_library(), names)
    return forces.as_library(library, function)


@signal_scale.in_units_of_the_motion
def identifications(decay: Decays, library: ForceLibrary, methods: Sequence[Method]) -> list[xr.Dataset]:
    """Identify the forces by methods that share one decision on the noise, with errors of the model.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        One decay, or several runs.
    library : ForceLibrary
        The offered forces.
    methods : sequence of Method
        If the `random_force` of a method is `auto`, it has a random force if the last method that fits the
        motion finds one and its test does not reject it; otherwise the sensor's noise alone.

    Returns
    -------
    list of Dataset
        In the order of the methods. `standard_error` and `covariance` are the total ones;
        `error_of_noise(force)` and `error_of_model(force)` are their parts; `held_out_rms` (rad) exists if
        there is an error of the model (see `with_error_of_model`).

    Notes
    -----
    With a random force, a fit need not follow the motion: each half period is a separate equation, and a
    force missing within the cycle changes its coefficients. This is correct if the random force is
    independent of motion and time. If its test rejects this, the sensor's noise alone predicts better.
    """
    return [followed.result for followed in decided(decay, library, methods)]


def decided(decay: Decays, library: ForceLibrary, methods: Sequence[Method]) -> list[FollowedRuns]:
    """Return the `identifications`, each with its simulated runs."""
    runs = as_runs(decay, driven=True)
    together, quiet = dict(enumerate(runs)), [with_noise(method, "off") for method in methods]
    results = [FollowedRuns(together, method.identify(decay, library)) for method in quiet]
    if any(inputs.inputs_of(run) for run in runs):
        return results
    # Decrements neglect forces: the last method that fits the whole motion decides.
    places = [at for at, method in enumerate(methods) if _is_open(method)]
    open_ones = sorted(places, key=lambda at: scope_of(methods[at]).family in DECIDING)
    stochastic: dict[int, FollowedRuns] = {}
    # From here on, a residual may be that of a random force, which is then estimated. Reject a dependence on
    # the amplitude before the long estimation.
    deciding = results[open_ones[-1]] if open_ones else None
    if deciding and _residual(deciding)[0] < 0.05 and not _depends_on_amplitude(deciding):
        stochastic = _stochastic(decay, library, {at: methods[at] for at in open_ones})
    for at, method in enumerate(quiet):
        if at in stochastic:
            results[at] = model_error.with_rounding(stochastic[at])
        else:
            results[at] = with_model_in_errors(results[at], method, library)
    return results


def _depends_on_amplitude(followed: FollowedRuns) -> bool:
    """Return true if the residual of the averages depends on the amplitude, unlike a random force."""
    moving = [motion for motion in followed.motions if motion is not None]
    if len(moving) < len(followed.motions):
        return False
    runs, result = [*followed.runs.values()], followed.result
    library = models.library_of(result).select(forces_in_model(result))
    free_motions = [
        xr.Dataset({"angle": ("time", motion.x)}, {"time": run.time})
        for run, motion in zip(runs, moving, strict=True)
    ]
    averaging = Averaging(shapes=models.shape_values_of(result))
    try:
        return averaging.amplitude_p_value(runs, free_motions, library) < AMPLITUDE_LEVEL
    except (SysidTribError, np.linalg.LinAlgError):
        return False


def with_model_in_errors(followed: FollowedRuns, method: Method, library: ForceLibrary) -> FollowedRuns:
    """Return the identification, with model errors included if the residual is not noise."""
    p_value, over_noise = _residual(followed)
    if p_value >= WHITE_LEVEL:
        return model_error.with_rounding(followed)
    factor = widening(followed.result, over_noise)
    return model_error.with_error_of_model(followed, method, library, factor)


def with_common_noise(
    decay: Decays, library: ForceLibrary, methods: Mapping[str, Method]
) -> dict[str, Method]:
    """Return methods by name; those without a given noise use the noise of direct identification.

    Without a direct method, the first one decides; if it cannot identify the record, the sensor's noise alone
    is used.
    """
    open_ones = [method for method in methods.values() if _is_open(method)]
    direct = [method for method in open_ones if scope_of(method).family == "direct"]
    option: RandomForceOption = "off"
    with suppress(SysidTribError, np.linalg.LinAlgError):
        for method in [*direct, *open_ones][:1]:
            option = method_of(identifications(decay, library, [method])[0]).random_force
    return {label: with_noise(method, option) for label, method in methods.items()}


def _is_open(method: Method) -> bool:
    return getattr(method, "random_force", "off") == "auto"


def with_noise(method: Method, option: RandomForceOption) -> Method:
    """Return a method with this noise if it has no other; otherwise unchanged."""
    return with_random_force(method, option) if _is_open(method) else method


def has_white_residual(followed: FollowedRuns) -> bool:
    """Return true if the residual of a model (with a random force, its innovations) is white noise."""
    return _residual(followed)[0] >= WHITE_LEVEL


def _residual(followed: FollowedRuns) -> tuple[float, float]:
    """Return the p-value that a model's residual, or its innovations, is white; and its size."""
    whole = followed.once("residual", lambda: residuals({"": followed}, followed.result))
    return float(whole.p_value.item()), float(whole.tested_over_noise.item())


def _stochastic(
    decay: Decays, library: ForceLibrary, methods: Mapping[int, Method]
) -> dict[int, FollowedRuns]:
    """Return the identifications with a random force or coloured noise; empty if these are rejected."""
    stochastic: dict[int, FollowedRuns] = {}
    runs, last = dict(enumerate(as_runs(decay, driven=True))), [*methods][-1]
    for at, method in methods.items():
        try:
            result = with_random_force(method, "estimated").identify(decay, library)
            stochastic[at] = FollowedRuns(runs, result)
            refused = False
            if at == last:
                refused = _residual(stochastic[at])[0] < WHITE_LEVEL or not is_random(stochastic[at])
            elif scope_of(method).family == "averaging" and is_found(random_force_of(result)):
                # If a fast method rejects the random force, the slow methods do not search for it.
                refused = not is_random(stochastic[at])
        except (SysidTribError, np.linalg.LinAlgError):
            refused = at == last
        if refused:
            return {}
    return stochastic
