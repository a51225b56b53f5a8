"""Trajectory fit: maximum likelihood of the angle itself, with exact switching and sticking."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import forces_to_identify, is_free_to_move
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force, is_fitted
from sysid_trib.likelihood.sensor_noise import sensor_noise_of
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.scope import Constrained, MethodScope
from sysid_trib.motion_fit.free_fit import identified_freely, most_likely
from sysid_trib.motion_fit.least_squares import Fit
from sysid_trib.motion_fit.moving_samples import points_of, regressed
from sysid_trib.motion_fit.parameters import PER_RUN, Parameters
from sysid_trib.motion_fit.problem import FitProblem, WhitenedRecord
from sysid_trib.motion_fit.random_motion import identified_with_random_force
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.records.smoothing import first_frequency, nominal_frequency
from sysid_trib.results.schema import model_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.simulation.initial_conditions import first_guess
from sysid_trib.simulation.measured_motion import MEASURED
from sysid_trib.simulation.model import FREQUENCY, Model

KINDS_OF_STARTS = ("fitted", "measured")
StartsOption: TypeAlias = Literal["fitted", "measured"]


@dataclass(frozen=True)
class Trajectory(Constrained):
    """Least squares of the measured angle on the motion of the model: maximum likelihood in white noise.

    Parameters
    ----------
    reference_frequency : float, rad/s, optional
        Reference frequency w, which is fixed; the library's force of formula `x` is then identified too.
        Without it, w is fitted and that force is left out.
    noise : {"white", "coloured"}
        `coloured` whitens residuals and sensitivities by an autoregression, whose order is chosen by the
        Bayesian information criterion.
    fit_shapes : tuple of str
        Shape parameters that are fitted (`("dahl.s",)`), within the library's limits; the others are held.
    start : Model, optional
        Model from which the fit starts; by default the direct identification.
    shapes : mapping of str to float
        Values of held shape parameters, and first estimates of fitted ones.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        `estimated` estimates a white random acceleration in each run in addition to the sensor's noise; a
        number is its one-sided density, which is fixed; `auto` leaves the choice to `identify`. The
        innovations are then fitted (see `random_motion`).
    own : tuple of str
        Forces with a separate coefficient in each run, `("lambda",)`: `lambda_1`, `lambda_2`, ... in the
        result.
    warm_up : float, s
        Beginning of each run that is not fitted, because the motion still depends on the initial states and
        memory. The free motion is fitted, whatever `random_force` is.
    starts : {"fitted", "measured"}
        Whether angle, rate and the sensor's zero of each run are fitted. `measured` uses the angle and the
        rate of the smoothed record at its first sample, and no zero, as for a joint whose control loop uses
        the sensor.
    constraints : mapping of str to float, (float, float) or str
        `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`: fixed parameters, lowest and highest values
        of coefficients and of fitted shape parameters, and parameters as formulas of others.

    Notes
    -----
    With a random force the result contains `random_force_density` with its error and p-value,
    `innovation_rms` (rad) and `autocorrelation(lag)` of the innovations. `noise` is then that of the sensor
    in the presence of the random force, and its colour is that of `Direct`.

    If a rate or an acceleration was measured, the fit compares this quantity, with the free motion only. The
    result then has the attribute `compared_in`, `bias` of the sensor with `bias_standard_error`, and
    `measured_noise` of a sample.

    The fitted window grows over the records unless the start already follows them. Sensitivities are
    differences of exact motions, so they include changes of switching times and of the stop. Each of several
    runs is weighted by its own residual noise. A fixed parameter has the standard error 0, a tied one that of
    the chain rule. A parameter at its bound is held there; all errors are those of the fit in which it is
    free.

    If the residual of driven runs is not white, errors are the scatter between runs (six or more), and at
    least the scatter between 24 parts of each run: to first order this is the jackknife (Bell and McCaffrey
    2002, CR3). A sensor term of formula `1` is a common zero of all runs.

    Examples
    --------
    The presliding length of a Dahl friction is fitted with the coefficients.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> forces = st.library("zeta", st.load_library("candidate_effects")["dahl"])
    >>> model = st.Model(forces, {"zeta": 0.01, "dahl": 0.002}, 9.91, shapes={"dahl.s": 0.02})
    >>> record = st.simulate(model, np.arange(0.0, 8.0, 0.02), angle=0.3)
    >>> found = st.identify(record, forces, st.methods.Trajectory(fit_shapes=("dahl.s",)))
    >>> found.shape_parameter.values.tolist(), found["shape"].round(3).values.tolist()
    (['dahl.s'], [0.02])
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
            raise UsageError(f"warm_up={self.warm_up} is not a time; give seconds, zero or more.")
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
        """Random force that is fitted; none if the noise is whitened as coloured noise."""
        return self.random_force if self.noise == "white" else "off"

    @in_units_of_the_motion
    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several runs.

        Raises
        ------
        DecayError
            No motion of the model can be fitted to the decay.
        UsageError
            A shape or constraint does not belong to these forces.
        """
        runs = as_runs(decay, driven=True)
        library = library.with_own(self.own, len(runs))
        problem = self.problem(runs, library)
        # A measured rate or acceleration is fitted by the free motion alone.
        stochastic_too = is_fitted(self._random_force) and not any(MEASURED in run for run in runs)
        stochastic_too = stochastic_too and not self.warm_up
        begun = self
        if self.start is None and not stochastic_too and problem.driven and library.used:
            # Direct uses samples at rest as well, and updates the coefficients in formulas from round to
            # round.
            begun = replace(self, start=_regressed_start(problem))
        quick = _quick(self, problem, runs) if begun.start is None or stochastic_too else None
        first = first_values(begun, problem, quick)
        if stochastic_too:
            if quick is not None:
                # Direct identification provides the colours, from frequencies above that of the motion.
                filters = [sensor_noise_of(quick, at).filter_ for at in range(len(runs))]
                problem = problem.with_filters(filters)
            return identified_with_random_force(self, problem, first)
        constraints = self._constraints(len(runs))
        return identified_freely(self, problem, first, constraints, coloured=self.noise == "coloured")

    def likelihood(self, decay: Decays, library: ForceLibrary, near: xr.Dataset) -> Fit:
        """Return the likelihood of the free motion about its best fit, without holding parameters at bounds.

        The fit starts from a result: a motion that stops may have a minimum for each number of swings.
        """
        runs = as_runs(decay, driven=True)
        problem = self.problem(runs, library.with_own(self.own, len(runs)))
        first = first_values(self, problem, near)
        return most_likely(problem, first, coloured=self.noise == "coloured")

    def _constraints(self, count: int) -> Constraints:
        """Return the constraints of each of `count` runs."""
        return Constraints(self.constraints).of_each_run(self.own, count)

    def problem(self, runs: Sequence[xr.Dataset], library: ForceLibrary) -> FitProblem:
        """Return the records and parameters of the fit of forces to runs."""
        offered = forces_to_identify(library, self.reference_frequency, sensors=True)
        records = tuple(WhitenedRecord.of_decay(run, offered, self.warm_up) for run in runs)
        constraints = self._constraints(len(runs))
        parameters = Parameters(
            offered, self.reference_frequency, self.fit_shapes, self.shapes, len(runs), constraints
        )
        parameters = parameters.completed()
        if self.starts == "measured":
            parameters = parameters.fix(measured_starts(runs))
            records = tuple(replace(record, start_is_shown=True) for record in records)
        elif is_free_to_move(offered, parameters.constraints.fixed):
            # The rate of a free body does not determine its position.
            held = [at for at, record in enumerate(records) if record.sensor[0] != "angle"]
            parameters = parameters.fix({f"{PER_RUN[0]} of run {at}": 0.0 for at in held})
        return FitProblem(parameters, records, runs, library)


def measured_starts(runs: Sequence[xr.Dataset]) -> dict[str, float]:
    """Return angle (rad) and rate (rad/s) of each run at its first sample, and a zero of 0, by their names.

    Raises
    ------
    UsageError
        A rate or an acceleration was measured, so the position of the body is unknown.
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
    """Return the direct identification: a first estimate, and the colour of the sensor noise.

    Return None if it fails and a start model is given.
    """
    parameters = problem.parameters
    # Held parameters act on the first estimate too; ties act only in the fit of the motion.
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
    """Return the first estimate of all parameters, from the start model or the direct identification."""
    parameters = problem.parameters
    start = method.start if quick is None else method.start or model_of(quick)
    assert start is not None
    w, free = start.reference_frequency, is_free_to_move(parameters.library, parameters.constraints.fixed)
    # A result may have no starts, or those of other runs.
    no_start = quick is None or np.size(quick.get(PER_RUN[0], ())) != len(problem.records)
    if no_start or method.start is not None or free:
        # Use the runs themselves: a record may contain a quantity other than the angle.
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
