"""Direct identification of Eq. 1: weak form, whitened, with refined instrumental variables."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import forces_to_identify
from sysid_trib.likelihood.exact_motions import along_exact_motions, first_motion
from sysid_trib.likelihood.least_squares import constraint_map
from sysid_trib.likelihood.random_force import (
    RandomForceOption,
    check_random_force,
    is_fitted,
    random_force_of_ratio,
    random_force_variables,
)
from sysid_trib.likelihood.random_rows import with_random_force
from sysid_trib.likelihood.ratio_posterior import NOTHING_OPEN
from sysid_trib.likelihood.rows import Regression, Solution, begin
from sysid_trib.likelihood.sensor_noise import NoiseModel, colour_variables
from sysid_trib.methods.scope import Constrained, MethodScope
from sysid_trib.records.decay import Decays, as_runs, one_or_all
from sysid_trib.records.smoothing import swing_frequency
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import Variables, start_variables

MAX_SELECTIONS = 5
# Of a record of fewer radians the half tells no more than the whole.
FEWEST_RADIANS = 120.0


@dataclass(frozen=True)
class Direct(Constrained):
    """Regression of Eq. 1 on its force columns (Le Bot et al. 2019, Eq. 1), solved by a pysindy optimiser.

    The columns are those of `ForceFeatures`, a feature library of pysindy, averaged over the samples' cells,
    and they are solved by `WhitenedLeastSquares`, one of its optimisers.

    Parameters
    ----------
    reference_frequency : float, rad/s, optional
        w, held; the library's force of formula `x` is then among those that are identified. Without it w is
        fitted and that force is absent.
    optimizer : pysindy optimiser, optional
        Chooses the forces that are kept; their coefficients are then refined. Columns are scaled to their RMS
        force, so that a threshold is a force in rad. Without it every force is kept.
    significance : float, optional
        Family-wise level of significance at which a force is kept; None keeps every force.
    form : {"weak", "strong"}
        `strong` solves theta'' + theta of the smoothed record, for comparison.
    refine : bool
        Whether the nonlinear columns are taken from the motion of the identified model (refined instrumental
        variables, Young 2011), which removes the bias of smoothed columns.
    shapes : mapping of str to float
        Values of shape parameters, which are held.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        `estimated` finds a white random acceleration in each run besides the sensor's noise, by the
        restricted likelihood of the rows, and the colour of that noise; a number is its one-sided density,
        held, and the sensor's noise is white then. `auto` leaves it to `identify`. The
        columns are then those of the smoothed motion, since the free motion does not follow the record (see
        `with_random_force`). The strong form, and the weak form that is not refined, have none.
    own : tuple of str
        Forces whose coefficient is each run's own, `("lambda",)`: `lambda_1`, `lambda_2`, ... in the result.
    constraints : mapping of str to float, (float, float) or str
        `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`: coefficients and shape parameters that are
        held, lowest and highest value of coefficients, and coefficients as linear formulas of others.
    fix, bounds, tie : mapping, deprecated
        Parts of `constraints`.

    Notes
    -----
    At convergence the residual angle is orthogonal to the sensitivities of the motion: the estimate has
    the variance of maximum likelihood in white noise. Fixed and tied coefficients are a linear map of the
    columns. A coefficient that would pass its bound is held there; the errors are those of the others.
    """

    scope: ClassVar = MethodScope(
        label="direct",
        assumes="the forces offered are all there are",
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

    def __post_init__(self, *old: Any) -> None:
        super().__post_init__(*old)
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
            With `angle(time)`, rad and s; a known `input(time)`, rad/s^2, is taken by the weak form.
        library : ForceLibrary
            Forces, and terms of the sensor: the record is then x + coefficient * h(x, v, t). The strong form
            takes none.

        Returns
        -------
        Dataset
            See `identify`; a force that was not kept has `active` False, coefficient 0 and the standard error
            it would have had. Besides: `birge_ratio`, the in-band residual over the noise; `start_angle`
            (rad), `start_rate` (rad/s) and `offset` (rad) of the model's motion, `(run)` where there are
            several; with constraints `constraint(force)`, how each coefficient is constrained. attrs:
            `refined`, whether the columns are from that motion; `correlation_lags`, over which the errors
            allow for correlation.

        Raises
        ------
        DecayError
            The decay cannot support the request: too short, or forces that are the same on it.
        UsageError
            A constraint is not linear in the coefficients, or does not fit to the library.
        """
        runs_given = as_runs(decay, driven=self.form == "weak")
        library = library.with_own(self.own, len(runs_given))
        offered = forces_to_identify(library, self.reference_frequency, sensors=self.form == "weak")
        asked = Constraints(self.constraints).of_each_run(self.own, len(runs_given))
        shapes = {**self.shapes, **{k: v for k, v in asked.fixed.items() if k not in offered.symbols}}
        constraints = constraint_map(asked, offered, shapes)
        begun = begin(
            runs_given, offered, constraints, reference_frequency=self.reference_frequency, shapes=shapes
        )
        chosen, regression = np.ones(len(offered), bool), begun
        if not self._fits_random_force:
            regression = begun.in_strong_form() if self.form == "strong" else begun
            chosen = _selected(self, regression)
        # About the motion of the kept forces alone the choice is better founded than about all of them.
        for _ in range(MAX_SELECTIONS):
            active = chosen
            regression, refined, (shift, further) = self._regressed(begun, regression, active)
            chosen = _selected(self, regression)
            if np.array_equal(chosen, active):
                break
        if not refined and (nearer := _of_first_half(self, decay, library)) is not None:
            first = replace(begun.solve(active), values=nearer)
            if (found := along_exact_motions(begun, first, active)) is not None:
                regression, refined = found, True
        solution = regression.solve(active)
        solution = replace(solution, covariance=solution.covariance + further)
        solution = regression.with_errors_of_dropped(solution, active)
        values = solution.values + shift
        values[:-1] = solution.constraints.impose(values[:-1])
        estimate = _estimate(regression, replace(solution, values=values))
        result = identification(
            replace(self, shapes=shapes), decay, offered, estimate, offered=library, active=active
        )
        if self._fits_random_force:
            result = result.assign(_random_force(regression, self.random_force))
        reached = set(constraints.free[active[constraints.free]]) - set(solution.constraints.free)
        result = asked.marked(result, [offered.symbols[i] for i in reached])
        return result.assign_attrs(refined=str(refined), correlation_lags=solution.lags)

    @property
    def _fits_random_force(self) -> bool:
        return is_fitted(self.random_force) and self._takes_random_force

    def _regressed(
        self, begun: Regression, present: Regression, active: Mask
    ) -> tuple[Regression, bool, tuple[Array, Array]]:
        """The regression of the active forces, whether it has settled, what open ratios add."""
        if self._fits_random_force:
            return with_random_force(begun, active, self.random_force)
        if self.form == "strong" or not self.refine:
            return present, False, NOTHING_OPEN
        first = begun.solve(active)
        if not active.all():
            # Linear about the kept forces alone.
            begun = begun.about(begun.paths, np.where(active, first.values[:-1], 0.0))
        refined = along_exact_motions(begun, first, active)
        return (begun if refined is None else refined), refined is not None, NOTHING_OPEN


