"""Least squares of motions on records: the fit over a growing window, its likelihood, the bound on errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.motion_fit.linearised import whitened
from sysid_trib.motion_fit.parameters import Parameters
from sysid_trib.motion_fit.problem import FitProblem
from sysid_trib.results.random_force import RandomForce
from sysid_trib.results.variables import described
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE, FREQUENCY, Model
from sysid_trib.simulation.trajectory import trajectory

NO_FITTED_MOTION = "No motion with these forces follows the record; offer other forces or a shorter window."
# Relative step at which a fit with parameters held is done: its deviance is known to far less than 1.
HELD_TOLERANCE = 1e-8


# Parts of the record to which the fit is extended in turn, so that a phase slip cannot trap it.
WINDOWS = (0.06, 0.12, 0.22, 0.4, 0.65)
# A start needs no growing window if its motion is this near to the record (RMS, relative to the record).
FOLLOWED = 0.1
# A motion that is no nearer than this (RMS, of the record's) is no first guess to be held on to.
FAR_GUESS = 0.7
MAX_EVALUATIONS = 60
# A window changes a parameter only if its column has this part of its size outside of all others: otherwise
# rounding would decide where the next window begins.
WINDOW_RIDGE = 1e-3
# Steps, in units of the solution, below which a fit is done.
CONVERGED = 1e-12
# The same for driven motions. The residual of switching friction is no smooth function of the parameters, so
# the last digits are never reached; the deviance of 10^4 samples is known to a thousandth.
CONVERGED_DRIVEN = 1e-7
# A driven motion follows the record if its residual (RMS) is at most this part of it: it forgets a slip of
# phase.
FOLLOWED_DRIVEN = 0.3
# Parts of all runs between which a model that lacks something scatters; from so many runs on, these do.
PARTS_OF_RUNS, FEWEST_CLUSTERS = 24, 6
# A motion whose sensitivities, whitened, are beyond this has diverged; their squares are still numbers.
LARGEST_SENSITIVITY = 1e100
# Part of what decides a parameter that its cluster leaves to the others, at least.
LEAST_LEFT = 1e-3
# A combination of parameters is not known if it moves the residual by less than this part of the best known.
SINGULAR_PART = 1e-7


@dataclass(frozen=True)
class Fit:
    """A minimum of the whitened residual, about which the likelihood is known where that has unit variance.

    Attributes
    ----------
    problem : FitProblem
    values : (parameter,) array of float
        All parameters.
    residual : (sample,) array of float
        Whitened residual, motion minus record.
    sensitivity : (sample, free) array of float
        Its derivative by the free parameters.
    """

    problem: FitProblem
    values: Array
    residual: Array
    sensitivity: Array

    @property
    def parameters(self) -> Parameters:
        """The parameters, in the order of their vector."""
        return self.problem.parameters

    def in_its_noise(self) -> "Fit":
        """Return the fit in white noise with the residual variance of each run.

        The parameters take their part of the noise from what is left.
        """
        problem, records = self.problem, []
        part = len(self.parameters.free) / len(problem.records)
        for record, residual in zip(problem.records, problem.residuals(self.values), strict=True):
            white = replace(record, weight=1.0).white(residual)
            records.append(replace(record, weight=float(np.sqrt((len(white) - part) / (white @ white)))))
        return fitted(replace(problem, records=tuple(records)), self.values)

    def with_free(self, parameters: Parameters) -> "Fit":
        """Return the fit at the same values with the sensitivities of parameters of which more are free."""
        if len(parameters.free) == len(self.parameters.free):
            return self
        problem = replace(self.problem, parameters=parameters)
        sensitivity = problem.white_sensitivity(self.values, problem.residuals(self.values))
        return replace(self, problem=problem, sensitivity=sensitivity)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of all parameters by the curvature here, (parameter, parameter); 0 of fixed ones."""
        jacobian = self.parameters.jacobian(self.values)
        return np.asarray(jacobian @ self._inverse @ jacobian.T)

    @cached_property
    def clustered_covariance(self) -> Array:
        """Return the covariance of all parameters where the residual is what the model lacks, not noise.

        Of `FEWEST_CLUSTERS` runs or more it is that between runs, and at least that between parts of runs; of
        fewer runs that between parts.
        """
        of_parts = self.covariance_between_parts
        if len(self.problem.records) < FEWEST_CLUSTERS:
            return of_parts
        of_runs = self._covariance_between(self._ends(1))
        parts, runs = (np.sqrt(np.diag(covariance)) for covariance in (of_parts, of_runs))
        ratio = np.divide(parts, runs, out=np.ones_like(parts), where=runs > 0.0)
        wider = np.maximum(1.0, ratio)
        return np.asarray(of_runs * np.outer(wider, wider))

    @cached_property
    def covariance_between_parts(self) -> Array:
        """Return the covariance of all parameters where the residual is correlated within parts of runs."""
        return self._covariance_between(self._ends(-(-PARTS_OF_RUNS // len(self.problem.records))))

    def _ends(self, parts: int) -> list[int]:
        """Return the samples at which parts of runs end, the last left out; each run has so many parts."""
        counts = [len(record.time) - record.uncounted for record in self.problem.records]
        lengths = [len(part) for count in counts for part in np.array_split(np.arange(count), parts)]
        return np.cumsum(lengths)[:-1].tolist()

    def _covariance_between(self, ends: Sequence[int]) -> Array:
        """Return the covariance of all parameters by the scatter between clusters of samples.

        The sandwich of Liang and Zeger (1986), each score divided by what its cluster leaves to the others
        (CR3 of Bell and McCaffrey 2002): to first order the jackknife that leaves out one cluster at a time.
        The scores alone give errors that are too small where a few clusters decide a parameter.
        """
        size = np.linalg.norm(self.sensitivity, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        basis, singular, axes = np.linalg.svd(self.sensitivity / size, full_matrices=False)
        known = singular > SINGULAR_PART * singular[0]
        changes = []
        for rows, part in zip(np.split(basis[:, known], ends), np.split(self.residual, ends), strict=True):
            leverage, directions = np.linalg.eigh(rows.T @ rows)
            remaining = np.maximum(1.0 - leverage, LEAST_LEFT)
            changes.append(directions @ ((directions.T @ (rows.T @ part)) / remaining))
        to_free = (axes[known] / singular[known, None]).T / size[:, None]
        table = np.stack(changes) @ (self.parameters.jacobian(self.values) @ to_free).T
        return np.asarray(table.T @ table * (1.0 - 1.0 / len(table)))

    @property
    def _inverse(self) -> Array:
        """Inverse of the products of the sensitivities, (free, free)."""
        size = np.linalg.norm(self.sensitivity, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        scaled = self.sensitivity / size
        return np.asarray(np.linalg.pinv(scaled.T @ scaled) / np.outer(size, size))

    def deviance(self, values: Array) -> float:
        """Return the deviance of values: by how much twice the log likelihood is below that of this fit."""
        residual = self.problem.white(self.problem.residuals(values))
        return float(residual @ residual - self.residual @ self.residual)

    def deviance_of(self, fit: "Fit") -> float:
        """Return the deviance of another fit."""
        return float(fit.residual @ fit.residual - self.residual @ self.residual)

    def holding(self, held: Mapping[str, float], near: Array) -> "Fit":
        """Return the best fit with parameters held at these values, from a nearby one."""
        places = [self.parameters.index(name) for name in held]
        across = self.covariance[:, places] @ np.linalg.pinv(self.covariance[np.ix_(places, places)])
        start = near + across @ (np.array([*held.values()]) - near[places])
        problem = replace(self.problem, parameters=self.parameters.fix(held))
        return fitted(problem, start, tolerance=HELD_TOLERANCE)


def grown(problem: FitProblem, values: Array) -> Array:
    """Extend the fit over the records window by window, unless a motion follows them sooner.

    A window may hold too little to tell forces apart: from a motion that is near the record the whole is
    tried first.
    """
    away = missed(problem, values)
    if away < FOLLOWED:
        return values
    if problem.driven:
        tried = fitted(problem, values).values
        if missed(problem, tried) < FOLLOWED_DRIVEN:
            return tried
    # A motion this near has not slipped out of phase.
    elif away < 0.5:
        tried = fitted(problem, values).values
        if missed(problem, tried) < FOLLOWED:
            return tried
    for part in WINDOWS:
        values = fitted(problem.first(part), values, ridge=WINDOW_RIDGE).values
    return values


# Further starts about a fit of driven motions whose residual is more than noise; their distance in standard
# errors; the relative step at which their fits end, and their largest number of evaluations.
FURTHER_STARTS, START_DISTANCE, ROUGHLY, FEW_EVALUATIONS = 2, 2.0, 1e-3, 12
# A start is better if its fit reduces the sum of squares by this part.
BETTER_START_BY = 1e-3


def nearby_best(fit: Fit) -> Fit:
    """Return the best of several fits that start near one.

    With friction that sticks, the sum of squares has many minima.

    Parameters
    ----------
    fit : Fit
        A minimum. The further starts are drawn from its errors between parts, always the same ones.
    """
    free, random = fit.parameters.free, np.random.default_rng(20190417)
    best = fit
    for _ in range(FURTHER_STARTS):
        root = covariance_root(best.covariance_between_parts[np.ix_(free, free)])
        direction = random.standard_normal(len(free))
        start = best.values[free] + START_DISTANCE * root @ direction
        of_start = best.parameters.expand(start)
        try:
            # The motion of a start far away may diverge.
            with np.errstate(all="ignore"):
                tried = fitted(best.problem, of_start, tolerance=ROUGHLY, most_evaluations=FEW_EVALUATIONS)
        except DecayError:
            continue
        if sum_of_squares(tried) < (1.0 - BETTER_START_BY) * sum_of_squares(best):
            best = tried
    return best if best is fit else fitted(best.problem, best.values)


def sum_of_squares(fit: Fit) -> float:
    """Return the sum of squares of the whitened residual."""
    return float(fit.residual @ fit.residual)


def calmer(problem: FitProblem, values: Array) -> Array:
    """Return the first guess, with free coefficients at zero if its motion is farther from the records.

    Many forces on few swings: the balance of forces may give coefficients whose motion runs away, from which
    no fit comes back.
    """
    away = missed(problem, values)
    if away < FAR_GUESS:
        return values
    parameters, calm = problem.parameters, values.copy()
    calm[[parameters.index(symbol) for symbol in parameters.library.symbols]] = 0.0
    low, high = parameters.limits
    calm = parameters.expand(np.clip(calm, low, high)[parameters.free])
    return values if away <= missed(problem, calm) else calm


def missed(problem: FitProblem, values: Array) -> float:
    """Return the RMS of the residual over that of the record, the largest of all runs."""
    pairs = zip(problem.residuals(values), problem.records, strict=True)
    return max(root_mean_square(residual) / root_mean_square(record.angle) for residual, record in pairs)


def fitted(
    problem: FitProblem,
    values: Array,
    *,
    tolerance: float | None = None,
    ridge: float = 0.0,
    most_evaluations: int = MAX_EVALUATIONS,
) -> Fit:
    """Find the parameters of least whitened residual.

    Parameters
    ----------
    problem : FitProblem
        Records and parameters.
    values : (parameter,) array of float
        First guess.
    tolerance : float, optional
        Relative step or fall of the sum of squares at which the fit is done; that of free or driven motions
        where left out.
    ridge : float
        Weight of the distance from the first guess, of the sizes of the sensitivities there (Tikhonov).
    most_evaluations : int
        Largest number of evaluations of the residuals.
    """
    parameters = problem.parameters
    tolerance = tolerance or (CONVERGED_DRIVEN if problem.driven else CONVERGED)
    low, high = (limit[parameters.free] for limit in parameters.limits)
    bounded = bool(np.any(np.isfinite(low)) or np.any(np.isfinite(high)))
    inside = np.clip(values[parameters.free], np.nextafter(low, np.inf), np.nextafter(high, -np.inf))

    # The optimiser asks for sensitivities where it has just asked for residuals.
    @lru_cache(maxsize=1)
    def residuals(*free: float) -> list[Array]:
        return problem.residuals(parameters.expand(np.array(free)))

    def sensitivity(free: Array) -> Array:
        here = parameters.expand(free)
        columns = problem.white_sensitivity(here, residuals(*free))
        # The optimiser within bounds takes nothing else.
        if bounded and not np.all(np.abs(columns) < LARGEST_SENSITIVITY):
            raise DecayError(NO_FITTED_MOTION)
        return columns

    if not np.all(np.isfinite(problem.white(residuals(*inside)))):
        raise DecayError(NO_FITTED_MOTION)
    rows = np.empty((0, len(inside)))
    if ridge:
        rows = ridge * np.diag(np.linalg.norm(sensitivity(inside), axis=0))
        if not np.all(np.isfinite(rows)):
            raise DecayError(NO_FITTED_MOTION)
    minimum = least_squares(
        lambda free: np.append(problem.white(residuals(*free)), rows @ (free - inside)),
        inside,
        jac=lambda free: np.vstack([sensitivity(free), rows]),
        bounds=(low, high) if bounded else (-np.inf, np.inf),
        method="trf" if bounded else "lm",
        x_scale="jac",
        xtol=tolerance,
        ftol=tolerance,
        gtol=0.01 * tolerance,
        max_nfev=most_evaluations,
    )
    values = parameters.expand(np.asarray(minimum.x, dtype=float))
    # The distance from the first guess is no residual of the record.
    samples = slice(len(minimum.fun) - len(rows))
    return Fit(problem, values, np.asarray(minimum.fun)[samples], np.asarray(minimum.jac)[samples])


def stopped_by_bounds(fit: Fit) -> dict[str, float]:
    """Return the parameters at a bound that would pass it, and this bound."""
    parameters, covariance = fit.parameters, fit.covariance
    free = parameters.free
    step = np.zeros(len(parameters))
    step[free] = -covariance[np.ix_(free, free)] @ (fit.sensitivity.T @ fit.residual)
    stopped = {}
    for name, (low, high) in parameters.constraints.bounds.items():
        value, i = fit.values[parameters.index(name)], parameters.index(name)
        # A parameter that is nearer to a bound than this part of its standard error is stopped by it.
        near = 1e-3 * np.sqrt(fit.residual @ fit.residual / len(fit.residual) * covariance[i, i])
        if i in free and not low + near < value + step[i] < high - near:
            stopped[name] = low if value - low < high - value else high
    return stopped


def covariance_root(covariance: Array) -> Array:
    """Return R with R R' the covariance, of parameters that differ by orders of magnitude."""
    size = np.sqrt(np.diag(covariance))
    scale = np.where(size > 0.0, size, 1.0)
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(size[:, None] * axes * np.sqrt(np.maximum(variances, 0.0)))


def cramer_rao_bound(
    model: Model,
    time: ArrayLike,
    angle: float,
    rate: float,
    noise: float,
    *,
    free: bool = False,
    random_force: float = 0.0,
) -> xr.Dataset:
    """Return the smallest standard errors with which a decay in white noise determines its model.

    Parameters
    ----------
    model : Model
        The truth. Its coefficients are estimated, also those that are zero; its shapes are known.
    time : (sample,) array_like of float, s
        Times of the samples.
    angle : float, rad
        Angle at the first sample; estimated as well.
    rate : float, rad/s
        Rate at the first sample; estimated as well.
    noise : float, rad
        Standard deviation of one sample.
    free : bool
        Whether the reference frequency is estimated too.
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of a white acceleration that pushes the motion; it is known.

    Returns
    -------
    xarray.Dataset
        `standard_error(force)`, `covariance(force, other_force)` and the scalars
        `start_angle_standard_error` (rad), `start_rate_standard_error` and
        `reference_frequency_standard_error` (rad/s; 0 where it is held).

    Raises
    ------
    UsageError
        Some parameters are not determined: a force that does not act on this motion, or a force of formula
        `x` besides the frequency.

    Notes
    -----
    The inverse of Fisher's information, J' J / noise^2 with the sensitivities J of the motion. With a
    random force J are the innovations of these sensitivities over their size, by the Kalman filter about the
    motion that nothing pushes.
    """
    time, symbols = np.asarray(time, dtype=float), list(model.coefficients)
    start = np.array([angle, rate], dtype=float)
    ratio = RandomForce(random_force).per_tau(model.reference_frequency) / noise**2
    sensitivity = whitened(model, time, (angle, rate), ratio, sensitivities(model, time, start, free))
    # Parameters differ by orders of magnitude: without scaling the matrix is singular to rounding.
    size = np.linalg.norm(sensitivity, axis=0)
    _, singular, axes = np.linalg.svd(sensitivity / size, full_matrices=False)
    if singular[-1] < 1e-8 * singular[0]:
        names = [*symbols, "start angle", "start rate", "reference frequency"]
        dependent = [name for name, part in zip(names, axes[-1], strict=False) if abs(part) > 1e-3]
        raise UsageError(f"No record can determine {' and '.join(dependent)} together; leave one out.")
    covariance = noise**2 * (axes.T / singular**2) @ axes / np.outer(size, size)
    count, error = len(symbols), np.append(np.sqrt(np.diag(covariance)), 0.0)
    values = {"standard_error": error[:count], "covariance": covariance[:count, :count]}
    scalars = [f"{name}_standard_error" for name in ("start_angle", "start_rate", "reference_frequency")]
    values |= zip(scalars, error[count:].tolist(), strict=False)
    coords = {"force": symbols, "other_force": symbols}
    return xr.Dataset(described("cramer_rao_bound", values), coords)


def sensitivities(model: Model, time: Array, start: Array, free: bool) -> Array:
    """Return derivatives of the angle by coefficients, start and reference frequency, (sample, parameter)."""
    names = [*model.coefficients, BY_ANGLE, BY_RATE, *([FREQUENCY] if free else [])]
    columns = trajectory(model, time, *start.tolist(), by=names).derivatives["angle"]
    for name, column in zip(names, columns.T, strict=True):
        if not column.any():
            raise UsageError(f"Force {name} does not act on this motion; leave it out.")
    return columns
