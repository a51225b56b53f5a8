"""What is said of a record: explained, with a random force, not explained, undetermined, or breaking down."""

from collections.abc import Mapping
from contextlib import suppress

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood.random_force import RandomForce, random_force_of
from sysid_trib.likelihood.sensor_noise import sensor_noise_of
from sysid_trib.motion_fit import bands, innovations
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.results.effects import determines
from sysid_trib.results.variables import group_names, noise_of_run, text_variable
from sysid_trib.validation.findings import DIVERGES
from sysid_trib.validation.random_force_test import ASPECTS, ON, dependence, dependence_on_motion
from sysid_trib.validation.residuals import FollowedRuns

PARTS_OF_RECORD = ("first", "second", "last")
NO_NEARER = "over the {} third{} its motion is no nearer to the record than rest"


def no_nearer_than_rest(angle: Array, residual: Array) -> str:
    """Over which third of a record a model is as far from it as rest, as a text to name the run in; or none.

    Parameters
    ----------
    angle, residual : (sample,) array of float, rad
        The record about its equilibrium, and record minus model.
    """
    if not np.all(np.isfinite(residual)):
        return DIVERGES
    thirds = zip(PARTS_OF_RECORD, np.array_split(angle, 3), np.array_split(residual, 3), strict=True)
    for name, motion, missed in thirds:
        if np.sum(missed**2) >= np.sum(motion**2):
            return NO_NEARER.format(name, "{}")
    return ""


def widening(result: xr.Dataset, residual_over_noise: float) -> float:
    """By how much stated errors are to be widened where a model does not explain the record; 1 at least.

    Parameters
    ----------
    result : Dataset
        An identification.
    residual_over_noise : float
        RMS of record minus model over the noise.

    Notes
    -----
    Birge 1932: errors by the noise alone times the residual over the noise. What a method has widened
    already, by the Birge ratio of its own equations, is not widened twice; nor is what it takes for a random
    force, which its errors allow for.
    """
    stated = max(1.0, float(result.get("birge_ratio", 1.0)))
    return 1.0 if random_force_of(result) else max(1.0, residual_over_noise / stated)


# Level at which a random force depends on something, and at which there is one at all.
DEPENDENCE_LEVEL = 0.01
# Noise of so many times that of the sensor is more than an error of its estimate.
MARKED = 1.5
VERDICTS = ("explained", "explained with a random force", "approximate", "not explained", "undetermined")
# A model is approximate that leaves no more than this part of the motion (RMS).
APPROXIMATE_PART = 0.05
# Predictions are this far ahead at most, and this close to each other (periods).
LONGEST_PREDICTION, PREDICTION_STEP = 10.0, 0.25


def is_found(force: RandomForce) -> bool:
    """True if there is a random force beyond chance; one that was given is there."""
    return bool(force) and not force.p_value >= DEPENDENCE_LEVEL


def random_force_groups(followed: FollowedRuns) -> dict[str, xr.Dataset]:
    """What a random force is judged and drawn by, as groups of a tree; none where none is found.

    Parameters
    ----------
    followed : FollowedRuns
        All runs of an identification.

    Returns
    -------
    dict of str to Dataset
        `random_force`: over `run` what `random_force_dependence` returns, `reason` where it is nan. And
        `innovations`, `prediction_bands` of each run (`innovations_1`, ... of several), left out of a run
        whose motion does not settle, or that is too short.
    """
    result, runs = followed.result, followed.runs
    if not is_found(random_force_of(result)):
        return {}
    groups = {"random_force": tested_runs(followed)}
    names = [group_names(name, len(runs)) for name in ("innovations", "prediction_bands")]
    for (at, decay), of_innovations, of_bands in zip(runs.items(), *names, strict=True):
        if groups["random_force"].reason.values[at]:
            continue
        tracked = followed.tracked(at)
        groups[of_innovations] = innovations.innovations_of(decay, tracked)
        # Of a record too short to predict anything there is no figure.
        with suppress(SysidTribError):
            groups[of_bands] = bands.bands_of(tracked, result, _horizons(decay, result), run=at)
    return groups


