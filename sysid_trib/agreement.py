"""How well two identifications of one decay agree, and how well each model follows the record."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from sysid_trib.errors import SysidTribError
from sysid_trib.model import rescaling_factors
from sysid_trib.results import library_of, model_of
from sysid_trib.simulate import trajectory
from sysid_trib.start import FittedMotion, first_guess, fit_start
from sysid_trib.ties import exactly_dependent, indistinguishable, without_signature

Array = NDArray[np.float64]

# Samples a period for the statistics of the difference: more would cost time and change nothing.
SAMPLES_PER_PERIOD = 60
# A model has left the noise where the RMS over half a period is beyond this many noise levels.
LEFT = 2.0


def fitted_motion(decay: xr.Dataset, result: xr.Dataset) -> FittedMotion:
    """Motion of an identified model, its start and the sensor's zero fitted to the decay."""
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    frequency = result.reference_frequency.item()
    if "start_angle" in result:
        start = (result.start_angle.item(), result.start_rate.item())
    else:
        start = first_guess(time, angle, frequency)
    return fit_start(model_of(result), time, angle, start)


def comparison(
    decay: xr.Dataset,
    results: Sequence[xr.Dataset],
    motion: FittedMotion,
    methods: Sequence[Any],
    draws: int,
    seed: int,
) -> xr.Dataset:
    """Difference of two identifications, force by force and as a whole (see `cross_check`)."""
    first, second = results
    shared = [s for s in first.force.values.tolist() if s in second.force.values.tolist()]
    kept = [s for s in shared if _in_model(first, s) and _in_model(second, s)]
    difference = _difference(first, second, kept)
    expected, scatter = _scatter(decay, second, motion, methods, kept, draws, seed)
    count = len(difference)
    error = np.sqrt(np.diag(scatter))
    excess = difference - expected
    chi_square = float(excess @ np.linalg.pinv(scatter) @ excess)
    # The covariance is itself estimated from `draws` records: Hotelling's T^2, which is F distributed.
    freedom = max(1, draws - count)
    p_value = float(f_distribution.sf(chi_square * freedom / (count * max(1, draws - 1)), count, freedom))
    labels = [*kept, "asymptotic frequency"]
    per = {"units": "1; rad/s for the frequency"}
    return xr.Dataset(
        {
            "difference": ("quantity", difference, per | {"long_name": "first method minus second"}),
            "expected_difference": (
                "quantity",
                expected,
                per | {"long_name": "difference of the methods' biases"},
            ),
            "standard_error": ("quantity", error, per | {"long_name": "standard error of the difference"}),
            "z": ("quantity", excess / error, {"units": "1", "long_name": "excess over its standard error"}),
            "chi_square": ((), chi_square, {"units": "1", "long_name": "chi-square of all differences"}),
            "degrees_of_freedom": ((), count, {"units": "1", "long_name": "number of differences"}),
            "p_value": (
                (),
                p_value,
                {"units": "1", "long_name": "probability of a larger chi-square by chance"},
            ),
        },
        {"quantity": labels},
    )


def residuals(
    decay: xr.Dataset, names: Sequence[str], motions: Sequence[FittedMotion], noise: float
) -> xr.Dataset:
    """What each model leaves of the record: RMS, RMS over the noise, and when it first leaves the noise."""
    time, angle = decay.time.values, decay.angle.values
    rows = []
    for motion in motions:
        gap = angle - motion.offset - motion.x
        rms = float(np.sqrt(np.mean(gap**2)))
        rows.append((rms, rms / noise, _departure(time, gap, noise, motion)))
    table = np.array(rows)
    return xr.Dataset(
        {
            "residual_rms": (
                "model",
                table[:, 0],
                {"units": "rad", "long_name": "RMS of record minus model"},
            ),
            "residual_over_noise": ("model", table[:, 1], {"units": "1", "long_name": "RMS over the noise"}),
            "departure_time": (
                "model",
                table[:, 2],
                {"units": "s", "long_name": "first time at which the model leaves the noise, nan if never"},
            ),
        },
        {"model": list(names)},
    )


