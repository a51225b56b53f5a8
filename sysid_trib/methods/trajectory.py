"""Trajectory fit: maximum likelihood of the angle itself, with exact switching and sticking."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import forces_to_identify, is_free_to_move
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force, is_fitted
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, sensor_noise_of, white_p_value
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.scope import Constrained, MethodScope
from sysid_trib.motion_fit.least_squares import (
    NO_FITTED_MOTION,
    Fit,
    calmer,
    fitted,
    grown,
    missed,
    nearby_best,
    stopped_by_bounds,
)
from sysid_trib.motion_fit.moving_samples import points_of, regressed
from sysid_trib.motion_fit.parameters import PER_RUN, Parameters
from sysid_trib.motion_fit.problem import FitProblem, WhitenedRecord
from sysid_trib.motion_fit.random_motion import Iterate, fit_random_motion, stochastic_identification
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.records.smoothing import first_frequency, nominal_frequency, sensor_noise
from sysid_trib.results.effects import birge_ratio
from sysid_trib.results.schema import model_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.simulation.initial_conditions import first_guess
from sysid_trib.simulation.measured_motion import MEASURED
from sysid_trib.simulation.model import FREQUENCY, Model

KINDS_OF_STARTS = ("fitted", "measured")
StartsOption: TypeAlias = Literal["fitted", "measured"]
# A motion whose residual is more than this part of a record does not follow it.
LARGEST_UNFOLLOWED = 0.7


@dataclass(frozen=True)
class Trajectory(Constrained):
    """Least squares of the measured angle on the motion of the model: maximum likelihood in white noise.

    Parameters
    ----------
    reference_frequency : float, rad/s, optional
        w, held; the library's force of formula `x` is then among those that are identified. Without it w is
        fitted and that force is absent.
    noise : {"white", "coloured"}
        `coloured` whitens residuals and sensitivities by an autoregression, whose order is chosen by the
        Bayesian information criterion.
    fit_shapes : tuple of str
        Shape parameters to fit (`("dahl.s",)`), between the library's limits; the others are held.
    start : Model, optional
        Model from which the fit starts; the direct identification where left out.
    shapes : mapping of str to float
        Values of shape parameters, held or first guesses.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        `estimated` finds a white random acceleration in each run besides the sensor's noise; a number is its
        one-sided density, held; `auto` leaves it to `identify`. The fit is then that of the innovations (see
        `random_motion`).
    own : tuple of str
        Forces whose coefficient is each run's own, `("lambda",)`: `lambda_1`, `lambda_2`, ... in the result.
    warm_up : float, s
        Beginning of each run that does not count: until then the motion forgets with what its states and
        memory began. The free motion is fitted, whatever `random_force` is.
    starts : {"fitted", "measured"}
        Whether angle, rate and the sensor's zero of each run are fitted; `measured` takes the angle and the
        rate of the smoothed record at its first sample, and no zero, as for a joint whose control loop sees
        the sensor.
    constraints : mapping of str to float, (float, float) or str
        `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`: parameters that are held, lowest and highest
        value of coefficients and of shape parameters that are fitted, and parameters as formulas of others.

    Notes
    -----
    With a random force the result has `random_force_density` with its error and p-value, `innovation_rms`
    (rad) and `autocorrelation(lag)` of the innovations; `noise` is the sensor's with it, its colour that of
    `Direct`.

    Where a rate or an acceleration was measured, that is what is compared, by the free motion alone: attrs
    `compared_in`, and `bias` of the sensor with `bias_standard_error`; `measured_noise` is that of a sample.

    The window grows over the records unless the start already follows them; sensitivities are differences of
    exact motions, so that switching times and the stop take part. Each of several runs is weighted by its own
    noise, that of its residual. A fixed parameter has the standard error 0, a tied one that of the chain
    rule. A parameter at its bound is held there; all errors are those of the fit in which it is free.

    Where the residual of driven runs is not white, errors are the scatter between runs (six or more), and at
    least that between 24 parts of them: the jackknife to first order (Bell and McCaffrey 2002, CR3). A term
    of the sensor of formula `1` is the zero of all runs.
    """

    reference_frequency: float | None = None
    noise: Literal["white", "coloured"] = "white"
    fit_shapes: tuple[str, ...] = ()
    start: Model | None = None
    shapes: Mapping[str, float] = field(default_factory=dict)
    random_force: RandomForceOption = "auto"
    own: tuple[str, ...] = ()
    warm_up: float = 0.0
    starts: StartsOption = "fitted"

    def __post_init__(self) -> None:
        check_random_force(self.random_force)
        if not isinstance(self.random_force, str) and self.noise == "coloured":
            raise UsageError(
                "random_force= needs noise='white'; the fit then determines the colour of the noise."
            )
        if not self.warm_up >= 0.0:
            raise UsageError(f"warm_up={self.warm_up} is no time; give seconds, zero or more.")
        if self.starts not in KINDS_OF_STARTS:
            raise UsageError(f"starts='{self.starts}' is neither 'fitted' nor 'measured'.")
        if self.noise not in ("white", "coloured"):
            raise UsageError(f"noise='{self.noise}' is neither 'white' nor 'coloured'.")

    @property
    def scope(self) -> MethodScope:
        """Scope of the method; its errors allow for coloured noise if this is asked for."""
        return MethodScope(
            label="trajectory",
            assumes=f"no forces act except those offered; the residual is {self.noise} noise",
            white_noise=self.noise == "white",
            family="trajectory",
            driven=True,
        )

    @property
    def _random_force(self) -> RandomForceOption:
        """The random force that is fitted: none with noise that is whitened as it is."""
        return self.random_force if self.noise == "white" else "off"

    @in_units_of_the_motion
    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several runs.

        Raises
        ------
        DecayError
            No motion of the model can be fitted to the decay.
        UsageError
            A shape or constraint is not one of these forces.
        """
        runs = as_runs(decay, driven=True)
        library = library.with_own(self.own, len(runs))
        problem = self.problem(runs, library)
        # In its own quantity the record is fitted by the free motion alone.
        stochastic_too = is_fitted(self._random_force) and not any(MEASURED in run for run in runs)
        stochastic_too = stochastic_too and not self.warm_up
        begun = self
        if self.start is None and not stochastic_too and problem.driven and library.used:
            # Direct takes samples at rest as well, and the coefficients in formulas from round to round.
            begun = replace(self, start=_regressed_start(problem))
        quick = _quick(self, problem, runs) if begun.start is None or stochastic_too else None
        first = first_values(begun, problem, quick)
        if stochastic_too:
            return stochastic_identification(self, *_with_random_force(self, problem, first, quick))
        fit = self._fitted_freely(problem, first)
        parameters = fit.parameters
        while stopped := stopped_by_bounds(fit):
            fit = fitted(replace(fit.problem, parameters=fit.parameters.fix(stopped)), fit.values)
        return identification_of_fit(self, fit, fit.with_free(parameters))

    def likelihood(self, decay: Decays, library: ForceLibrary, near: xr.Dataset) -> Fit:
        """Return likelihood of the free motion about its best fit; a parameter at a bound is not held there.

        The fit starts from a result: a motion that stops may have a minimum for each number of swings.
        """
        runs = as_runs(decay, driven=True)
        problem = self.problem(runs, library.with_own(self.own, len(runs)))
        first = first_values(self, problem, near)
        fit = self._fitted_freely(problem, first)
        # In strong noise the result may be nearer than the fit over a growing window.
        fit = min(fit, fitted(fit.problem, first), key=lambda tried: float(tried.residual @ tried.residual))
        _residuals(fit)
        return fit.in_its_noise()

    def problem(self, runs: Sequence[xr.Dataset], library: ForceLibrary) -> FitProblem:
        """Return the records and parameters of the fit of forces to runs."""
        offered = forces_to_identify(library, self.reference_frequency, sensors=True)
        records = tuple(WhitenedRecord.of_decay(run, offered, self.warm_up) for run in runs)
        constraints = Constraints(self.constraints).of_each_run(self.own, len(runs))
        parameters = Parameters(
            offered, self.reference_frequency, self.fit_shapes, self.shapes, len(runs), constraints
        )
        parameters = parameters.completed()
        if self.starts == "measured":
            parameters = parameters.fix(measured_starts(runs))
            records = tuple(replace(record, start_is_shown=True) for record in records)
        elif is_free_to_move(offered, parameters.constraints.fixed):
            # The position of a free body does not follow from its rate.
            held = [at for at, record in enumerate(records) if record.sensor[0] != "angle"]
            parameters = parameters.fix({f"{PER_RUN[0]} of run {at}": 0.0 for at in held})
        return FitProblem(parameters, records, runs, library)

    def _fitted_freely(self, problem: FitProblem, first: Array) -> Fit:
        """Return the fit of the free motion, in the noise of each run."""
        fit = fitted(problem, grown(problem, calmer(problem, first)))
        # Rounds in which noise and fit of several runs, or of coloured noise, follow each other. Where the
        # motion does not follow the record there is no noise, and each round would take all evaluations.
        rounds = 3 if self.noise == "coloured" or len(problem.records) > 1 else 0
        if rounds and missed(problem, fit.values) > LARGEST_UNFOLLOWED:
            rounds = 0
        # The discrepancy of a model of driven motions does not measure the noise of a run: a run that hardly
        # moves would dominate.
        if problem.driven and not _residual_is_white(fit):
            rounds = 0
            # A run that the motion follows has one minimum.
            if len(problem.records) > 1:
                fit = nearby_best(fit)
        for _ in range(rounds):
            problem = problem.weighted(fit.values, coloured=self.noise == "coloured")
            fit = fitted(problem, fit.values)
        return fit


