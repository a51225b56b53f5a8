"""Cross-check of two identifications of a decay, and the forces that they cannot separate."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import scipy
import xarray as xr

from sysid_trib import records
from sysid_trib.arrays import Array
from sysid_trib.cycles.backbone import smoothed_backbone
from sysid_trib.errors import DecayError, SysidTribError, Tell, silent
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.scope import Method
from sysid_trib.motion_fit import bands, innovations
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.runs import Decays, RecordsLike, as_runs
from sysid_trib.results import references, schema, signal_scale
from sysid_trib.results.models import library_of
from sysid_trib.results.random_force import is_found, random_force_of
from sysid_trib.results.variables import described, group_names
from sysid_trib.validation import common_reference
from sysid_trib.validation.influence import covariances_of_difference
from sysid_trib.validation.lack_of_fit import lack_of_fit
from sysid_trib.validation.residuals import FollowedRuns, residuals, with_motions
from sysid_trib.validation.separability import exactly_dependent, indistinguishable, without_signature
from sysid_trib.validation.verdict import decided, judged_models, tested_runs


def ties(runs: Sequence[xr.Dataset], result: xr.Dataset) -> dict[str, str]:
    """Return the forces that averaging, or any method, cannot separate in principle."""
    library = library_of(result)
    shapes = schema.model_of(result).shapes
    size = max(float(np.max(np.abs(run.angle.values))) for run in runs)

    def as_text(groups: Sequence[Sequence[str]]) -> str:
        return "; ".join(" = ".join(group) for group in groups)

    return {
        "averaging_cannot_tell_apart": as_text(indistinguishable(library, 0.02 * size, size, shapes=shapes)),
        "averaging_cannot_see": ", ".join(without_signature(library, size, shapes)),
        "no_method_can_tell_apart": as_text(exactly_dependent(library, size, shapes=shapes)),
    }


# Averaging is insensitive to most missing forces. So for incomplete models, the second method is preferred
# only if its prediction is better by more than this factor.
CLEARLY_BETTER = 1.1
# Longest horizon of the predictions, and largest distance between horizons (periods).
LONGEST_PREDICTION, PREDICTION_STEP = 10.0, 0.25
# Fraction of the first method's errors that represents second-order terms, which dominate if two methods
# agree to first order.
SECOND_ORDER_PART = 0.1
# Stated errors above this multiple of those due to noise include more than noise.
EXCESS = 1.5
# Significance level below which runs or methods disagree.
HOMOGENEITY_LEVEL = 0.01


def agreement_of(p_value: float) -> str:
    """Return `disagree` if the p-value is below `HOMOGENEITY_LEVEL`, else `agree`."""
    return "unknown" if np.isnan(p_value) else "agree" if p_value >= HOMOGENEITY_LEVEL else "disagree"


@signal_scale.in_units_of_the_motion
def cross_check(
    decay: RecordsLike,
    first: xr.Dataset,
    second: xr.Dataset,
    *,
    tell: Tell = silent,
) -> xr.DataTree:
    """Compare two identifications of one decay, or of the same runs.

    Parameters
    ----------
    decay : record, or several of them
        The decay, or the runs, that both identifications are from.
    first, second : Dataset
        Identifications by one method each, such as averaging and direct.
    tell : callable
        Called with a few words on the progress of the work.

    Returns
    -------
    DataTree
        Groups `record` (with each model's simulated angle) and `envelope` (`record_1`, `envelope_1`,
        `record_2`, ... for several runs), and one group per method.

        `judged` contains over `model` the residual and the verdict: `residual_rms` (rad) of the simulated
        motion, over the noise and over the motion; `p_value` of the hypothesis that the residual is white
        noise, and the RMS of the tested residual (`tested_rms`; with a random force, of one-step
        predictions), over its stated deviation; `departure_time` (s); a `spectral_line` (rad/s) with its
        amplitude; `held_out_rms`; `random_force_p`; `failure`; `verdict`, one of `VERDICTS`. For several runs
        also `run_tested_rms`, ... of each run. Its attributes name the `preferred` method, and the `verdict`
        on it.

        `agreement` contains over `quantity` (each force, and the asymptotic frequency) the `difference`
        first - second at the second's reference frequency, its `standard_error` and `z`; `chi_square`,
        `degrees_of_freedom`, `p_value`. Its attributes are the `verdict` (agree, disagree, unknown) and the
        forces that the methods cannot separate in principle.

        The groups `backbone` and `lack_of_fit` belong to each run (see these functions). If the second
        identification has a random force, there are also the groups of `random_force_groups`.

    Notes
    -----
    Both methods use the same noisy samples, so their errors do not simply add. To first order each quantity
    changes linearly with the noise of each sample; the factors are the influence of the samples on the
    method: A for the first, D for the second. The covariance of the difference is (A - D) S (A - D)', with
    the covariance S of the noise from the second's result: white or coloured noise of the sensor, and the
    random force (Hausman 1978, if one of them is efficient). `Averaging` has the influence of its envelope,
    of the equations between half periods and of indirect inference; `Direct` and `Trajectory` have that of
    whitened least squares of the motion. A tenth of the first's errors is added for second-order terms. The
    attribute `errors` is `influence` or `stated`.

    The stated covariances are added instead (`stated`) in three cases: the influence of a method is not
    known; the errors include those of an incomplete model; or they exceed 1.5 times those due to the noise,
    because the methods then weight non-noise differently. If a first-order bias was not removed, the verdict
    is unknown.

    z = difference/standard_error; the p-value is that of chi-square. A model without a motion (it diverges)
    has nan for its angle and residual. The residual of a result with a random force is the error of its
    one-step predictions, over the standard deviation of this error.

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> first, second = (st.identify(decay, method=method) for method in ("averaging", "trajectory"))
    >>> agreement = st.cross_check(decay, first, second)["agreement"]
    >>> agreement.attrs["verdict"], bool(abs(agreement.z).max() < 3.0)
    ('agree', True)
    """
    together = dict(enumerate(as_runs(records.as_decays(decay, "cross_check"))))
    followed = [FollowedRuns(together, result) for result in (first, second)]
    return _checked(followed, tell=tell)


@signal_scale.in_units_of_the_motion
def identified_and_checked(
    decay: Decays,
    library: ForceLibrary,
    methods: Sequence[Method],
    *,
    tell: Tell = silent,
) -> xr.DataTree:
    """Return `cross_check` of two methods' `identifications`, which provides their motions in the runs."""
    tell("identification")
    return _checked(decided(decay, library, methods), tell=tell)


