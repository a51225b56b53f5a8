"""How well two identifications of one decay agree, and how well each model follows the record."""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from sysid_trib.averaging.identifiability import exactly_dependent, indistinguishable, without_signature
from sysid_trib.errors import SimulationError, SysidTribError
from sysid_trib.records.runs import noise_of_run, one_or_all
from sysid_trib.results.common_reference import FREQUENCY, in_model, quantities, stated_covariance
from sysid_trib.results.schema import NOT_KEPT, library_of, model_of
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion, first_guess, fit_start

Array = NDArray[np.float64]

# Samples a period for the statistics of the difference: more would cost time and change nothing.
SAMPLES_PER_PERIOD = 60
# A model has left the noise where the RMS over half a period is beyond this many noise levels.
LEFT = 2.0


def fitted_motion(decay: xr.Dataset, result: xr.Dataset, run: int = 0) -> FittedMotion | None:
    """Motion of an identified model in a run, start and sensor's zero fitted; None if it diverges."""
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    frequency = result.reference_frequency.item()
    if "start_angle" in result:
        start = (float(np.ravel(result.start_angle)[run]), float(np.ravel(result.start_rate)[run]))
    else:
        start = first_guess(time, angle, frequency)
    try:
        return fit_start(model_of(result), time, angle, start)
    except SimulationError:
        return None


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
    shared = [s for s in first.force.values.tolist() if s in second.force.values.tolist()]
    kept = [s for s in shared if in_model(first, s) and in_model(second, s)]
    frequency = first.reference_frequency.item()
    difference = quantities(first, kept, frequency) - quantities(second, kept, frequency)
    count = len(difference)
    # The second's model is the truth of the simulated records, or the first's if that has no motion.
    # Where a bias could not be removed, what to expect is not known.
    failed = any(str(r.attrs.get("first_order_bias_removed", "")).startswith("no:") for r in results)
    truth = (
        None
        if failed
        else next(((r, m) for r, m in zip(results[::-1], motions[::-1], strict=True) if None not in m), None)
    )
    expected, scatter = np.full(count, np.nan), np.full((count, count), np.nan)
    if truth is not None:
        expected, scatter = _scatter(runs, results, truth, kept, draws=draws, seed=seed)
    error = np.sqrt(np.diag(scatter))
    excess = difference - expected
    # One method with and without its bias: nothing else differs.
    z = np.divide(excess, error, out=np.zeros_like(excess), where=error != 0.0)
    chi_square = float(excess @ np.linalg.pinv(scatter) @ excess) if truth is not None else float("nan")
    # The covariance is itself estimated from `draws` records: Hotelling's T^2, which is F distributed.
    freedom = max(1, draws - count)
    p_value = float(f_distribution.sf(chi_square * freedom / (count * max(1, draws - 1)), count, freedom))
    per = {"units": "1; rad/s for the frequency"}
    columns = {
        "difference": (difference, per | {"long_name": "first method minus second"}),
        "expected_difference": (expected, per | {"long_name": "difference of the methods' biases"}),
        "standard_error": (error, per | {"long_name": "standard error of the difference"}),
        "z": (z, {"units": "1", "long_name": "excess over its standard error"}),
    }
    scalars = {
        "chi_square": (chi_square, "chi-square of all differences"),
        "degrees_of_freedom": (count, "number of differences"),
        "p_value": (p_value, "probability of a larger chi-square by chance"),
    }
    variables: dict[str, Any] = {k: ("quantity", value, attrs) for k, (value, attrs) in columns.items()}
    variables |= {k: ((), value, {"units": "1", "long_name": name}) for k, (value, name) in scalars.items()}
    return xr.Dataset(variables, {"quantity": [*kept, FREQUENCY]})


def residuals(
    decay: xr.Dataset, names: Sequence[str], motions: Sequence[FittedMotion | None], noise: float
) -> xr.Dataset:
    """What each model leaves of the record: RMS, RMS over the noise, when, and whether it is but white noise.

    A model without a motion leaves nan.
    """
    time, angle = decay.time.values, decay.angle.values
    rows = []
    for motion in motions:
        if motion is None:
            rows.append((np.nan, np.nan, float(time[0]), 0.0))
            continue
        gap = angle - motion.offset - motion.x
        rms = float(np.sqrt(np.mean(gap**2)))
        rows.append((rms, rms / noise, _departure(time, gap, noise, motion), _chance(gap, noise, motion)))
    columns = {
        "residual_rms": ("rad", "RMS of record minus model"),
        "residual_over_noise": ("1", "RMS of record minus model over the noise"),
        "departure_time": ("s", "first time at which the model leaves the noise, nan if never"),
        "residual_p_value": (
            "1",
            "probability that white noise leaves as much within the band of the motion",
        ),
    }
    variables: dict[str, Any] = {
        name: ("model", values, {"units": units, "long_name": long_name})
        for (name, (units, long_name)), values in zip(columns.items(), np.array(rows).T, strict=True)
    }
    return xr.Dataset(variables, {"model": list(names)})


def pooled(each: Sequence[xr.Dataset]) -> xr.Dataset:
    """`residuals` of several runs as one, those of each run beside it with the dimension `run`.

    RMS over the runs, the earliest departure, and the least p-value times the number of runs (Bonferroni).
    """
    if len(each) == 1:
        return each[0]
    runs = xr.concat(each, "run")
    whole = xr.Dataset(
        {
            name: np.sqrt((runs[name] ** 2).mean("run", skipna=False))
            for name in ("residual_rms", "residual_over_noise")
        }
    )
    whole["departure_time"] = runs.departure_time.min("run")
    whole["residual_p_value"] = np.minimum(1.0, len(each) * runs.residual_p_value.min("run"))
    for name in whole.data_vars:
        whole[name].attrs = each[0][name].attrs
    return whole.merge(runs.rename({name: f"run_{name}" for name in runs.data_vars}))