def measured_starts(runs: Sequence[xr.Dataset]) -> dict[str, float]:
    """Return angle (rad) and rate (rad/s) of each run at its first sample, and a zero of 0, by their names.

    Raises
    ------
    UsageError
        A rate or an acceleration was measured: where the body is, is not known.
    """
    if any(MEASURED in run for run in runs):
        raise UsageError("starts='measured' needs a measured angle; leave it out.")
    w, held = nominal_frequency(first_frequency(runs)), dict[str, float]()
    for at, run in enumerate(runs):
        angle, rate = first_guess(run.time.values.astype(float), run.angle.values.astype(float), w)
        held |= zip((f"{name} of run {at}" for name in PER_RUN), (angle, rate, 0.0), strict=True)
    return held


def _regressed_start(problem: FitProblem) -> Model:
    """Return the model of a regression over the moving samples of driven runs."""
    parameters = problem.parameters
    library, held = parameters.library, parameters.constraints.fixed
    regression = regressed(points_of(problem.runs, library), library, held)
    coefficients = {symbol: regression.coefficients.get(symbol, 0.0) for symbol in library.symbols}
    frequency = parameters.reference_frequency or regression.frequency
    return Model(library, coefficients, frequency, dict(parameters.shapes))


def _quick(method: Trajectory, problem: FitProblem, runs: Sequence[xr.Dataset]) -> xr.Dataset | None:
    """Return the direct identification, its first guess and the colour of the sensor noise.

    Return None if it fails and a start model is given.
    """
    parameters = problem.parameters
    # Held parameters act on the first guess too; ties act only in the fit of the motion.
    guessed = parameters.library.select(
        s for s in parameters.library.symbols if s not in parameters.constraints.ties
    )
    held = {s: value for s, value in parameters.constraints.fixed.items() if s in guessed.symbols}
    direct = Direct(
        reference_frequency=method.reference_frequency,
        shapes=parameters.shapes,
        random_force=method._random_force,
        constraints=held,
    )
    try:
        return direct.identify(runs, guessed if len(guessed) else parameters.library)
    except DecayError:
        if method.start is None:
            raise
        return None


