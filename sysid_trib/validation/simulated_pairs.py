"""How two identifications differ, and how that scatters: both methods on records simulated by one model."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, Tell, silent
from sysid_trib.likelihood.random_force import is_fitted, random_force_of
from sysid_trib.methods import method_of, scope
from sysid_trib.motion_fit.linearised import linearised_along, random_walk_about
from sysid_trib.records.decay import Decays, one_or_all
from sysid_trib.results import references, schema
from sysid_trib.results.variables import described, noise_of_run
from sysid_trib.simulation import simulate
from sysid_trib.validation.residuals import FollowedRuns

EXCESS_LEVEL = 0.01
PERIODS_PER_STRETCH = 20
# A run is long where identifying every simulated record whole would take longer than its stretches do, and
# something is gained: three short records cost as much as one of twice their length.
LONGEST_WHOLE = 120

# What to expect of the difference of two identifications that are right, (quantity,); its covariance about
# that, nan if it is not known; the simulated records that count; and whether the covariance is the sum of
# those that the methods state, not that of the records.
Scatter: TypeAlias = tuple[Array, Array, int, bool]


def comparison(pair: Sequence[FollowedRuns], *, draws: int, seed: int, tell: Tell) -> xr.Dataset:
    """Difference of two identifications, force by force and as a whole (see `cross_check`)."""
    pair, duration = compared_part(pair)
    results = [followed.result for followed in pair]
    kept = references.comparable(*results)
    # The second's model is the truth of the simulated records, or the first's if that has no motion.
    # One that does not swing at small amplitudes has no period there.
    swings = [followed for followed in pair[::-1] if followed.result.asymptotic_frequency.item() > 0.0]
    moving = [followed for followed in swings if None not in followed.motions]
    frequency = (moving or pair[::-1])[0].result.reference_frequency.item()
    difference = np.subtract(*(references.comparison_values(result, kept, frequency) for result in results))
    known = _nothing_known(len(difference), 0)
    # Where a bias could not be removed, what to expect is not known.
    failed = any(str(r.attrs.get("first_order_bias_removed", "")).startswith("no:") for r in results)
    if moving and not failed:
        known = scatter(results, moving[0], kept, draws=draws, seed=seed, tell=tell)
    expected, covariance, records, stated = known
    error, excess = np.sqrt(np.diag(covariance)), difference - expected
    # One method with and without its bias: nothing else differs.
    z = np.divide(excess, error, out=np.zeros_like(excess), where=error != 0.0)
    chi_square, p_value = _chi_square(difference, known)
    values: dict[str, Any] = {"difference": difference, "expected_difference": expected}
    values |= {"standard_error": error, "z": z, "chi_square": chi_square, "p_value": p_value}
    values["degrees_of_freedom"] = len(difference)
    # Where the motion is pushed some records may not be identified.
    attrs: dict[str, Any] = {"errors": "stated" if stated else "simulated", "simulated_records": records}
    attrs |= {} if duration is None else {"compared_stretch": duration}
    coords = {"quantity": [*kept, references.ASYMPTOTIC_FREQUENCY]}
    return xr.Dataset(described("cross_check", values), coords, attrs)


def compared_part(pair: Sequence[FollowedRuns]) -> tuple[Sequence[FollowedRuns], float | None]:
    """Stretches of long runs, with what both methods identify there; and their duration (s).

    As given, and None, where no run is longer than `LONGEST_WHOLE` periods, where a force depends on time, or
    where a method cannot identify the stretches as runs of one experiment, each with a start of its own. A
    random force is held at that of the whole.
    """
    runs, results = pair[0].runs.values(), [followed.result for followed in pair]
    frequency = results[1].asymptotic_frequency.item()
    # A model that does not swing at small amplitudes has no period there.
    if not frequency > 0.0:
        return pair, None
    period = 2.0 * np.pi / frequency
    duration = PERIODS_PER_STRETCH * period
    parts = [part for run in runs for part in stretches(run, duration, LONGEST_WHOLE * period)]
    libraries = [schema.library_of(result, whole=True) for result in results]
    methods = [_with_held_random_force(result) for result in results]
    # A stretch counts the time since the first sample anew.
    timed = any("t" in force.formula.names for library in libraries for force in library)
    if len(parts) == len(runs) or timed or not all(scope.scope_of(method).several_runs for method in methods):
        return pair, None
    try:
        of_parts = [m.identify(parts, library) for m, library in zip(methods, libraries, strict=True)]
    except SysidTribError:
        return pair, None
    return [FollowedRuns(dict(enumerate(parts)), result) for result in of_parts], duration


def stretches(run: xr.Dataset, duration: float, longest: float) -> list[xr.Dataset]:
    """Beginning, middle and end, of `duration` (s), of a run longer than `longest`; else the run itself."""
    time = run.time.values
    whole = time[-1] - time[0]
    if whole <= longest:
        return [run]
    # A long run is compared on its beginning, its middle and its end: from three amplitudes what depends on
    # amplitude can be told, which a single stretch of a motion that hardly decays leaves undecided.
    starts = time[0] + np.linspace(0.0, 1.0, 3) * (whole - duration)
    ends = starts + duration
    bounds = zip(np.searchsorted(time, starts), np.searchsorted(time, ends, side="right"), strict=True)
    return [run.isel(time=slice(int(first), int(last))) for first, last in bounds]


def _simulated(truth: FollowedRuns, draws: int, seed: int) -> Callable[[int | None], Decays]:
    """Gives the record of a draw, with the random force that the truth has; of None the one without noise."""
    result = truth.result
    model, simulated = schema.model_of(result), []
    period = 2.0 * np.pi / result.asymptotic_frequency.item()
    # A stream of its own: the sensor's noise is the same with a random force and without.
    random, forcing = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    for (at, run), motion in zip(truth.runs.items(), truth.motions, strict=True):
        assert motion is not None
        time, noise = run.time.values.astype(float), noise_of_run(result, at)
        # Samples a period for the statistics of the difference: more would cost time and change nothing.
        most = int(60 * (time[-1] - time[0]) / period) + 2
        if len(time) > most:
            noise *= np.sqrt(most / len(time))
            time = np.linspace(time[0], time[-1], most)
        free, force = simulate.trajectory(model, time, motion.angle, motion.rate), random_force_of(result, at)
        walks = np.zeros((draws, 1))
        if force:
            per_tau = force.per_tau(model.reference_frequency)
            walks = random_walk_about(linearised_along(model, time, free), per_tau, forcing, draws).T
        simulated.append((time, free.angle, noise, walks))

    def record(draw: int | None) -> Decays:
        decays = []
        for time, angle, noise, walks in simulated:
            white = noise * random.standard_normal(len(angle))
            shown = angle if draw is None else angle + white + walks[draw]
            decays.append(xr.Dataset({"angle": ("time", shown)}, {"time": time}))
        return one_or_all(decays)

    return record


def _chi_square(difference: Array, scatter: Scatter) -> tuple[float, float]:
    """Chi-square of a difference, and its p-value.

    A covariance that is itself estimated from records: Hotelling's T^2, which is F distributed.
    """
    expected, covariance, records, stated = scatter
    if not np.all(np.isfinite(covariance)):
        return float("nan"), float("nan")
    excess, count = difference - expected, len(difference)
    statistic = float(excess @ np.linalg.pinv(covariance) @ excess)
    if stated:
        return statistic, float(scipy.stats.chi2.sf(statistic, count))
    rest = max(1, records - count)
    ratio = statistic * rest / (count * max(1, records - 1))
    return statistic, float(scipy.stats.f.sf(ratio, count, rest))


def _nothing_known(count: int, records: int) -> Scatter:
    """The scatter of so many quantities where too few records were identified."""
    return np.full(count, np.nan), np.full((count, count), np.nan), records, False


def fewest_records(count: int) -> int:
    """Number of records by which a difference of two identifications in `count` quantities is judged."""
    return 2 * count + 2


def scatter(
    results: Sequence[xr.Dataset],
    truth: FollowedRuns,
    kept: Sequence[str],
    *,
    draws: int,
    seed: int,
    tell: Tell = silent,
) -> Scatter:
    """Scatter of the difference of two identifications over simulated records of a known model.

    Parameters
    ----------
    results : sequence of Dataset
        Both identifications.
    truth : FollowedRuns
        The runs that both are from, with that of the two whose model is simulated.
    kept : sequence of str
        Symbols of the forces that are compared.
    draws, seed : int
        Number of records, and the seed of their noise.
    tell : Tell
        Called before each record.

    Raises
    ------
    SimulationError
        The motion of the model cannot be computed.

    Notes
    -----
    Where the truth has a random force its records are pushed. What to expect is then the mean over the
    records, whose own error is 1/n of their covariance; and as Hotelling's statistic wants more records than
    quantities, fewer than 2 k + 2 for k quantities decide nothing. From these on, pushed or not, a p-value
    above 0.1 is the last: no others are drawn; else the p-value is that of all. So it is below any level a
    with the probability a at most: below 0.1 it is that of all records; above 0.1 it is that of the first 2 k
    + 2, or these had one below 0.1.
    """
    frequency, record = truth.result.reference_frequency.item(), _simulated(truth, draws, seed)
    runs = list(truth.runs.values())
    methods, at_best = zip(*(_at_its_best(runs, result) for result in results), strict=True)
    # Each with what it was offered: forces that one of them neglects are part of its bias.
    offered = [schema.library_of(result, whole=True) for result in results]

    def values(pair: Sequence[xr.Dataset]) -> Array:
        return np.stack([references.comparison_values(result, kept, frequency) for result in pair])

    def identified(draw: int | None) -> Array:
        decay, pairs = record(draw), zip(methods, offered, strict=True)
        return values([method.identify(decay, library) for method, library in pairs])

    # The bias that a method left in is what it would have removed; what remains shows in the records.
    difference = np.subtract(*values(results))
    bias = difference - np.subtract(*values(at_best))
    stated = np.stack([references.stated_covariance(result, kept) for result in results])
    stochastic = bool(random_force_of(truth.result))
    if not stochastic:
        with suppress(SysidTribError):
            bias = bias + np.subtract(*identified(None))
    if any("error_of_model" in result for result in results):
        # What the models lack is not in records that are simulated by them.
        return bias, stated.sum(axis=0), 0, True
    # What fewer records give is no covariance.
    enough = fewest_records(len(bias))
    drawn: list[Array] = []

    def known() -> Scatter:
        """By the records that were drawn, about the difference without noise or, without one, its mean."""
        of_methods, count = np.array(drawn), len(drawn)
        differences, errors = of_methods[:, 0] - of_methods[:, 1], of_methods.std(axis=0, ddof=1)
        # How much the errors that the methods state exceed those by the noise alone: where a residual is more
        # than noise, methods weigh it differently: they no longer share their errors, which then add. What
        # does not vary, as a force that every draw drops, has no ratio.
        of_stated = np.sqrt(np.diagonal(stated, axis1=1, axis2=2))
        excess = np.divide(of_stated, errors, out=np.ones_like(errors), where=errors > 0.0)
        # Of a few records the largest ratio by chance depends on their number: at 1 %, of all quantities.
        allowed = np.sqrt((count - 1) / scipy.stats.chi2.ppf(EXCESS_LEVEL / errors.size, count - 1))
        exceeds = bool(np.max(excess) > allowed)
        simulated = np.atleast_2d(np.cov(differences, rowvar=False))
        covariance = stated.sum(axis=0) if exceeds else simulated
        if not stochastic:
            return bias, covariance, count, exceeds
        return bias + differences.mean(axis=0), covariance + simulated / count, count, exceeds

    for draw in range(draws):
        tell(f"both methods held against each other on {draws} simulated records", draw / draws)
        with suppress(SysidTribError):
            drawn.append(identified(draw))
            # Where as many records as decide give a larger p-value, no others are drawn.
            if len(drawn) >= enough and _chi_square(difference, known())[1] > 0.1:
                break
    return known() if len(drawn) >= (enough if stochastic else 3) else _nothing_known(len(bias), len(drawn))


def _at_its_best(runs: Sequence[xr.Dataset], result: xr.Dataset) -> tuple[Any, xr.Dataset]:
    """Method and result with the removal of bias that was left off: its scatter is calibrated.

    A random force is held at the result's own, so that a record takes no longer than one without.
    """
    method = _with_held_random_force(result)
    off = {name: True for name in ("correct", "refine") if getattr(method, name, True) is False}
    if not off:
        return method, result
    try:
        better = replace(method, **off)
        return better, better.identify(one_or_all(runs), schema.library_of(result, whole=True))
    except SysidTribError:
        return method, result


def _with_held_random_force(result: xr.Dataset) -> Any:
    """The method of a result; if it estimates a random force, that is held: off where it found none."""
    method = method_of(result)
    if not is_fitted(getattr(method, "random_force", "off")):
        return method
    force = random_force_of(result)
    return replace(method, random_force=force.density if force else "off")
