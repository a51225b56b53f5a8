"""How the difference of two identifications scatters: both methods on records simulated by one model."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from scipy.stats import chi2, f as f_distribution

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, Tell, silent
from sysid_trib.likelihood.random_force import is_fitted, random_force_of
from sysid_trib.methods import method_of
from sysid_trib.motion_fit.linearised import linearised_along, random_walk_about
from sysid_trib.records.decay import Decays, one_or_all
from sysid_trib.results import references, schema
from sysid_trib.results.variables import noise_of_run
from sysid_trib.simulation import initial_conditions, simulate

EXCESS_LEVEL = 0.01

# An identification, and its motion in each run.
Truth: TypeAlias = tuple[xr.Dataset, Sequence[initial_conditions.FittedMotion]]


def _simulated(
    runs: Sequence[xr.Dataset], truth: Truth, draws: int, seed: int
) -> Callable[[int | None], Decays]:
    """Gives the record of a draw, with the random force that the truth has; of None the one without noise."""
    result, motions = truth
    model, simulated = schema.model_of(result), []
    period = 2.0 * np.pi / result.asymptotic_frequency.item()
    # A stream of its own: the sensor's noise is the same with a random force and without.
    random, forcing = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    for at, (run, motion) in enumerate(zip(runs, motions, strict=True)):
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


@dataclass(frozen=True)
class Scatter:
    """What to expect of the difference of two identifications that are right, and how it scatters.

    Attributes
    ----------
    expected : (quantity,) array of float
    covariance : (quantity, quantity) array of float
        Of the difference minus the expected one; nan if it is not known.
    records : int
        Simulated records that count.
    stated : bool
        Whether the covariance is the sum of those that the methods state, not that of the records.
    """

    expected: Array
    covariance: Array
    records: int
    stated: bool = False

    def chi_square(self, difference: Array) -> tuple[float, float]:
        """Chi-square of a difference, and its p-value.

        A covariance that is itself estimated from records: Hotelling's T^2, which is F distributed.
        """
        if not np.all(np.isfinite(self.covariance)):
            return float("nan"), float("nan")
        excess, count = difference - self.expected, len(difference)
        statistic = float(excess @ np.linalg.pinv(self.covariance) @ excess)
        if self.stated:
            return statistic, float(chi2.sf(statistic, count))
        rest = max(1, self.records - count)
        ratio = statistic * rest / (count * max(1, self.records - 1))
        return statistic, float(f_distribution.sf(ratio, count, rest))


def nothing_known(count: int, records: int = 0) -> Scatter:
    """The scatter of so many quantities where too few records were identified."""
    return Scatter(np.full(count, np.nan), np.full((count, count), np.nan), records)


def fewest_records(count: int) -> int:
    """Number of records by which a difference of two identifications in `count` quantities is judged."""
    return 2 * count + 2


def scatter(
    runs: Sequence[xr.Dataset],
    results: Sequence[xr.Dataset],
    truth: Truth,
    kept: Sequence[str],
    *,
    draws: int,
    seed: int,
    tell: Tell = silent,
) -> Scatter:
    """Scatter of the difference of two identifications over simulated records of a known model.

    Parameters
    ----------
    runs : sequence of Dataset
        The runs that both results are from.
    results : sequence of Dataset
        Both identifications.
    truth : (Dataset, sequence of FittedMotion)
        That of the two whose model is simulated, and its motions.
    kept : sequence of str
        Symbols of the forces that are compared.
    draws, seed : int
        Number of records, and the seed of their noise.
    tell : Tell
        Called before each record.

    Returns
    -------
    Scatter

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
    frequency, record = truth[0].reference_frequency.item(), _simulated(runs, truth, draws, seed)
    methods, at_best = zip(*(_at_its_best(runs, result) for result in results), strict=True)
    # Each with what it was offered: forces that one of them neglects are part of its bias.
    offered = [schema.library_of(result, whole=True) for result in results]

    def values(pair: Sequence[xr.Dataset]) -> Array:
        return np.stack([references.comparison_values(result, kept, frequency) for result in pair])

    def identified(draw: int | None) -> Array:
        decay, pairs = record(draw), zip(methods, offered, strict=True)
        return values([method.identify(decay, library) for method, library in pairs])

    # The bias that a method left in is what it would have removed; what remains shows in the records.
    bias = np.subtract(*values(results)) - np.subtract(*values(at_best))
    without_noise = np.zeros_like(bias)
    both_stated = np.add(*(references.stated_covariance(result, kept) for result in results))
    stochastic = bool(random_force_of(truth[0]))
    if not stochastic:
        with suppress(SysidTribError):
            without_noise = np.subtract(*identified(None))
    if any("error_of_model" in result for result in results):
        # What the models lack is not in records that are simulated by them.
        return Scatter(bias + without_noise, both_stated, 0, stated=True)
    # What fewer records give is no covariance.
    least = fewest_records(len(bias)) if stochastic else 3
    drawn: list[Array] = []

    def known() -> Scatter:
        """By the records that were drawn, about the difference without noise or, without one, its mean."""
        of_methods = np.array(drawn)
        differences = of_methods[:, 0] - of_methods[:, 1]
        covariance = np.atleast_2d(np.cov(differences, rowvar=False))
        # Of a few records the largest ratio by chance depends on their number: at 1 %, of all quantities.
        freedoms = len(drawn) - 1
        allowed = np.sqrt(freedoms / chi2.ppf(EXCESS_LEVEL / of_methods[0].size, freedoms))
        stated = bool(np.max(_excess(results, kept, of_methods)) > allowed)
        whole = both_stated if stated else covariance
        if not stochastic:
            return Scatter(bias + without_noise, whole, len(drawn), stated)
        whole, mean = whole + covariance / len(drawn), differences.mean(axis=0)
        return Scatter(bias + mean, whole, len(drawn), stated)

    for draw in range(draws):
        tell(f"both methods held against each other on {draws} simulated records", draw / draws)
        with suppress(SysidTribError):
            drawn.append(identified(draw))
            enough = len(drawn) >= fewest_records(len(bias))
            # Where as many records as decide give a larger p-value, no others are drawn.
            if enough and known().chi_square(np.subtract(*values(results)))[1] > 0.1:
                break
    return known() if len(drawn) >= least else nothing_known(len(bias), len(drawn))