def first_values(method: Trajectory, problem: FitProblem, quick: xr.Dataset | None) -> Array:
    """Return the first guess of all parameters: from the start model, or from direct identification."""
    parameters = problem.parameters
    start = method.start if quick is None else method.start or model_of(quick)
    assert start is not None
    w, free = start.reference_frequency, is_free_to_move(parameters.library, parameters.constraints.fixed)
    # A result need not have starts, or those of other runs.
    no_start = quick is None or np.size(quick.get(PER_RUN[0], ())) != len(problem.records)
    if no_start or method.start is not None or free:
        # Use the runs themselves: a record may contain another quantity than the angle.
        pairs = ((run.time.values.astype(float), run.angle.values.astype(float)) for run in problem.runs)
        per_run = np.array([(*first_guess(time, angle, w), 0.0) for time, angle in pairs])
    else:
        assert quick is not None
        per_run = np.stack([np.ravel(quick[name]) for name in PER_RUN], axis=1)
        # The zero of an integrated signal is not that of the sensor.
        per_run[:, -1] *= [record.sensor[0] == "angle" for record in problem.records]
    values = parameters.library.shape_values(method.shapes)
    values |= {**start.coefficients, **start.shapes, FREQUENCY: start.reference_frequency}
    return parameters.expand(parameters.pack(values, per_run)[parameters.free])


