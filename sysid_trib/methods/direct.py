"""Direct identification of Eq. 1: weak form, whitened, with refined instrumental variables."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Mask, root_mean_square
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import forces_to_identify
from sysid_trib.likelihood.least_squares import constraint_map
from sysid_trib.likelihood.random_force import (
    RandomForceOption,
    check_random_force,
    is_fitted,
    random_force_of_ratio,
    random_force_variables,
)
from sysid_trib.likelihood.refined_columns import MAX_REFINEMENTS_OF_CURVES, refine_from
from sysid_trib.likelihood.regression import begin
from sysid_trib.likelihood.rows import Solution
from sysid_trib.likelihood.selected_regression import RegressionOptions, regress
from sysid_trib.methods.scope import Constrained, MethodScope
from sysid_trib.records.runs import Decays, as_runs, one_or_all
from sysid_trib.records.smoothing import swing_frequency
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import Variables, described, start_variables
from sysid_trib.simulation.model import Model

# Least duration (rad): half of a shorter record gives no better start.
FEWEST_RADIANS = 120.0


@dataclass(frozen=True)
class Direct(Constrained):
    """Regression of Eq. 1 on its force columns (Le Bot et al. 2019, Eq. 1), solved by whitened least squares.

    The columns are those of `ForceFeatures`, a feature library of pysindy, averaged over the samples' cells.
    `WhitenedLeastSquares`, an optimiser for pysindy, solves them.

    Parameters
    ----------
    reference_frequency : float, rad/s, optional
        Reference frequency w, which is fixed; the library's force of formula `x` is then identified too.
        Without it, w is fitted and that force is left out.
    optimizer : pysindy optimiser, optional
        Selects the forces that are kept; their coefficients are then refined. Columns are scaled to their RMS
        force, so a threshold is a force in rad. Without it every force is kept.
    significance : float, optional
        Family-wise significance level at which a force is kept; None keeps every force.
    form : {"weak", "strong"}
        `strong` solves theta'' + theta of the smoothed record, for comparison.
    refine : bool
        Whether the nonlinear columns are computed along the motion of the identified model (refined
        instrumental variables, Young 2011), which removes the bias of smoothed columns.
    shapes : mapping of str to float
        Values of shape parameters, which are fixed.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        `estimated` estimates a white random acceleration in each run in addition to the sensor's noise, and
        the colour of this noise, by the restricted likelihood of the rows. A number is the one-sided density,
        which is held; the sensor's noise is then white. `auto` leaves the choice to `identify`. With a random
        force the columns are those of the smoothed motion, because the free motion does not follow the record
        (see `regress_stochastic`). The strong form, and the weak form without refinement, have no random
        force.
    own : tuple of str
        Forces with a separate coefficient in each run, `("lambda",)`: `lambda_1`, `lambda_2`, ... in the
        result.
    start : Model, optional
        Model with nearly the same forces, from another fit of the records: the first columns are computed
        along its motion, if that follows the records.
    most_refinements : int
        Largest number of motions along which columns are computed, with `start`.
    constraints : mapping of str to float, (float, float) or str
        `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`: fixed values of coefficients and shape
        parameters, lowest and highest values of coefficients, and coefficients as linear formulas of others.

    Notes
    -----
    At convergence the residual angle is orthogonal to the sensitivities of the motion: the estimate has the
    variance of maximum likelihood in white noise. Fixed and tied coefficients are a linear map of the
    columns. A coefficient that would pass its bound is held there. All errors, including its own, are those
    of the fit in which it is free.

    Examples
    --------
    With a significance level, the regression keeps only the forces that the record demands.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01, "epsilon": 0.3}, 9.91)
    >>> angle = st.simulate(model, np.arange(0.0, 10.0, 0.02), angle=0.3).angle
    >>> angle = angle + np.random.default_rng(0).normal(0.0, 1e-4, 500)
    >>> st.identify(angle, method=st.methods.Direct(significance=0.01)).active.to_series().to_dict()
    {'lambda': False, 'zeta': True, 'delta': False, 'nu': False, 'epsilon': True}
    """

    scope: ClassVar = MethodScope(
        label="direct",
        assumes="no forces act except those offered",
        family="direct",
        driven=True,
        # On derivatives of the smoothed record, as pysindy is commonly used.
        variants={"strong form": {"form": "strong"}},
    )

    reference_frequency: float | None = None
    optimizer: Any = None
    significance: float | None = None
    form: Literal["weak", "strong"] = "weak"
    refine: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)
    random_force: RandomForceOption = "auto"
    own: tuple[str, ...] = ()
    start: Model | None = None
    most_refinements: int = MAX_REFINEMENTS_OF_CURVES

    def __post_init__(self) -> None:
        check_random_force(self.random_force)
        if not isinstance(self.random_force, str) and not self._takes_random_force:
            raise UsageError(
                "A random_force is for form='weak' with refine=True; ask for these, or leave it out."
            )
        if self.form not in ("weak", "strong"):
            raise UsageError(f"form='{self.form}' is neither 'weak' nor 'strong'.")
        if self.significance is not None and not 0.0 < self.significance < 1.0:
            raise UsageError(f"significance={self.significance} must lie between 0 and 1, such as 0.01.")

    @property
    def _takes_random_force(self) -> bool:
        return self.form == "weak" and self.refine

    @in_units_of_the_motion
    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay, or from several runs.

        Parameters
        ----------
        decay : Dataset or sequence of Dataset
            One record or several with `angle(time)`, rad and s; the weak form uses a known `input(time)`,
            rad/s^2.
        library : ForceLibrary
            Forces, and terms of the sensor: the record is then x + coefficient * h(x, v, t). The strong form
            takes no sensor terms.

        Returns
        -------
        Dataset
            See `identify`. A force that was not kept has `active` False, coefficient 0 and the standard error
            that it would have. Further variables: `birge_ratio`, the in-band residual over the noise;
            `start_angle` (rad), `start_rate` (rad/s) and `offset` (rad) of the model's motion, `(run)` for
            several runs; with constraints `constraint(force)`, which states each coefficient's constraint.
            Attributes: `refined`, whether the columns are from that motion; `correlation_lags`, the number of
            lags over which the errors allow for correlation.

        Raises
        ------
        DecayError
            The decay cannot support the request: it is too short, or forces are identical on it.
        UsageError
            A constraint is not linear in the coefficients, or does not fit the library.
        """
        runs_given = as_runs(decay, driven=self.form == "weak")
        library_given = library
        library = library.with_own(self.own, len(runs_given))
        offered = forces_to_identify(library, self.reference_frequency, sensors=self.form == "weak")
        asked = Constraints(self.constraints).of_each_run(self.own, len(runs_given))
        shapes = {**self.shapes, **{k: v for k, v in asked.fixed.items() if k not in offered.symbols}}
        constraints = constraint_map(asked, offered, shapes)
        runs = begin(
            runs_given, offered, constraints, reference_frequency=self.reference_frequency, shapes=shapes
        )
        started = None
        if self.start is not None and self._takes_random_force and not self._fits_random_force:
            started = refine_from(runs, self.start, self.most_refinements, constraints)
        if started is not None:
            every = np.ones(len(offered), bool)
            return self._identified(decay, library, offered, asked, shapes, started, every, refined=True)
        options = RegressionOptions(
            optimizer=self.optimizer,
            significance=self.significance,
            strong=self.form == "strong",
            refine=self.refine,
            random_force=self.random_force if self._fits_random_force else None,
        )
        # The method itself replaces the forces that each run has separately.
        nearer = partial(_of_first_half, self, decay, library_given)
        solution, active, refined = regress(runs, constraints, options, nearer)
        return self._identified(decay, library, offered, asked, shapes, solution, active, refined=refined)

    def _identified(
        self,
        decay: Decays,
        library: ForceLibrary,
        offered: ForceLibrary,
        asked: Constraints,
        shapes: Mapping[str, float],
        solution: Solution,
        active: Mask,
        *,
        refined: bool,
    ) -> xr.Dataset:
        """Return a solution as an identification."""
        estimate, constraints = _estimate(solution), constraint_map(asked, offered, shapes)
        method = replace(self, shapes=shapes, start=None)
        result = identification(method, decay, offered, estimate, offered=library, active=active)
        result = result.assign(_random_force(solution, self.random_force))
        reached = set(constraints.free[active[constraints.free]]) - set(solution.constraints.free)
        result = asked.marked(result, [offered.symbols[i] for i in reached])
        result = result.assign(described("identification", {"refined": refined}))
        return result.assign_attrs(correlation_lags=solution.lags)

    @property
    def _fits_random_force(self) -> bool:
        return is_fitted(self.random_force) and self._takes_random_force


