"""Least squares of motions on records: fit over a growing window, likelihood, Cramér-Rao bound."""

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
# Relative step at which a fit with held parameters ends: its deviance is then known to far less than 1.
HELD_TOLERANCE = 1e-8


# Fractions of the record to which the fit is extended one after another, so that a phase slip cannot trap it.
WINDOWS = (0.06, 0.12, 0.22, 0.4, 0.65)
# A start needs no growing window if its residual is at most this fraction of the record (RMS).
FOLLOWED = 0.1
# A first estimate is replaced if the residual of its motion exceeds this fraction of the record (RMS).
FAR_GUESS = 0.7
MAX_EVALUATIONS = 60
# A window changes a parameter only if the independent part of its column is at least this fraction of the
# column. Otherwise rounding errors would determine the start of the next window.
WINDOW_RIDGE = 1e-3
# Relative step below which a fit ends.
CONVERGED = 1e-12
# The same for driven motions. The residual of switching friction is not a smooth function of the parameters,
# so the last digits never converge; the deviance of 10^4 samples is known to a thousandth.
CONVERGED_DRIVEN = 1e-7
# A driven motion follows the record if its residual (RMS) is at most this fraction of the record. It recovers
# from a phase slip.
FOLLOWED_DRIVEN = 0.3
# Number of parts of each run as clusters for an incomplete model; from this number of runs on, runs are the
# clusters.
PARTS_OF_RUNS, FEWEST_CLUSTERS = 24, 6
# If a whitened sensitivity exceeds this, the motion has diverged; its square is still a finite number.
LARGEST_SENSITIVITY = 1e100
# Least fraction of the information on a parameter that counts as outside of a cluster.
LEAST_LEFT = 1e-3
# A combination of parameters is not determined if it moves the residual by less than this fraction of the
# largest.
SINGULAR_PART = 1e-7