def _with_random_force(
    method: Trajectory, problem: FitProblem, values: Array, quick: xr.Dataset | None
) -> tuple[Fit, Array, Iterate]:
    """Return the fit of the innovations; a parameter that a bound stops is held there."""
    if quick is not None:
        # Direct identification has the colours by frequencies above the motion's.
        filters = [sensor_noise_of(quick, at).filter_ for at in range(len(problem.records))]
        problem = problem.with_filters(filters)
    fit, covariance, at = _likelier_of(problem, values, method)
    while stopped := stopped_by_bounds(fit):
        problem = replace(problem, parameters=problem.parameters.fix(stopped))
        values = problem.parameters.expand(fit.values[problem.parameters.free])
        # The errors remain those of the first fit, which include the parameters at bounds.
        fit, _, at = _likelier_of(problem, values, method)
    return fit, covariance, at


def _likelier_of(problem: FitProblem, values: Array, method: Trajectory) -> tuple[Fit, Array, Iterate]:
    """Return the more likely of the fits in coloured and in white noise."""
    fit = fit_random_motion(problem, values, method.random_force)
    white = [np.ones(1)] * len(problem.records)
    if all(len(record.filter_) == 1 for record in problem.records):
        return fit
    try:
        in_white = fit_random_motion(problem.with_filters(white), values, method.random_force)
    except DecayError:
        return fit
    return min(fit, in_white, key=lambda tried: tried[2].penalised_deviance())


def _residual_is_white(fit: Fit) -> bool:
    """Return true if the residual of each run is white."""
    residuals = fit.problem.residuals(fit.values)
    return min(white_p_value(residual) for residual in residuals) >= WHITE_LEVEL


def _residuals(fit: Fit) -> list[Array]:
    """Return the residual of each run; raise an error where the motion does not follow them."""
    counted, unphysical = [], not np.all(np.isfinite(fit.sensitivity))
    for record, residual in zip(fit.problem.records, fit.problem.residuals(fit.values), strict=True):
        counted.append(residual[record.uncounted :])
        unphysical |= np.max(np.abs(counted[-1])) > np.max(np.abs(record.angle))
    if unphysical:
        raise DecayError(NO_FITTED_MOTION)
    return counted


def identification_of_fit(method: Trajectory, fit: Fit, unbounded: Fit) -> xr.Dataset:
    """Return a fit as an identification, with the errors of the one in which no bound holds a parameter."""
    problem, parameters = fit.problem, fit.parameters
    residuals, runs = _residuals(fit), problem.runs
    degrees_of_freedom = max(1, len(fit.residual) - len(parameters.free))
    reduced = fit.residual @ fit.residual / degrees_of_freedom
    covariance = reduced * unbounded.covariance
    noises = [sensor_noise(run) for run in runs]
    if any(record.inputs for record in problem.records):
        # A driven motion may contain parts that no spline follows: the residual of the model is not below the
        # noise.
        noises = np.minimum(noises, [root_mean_square(residual) for residual in residuals]).tolist()
        if min(white_p_value(residual) for residual in residuals) < WHITE_LEVEL:
            # Errors of a driven record whose residual is not white.
            covariance = unbounded.clustered_covariance
    # Unit of the compared quantity.
    units = runs[0][MEASURED].attrs.get("units", "rad") if MEASURED in runs[0] else "rad"
    extra: dict[str, tuple[ArrayLike, str, str]]
    extra = {"residual_rms": ([root_mean_square(residual) for residual in residuals], units, "RMS residual")}
    levels = noises
    if MEASURED in runs[0]:
        measured = (xr.Dataset({"angle": ("time", r.angle)}, {"time": r.time}) for r in problem.records)
        levels = [sensor_noise(record) for record in measured]
        places = [parameters.of_run(run).stop - 1 for run in range(len(runs))]
        bias_errors = np.sqrt(np.diag(covariance)[places])
        extra["bias"] = (fit.values[places], units, "bias of the sensor about the mean of the swing")
        extra["bias_standard_error"] = (bias_errors, units, "standard error of the bias")
        extra["measured_noise"] = (levels, units, "noise of one sample of the measured quantity")
    if all(levels):
        chi_square = sum(float(r @ r) / level**2 for r, level in zip(residuals, levels, strict=True))
        ratio = birge_ratio(chi_square, degrees_of_freedom)
        extra["birge_ratio"] = (ratio, "1", "Birge ratio by the sensor's noise")
    result = problem.identification(method, fit.values, covariance, noises, extra)
    constraints = Constraints(method.constraints).of_each_run(method.own, len(runs))
    result = constraints.marked(result, parameters.constraints.fixed.keys() & constraints.bounds.keys())
    if MEASURED in runs[0]:
        result = result.assign(offset=0.0 * result.offset)
        result.attrs["compared_in"] = problem.records[0].sensor[0]
    orders = ", ".join(str(len(record.filter_) - 1) for record in problem.records)
    return result.assign_attrs(noise_model=f"autoregression of order {orders}")