def ties(decay: xr.Dataset, result: xr.Dataset) -> dict[str, str]:
    """Forces that averaging, or any method, cannot tell apart by principle."""
    library = library_of(result)
    shapes = model_of(result).shapes
    size = float(np.max(np.abs(decay.angle.values)))

    def told(groups: Sequence[Sequence[str]]) -> str:
        return "; ".join(" = ".join(group) for group in groups)

    return {
        "averaging_cannot_tell_apart": told(indistinguishable(library, 0.02 * size, size, shapes=shapes)),
        "averaging_cannot_see": ", ".join(without_signature(library, 0.02 * size, size, shapes=shapes)),
        "no_method_can_tell_apart": told(exactly_dependent(library, size, shapes=shapes)),
    }


def _in_model(result: xr.Dataset, symbol: str) -> bool:
    return bool(np.isclose(result.refers_to.sel(force=symbol), result.reference_frequency, rtol=1e-12))


def _difference(first: xr.Dataset, second: xr.Dataset, kept: Sequence[str]) -> Array:
    """First minus second, at the first's reference frequency, and of the asymptotic frequencies (rad/s)."""
    library = library_of(second).select(kept)
    factors = rescaling_factors(
        library.forces, second.reference_frequency.item(), first.reference_frequency.item()
    )
    other = second.coefficient.sel(force=kept).values * np.where(np.isnan(factors), 1.0, factors)
    coefficients = first.coefficient.sel(force=kept).values - other
    return np.append(coefficients, first.asymptotic_frequency.item() - second.asymptotic_frequency.item())


def _scatter(
    decay: xr.Dataset,
    result: xr.Dataset,
    motion: FittedMotion,
    methods: Sequence[Any],
    kept: Sequence[str],
    draws: int,
    seed: int,
) -> tuple[Array, Array]:
    """Mean difference without noise, and covariance of the difference over noisy records of a known model."""
    model, library = model_of(result), library_of(result, whole=True)
    library = library.select([s for s in library.symbols if s in (*kept, *_stiffness(library))])
    time, noise = _coarse(decay, result)
    exact = trajectory(model, time, motion.angle, motion.rate).angle
    random = np.random.default_rng(seed)

    def difference(angle: Array, pair: Sequence[Any]) -> Array:
        record = xr.Dataset({"angle": ("time", angle)}, {"time": time})
        first, second = (method.identify(record, library) for method in pair)
        return _difference(first, second, kept)

    expected = difference(exact, methods)
    found = []
    for _ in range(draws):
        try:
            found.append(difference(exact + noise * random.standard_normal(len(time)), methods))
        except SysidTribError:
            continue
    return expected, np.atleast_2d(np.cov(np.array(found), rowvar=False))


def _stiffness(library: Any) -> tuple[str, ...]:
    force = library.role("x")
    return () if force is None else (force.symbol,)


def _coarse(decay: xr.Dataset, result: xr.Dataset) -> tuple[Array, float]:
    """Times of a record of the same length with fewer samples, and the noise of their local means."""
    time = decay.time.values.astype(float)
    period = 2.0 * np.pi / result.asymptotic_frequency.item()
    most = int(SAMPLES_PER_PERIOD * (time[-1] - time[0]) / period) + 2
    if len(time) <= most:
        return time, result.noise.item()
    return np.linspace(time[0], time[-1], most), result.noise.item() * np.sqrt(most / len(time))


def _departure(time: Array, gap: Array, noise: float, motion: FittedMotion) -> float:
    """First time at which the RMS over half a period is beyond `LEFT` noise levels; nan if never."""
    turns = np.flatnonzero(np.diff(np.sign(motion.v)) != 0)
    width = int(np.median(np.diff(turns))) if len(turns) > 2 else max(1, len(gap) // 10)
    total = np.concatenate([[0.0], np.cumsum(gap**2)])
    local = np.sqrt((total[width:] - total[:-width]) / width)
    beyond = np.flatnonzero(local > LEFT * noise)
    return float(time[beyond[0]]) if len(beyond) else float("nan")


def method_of(result: xr.Dataset) -> Any:
    """The method of an identification with the options it was made with."""
    from sysid_trib import methods

    kind = next(
        k for k in vars(methods).values() if getattr(k, "__name__", "").lower() == result.attrs["method"]
    )
    options = json.loads(result.attrs["options"])
    # An optimiser is not kept as text: what the statistics need is its linear part.
    return kind(**{k: v for k, v in options.items() if k != "optimizer"})