@dataclass(frozen=True)
class Fit:
    """A minimum of the whitened residual, and the likelihood about it if the residual has unit variance.

    Attributes
    ----------
    problem : FitProblem
    values : (parameter,) array of float
        All parameters.
    residual : (sample,) array of float
        Whitened residual, motion minus record.
    sensitivity : (sample, free) array of float
        Derivatives of the residual by the free parameters.
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

        The number of parameters reduces the degrees of freedom of these variances.
        """
        problem, records = self.problem, []
        part = len(self.parameters.free) / len(problem.records)
        for record, residual in zip(problem.records, problem.residuals(self.values), strict=True):
            white = replace(record, weight=1.0).white(residual)
            records.append(replace(record, weight=float(np.sqrt((len(white) - part) / (white @ white)))))
        return fitted(replace(problem, records=tuple(records)), self.values)

    def with_free(self, parameters: Parameters) -> "Fit":
        """Return the fit at the same values with the sensitivities of more free parameters."""
        if len(parameters.free) == len(self.parameters.free):
            return self
        problem = replace(self.problem, parameters=parameters)
        sensitivity = problem.white_sensitivity(self.values, problem.residuals(self.values))
        return replace(self, problem=problem, sensitivity=sensitivity)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of all parameters from the curvature here, (parameter, parameter); 0 for fixed ones."""
        jacobian = self.parameters.jacobian(self.values)
        return np.asarray(jacobian @ self._inverse @ jacobian.T)

    @cached_property
    def clustered_covariance(self) -> Array:
        """Return the covariance of all parameters if the residual is due to an incomplete model, not noise.

        For `FEWEST_CLUSTERS` runs or more it is the covariance between runs, and at least that between parts
        of runs. For fewer runs it is that between parts.
        """
        of_parts = self.covariance_between_parts
        if len(self.problem.records) < FEWEST_CLUSTERS:
            return of_parts
        of_runs = self._covariance_between(self._ends(1))
        parts, runs = (np.sqrt(np.diag(covariance)) for covariance in (of_parts, of_runs))
        ratio = np.divide(parts, runs, out=np.ones_like(parts), where=runs > 0.0)
        wider = np.maximum(1.0, ratio)
        return np.asarray(of_runs * np.outer(wider, wider))

    @property
    def clusters(self) -> int:
        """Number of clusters of `clustered_covariance`: the runs, or parts of few runs."""
        runs = len(self.problem.records)
        return runs if runs >= FEWEST_CLUSTERS else runs * -(-PARTS_OF_RUNS // runs)

    @cached_property
    def covariance_between_parts(self) -> Array:
        """Return the covariance of all parameters if the residual is correlated within parts of runs."""
        return self._covariance_between(self._ends(-(-PARTS_OF_RUNS // len(self.problem.records))))

    def _ends(self, parts: int) -> list[int]:
        """Return the samples at which parts of runs end, without the last; each run has `parts` parts."""
        counts = [len(record.time) - record.uncounted for record in self.problem.records]
        lengths = [len(part) for count in counts for part in np.array_split(np.arange(count), parts)]
        return np.cumsum(lengths)[:-1].tolist()

    def _covariance_between(self, ends: Sequence[int]) -> Array:
        """Return the covariance of all parameters from the scatter between clusters of samples.

        This is the sandwich of Liang and Zeger (1986). Each score is divided by the fraction of the
        information that the other clusters contain (CR3 of Bell and McCaffrey 2002): to first order it is the
        jackknife that leaves out one cluster at a time. The scores alone give too small errors if a few
        clusters determine a parameter.
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
        """Return the deviance of values: twice the log likelihood of this fit minus that of the values."""
        residual = self.problem.white(self.problem.residuals(values))
        return float(residual @ residual - self.residual @ self.residual)

    def deviance_of(self, fit: "Fit") -> float:
        """Return the deviance of another fit."""
        return float(fit.residual @ fit.residual - self.residual @ self.residual)

    def holding(self, held: Mapping[str, float], near: Array) -> "Fit":
        """Return the best fit with parameters held at these values, started from a nearby fit."""
        places = [self.parameters.index(name) for name in held]
        across = self.covariance[:, places] @ np.linalg.pinv(self.covariance[np.ix_(places, places)])
        start = near + across @ (np.array([*held.values()]) - near[places])
        problem = replace(self.problem, parameters=self.parameters.fix(held))
        return fitted(problem, start, tolerance=HELD_TOLERANCE)


def grown(problem: FitProblem, values: Array) -> Array:
    """Extend the fit over the records window by window, unless an earlier motion follows them.

    A window may contain too little information to separate forces. So if a motion is near the record, the
    whole record is tried first.
    """
    away = missed(problem, values)
    if away < FOLLOWED:
        return values
    if problem.driven:
        tried = fitted(problem, values).values
        if missed(problem, tried) < FOLLOWED_DRIVEN:
            return tried
    # A motion this near has not lost the phase.
    elif away < 0.5:
        tried = fitted(problem, values).values
        if missed(problem, tried) < FOLLOWED:
            return tried
    for part in WINDOWS:
        values = fitted(problem.first(part), values, ridge=WINDOW_RIDGE).values
    return values


# For fits of driven motions whose residual is more than noise: number of further starts, their distance in
# standard errors, the relative step at which their fits end, and their largest number of evaluations.
FURTHER_STARTS, START_DISTANCE, ROUGHLY, FEW_EVALUATIONS = 2, 2.0, 1e-3, 12
# A start is better if its fit reduces the sum of squares by this fraction.
BETTER_START_BY = 1e-3