def ties(runs: Sequence[xr.Dataset], result: xr.Dataset) -> dict[str, str]:
    """Forces that averaging, or any method, cannot tell apart by principle."""
    library = library_of(result)
    shapes = model_of(result).shapes
    size = max(float(np.max(np.abs(run.angle.values))) for run in runs)

    def told(groups: Sequence[Sequence[str]]) -> str:
        return "; ".join(" = ".join(group) for group in groups)

    return {
        "averaging_cannot_tell_apart": told(indistinguishable(library, 0.02 * size, size, shapes=shapes)),
        "averaging_cannot_see": ", ".join(without_signature(library, 0.02 * size, size, shapes=shapes)),
        "no_method_can_tell_apart": told(exactly_dependent(library, size, shapes=shapes)),
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
    result, motions = truth
    model = model_of(result)
    noises = [_coarse(run, result, at) for at, run in enumerate(runs)]
    exact = [
        trajectory(model, time, motion.angle, motion.rate).angle
        for (time, _), motion in zip(noises, motions, strict=True)
        if motion is not None
    ]
    random = np.random.default_rng(seed)
    best = [_at_its_best(runs, r) for r in results]
    # Each with what it was offered: forces that one of them neglects are part of its bias.
    offered = [library_of(r, whole=True) for r in results]
    frequency = result.reference_frequency.item()

    def difference(pair: Sequence[xr.Dataset]) -> Array:
        first, second = stacked(pair)
        return np.asarray(first - second)

    def stacked(pair: Sequence[xr.Dataset]) -> Array:
        return np.stack([quantities(r, kept, frequency) for r in pair])

    def identified(strength: float) -> list[xr.Dataset]:
        records = [
            xr.Dataset(
                {"angle": ("time", x + strength * noise * random.standard_normal(len(x)))}, {"time": t}
            )
            for x, (t, noise) in zip(exact, noises, strict=True)
        ]
        return [
            method.identify(one_or_all(records), library)
            for (method, _), library in zip(best, offered, strict=True)
        ]

    # The bias that a method left in is what it would have removed; what remains shows without noise.
    expected = difference(results) - difference([r for _, r in best])
    with suppress(SysidTribError):
        expected = expected + difference(identified(0.0))
    found = []
    for _ in range(draws):
        try:
            found.append(stacked(identified(1.0)))
        except SysidTribError:
            continue
    if len(found) < 3:
        count = len(kept) + 1
        return np.full(count, np.nan), np.full((count, count), np.nan)
    both = np.array(found)
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

    Where a model leaves more than noise, methods weigh what is left differently: they no longer share their
    errors, which then add. A ratio below 1.5 is chance.
    """
    stated = np.stack([np.sqrt(np.diag(stated_covariance(result, kept))) for result in results])
    drawn = draws.std(axis=0, ddof=1)
    # What does not vary, as a force that every draw drops, has no ratio.
    ratio = np.divide(stated, drawn, out=np.ones_like(drawn), where=drawn > 0.0)
    return bool(np.max(ratio) > 1.5)


def _coarse(decay: xr.Dataset, result: xr.Dataset, run: int) -> tuple[Array, float]:
    """Times of a record of the same length with fewer samples, and the noise of their local means."""
    time, noise = decay.time.values.astype(float), noise_of_run(result, run)
    period = 2.0 * np.pi / result.asymptotic_frequency.item()
    most = int(SAMPLES_PER_PERIOD * (time[-1] - time[0]) / period) + 2
    if len(time) <= most:
        return time, noise
    return np.linspace(time[0], time[-1], most), noise * np.sqrt(most / len(time))


def _departure(time: Array, gap: Array, noise: float, motion: FittedMotion) -> float:
    """First time at which the RMS over half a period is beyond `LEFT` noise levels; nan if never."""
    width = _half_period(motion)
    total = np.concatenate([[0.0], np.cumsum(gap**2)])
    local = np.sqrt((total[width:] - total[:-width]) / width)
    beyond = np.flatnonzero(local > LEFT * noise)
    return float(time[beyond[0]]) if len(beyond) else float("nan")


def _chance(gap: Array, noise: float, motion: FittedMotion) -> float:
    """Probability that the means of a gap over twelfths of a period are those of white noise of this level.

    A missing force is a slow gap: it hides in the RMS of all samples, but not in their means.
    """
    width = max(1, _half_period(motion) // 6)
    count = len(gap) // width
    means = gap[: count * width].reshape(count, width).mean(axis=1)
    return float(chi2.sf(width * np.sum((means / noise) ** 2), count))


def _half_period(motion: FittedMotion) -> int:
    """Samples of a half period."""
    turns = np.flatnonzero(np.diff(np.sign(motion.v)) != 0)
    return int(np.median(np.diff(turns))) if len(turns) > 2 else max(1, len(motion.v) // 10)


def method_of(result: xr.Dataset) -> Any:
    """The method of an identification with the options it was made with."""
    from sysid_trib import methods

    kind = next(
        k for k in vars(methods).values() if getattr(k, "__name__", "").lower() == result.attrs["method"]
    )
    options = json.loads(result.attrs["options"])
    # What an optimiser or a start model is for, the statistics do without.
    return kind(**{k: v for k, v in options.items() if not (isinstance(v, dict) and NOT_KEPT in v)})