def comparison(pair: Sequence[FollowedRuns]) -> xr.Dataset:
    """Compare two identifications force by force and as a whole (see `cross_check`)."""
    results = [followed.result for followed in pair]
    kept = common_reference.comparable(*results)
    # Use the second's noise for the record, or the first's if the second has no motion.
    # A model that does not oscillate at small amplitudes has no period there.
    swings = [followed for followed in pair[::-1] if followed.result.asymptotic_frequency.item() > 0.0]
    moving = [followed for followed in swings if None not in followed.motions]
    frequency = (moving or pair[::-1])[0].result.reference_frequency.item()
    difference = np.subtract(
        *(common_reference.comparison_values(result, kept, frequency) for result in results)
    )
    # Two methods on one record. Different samples have no common noise (`questions.difference`); the table of
    # `compare` takes the errors as independent (`holdout.contrast`); and for driven records no influence is
    # known (`driven._difference`).
    covariance, errors = np.full((len(difference), len(difference)), np.nan), "stated"
    biased = not all(bool(result.get("first_order_bias_removed", True)) for result in results)
    if moving and not biased:
        covariance, errors = _covariance(pair, moving[0], kept)
    error = np.sqrt(np.diag(covariance))
    # Quantities that both methods hold do not differ.
    z = np.divide(difference, error, out=np.zeros_like(difference), where=error != 0.0)
    chi_square = float("nan")
    if np.all(np.isfinite(covariance)):
        # In units of the errors: coefficients and frequency differ by orders of magnitude.
        scale = np.where(error > 0.0, error, 1.0)
        chi_square = float(z @ np.linalg.pinv(covariance / np.outer(scale, scale), hermitian=True) @ z)
    values: dict[str, Any] = {"difference": difference, "standard_error": error, "z": z}
    values |= {"chi_square": chi_square, "degrees_of_freedom": len(difference)}
    values["p_value"] = float(scipy.stats.chi2.sf(chi_square, len(difference)))
    coords = {"quantity": [*kept, common_reference.ASYMPTOTIC_FREQUENCY]}
    return xr.Dataset(described("agreement", values), coords, {"errors": errors})


def _covariance(pair: Sequence[FollowedRuns], truth: FollowedRuns, kept: Sequence[str]) -> tuple[Array, str]:
    """Return the covariance of two identifications' difference, and if it is by `influence` or `stated`."""
    results = [followed.result for followed in pair]
    stated = [references.stated_covariance(result, kept) for result in results]
    complete = not any("error_of_model" in result for result in results)
    by_noise = covariances_of_difference(pair, truth, kept) if complete else None
    if by_noise is not None:
        own = (by_noise.first, by_noise.second)
        squares = [
            np.diag(all_of) > EXCESS**2 * np.diag(part) for all_of, part in zip(stated, own, strict=True)
        ]
        if not np.any(squares):
            return by_noise.difference + SECOND_ORDER_PART**2 * by_noise.first, "influence"
    return np.sum(stated, axis=0), "stated"


