"""How far two identifications of one decay differ, and what they cannot tell apart."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.stats import f as f_distribution

from sysid_trib.arrays import Array
from sysid_trib.averaging.identifiability import exactly_dependent, indistinguishable, without_signature
from sysid_trib.errors import SysidTribError
from sysid_trib.methods import method_of
from sysid_trib.records.runs import one_or_all
from sysid_trib.results.common_reference import (
    ASYMPTOTIC_FREQUENCY,
    comparable,
    comparison_values,
    stated_covariance,
)
from sysid_trib.results.per_run import noise_of_run
from sysid_trib.results.schema import library_of, model_of
from sysid_trib.results.variables import chi_square_test, variable
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion
from sysid_trib.validation.homogeneity import MIXED_UNITS

# Samples a period for the statistics of the difference: more would cost time and change nothing.
SAMPLES_PER_PERIOD = 60


def comparison(
    runs: Sequence[xr.Dataset],
    results: Sequence[xr.Dataset],
    motions: Sequence[Sequence[FittedMotion | None]],
    *,
    draws: int,
    seed: int,
) -> xr.Dataset:
    """Difference of two identifications, force by force and as a whole (see `cross_check`).

    `motions` : of each result, in each run.
    """
    first, second = results
    kept = comparable(*results)
    frequency = first.reference_frequency.item()
    difference = comparison_values(first, kept, frequency) - comparison_values(second, kept, frequency)
    count = len(difference)
    # The second's model is the truth of the simulated records, or the first's if that has no motion.
    # Where a bias could not be removed, what to expect is not known.
    failed = any(str(r.attrs.get("first_order_bias_removed", "")).startswith("no:") for r in results)
    moving = [(r, m) for r, m in zip(results[::-1], motions[::-1], strict=True) if None not in m]
    truth = None if failed or not moving else moving[0]
    expected, scatter = np.full(count, np.nan), np.full((count, count), np.nan)
    if truth is not None:
        expected, scatter = _scatter(runs, results, truth, kept, draws=draws, seed=seed)
    error = np.sqrt(np.diag(scatter))
    excess = difference - expected
    # One method with and without its bias: nothing else differs.
    z = np.divide(excess, error, out=np.zeros_like(excess), where=error != 0.0)
    chi_square = float(excess @ np.linalg.pinv(scatter) @ excess) if truth is not None else float("nan")
    # The covariance is itself estimated from `draws` records: Hotelling's T^2, which is F distributed.
    rest = max(1, draws - count)
    p_value = float(f_distribution.sf(chi_square * rest / (count * max(1, draws - 1)), count, rest))
    variables = {
        "difference": variable("quantity", difference, "first method minus second", MIXED_UNITS),
        "expected_difference": variable(
            "quantity", expected, "difference of the methods' biases", MIXED_UNITS
        ),
        "standard_error": variable("quantity", error, "standard error of the difference", MIXED_UNITS),
        "z": variable("quantity", z, "excess over its standard error", "1"),
        **chi_square_test((), chi_square, count, "chi-square of all differences", p_value),
    }
    return xr.Dataset(variables, {"quantity": [*kept, ASYMPTOTIC_FREQUENCY]})


def ties(runs: Sequence[xr.Dataset], result: xr.Dataset) -> dict[str, str]:
    """Forces that averaging, or any method, cannot tell apart by principle."""
    library = library_of(result)
    shapes = model_of(result).shapes
    size = max(float(np.max(np.abs(run.angle.values))) for run in runs)

    def as_text(groups: Sequence[Sequence[str]]) -> str:
        return "; ".join(" = ".join(group) for group in groups)

    return {
        "averaging_cannot_tell_apart": as_text(indistinguishable(library, 0.02 * size, size, shapes=shapes)),
        "averaging_cannot_see": ", ".join(without_signature(library, 0.02 * size, size, shapes=shapes)),
        "no_method_can_tell_apart": as_text(exactly_dependent(library, size, shapes=shapes)),
    }


def _scatter(
    runs: Sequence[xr.Dataset],
    results: Sequence[xr.Dataset],
    truth: tuple[xr.Dataset, Sequence[FittedMotion | None]],
    kept: Sequence[str],
    *,
    draws: int,
    seed: int,
) -> tuple[Array, Array]:
    """Mean difference without noise, and covariance of the difference over noisy records of a known model."""
    exact = _exact_motions(runs, *truth)
    random = np.random.default_rng(seed)
    best = [_at_its_best(runs, result) for result in results]
    # Each with what it was offered: forces that one of them neglects are part of its bias.
    offered = [library_of(result, whole=True) for result in results]
    frequency = truth[0].reference_frequency.item()

    def values(pair: Sequence[xr.Dataset]) -> Array:
        return np.stack([comparison_values(result, kept, frequency) for result in pair])

    def identified(noise_factor: float) -> Array:
        records = [
            _record(time, angle + noise_factor * noise * random.standard_normal(len(angle)))
            for time, angle, noise in exact
        ]
        pairs = zip(best, offered, strict=True)
        return values([method.identify(one_or_all(records), library) for (method, _), library in pairs])

    # The bias that a method left in is what it would have removed; what remains shows without noise.
    expected = np.subtract(*values(results)) - np.subtract(*values([result for _, result in best]))
    with suppress(SysidTribError):
        expected = expected + np.subtract(*identified(0.0))
    drawn_values = []
    for _ in range(draws):
        with suppress(SysidTribError):
            drawn_values.append(identified(1.0))
    if len(drawn_values) < 3:
        count = len(kept) + 1
        return np.full(count, np.nan), np.full((count, count), np.nan)
    both = np.array(drawn_values)
    scatter = np.atleast_2d(np.cov(both[:, 0] - both[:, 1], rowvar=False))
    if _beyond_noise(results, kept, both):
        scatter = sum((stated_covariance(result, kept) for result in results), np.zeros_like(scatter))
    return expected, scatter


def _at_its_best(runs: Sequence[xr.Dataset], result: xr.Dataset) -> tuple[Any, xr.Dataset]:
    """Method and result with the removal of bias that was left off: its scatter is calibrated."""
    method = method_of(result)
    off = {name: True for name in ("correct", "refine") if getattr(method, name, True) is False}
    if not off:
        return method, result
    try:
        better = replace(method, **off)
        return better, better.identify(one_or_all(runs), library_of(result, whole=True))
    except SysidTribError:
        return method, result


def _beyond_noise(results: Sequence[xr.Dataset], kept: Sequence[str], draws: Array) -> bool:
    """Whether the errors that the methods state exceed those by the noise alone.

    Where a residual is more than noise, methods weigh it differently: they no longer share their errors,
    which then add. A ratio below 1.5 is chance.
    """
    stated = np.stack([np.sqrt(np.diag(stated_covariance(result, kept))) for result in results])
    drawn = draws.std(axis=0, ddof=1)
    # What does not vary, as a force that every draw drops, has no ratio.
    ratio = np.divide(stated, drawn, out=np.ones_like(drawn), where=drawn > 0.0)
    return bool(np.max(ratio) > 1.5)


def _exact_motions(
    runs: Sequence[xr.Dataset], result: xr.Dataset, motions: Sequence[FittedMotion | None]
) -> list[tuple[Array, Array, float]]:
    """Times, angle of the model's motion and noise of each run; with fewer samples, of less noise."""
    model, exact = model_of(result), []
    period = 2.0 * np.pi / result.asymptotic_frequency.item()
    for at, (run, motion) in enumerate(zip(runs, motions, strict=True)):
        time, noise = run.time.values.astype(float), noise_of_run(result, at)
        most = int(SAMPLES_PER_PERIOD * (time[-1] - time[0]) / period) + 2
        if len(time) > most:
            noise *= np.sqrt(most / len(time))
            time = np.linspace(time[0], time[-1], most)
        if motion is not None:
            exact.append((time, trajectory(model, time, motion.angle, motion.rate).angle, noise))
    return exact


def _record(time: Array, angle: Array) -> xr.Dataset:
    return xr.Dataset({"angle": ("time", angle)}, {"time": time})
