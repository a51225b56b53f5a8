"""Profile likelihood of a parameter: how much worse the motion fits where it is held beside its estimate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import xarray as xr
from scipy.interpolate import PchipInterpolator
from scipy.stats import chi2, norm

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SysidTribError, Tell, UsageError, silent
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.methods import Trajectory, method_of
from sysid_trib.records.decay import Decays, as_runs
from sysid_trib.results.schema import library_of, model_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import variable

# Confidence of the intervals, and the root of the deviance at their ends.
CONFIDENCE = 0.95
END_ROOT = float(norm.isf(0.5 * (1.0 - CONFIDENCE)))
# Steps of the standard error by which the ends are looked for, and how many each way.
STEP_OUT, MOST_STEPS_OUT = 1.0, 8
# The interval by the standard error is no good where an end is off by this part of it.
OFF = 0.1


@dataclass
class Profile:
    """One parameter: the values at which it was held, and the signed root of the deviance there.

    Attributes
    ----------
    name : str
    estimate, error : float
    low, high : float
        Limits of the library; infinite of a coefficient.
    roots : dict of float to float
        By value; zero at the estimate.
    """

    name: str
    estimate: float
    error: float
    low: float
    high: float
    roots: dict[float, float] = field(default_factory=dict)

    def end(self, sign: float, deviance: Callable[[float], float]) -> float:
        """Where the root of the deviance is `END` on one side; infinite, or the limit, where it never is."""
        value, step = self.estimate, STEP_OUT * self.error
        limit = self.high if sign > 0.0 else self.low
        for _ in range(MOST_STEPS_OUT):
            value = min(value + step, self.high) if sign > 0.0 else max(value - step, self.low)
            if not self._look(value, sign, deviance):
                return limit
            if abs(self.roots[value]) >= END_ROOT:
                break
            if value == limit:
                return limit
        else:
            return sign * np.inf
        # The root is nearly a straight line: the end by interpolation, looked at once more.
        self._look(self._by_root(sign * END_ROOT), sign, deviance)
        return self._by_root(sign * END_ROOT)

    def _look(self, value: float, sign: float, deviance: Callable[[float], float]) -> bool:
        deviance_there = deviance(value)
        if np.isfinite(deviance_there):
            self.roots[value] = sign * float(np.sqrt(max(0.0, deviance_there)))
        return bool(np.isfinite(deviance_there))

    def _by_root(self, root: float) -> float:
        values = np.array(sorted({self.estimate: 0.0, **self.roots}))
        roots = np.maximum.accumulate([({self.estimate: 0.0} | self.roots)[value] for value in values])
        rising = np.concatenate([[True], np.diff(roots) > 0.0])
        return float(PchipInterpolator(roots[rising], values[rising])(root))


@in_units_of_the_motion
def profile(decay: Decays, result: xr.Dataset, names: Sequence[str], *, tell: Tell = silent) -> xr.Dataset:
    """Intervals of coefficients and shape parameters by the profile likelihood of the motion.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        An identification of it, whose forces, constraints and shapes are those of the fits.
    names : sequence of str
        Symbols of forces (`lambda`), and shape parameters (`dahl.s`).
    tell : callable
        Called with the name of each.

    Returns
    -------
    Dataset
        Over `parameter`: `estimate` of the fit of the motion, its `standard_error`, `low` and `high` of the
        interval of 95 % by the profile (the library's limit, or infinite, where no value is refused), and
        whether it is `asymmetric`: an end is off by more than a tenth from that by the standard error. Over
        `parameter` and `point` the `value` at which it was held and the `deviance` there.

    Raises
    ------
    UsageError
        A name that is no parameter of the model, or is held.
    DecayError
        The motion is pushed by a random force, or no motion follows the record.

    Notes
    -----
    All other parameters are fitted anew at each value, also the start of each run. The deviance is the sum of
    squares over the variance of a sample that the best fit leaves, less its least; it exceeds the 95 % point
    of chi-square (one degree) outside of the interval (Venzon and Moolgavkar 1988).
    """
    runs = as_runs(decay, driven=True)
    library = library_of(result)
    if any(random_force_of(result, run) for run in range(len(runs))):
        raise DecayError(
            "A random force pushes this record: a profile is of the free motion; hold it off with "
            "--random-force off, if the residual allows it."
        )
    shapes = tuple(name for name in names if name in library.shape_values())
    asked = method_of(result)
    method = Trajectory(
        reference_frequency=asked.reference_frequency,
        constraints=asked.constraints,
        random_force="off",
        start=model_of(result),
        fit_shapes=shapes,
    )
    best = method.identify(runs, library)
    fits = _Fits(runs, library, replace(method, start=model_of(best)), best)
    profiles = []
    for at, name in enumerate(names):
        tell(f"profile of {name}", at / len(names))
        profiled = _parameter(best, library, name)
        low, high = (profiled.end(sign, partial(fits.deviance, name)) for sign in (-1.0, 1.0))
        profiles.append((profiled, low, high))
    return _dataset(profiles)


@dataclass(frozen=True)
class _Fits:
    """Fits of the motion with one parameter held."""

    runs: Sequence[xr.Dataset]
    library: ForceLibrary
    method: Trajectory
    best: xr.Dataset

    def deviance(self, name: str, value: float) -> float:
        """Deviance of the best fit in which a parameter has a value; nan where there is none."""
        start = self.method.start
        assert start is not None
        held = {**self.method.constraints, name: value}
        if name in start.coefficients:
            start = replace(start, coefficients={**start.coefficients, name: value})
        else:
            start = replace(start, shapes={**start.shapes, name: value})
        rest = tuple(shape for shape in self.method.fit_shapes if shape != name)
        try:
            deviance_there = replace(self.method, start=start, constraints=held, fit_shapes=rest).identify(
                self.runs, self.library
            )
        except SysidTribError:
            return float("nan")
        samples = np.array([run.sizes["time"] for run in self.runs])
        ratios = (deviance_there.residual_rms.values / self.best.residual_rms.values) ** 2
        # The parameters of the best fit take their part of the noise from what it leaves.
        return float(np.sum((samples - self._numbers / len(samples)) * (ratios - 1.0)))

    @property
    def _numbers(self) -> int:
        """How many numbers the best fit has: coefficients, frequency, shapes, start and zero of each run."""
        free = np.count_nonzero(self.best.standard_error.values > 0.0)
        return int(free) + 1 + len(self.method.fit_shapes) + 3 * len(self.runs)


def _parameter(best: xr.Dataset, library: ForceLibrary, name: str) -> Profile:
    """A parameter with its estimate and the limits of the library."""
    if name in best.force.values:
        row = best.sel(force=name)
        profiled = Profile(name, row.coefficient.item(), row.standard_error.item(), -np.inf, np.inf)
    elif "shape" in best and name in best.shape_parameter.values:
        symbol, _, key = name.partition(".")
        shape, row = library[symbol].shape[key], best.sel(shape_parameter=name)
        profiled = Profile(name, row["shape"].item(), row.shape_standard_error.item(), shape.low, shape.high)
    else:
        known = [*best.force.values.tolist(), *library.shape_values()]
        raise UsageError(f"'{name}' is no parameter of this model; there are {', '.join(known)}.")
    if not (np.isfinite(profiled.error) and profiled.error > 0.0):
        raise UsageError(f"{name} is held, or at its bound: there is no profile of it.")
    return profiled


def _dataset(profiles: Sequence[tuple[Profile, float, float]]) -> xr.Dataset:
    """The Dataset of `profile`."""
    count = max(len(profiled.roots) for profiled, *_ in profiles) + 1
    points: Array = np.full((2, len(profiles), count), np.nan)
    for at, (profiled, *_) in enumerate(profiles):
        roots = {profiled.estimate: 0.0} | profiled.roots
        values = sorted(roots)
        points[:, at, : len(values)] = values, np.square([roots[value] for value in values])
    names = [profiled.name for profiled, *_ in profiles]
    estimate, error = (
        np.array([getattr(profiled, name) for profiled, *_ in profiles]) for name in ("estimate", "error")
    )
    low, high = (np.array(ends) for ends in zip(*(ends for _, *ends in profiles), strict=True))
    off = np.maximum(np.abs(estimate - low - END_ROOT * error), np.abs(high - estimate - END_ROOT * error))
    unit = "that of the parameter"
    return xr.Dataset(
        {
            "estimate": variable("parameter", estimate, "estimate", unit),
            "standard_error": variable("parameter", error, "standard error", unit),
            "low": variable("parameter", low, "lower end of the interval of 95 %", unit),
            "high": variable("parameter", high, "upper end of the interval of 95 %", unit),
            "asymmetric": variable("parameter", off > OFF * END_ROOT * error, "whether the error misleads"),
            "value": variable(("parameter", "point"), points[0], "value at which it was held", unit),
            "deviance": variable(("parameter", "point"), points[1], "deviance there", "1"),
        },
        {"parameter": names},
        {"confidence": CONFIDENCE, "threshold": float(chi2.ppf(CONFIDENCE, 1))},
    )
