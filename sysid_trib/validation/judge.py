"""Judgement of a result: the residual of each model on the records, and the verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL
from sysid_trib.results.judged import EXPLAINED_VERDICTS, LARGE
from sysid_trib.results.random_force import DEPENDENCE_LEVEL
from sysid_trib.results.variables import described

# A model is approximate if its residual (RMS) is at most this fraction of the motion.
APPROXIMATE_PART = 0.05
DIVERGES = "its motion diverges"
# A motion that exceeds the largest angle of the record by this factor does not follow the record.
LARGEST_MOTION = 3.0


@dataclass(frozen=True)
class Evidence:
    """Evidence for the verdict on a model.

    Attributes
    ----------
    residual_is_noise : bool
        No deviation from white noise is found in the residual, or in the innovations with a random force.
    residual_over_motion : float
        RMS of record minus motion over that of the record; nan without a motion.
    residual_is_small : bool
        The residual is not much larger than the noise.
    has_random_force : bool
        A random force was found.
    random_force_p : float
        P-value of a random force independent of motion and time; nan if not tested.
    noise_hides_a_force : bool
        The estimated noise is larger than the sensor's, and depends on the motion.
    determines : bool
        The record determines a coefficient, or all coefficients together.
    rows_are_noise : bool
        The residual of the equations is noise, although the motion may diverge.
    """

    residual_is_noise: bool
    residual_over_motion: float
    residual_is_small: bool = False
    has_random_force: bool = False
    random_force_p: float = float("nan")
    noise_hides_a_force: bool = False
    determines: bool = True
    rows_are_noise: bool = False


def verdict_word(evidence: Evidence) -> str:
    """Return one of `results.judged.VERDICTS`.

    A record that determines no coefficient explains nothing, whatever the residual is.
    """
    # `discovery.parts.outcome_of` answers another question: whether a search found all missing effects.
    follows = evidence.residual_over_motion <= APPROXIMATE_PART
    verdict = "approximate" if follows else "not explained"
    if evidence.has_random_force:
        fits = evidence.residual_is_noise or evidence.residual_is_small
        if fits and evidence.random_force_p >= DEPENDENCE_LEVEL:
            verdict = "explained with a random force"
    elif evidence.residual_is_noise and not evidence.noise_hides_a_force:
        verdict = "explained"
    if evidence.determines:
        return verdict
    # No model of these forces could be contradicted: the residual of its rows is noise, although the motion
    # with undetermined coefficients may diverge.
    quiet = evidence.rows_are_noise and not evidence.has_random_force
    return "undetermined" if quiet or verdict in EXPLAINED_VERDICTS else verdict


def judged(
    records: Sequence[xr.Dataset],
    results: Mapping[str, xr.Dataset],
    tested: xr.Dataset,
    *,
    random_force_p: float = float("nan"),
) -> xr.Dataset:
    """Judge the models of a result; `with_verdicts` adds the verdicts.

    Parameters
    ----------
    records : sequence of Dataset
        Each run with the `simulated_angle` of every model and the sensor's `noise`.
    results : mapping of str to Dataset
        The identifications by the names of their models.
    tested : Dataset
        Over `model` the tests of the residuals, see `residuals`; with `residual_over_motion` if the angle was
        not measured directly.
    random_force_p : float
        P-value of a random force independent of motion and time.

    Returns
    -------
    Dataset
        Over `model` the variables `judged` of `variables.toml`.
    """
    # RMS over all runs; over the noise, each run's RMS is divided by its own noise.
    of_runs, noises = _residual_rms(records), np.array([run.noise.item() for run in records])
    rms = np.sqrt(np.mean(of_runs**2, axis=0))
    over_noise = np.sqrt(np.mean((of_runs / noises[:, None]) ** 2, axis=0))
    over_motion = rms / root_mean_square([root_mean_square(run.angle) for run in records])
    if int(records[0].attrs.get("integrations", 0)) > 0:
        # The angle is an integral of the measured signal.
        rms = tested.tested_rms.values
        over_noise = rms / root_mean_square(noises)
    if "residual_over_motion" in tested:
        over_motion = tested.residual_over_motion.values
    held_out = [float(result.get("held_out_rms", np.nan)) for result in results.values()]
    values: dict[str, Any] = {
        "residual_rms": rms,
        "residual_over_noise": over_noise,
        "residual_over_motion": over_motion,
        "held_out_rms": held_out,
        "random_force_p": np.full(len(results), random_force_p),
        "failure": failures_of(records),
    }
    return tested.assign(described("judged", values))


def evidence_of(of_model: xr.Dataset, **further: Any) -> Evidence:
    """Return the evidence on one model of `judged`; `further` : other fields of `Evidence`."""
    return Evidence(
        residual_is_noise=bool(of_model.p_value >= WHITE_LEVEL),
        residual_is_small=bool(of_model.tested_over_noise <= LARGE),
        residual_over_motion=of_model.residual_over_motion.item(),
        random_force_p=of_model.random_force_p.item(),
        **further,
    )


def with_verdicts(
    table: xr.Dataset, evidence: Mapping[str, Evidence], preferred: str, made_by: str
) -> xr.Dataset:
    """Add the verdict on each model to the judged variables, and that on the preferred model to attrs."""
    verdicts = [verdict_word(evidence[name]) for name in table.model.values.tolist()]
    table = table.assign(described("judged", {"verdict": verdicts}))
    attrs = {"made_by": made_by, "preferred": preferred}
    return table.assign_attrs(attrs | {"verdict": table.verdict.sel(model=preferred).item()})


def _residual_rms(records: Sequence[xr.Dataset]) -> Array:
    """Return the RMS of record minus motion, (run, model), rad; nan without a motion."""
    squares = [((run.angle - run.simulated_angle) ** 2).mean("time", skipna=False) for run in records]
    return np.sqrt([of_run.transpose("model").values for of_run in squares])


def failures_of(records: Sequence[xr.Dataset]) -> list[str]:
    """Return the reason why a model has no motion, in a few words; empty if it has one."""
    reasons = []
    largest = [np.abs(run.simulated_angle).max("time", skipna=False) for run in records]
    limits = [LARGEST_MOTION * np.abs(run.angle).max() for run in records]
    failed = [~(size <= limit).values for size, limit in zip(largest, limits, strict=True)]
    for of_model in np.transpose(failed):
        of_run = f" in run {np.argmax(of_model) + 1}" if len(records) > 1 else ""
        reasons.append(f"{DIVERGES}{of_run}" if of_model.any() else "")
    return reasons