def _at_its_best(runs: Sequence[xr.Dataset], result: xr.Dataset) -> tuple[Any, xr.Dataset]:
    """Method and result with the removal of bias that was left off: its scatter is calibrated.

    A random force is held at the result's own, so that a record takes no longer than one without.
    """
    method = with_held_random_force(method_of(result), result)
    off = {name: True for name in ("correct", "refine") if getattr(method, name, True) is False}
    if not off:
        return method, result
    try:
        better = replace(method, **off)
        return better, better.identify(one_or_all(runs), schema.library_of(result, whole=True))
    except SysidTribError:
        return method, result


def with_held_random_force(method: Any, result: xr.Dataset) -> Any:
    """A method that estimates a random force, with that of its result held: off where it found none."""
    if not is_fitted(getattr(method, "random_force", "off")):
        return method
    force = random_force_of(result)
    return replace(method, random_force=force.density if force else "off")


def _excess(results: Sequence[xr.Dataset], kept: Sequence[str], drawn: Array) -> Array:
    """How much the errors that the methods state exceed those by the noise alone, (method, quantity).

    Where a residual is more than noise, methods weigh it differently: they no longer share their errors,
    which then add.
    """
    stated = np.stack([np.sqrt(np.diag(references.stated_covariance(result, kept))) for result in results])
    errors = drawn.std(axis=0, ddof=1)
    # What does not vary, as a force that every draw drops, has no ratio.
    return np.divide(stated, errors, out=np.ones_like(errors), where=errors > 0.0)
