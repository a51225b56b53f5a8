"""Profile likelihood of a parameter: the deviance of the motion with this parameter held at other values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, Tell, UsageError, silent
from sysid_trib.methods import Trajectory, method_of
from sysid_trib.motion_fit.least_squares import Fit
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.results import models, signal_scale, variables
from sysid_trib.results.random_force import random_force_of
from sysid_trib.results.variables import CONFIDENCE, HALF_INTERVAL

# Search for the ends: first step in standard errors, growth factor of the steps, and largest number of steps
# in each direction, together about fifty errors.
STEP_OUT, STEP_GROWTH, MOST_STEPS_OUT = 1.0, 1.5, 8
# Accuracy of the root of the deviance at an end, and largest number of evaluations.
END_TOLERANCE, MOST_LOOKS = 0.02, 4
# The interval from the standard error is misleading if an end deviates by this fraction.
OFF = 0.1
# Fraction of a standard error.
ROUNDING_OF_A_LIMIT = 1e-9
# A deviance this far below zero belongs to a better fit, which replaces the best one; largest number of
# replacements.
BETTER, MOST_FITS = -0.02, 3


@signal_scale.in_units_of_the_motion
def profile(decay: Decays, result: xr.Dataset, names: Sequence[str], *, tell: Tell = silent) -> xr.Dataset:
    """Return the intervals of coefficients and shape parameters by the profile likelihood of the motion.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        An identification of the record, whose forces, constraints and shapes are those of the fits.
    names : sequence of str
        Symbols of forces (`lambda`), and shape parameters (`dahl.s`).
    tell : callable
        Called with the name of each parameter.

    Returns
    -------
    Dataset
        Over `parameter`: `estimate` of the fit of the motion, its `standard_error`, `low` and `high` of the
        95 % interval from the profile (a limit of the library, a bound, or infinity if no value is rejected),
        and `asymmetric`, whether an end deviates by more than a tenth from that of the standard error. Over
        `parameter` and `point`: the `value` at which the parameter was held, and its `deviance`.

    Raises
    ------
    UsageError
        A name is not a parameter of the model, or the parameter is fixed or tied.
    DecayError
        There is a random force, or no motion follows the record.

    Notes
    -----
    All other parameters, including the start of each run, are fitted again at each value. The deviance is the
    sum of squares minus its minimum, over the residual variance of the best fit. Outside of the interval it
    exceeds the 95 % point of chi-square (degrees of freedom: 1) (Venzon and Moolgavkar 1988).

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> interval = st.validation.profile(decay, st.identify(decay, method="direct"), ["zeta"])
    >>> interval.low.round(4).item(), interval.high.round(4).item(), interval.asymmetric.item()
    (0.0096, 0.0098, False)
    """
    likelihood = free_likelihood(decay, result, names)
    for _ in range(MOST_FITS):
        error = np.array([_error(likelihood, name) for name in names])
        profiles, ends = [], np.empty((len(names), 2))
        for at, name in enumerate(names):
            tell(f"profile of {name}", at / len(names))
            fits = {0.0: likelihood}
            ends[at] = [_end(likelihood, name, error[at], fits, sign) for sign in (-1.0, 1.0)]
            profiles.append(fits)
        best = min((fit for fits in profiles for fit in fits.values()), key=likelihood.deviance_of)
        # A fit that is better than the best one replaces it.
        if likelihood.deviance_of(best) >= BETTER:
            break
        likelihood = replace(best, problem=likelihood.problem).in_its_noise()
    places = [likelihood.parameters.index(name) for name in names]
    estimate = likelihood.values[places]
    points: Array = np.full((2, len(profiles), max(map(len, profiles))), np.nan)
    for at, fits in enumerate(profiles):
        points[0, at, : len(fits)], roots = _roots(likelihood, fits)
        points[1, at, : len(fits)] = roots**2
    low, high = (
        _at_limit(estimate + error * end, np.asarray(limit)[places], error)
        for end, limit in zip(ends.T, likelihood.parameters.limits, strict=True)
    )
    values = {
        "estimate": estimate,
        "standard_error": error,
        "low": low,
        "high": high,
        "asymmetric": np.max(np.abs(np.abs(ends) - HALF_INTERVAL), axis=1) > OFF * HALF_INTERVAL,
        "value": estimate[:, None] + error[:, None] * points[0],
        "deviance": points[1],
    }
    attrs = {"confidence": CONFIDENCE, "threshold": float(scipy.stats.chi2.ppf(CONFIDENCE, 1))}
    return xr.Dataset(variables.described("profile", values), {"parameter": list(names)}, attrs)


def _at_limit(value: Array, limit: Array, error: Array) -> Array:
    """Return values, with those that equal a limit up to rounding set to the limit."""
    return np.where(np.abs(value - limit) < ROUNDING_OF_A_LIMIT * error, limit, value)


def _end(likelihood: Fit, name: str, error: float, fits: dict[float, Fit], sign: float) -> float:
    """Find the value at which the deviance rejects a parameter on one side; else its limit, or infinity.

    Places are counted in errors from the best fit. `fits` contains fits with the parameter held, by place,
    and is extended.
    """
    parameters, place = likelihood.parameters, likelihood.parameters.index(name)
    estimate = float(likelihood.values[place])
    limit = sign * max(0.0, sign * (float(parameters.limits[int(sign > 0.0)][place]) - estimate) / error)

    def root_at(at: float) -> float:
        """Return the root of the deviance at a place, by a fit that starts from the nearest known one."""
        if at not in fits:
            near = max((other for other in fits if other * at >= 0.0 and abs(other) < abs(at)), key=abs)
            fits[at] = likelihood.holding({name: estimate + at * error}, fits[near].values)
        return float(np.sqrt(max(0.0, likelihood.deviance_of(fits[at]))))

    def interpolated() -> float:
        """Interpolate the end between the known roots, which are nearly linear."""
        places, roots = _roots(likelihood, fits)
        roots = np.maximum.accumulate(roots)
        rising = np.concatenate([[True], np.diff(roots) > 0.0])
        # The root of the deviance at the end of an interval.
        return float(scipy.interpolate.PchipInterpolator(roots[rising], places[rising])(sign * HALF_INTERVAL))

    at, step = 0.0, STEP_OUT
    for _ in range(MOST_STEPS_OUT):
        at = sign * min(abs(at) + step, abs(limit))
        if root_at(at) >= HALF_INTERVAL:
            break
        if at == limit:
            return limit
        step *= STEP_GROWTH
    else:
        return sign * np.inf
    for _ in range(MOST_LOOKS):
        if abs(root_at(interpolated()) - HALF_INTERVAL) < END_TOLERANCE:
            break
    return interpolated()


def _roots(likelihood: Fit, fits: dict[float, Fit]) -> tuple[Array, Array]:
    """Return places in their order, and the signed root of the deviance there, (place,) each."""
    places = np.array(sorted(fits))
    deviance = np.array([likelihood.deviance_of(fits[at]) for at in places.tolist()])
    return places, np.copysign(np.sqrt(np.maximum(0.0, deviance)), places)


def free_likelihood(decay: Decays, result: xr.Dataset, names: Sequence[str] = ()) -> Fit:
    """Return the likelihood of the motion of an identification's forces; named shapes are fitted too.

    Raises
    ------
    DecayError
        There is a random force, or no motion follows the record.
    """
    runs, library, asked = as_runs(decay, driven=True), models.library_of(result), method_of(result)
    if any(random_force_of(result, run) for run in range(len(runs))):
        raise DecayError(
            "This record has a random force, but a profile is for the free motion: use "
            "--random-force off, if the residual allows it."
        )
    shapes = (*getattr(asked, "fit_shapes", ()), *(name for name in names if name in library.shape_values()))
    method = Trajectory(
        reference_frequency=asked.reference_frequency,
        constraints=asked.constraints,
        random_force="off",
        fit_shapes=tuple(dict.fromkeys(shapes)),
    )
    return method.likelihood(runs, library, result)


def _error(likelihood: Fit, name: str) -> float:
    """Return the standard error of a parameter from the curvature of the likelihood."""
    parameters = likelihood.parameters
    if name not in parameters.common:
        known = [*parameters.library.symbols, *parameters.library.shape_values()]
        raise UsageError(f"'{name}' is not a parameter of this model; there are {', '.join(known)}.")
    at = parameters.index(name)
    error = float(np.sqrt(likelihood.covariance[at, at]))
    if at not in parameters.free or not (np.isfinite(error) and error > 0.0):
        raise UsageError(f"{name} is fixed or tied, so it has no profile.")
    return error


@dataclass(frozen=True)
class LogLikelihood:
    """Log likelihood of a motion relative to its best fit, as a function for samplers.

    Attributes
    ----------
    names : tuple of str
        The free parameters: coefficients, shapes, the frequency, and the start and zero of each run.
    estimate : (parameter,) array of float
        Most likely values of the parameters.
    covariance : (parameter, parameter) array of float
        Covariance from the curvature of the likelihood at the estimate.
    low, high : (parameter,) array of float
        Limits of the parameters.
    """

    names: tuple[str, ...]
    estimate: Array
    covariance: Array
    low: Array
    high: Array
    fit: Fit

    def __call__(self, values: ArrayLike) -> float:
        """Return the log likelihood of the free parameters, (parameter,); minus infinity outside limits."""
        free = np.asarray(values, dtype=float)
        if free.shape != self.estimate.shape:
            raise UsageError(f"{len(self.names)} parameters are wanted, in the order of names: {self.names}.")
        if np.any((free < self.low) | (free > self.high)):
            return -np.inf
        return -0.5 * self.fit.deviance(self.fit.parameters.expand(free))


def log_likelihood(decay: Decays, result: xr.Dataset) -> LogLikelihood:
    """Return the likelihood of the motion of an identification, for a sampler such as emcee.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        An identification of the record, whose forces, constraints and fitted shapes are those of the
        likelihood.

    Returns
    -------
    LogLikelihood
        Log likelihood with parameters in the units of the record (rad, or that of a displacement) and rad/s.

    Raises
    ------
    DecayError
        There is a random force, or no motion follows the record.

    Notes
    -----
    The noise is white with the residual variance of the best fit in each run. Priors are flat within the
    limits of the library and of bounds.

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> likelihood = st.validation.log_likelihood(decay, st.identify(decay, method="direct"))
    >>> likelihood.names[1], likelihood.estimate[1].round(4).item()
    ('zeta', 0.0097)
    >>> likelihood(likelihood.estimate) > likelihood(1.001 * likelihood.estimate)
    True
    """
    fit = free_likelihood(decay, result)
    free = fit.parameters.free
    low, high = fit.parameters.limits
    return LogLikelihood(
        names=tuple(fit.parameters.names[at] for at in free),
        estimate=fit.values[free],
        covariance=fit.covariance[np.ix_(free, free)],
        low=low[free],
        high=high[free],
        fit=fit,
    )
