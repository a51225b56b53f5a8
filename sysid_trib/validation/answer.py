"""The answer that predicts: with which noise a record is identified, and how wrong its model may be."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.likelihood.random_force import RandomForceOption, random_force_of
from sysid_trib.methods import method_of
from sysid_trib.methods.scope import Method, scope_of, with_random_force
from sysid_trib.records.decay import Decays, as_runs
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.validation import model_error
from sysid_trib.validation.residuals import FollowedRuns, residuals
from sysid_trib.validation.verdict import is_found, is_random

# Significance level of a residual that is not white noise.
RESIDUAL_LEVEL = 1e-3
# Where models are incomplete averaging is immune to most of what they lack: the other method is the answer
# where it predicts better by more than this.
CLEARLY_BETTER = 1.1
# Families of methods that fit the motion, and so see a random force in it.
DECIDING = ("direct", "trajectory")


def checked_library(function: str, library: ForceLibrary | None, methods: Iterable[Any]) -> ForceLibrary:
    """The library that is offered, by default that of the contact forces; what is no method is refused.

    Raises
    ------
    UsageError
        Something else in the place of a library or method, or a class in that of an object.
    """
    library = load_library() if library is None else library
    if not isinstance(library, ForceLibrary):
        raise UsageError(f"{function} wants a ForceLibrary, not {library!r}: load_library('contact_forces').")
    for method in methods:
        if isinstance(method, type) or not hasattr(method, "identify"):
            raise UsageError(f"{function} wants a method such as methods.Direct(), not {method!r}.")
    return library


@in_units_of_the_motion
def identifications(decay: Decays, library: ForceLibrary, methods: Sequence[Method]) -> list[xr.Dataset]:
    """Identify the forces by methods that share one decision on the noise, with errors of the model.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        One decay, or several runs.
    library : ForceLibrary
        The forces offered.
    methods : sequence of Method
        Those whose `random_force` is `auto` have one where the last of them that fits the motion finds it and
        its test does not refuse it, and the sensor's noise alone elsewhere.

    Returns
    -------
    list of Dataset
        In the order of the methods. `standard_error` and `covariance` are the total ones;
        `error_of_noise(force)` and `error_of_model(force)` their parts; `held_out_rms` (rad) where there is
        an error of the model (see `with_error_of_model`).

    Notes
    -----
    A random force frees a fit from following the motion: each half period is an equation of its own, and
    whatever the model lacks within the cycle moves its coefficients. It is right where it depends on nothing;
    where its test refuses it, the sensor's noise alone predicts better.
    """
    return [followed.result for followed in decided(decay, library, methods)]


def decided(decay: Decays, library: ForceLibrary, methods: Sequence[Method]) -> list[FollowedRuns]:
    """`identifications`, each with the runs as its motion follows them."""
    runs = as_runs(decay, driven=True)
    together, quiet = dict(enumerate(runs)), [with_noise(method, "off") for method in methods]
    results = [FollowedRuns(together, method.identify(decay, library)) for method in quiet]
    if any(inputs_of(run) for run in runs):
        return results
    residual_tests = [_residual(followed) for followed in results]
    # Decrements neglect forces: the last method of the whole motion decides.
    places = [at for at, method in enumerate(methods) if _is_open(method)]
    open_ones = sorted(places, key=lambda at: scope_of(methods[at]).family in DECIDING)
    # From here on a residual may be that of a random force, which is then looked for.
    if open_ones and residual_tests[open_ones[-1]][0] < 0.05:
        stochastic = _stochastic(decay, library, {at: methods[at] for at in open_ones})
        results = [stochastic.get(at, followed) for at, followed in enumerate(results)]
        residual_tests = [(1.0, 1.0) if at in stochastic else test for at, test in enumerate(residual_tests)]
    return [
        followed.with_result(with_model_in_errors(followed.result, method, runs, library, residual))
        for method, followed, residual in zip(quiet, results, residual_tests, strict=True)
    ]


def with_model_in_errors(
    result: xr.Dataset,
    method: Method,
    runs: Sequence[xr.Dataset],
    library: ForceLibrary,
    residual: tuple[float, float] | None = None,
) -> xr.Dataset:
    """The identification with errors that are those of the model too, where the residual is not noise.

    `residual` : of `_residual`, where it is known.
    """
    p_value, over_noise = residual or _residual(FollowedRuns(dict(enumerate(runs)), result))
    if p_value < RESIDUAL_LEVEL:
        return model_error.with_error_of_model(result, method, runs, library, over_noise)
    return model_error.with_rounding(result, runs)


def with_common_noise(
    decay: Decays, library: ForceLibrary, methods: Mapping[str, Method]
) -> dict[str, Method]:
    """Methods by their name; those that leave it open have the noise that direct identification has.

    Where none of them is direct the first decides; where that cannot identify the record it is the sensor's
    alone.
    """
    open_ones = [method for method in methods.values() if _is_open(method)]
    direct = [method for method in open_ones if scope_of(method).family == "direct"]
    option: RandomForceOption = "off"
    with suppress(SysidTribError, np.linalg.LinAlgError):
        for method in [*direct, *open_ones][:1]:
            option = method_of(identifications(decay, library, [method])[0]).random_force
    return {label: with_noise(method, option) for label, method in methods.items()}


def better_of(first: xr.Dataset, second: xr.Dataset) -> int:
    """Which of two identifications of a record is the answer: the second, unless the first predicts better.

    Where its model leaves nothing but noise the second is: it is at the statistical bound; else the first
    where its does. Elsewhere the second must predict the parts that were held out better than the first by
    more than `CLEARLY_BETTER`.
    """
    if "held_out_rms" not in second or "held_out_rms" not in first:
        return int("held_out_rms" not in second)
    held_out = [float(result.get("held_out_rms", np.nan)) for result in (first, second)]
    return 0 if np.isfinite(held_out[0]) and not CLEARLY_BETTER * held_out[1] < held_out[0] else 1


def _is_open(method: Method) -> bool:
    return getattr(method, "random_force", "off") == "auto"


def with_noise(method: Method, option: RandomForceOption) -> Method:
    """A method that leaves its noise open, with this one; any other as it is."""
    return with_random_force(method, option) if _is_open(method) else method


def _residual(followed: FollowedRuns) -> tuple[float, float]:
    """P-value that the residual of a model, with a random force its innovations, is white noise; its size."""
    whole = residuals({"": followed}, followed.result)
    return float(whole.residual_p_value.item()), float(whole.residual_over_noise.item())


def _stochastic(
    decay: Decays, library: ForceLibrary, methods: Mapping[int, Method]
) -> dict[int, FollowedRuns]:
    """Identifications with a random force or coloured noise, by their place; none where that is refused."""
    stochastic: dict[int, FollowedRuns] = {}
    runs, last = dict(enumerate(as_runs(decay, driven=True))), [*methods][-1]
    for at, method in methods.items():
        try:
            result = with_random_force(method, "estimated").identify(decay, library)
            stochastic[at] = FollowedRuns(runs, result)
            refused = False
            if at == last:
                refused = _residual(stochastic[at])[0] < RESIDUAL_LEVEL or not is_random(stochastic[at])
            elif scope_of(method).family == "averaging" and is_found(random_force_of(result)):
                # What the quicker methods refuse is not looked for by the slower ones.
                refused = not is_random(stochastic[at])
        except (SysidTribError, np.linalg.LinAlgError):
            refused = at == last
        if refused:
            return {}
    return stochastic
