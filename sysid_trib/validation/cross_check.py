"""Two identifications of a decay held against each other, and what they cannot tell apart."""

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.cycles.backbone import smoothed_backbone
from sysid_trib.cycles.signatures import exactly_dependent, indistinguishable, without_signature
from sysid_trib.errors import DecayError, SysidTribError, Tell, silent
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.methods.scope import Method
from sysid_trib.motion_fit import bands, innovations
from sysid_trib.records.decay import Decays, as_runs
from sysid_trib.records.half_sines import envelope
from sysid_trib.results import schema, signal_scale
from sysid_trib.results.variables import described, group_names
from sysid_trib.validation import findings, simulated_pairs
from sysid_trib.validation.lack_of_fit import lack_of_fit
from sysid_trib.validation.residuals import FollowedRuns, residuals, with_motions
from sysid_trib.validation.verdict import RESIDUAL_LEVEL, decided, is_found, tested_runs, verdict_on_record


def ties(runs: Sequence[xr.Dataset], result: xr.Dataset) -> dict[str, str]:
    """Forces that averaging, or any method, cannot tell apart by principle."""
    library = schema.library_of(result)
    shapes = schema.model_of(result).shapes
    size = max(float(np.max(np.abs(run.angle.values))) for run in runs)

    def as_text(groups: Sequence[Sequence[str]]) -> str:
        return "; ".join(" = ".join(group) for group in groups)

    return {
        "averaging_cannot_tell_apart": as_text(indistinguishable(library, 0.02 * size, size, shapes=shapes)),
        "averaging_cannot_see": ", ".join(without_signature(library, size, shapes)),
        "no_method_can_tell_apart": as_text(exactly_dependent(library, size, shapes=shapes)),
    }


# Where models are incomplete averaging is immune to most of what they lack: the other method is the answer
# where it predicts better by more than this.
CLEARLY_BETTER = 1.1
# Predictions are this far ahead at most, and this close to each other (periods).
LONGEST_PREDICTION, PREDICTION_STEP = 10.0, 0.25
# Simulated records by which the difference of two methods is judged.
SIMULATED_RECORDS = 32
# Significance level below which runs, or methods, are said to disagree.
HOMOGENEITY_LEVEL = 0.01


def agreement_of(p_value: float) -> str:
    """`disagree` where the p-value is below `HOMOGENEITY_LEVEL`, else `agree`."""
    return "unknown" if np.isnan(p_value) else "agree" if p_value >= HOMOGENEITY_LEVEL else "disagree"


@signal_scale.in_units_of_the_motion
def cross_check(
    decay: Decays,
    first: xr.Dataset,
    second: xr.Dataset,
    *,
    draws: int = SIMULATED_RECORDS,
    seed: int = 0,
    tell: Tell = silent,
) -> xr.DataTree:
    """Hold two identifications of one decay, or of the same runs, against each other.

    Parameters
    ----------
    decay : the decay, or the runs, that both are from.
    first, second : identifications, e.g. by averaging and direct.
    draws, seed : simulated records of the second's model with its noise, on which both methods are run; the
        scatter of their difference is its error. Both saw the same noise, so their errors do not simply add.
    tell : called as the records are worked through.

    Returns
    -------
    DataTree with groups `record` (with each model's simulated angle), `envelope` (`record_1`, `envelope_1`,
    `record_2`, ... of several runs), one group a method, and
    `comparison`: over `quantity` (each force, and the asymptotic frequency) the `difference` first - second
    at the second's reference frequency, the `expected_difference` (biases of the methods, on a simulated
    record without noise), the `standard_error` of the difference and `z`; `chi_square`,
    `degrees_of_freedom`, `p_value`; over `model` the `residual_rms` (rad) of the simulated model,
    `residual_over_noise` and `departure_time` (s). Its attrs say what the methods cannot tell apart by
    principle, the `verdict` (agree, disagree, unknown), and whether the record is `explained`: yes
    (no departure from white noise is found in the better model's residual), partly (a small one), no; and the
    `verdict_on_record`, one of `VERDICTS`; the `answer`, the method whose numbers are to be taken; over
    `model` the `residual_over_motion`. Groups `backbone` and `lack_of_fit` of each run (see there). Where the
    second has a random force, there are the groups of `random_force_groups`.

    Notes
    -----
    Where the errors that the methods state exceed those by the noise alone, because the residual is more than
    noise or they allow for a random force that was not found, the methods no longer share their errors: the
    stated covariances add. A model without a motion
    (it diverges) has nan for its angle and residual.

    z = (difference - expected_difference)/standard_error; chi-square with the covariance of the scatter, its
    p-value by Hotelling's distribution because that covariance is estimated from `draws` records.

    Of a run longer than 120 periods, beginning, middle and end are compared, 20 periods each: both methods
    identify the forces from these anew, as they do from the simulated records (attrs: `compared_stretch`, the
    length of each in s). The residuals are those of all samples.

    With a random force in the second's result the simulated records are pushed: free motion, linear response
    to white acceleration of that density, noise of the sensor. Each method holds its own random force there.
    The expected difference is then the mean over the records; the verdict is by those that both methods
    identified (attrs: `simulated_records`), and by the chi-square distribution where the covariances are the
    stated ones (`errors`: simulated or stated); unknown below 2 k + 2 records for k quantities. From so many
    on none is drawn after a p-value above 0.1; a smaller one is that of all. The residual of a result with a
    random force is what it predicts wrongly one sample ahead, over its own error.
    """
    together = dict(enumerate(as_runs(decay)))
    followed = [FollowedRuns(together, result) for result in (first, second)]
    return _checked(followed, draws=draws, seed=seed, tell=tell)