def _estimate(regression: Regression, solution: Solution) -> Estimate:
    """The estimate of the last regression as results take it; the noise is that with a random force."""
    paths, levels = regression.paths, [float(np.sqrt(noise.variance)) for noise in regression.noises]
    noises = [
        NoiseModel(level, path.sensor.filter_).standard_deviation
        for level, path in zip(levels, paths, strict=True)
    ]
    motions = regression.motions or [first_motion(path) for path in paths]
    if any(path.inputs for path in paths) and regression.motions:
        # A driven motion may have what no spline follows: what the model leaves is no less than the noise.
        left = [
            path.angle - path.sensor_terms(regression.trials) @ solution.values[:-1] - motion.x
            for path, motion in zip(paths, motions, strict=True)
        ]
        noises = np.minimum(noises, [np.std(residual) for residual in left]).tolist()
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (solution.birge_ratio, "1", "Birge ratio of the rows"),
        **start_variables([(m.angle, m.rate) for m in motions], solution.zeros.tolist()),
    }
    return Estimate(solution.values[:-1], solution.covariance, solution.values[-1], noises, extra)


def _random_force(regression: Regression, option: RandomForceOption) -> Variables:
    """The random force of each run as variables of a result."""
    frequency = regression.paths[0].frequency
    forces = [random_force_of_ratio(ratio, frequency, option) for ratio in regression.noises]
    colours = colour_variables([path.sensor.filter_ for path in regression.paths])
    return {**random_force_variables(forces), **colours}


def _of_first_half(method: Direct, decay: Decays, library: ForceLibrary) -> Array | None:
    """Coefficients and frequency by the first half of each run, whose motion slips less; None if it does too.

    Over many periods a first estimate is soon out of phase.
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
    if result.attrs["refined"] != "True":
        return None
    return np.append(result.coefficient.values, result.reference_frequency.item())


def _selected(method: Direct, regression: Regression) -> Mask:
    """Forces that are kept, by significance and by the optimiser."""
    optimizers = [] if method.optimizer is None else [method.optimizer]
    if method.significance is not None:
        from sysid_trib.likelihood.pysindy_features import SignificanceSelection

        removed = regression.tables[0].shape[1] - 1 - len(regression.trials)
        optimizers.append(SignificanceSelection(method.significance, removed_columns=removed))
    return regression.select(optimizers)