def _checked(pair: Sequence[FollowedRuns], *, tell: Tell) -> xr.DataTree:
    runs, results = [*pair[0].runs.values()], [followed.result for followed in pair]
    names = [result.attrs["method"] for result in results]
    if names[0] == names[1]:
        names = [f"{names[0]}_1", f"{names[1]}_2"]
    followed = dict(zip(names, pair, strict=True))
    compared = comparison(pair)
    tell("residuals")
    records = with_motions(followed)
    of_names = dict(zip(names, results, strict=True))
    stochastic = random_force_groups(pair[1])
    table = judged_models(
        followed,
        records,
        residuals(followed, results[1]),
        preferred=lambda table: names[_chosen(results, table)],
        made_by="identify",
    )
    compared.attrs |= {
        "first": names[0],
        "second": names[1],
        "verdict": agreement_of(compared.p_value.item()),
        **ties(runs, results[1]),
    }
    groups = dict(zip(group_names("record", len(runs)), records, strict=True))
    groups |= dict(zip(group_names("envelope", len(runs)), [envelope(run) for run in runs], strict=True))
    groups |= of_names | {"judged": table, "agreement": compared} | backbones_of(runs, of_names)
    return xr.DataTree.from_dict({**groups, **stochastic})


def backbones_of(runs: Sequence[xr.Dataset], results: Mapping[str, xr.Dataset]) -> dict[str, xr.Dataset]:
    """Return the backbone and the lack of fit of each run; none for a run with too few half periods."""
    groups = {}
    names = [group_names(name, len(runs)) for name in ("backbone", "lack_of_fit")]
    for run, of_record, of_models in zip(runs, *names, strict=True):
        with suppress(DecayError):
            smoothed = smoothed_backbone(run)
            groups[of_record] = smoothed.curves
            groups[of_models] = lack_of_fit(run, results, smoothed)
    return groups


def _chosen(results: Sequence[xr.Dataset], table: xr.Dataset) -> int:
    """Return the index of the preferred identification, by the residuals and by `better_of`.

    A spectral line (hum) moves extrema and their times, so that averaging loses its advantage. The second
    method is then preferred if its residual is not larger and contains only noise or a line.
    """
    rms, over_noise = table.tested_rms.values, table.tested_over_noise.values
    line = np.isfinite(table.spectral_line.values[1])
    if rms[1] <= 1.02 * rms[0] and (line or over_noise[1] <= 1.0):
        return 1
    return better_of(*results)


def better_of(first: xr.Dataset, second: xr.Dataset) -> int:
    """Return the index of the preferred identification: the second, unless the first predicts better.

    If the residual of the second is only noise, the second is preferred, because it is at the statistical
    bound; else the first if its residual is only noise. Otherwise the second must predict the held-out parts
    better than the first by more than `CLEARLY_BETTER`.
    """
    if "held_out_rms" not in second or "held_out_rms" not in first:
        return int("held_out_rms" not in second)
    held_out = [float(result.get("held_out_rms", np.nan)) for result in (first, second)]
    return 0 if np.isfinite(held_out[0]) and not CLEARLY_BETTER * held_out[1] < held_out[0] else 1


def random_force_groups(followed: FollowedRuns) -> dict[str, xr.Dataset]:
    """Return test, innovations and bands of a random force as groups of a tree; empty without one.

    Parameters
    ----------
    followed : FollowedRuns
        All runs of an identification.

    Returns
    -------
    dict of str to Dataset
        `random_force`: over `run` the result of `random_force_dependence`, with `reason` if it is nan. Also
        `innovations` and `prediction_bands` of each run (`innovations_1`, ... for several), except for runs
        that are too short or whose motion does not converge.
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
        # A record too short for predictions has no bands.
        with suppress(SysidTribError):
            groups[of_bands] = bands.bands_of(tracked, result, _horizons(decay, result), run=at)
    return groups


def _horizons(decay: xr.Dataset, result: xr.Dataset) -> Array:
    """Return the horizons (periods) of the predictions."""
    period = 2.0 * np.pi / float(result.reference_frequency)
    length = float(decay.time.values[-1] - decay.time.values[0]) / period
    longest = min(LONGEST_PREDICTION, 0.5 * (length - bands.SETTLING_PERIODS))
    return np.asarray(np.arange(1, max(2, int(longest / PREDICTION_STEP))) * PREDICTION_STEP, dtype=float)