@signal_scale.in_units_of_the_motion
def identified_and_checked(
    decay: Decays,
    library: ForceLibrary,
    methods: Sequence[Method],
    *,
    draws: int = SIMULATED_RECORDS,
    seed: int = 0,
    tell: Tell = silent,
) -> xr.DataTree:
    """The `cross_check` of two methods' `identifications`, which shares how these followed the runs."""
    tell("identification")
    return _checked(decided(decay, library, methods), draws=draws, seed=seed, tell=tell)


def _checked(pair: Sequence[FollowedRuns], *, draws: int, seed: int, tell: Tell) -> xr.DataTree:
    runs, results = [*pair[0].runs.values()], [followed.result for followed in pair]
    names = [result.attrs["method"] for result in results]
    if names[0] == names[1]:
        names = [f"{names[0]}_1", f"{names[1]}_2"]
    followed = dict(zip(names, pair, strict=True))
    compared = simulated_pairs.comparison(pair, draws=draws, seed=seed, tell=tell)
    tell("residuals")
    records = with_motions(followed)
    over_motion = {"residual_over_motion": residual_over_motion(records)}
    compared = compared.merge(residuals(followed, results[1])).assign(described("cross_check", over_motion))
    compared = compared.assign(findings.failure_of_models(records))
    verdict = agreement_of(compared.p_value.item())
    made = {"first": names[0], "second": names[1], "verdict": verdict, "draws": draws, "seed": seed}
    explained, answer = explained_by(compared), names[_chosen(results, compared)]
    stochastic = random_force_groups(pair[1])
    unexplained = compared.residual_over_motion.sel(model=answer).item()
    compared.attrs = (
        made | compared.attrs | {"explained": explained, "answer": answer} | ties(runs, results[1])
    )
    compared.attrs["verdict_on_record"] = verdict_on_record(explained, unexplained, pair[1], stochastic)
    groups = dict(zip(group_names("record", len(runs)), records, strict=True))
    groups |= dict(zip(group_names("envelope", len(runs)), [envelope(run) for run in runs], strict=True))
    of_names = dict(zip(names, results, strict=True))
    groups |= of_names | {"comparison": compared} | backbones_of(runs, of_names)
    return xr.DataTree.from_dict({**groups, **stochastic})


def backbones_of(runs: Sequence[xr.Dataset], results: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Backbone of each run, and where the models leave it; none of a run with too few half periods."""
    groups = {}
    names = [group_names(name, len(runs)) for name in ("backbone", "lack_of_fit")]
    for run, of_record, of_models in zip(runs, *names, strict=True):
        with suppress(DecayError):
            backbone, weights = smoothed_backbone(run)
            groups[of_record] = backbone
            groups[of_models] = lack_of_fit(run, results, (backbone, weights))
    return groups


def residual_over_motion(records: Sequence[xr.Dataset]) -> Array:
    """RMS of record minus motion over that of the record, of each model; nan without a motion."""
    missed = sum(((run.angle - run.simulated_angle) ** 2).sum("time", skipna=False).values for run in records)
    return np.sqrt(missed / sum(float((run.angle**2).sum()) for run in records))


def explained_by(compared: xr.Dataset) -> str:
    """`yes` if no departure from white noise is found in the better residual, `partly` if a small one."""
    if np.nanmax(compared.residual_p_value.values) >= RESIDUAL_LEVEL:
        return "yes"
    return "partly" if np.any(compared.residual_over_noise.values <= findings.LARGE) else "no"


def _chosen(results: Sequence[xr.Dataset], compared: xr.Dataset) -> int:
    """Which of two identifications is the answer, by their residuals and by `better_of`.

    What makes averaging immune to forces that are missing does not help against a line (hum), which moves
    extrema and their times: a second method that leaves no more, and but noise or a line, is the answer.
    """
    rms, over_noise = compared.residual_rms.values, compared.residual_over_noise.values
    line = np.isfinite(compared.line_frequency.values[1])
    if rms[1] <= 1.02 * rms[0] and (line or over_noise[1] <= 1.0):
        return 1
    return better_of(*results)


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


def _horizons(decay: xr.Dataset, result: xr.Dataset) -> Array:
    """Periods ahead for which predictions are made."""
    period = 2.0 * np.pi / float(result.reference_frequency)
    length = float(decay.time.values[-1] - decay.time.values[0]) / period
    longest = min(LONGEST_PREDICTION, 0.5 * (length - bands.SETTLING_PERIODS))
    return np.asarray(np.arange(1, max(2, int(longest / PREDICTION_STEP))) * PREDICTION_STEP, dtype=float)