def _estimate(solution: Solution) -> Estimate:
    """Return the estimate of the last regression for results; the noise is that with a random force."""
    runs = solution.runs
    noises = [replace(run.sensor, innovation=run.noise).standard_deviation for run in runs]
    if any(run.inputs for run in runs):
        # A driven motion may contain components that no spline follows: the residual of the model is not
        # below the noise.
        rms = [float(np.std(run.measured - run.x)) for run in runs if run.exact]
        noises = np.minimum(noises, rms or noises).tolist()
    expected = root_mean_square([run.noise for run in runs])
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (solution.noise / expected, "1", "Birge ratio of the rows"),
        **start_variables([run.start for run in runs], [run.offset for run in runs]),
    }
    return Estimate(runs[0].coefficients, solution.covariance, runs[0].frequency, noises, extra)


def _random_force(solution: Solution, option: RandomForceOption) -> Variables:
    """Return each run's random force as variables of a result; none if the noise is the sensor's alone."""
    runs, nominal = solution.runs, solution.runs[0].nominal_frequency
    forces = [random_force_of_ratio(run.ratio, nominal, option) for run in runs if run.ratio is not None]
    if not forces:
        return {}
    return random_force_variables(forces, [run.sensor.filter_ for run in runs])


def _of_first_half(method: Direct, decay: Decays, library: ForceLibrary) -> Array | None:
    """Return coefficients and frequency from the first half of each run; None if that loses the phase too.

    Over many periods, the motion of a first estimate loses the phase.
    """
    if not method._takes_random_force or method._fits_random_force:
        return None
    halves = [run.isel(time=slice(run.sizes["time"] // 2)) for run in as_runs(decay, driven=True)]
    try:
        if min(np.ptp(half.time.values) * swing_frequency(half) for half in halves) < FEWEST_RADIANS:
            return None
        result = method.identify(one_or_all(halves), library)
    except DecayError:
        return None
    if not result.refined:
        return None
    return np.append(result.coefficient.values, result.reference_frequency.item())