def nearby_best(fit: Fit) -> Fit:
    """Return the best of several fits that start near a given one.

    If friction sticks, the sum of squares has many minima.

    Parameters
    ----------
    fit : Fit
        A minimum. Further starts are drawn from its covariance between parts, with a fixed seed.
    """
    free, random = fit.parameters.free, np.random.default_rng(20190417)
    best = fit
    for _ in range(FURTHER_STARTS):
        root = covariance_root(best.covariance_between_parts[np.ix_(free, free)])
        direction = random.standard_normal(len(free))
        start = best.values[free] + START_DISTANCE * root @ direction
        of_start = best.parameters.expand(start)
        try:
            # The motion from a distant start may diverge.
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
    """Return the first estimate, with free coefficients at zero if its motion is then nearer to records.

    With many forces and few swings, the balance of forces may give coefficients whose motion diverges; a fit
    would not recover from them.
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
    """Return the RMS of the residual over that of the record, for the worst run."""
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
        First estimate.
    tolerance : float, optional
        Relative step, or relative decrease of the sum of squares, at which the fit ends; the default depends
        on whether the motions are free or driven.
    ridge : float
        Weight of the distance from the first estimate, relative to the sensitivities there (Tikhonov).
    most_evaluations : int
        Largest number of evaluations of the residuals.
    """
    parameters = problem.parameters
    tolerance = tolerance or (CONVERGED_DRIVEN if problem.driven else CONVERGED)
    low, high = (limit[parameters.free] for limit in parameters.limits)
    bounded = bool(np.any(np.isfinite(low)) or np.any(np.isfinite(high)))
    inside = np.clip(values[parameters.free], np.nextafter(low, np.inf), np.nextafter(high, -np.inf))

    # The optimiser asks for sensitivities at the values of the last residuals: keep that motion.
    @lru_cache(maxsize=1)
    def residuals(*free: float) -> list[Array]:
        return problem.residuals(parameters.expand(np.array(free)))

    def sensitivity(free: Array) -> Array:
        here = parameters.expand(free)
        columns = problem.white_sensitivity(here, residuals(*free))
        # The bounded optimiser fails with larger or non-finite values.
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
    # Leave out the rows of the distance from the first estimate, which are not part of the record.
    samples = slice(len(minimum.fun) - len(rows))
    return Fit(problem, values, np.asarray(minimum.fun)[samples], np.asarray(minimum.jac)[samples])


def stopped_by_bounds(fit: Fit) -> dict[str, float]:
    """Return the parameters that a bound stops, with this bound."""
    parameters, covariance = fit.parameters, fit.covariance
    free = parameters.free
    step = np.zeros(len(parameters))
    step[free] = -covariance[np.ix_(free, free)] @ (fit.sensitivity.T @ fit.residual)
    stopped = {}
    for name, (low, high) in parameters.constraints.bounds.items():
        value, i = fit.values[parameters.index(name)], parameters.index(name)
        # A parameter nearer to a bound than this fraction of its standard error counts as stopped by it.
        near = 1e-3 * np.sqrt(fit.residual @ fit.residual / len(fit.residual) * covariance[i, i])
        if i in free and not low + near < value + step[i] < high - near:
            stopped[name] = low if value - low < high - value else high
    return stopped


def covariance_root(covariance: Array) -> Array:
    """Return R with R R' the covariance of parameters that differ by orders of magnitude."""
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
        The true model. Its coefficients are estimated, also those that are zero; its shapes are known.
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
        One-sided density of a white acceleration, which is known.

    Returns
    -------
    xarray.Dataset
        `standard_error(force)`, `covariance(force, other_force)` and the scalars
        `start_angle_standard_error` (rad), `start_rate_standard_error` and
        `reference_frequency_standard_error` (rad/s; 0 if the frequency is held).

    Raises
    ------
    UsageError
        Some parameters are not determined: a force does not act on this motion, or a force has the formula
        `x` and the frequency is estimated too.

    Notes
    -----
    The bound is the inverse of Fisher's information, J' J / noise^2 with the sensitivities J of the motion.
    With a random force, J contains the normalised innovations of these sensitivities, from the Kalman filter
    about the free motion.

    Examples
    --------
    No method finds zeta more exactly than this from ten seconds with a noise of 1e-4 rad.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.0097, "delta": 0.037}, 9.91)
    >>> bound = st.cramer_rao_bound(model, np.arange(0.0, 10.0, 0.01), angle=0.3, rate=0.0, noise=1e-4)
    >>> print(f"{bound.standard_error.sel(force='zeta').item():.1e}")
    6.5e-06
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