def tested_runs(followed: FollowedRuns) -> xr.Dataset:
    """Over `run` what `random_force_dependence` returns; `reason` where the motion does not settle.

    Parameters
    ----------
    followed : FollowedRuns
        All runs of an identification with a random force.
    """
    return followed.once("random_force", lambda: _tested(followed))


def _tested(followed: FollowedRuns) -> xr.Dataset:
    tested, reasons, nothing = [], [], np.full((len(ASPECTS), len(ON)), np.nan)
    for at in followed.runs:
        # A run without a random force has none that depends on something.
        of_run, reason = dependence((1.0, *[np.nan] * 4), nothing), ""
        try:
            followed.tracked(at)
            if random_force_of(followed.result, at):
                of_run = dependence_on_motion(followed, at)
        except SysidTribError as error:
            of_run, reason = dependence([np.nan] * 5, nothing), str(error)
        tested.append(of_run)
        reasons.append(reason)
    together = xr.concat(tested, "run", combine_attrs="override")
    return together.assign(reason=text_variable("run", reasons, "why not tested"))


def _horizons(decay: xr.Dataset, result: xr.Dataset) -> Array:
    """Periods ahead for which predictions are made."""
    period = 2.0 * np.pi / float(result.reference_frequency)
    length = float(decay.time.values[-1] - decay.time.values[0]) / period
    longest = min(LONGEST_PREDICTION, 0.5 * (length - bands.SETTLING_PERIODS))
    return np.asarray(np.arange(1, max(2, int(longest / PREDICTION_STEP))) * PREDICTION_STEP, dtype=float)


def verdict_on_record(
    explained: str, unexplained: float, followed: FollowedRuns, groups: Mapping[str, xr.Dataset]
) -> str:
    """One of `VERDICTS`; a record that decides no coefficient explains nothing, whatever is left of it.

    Parameters
    ----------
    explained : {"yes", "partly", "no"}
        Whether the residual, with a random force the innovations, is noise.
    unexplained : float
        RMS of record minus motion over that of the record, of the answer's model; nan without a motion.
    followed : FollowedRuns
        All runs of the identification.
    groups : mapping of str to Dataset
        Of `random_force_groups`.
    """
    verdict = "approximate" if unexplained <= APPROXIMATE_PART else "not explained"
    if "random_force" in groups:
        if explained != "no" and p_value_of_dependence(groups["random_force"]) >= DEPENDENCE_LEVEL:
            verdict = "explained with a random force"
    elif explained == "yes" and not _noise_hides_a_force(followed):
        verdict = "explained"
    if determines(followed.result):
        return verdict
    # No model of these forces could have been contradicted: its rows leave but the noise, although the motion
    # of coefficients that are not known may diverge.
    rows = float(followed.result.get("birge_ratio", np.inf))
    quiet = rows <= MARKED and "random_force" not in groups
    return "undetermined" if quiet or verdict.startswith("explained") else verdict


def is_random(followed: FollowedRuns) -> bool:
    """True if what an identification takes for random is: its random force, and the colour of its noise.

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
    """True if what was found to be noise of the sensor is larger than the sensor's, and goes with the motion.

    A method that finds the colour of the noise with a random force takes a slow force for either.
    """
    if "random_force_density" not in followed.result:
        return False
    for at, decay in followed.runs.items():
        if noise_of_run(followed.result, at) <= MARKED * sensor_noise(decay):
            continue
        try:
            tested = dependence_on_motion(followed, at)
        except SysidTribError:
            return True
        if len(followed.runs) * tested.p_value.item() < DEPENDENCE_LEVEL:
            return True
    return False


def p_value_of_dependence(tested: xr.Dataset) -> float:
    """p-value of a random force that depends on nothing in all runs (Bonferroni); nan if untested."""
    return min(1.0, tested.sizes["run"] * float(tested.p_value.min(skipna=False)))
