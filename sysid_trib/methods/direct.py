"""Direct identification of Eq. 1: weak form, whitened, with refined instrumental variables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.to_identify import forces_to_identify
from sysid_trib.methods.scope import MethodScope
from sysid_trib.records.runs import Decays, as_runs, root_mean_square
from sysid_trib.regression.constraint_map import ConstraintMap, constraint_map
from sysid_trib.regression.linearisation import DeviationOperator, linearised
from sysid_trib.regression.problem import ReferenceTrajectory, RunRegression, begin, update
from sysid_trib.regression.rows import Rows, stack_rows, strong_rows, weak_rows
from sysid_trib.regression.solution import Mask, Solution, select, solve, with_errors_of_dropped
from sysid_trib.results.per_run import start_variables
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.simulation.model import Model
from sysid_trib.trajectory_fit.initial_conditions import fit_start

Array = NDArray[np.float64]
Runs = tuple[RunRegression, ...]

MAX_REFINEMENTS = 25
MAX_SELECTIONS = 5
# A simulated motion this far from the record (RMS, of the record's) has slipped out of phase.
SLIPPED = 0.3
# Part of the swing by which coefficients of a record without noise may still change.
SETTLED_WITHOUT_NOISE = 1e-10


@dataclass(frozen=True)
class Direct:
    """Regression of Eq. 1 on its force columns (Le Bot et al. 2019, Eq. 1), solved by a pysindy optimiser.

    The columns are those of `ForceFeatures`, a feature library of pysindy, and they are solved by
    `WhitenedLeastSquares`, one of its optimisers.

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
    fix : mapping of str to float
        Coefficients and shape parameters that are held, `{"lambda": 0.0}`.
    bounds : mapping of str to (float, float)
        Lowest and highest value of coefficients, `{"zeta": (0.0, inf)}`.
    tie : mapping of str to str
        Coefficients as linear formulas of others, `{"nu": "-2.356*delta"}`.

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
        # On derivatives of the smoothed record, as pysindy is commonly used.
        variants={"strong form": {"form": "strong"}},
    )

    reference_frequency: float | None = None
    optimizer: Any = None
    significance: float | None = None
    form: Literal["weak", "strong"] = "weak"
    refine: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)
    fix: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    tie: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.form not in ("weak", "strong"):
            raise UsageError(f"form='{self.form}' is neither 'weak' nor 'strong'.")
        if self.significance is not None and not 0.0 < self.significance < 1.0:
            raise UsageError(f"significance={self.significance} must lie between 0 and 1, such as 0.01.")

    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay, or from several runs.

        Parameters
        ----------
        decay : Dataset or sequence of Dataset
            With `angle(time)`, rad and s.
        library : ForceLibrary

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
        offered = forces_to_identify(library, self.reference_frequency)
        asked = Constraints(self.fix, self.bounds, self.tie)
        shapes = {**self.shapes, **{k: v for k, v in self.fix.items() if k not in offered.symbols}}
        constraints = constraint_map(asked, offered, shapes)
        runs = begin(
            as_runs(decay),
            offered,
            constraints,
            reference_frequency=self.reference_frequency,
            shapes=shapes,
        )
        every = np.ones(len(offered), bool)
        runs = _after(runs, solve(_weak_rows(runs, _linearised(runs)), runs[0], every, constraints))
        if self.form == "strong":
            rows, refined = _stacked(runs, [strong_rows(run) for run in runs]), False
            active = _selected(self, rows, constraints)
        else:
            runs, rows, active, refined = _weak_form(self, runs, constraints)
        solution = solve(rows, runs[0], active, constraints)
        solution = with_errors_of_dropped(solution, rows, runs[0], active, constraints)
        estimate = _estimate(_after(runs, solution), solution)
        result = identification(
            replace(self, shapes=shapes), decay, offered, estimate, offered=library, active=active
        )
        if asked:
            reached = set(constraints.free[active[constraints.free]]) - set(solution.constraints.free)
            kinds = asked.kinds(offered.symbols, [offered.symbols[i] for i in reached])
            result = result.assign_coords(constraint=("force", kinds))
        return result.assign_attrs(refined=str(refined), correlation_lags=solution.lags)


def _estimate(runs: Runs, solution: Solution) -> Estimate:
    """The estimate of the last regression as results take it."""
    noises = [run.problem.noise for run in runs]
    estimates = [run.estimate for run in runs]
    extra: dict[str, tuple[ArrayLike, str, str]] = {
        "birge_ratio": (solution.noise / root_mean_square(noises), "1", "Birge ratio of the rows"),
        **start_variables([run.start for run in estimates], [run.offset for run in estimates]),
    }
    common = estimates[0]
    return Estimate(common.coefficients, solution.covariance, common.frequency, noises, extra)


def _linearised(runs: Runs) -> list[DeviationOperator]:
    return [linearised(run) for run in runs]


def _weak_rows(runs: Runs, operators: Sequence[DeviationOperator]) -> Rows:
    """The regression of all runs about their reference trajectories."""
    return _stacked(runs, [weak_rows(run, near) for run, near in zip(runs, operators, strict=True)])


def _stacked(runs: Runs, rows: Sequence[Rows]) -> Rows:
    return stack_rows(rows, [run.problem.noise for run in runs])


def _after(runs: Runs, solution: Solution) -> Runs:
    """The runs with the solution as their estimate."""
    return update(runs, solution.coefficients, solution.steps, solution.constraints)


def _weak_form(method: Direct, runs: Runs, constraints: ConstraintMap) -> tuple[Runs, Rows, Mask, bool]:
    """Choose forces and refine them in turn, until the choice stands; whether the refinement settled."""
    operators = _linearised(runs)
    rows = _weak_rows(runs, operators)
    chosen = _selected(method, rows, constraints)
    smoothed = [run.reference for run in runs]
    # About the motion of the kept forces alone the choice is better founded than about all of them.
    for _ in range(MAX_SELECTIONS):
        active = chosen
        runs = _after(runs, solve(rows, runs[0], active, constraints))
        if not active.all():
            pairs = zip(runs, smoothed, strict=True)
            operators = [linearised(replace(run, reference=path)) for run, path in pairs]
        runs, rows, refined = _refined(method, runs, rows, operators, active, constraints)
        chosen = _selected(method, rows, constraints)
        if np.array_equal(chosen, active):
            break
    return runs, rows, active, refined


def _selected(method: Direct, rows: Rows, constraints: ConstraintMap) -> Mask:
    """Forces that are kept, by significance and by the optimiser."""
    optimizers = [] if method.optimizer is None else [method.optimizer]
    if method.significance is not None:
        from sysid_trib.regression.optimizers import SignificanceSelection

        removed = rows.nuisances.shape[1]
        optimizers.append(SignificanceSelection(method.significance, removed_columns=removed))
    return select(rows, optimizers, constraints)


def _refined(
    method: Direct,
    runs: Runs,
    rows: Rows,
    operators: Sequence[DeviationOperator],
    active: Mask,
    constraints: ConstraintMap,
) -> tuple[Runs, Rows, bool]:
    """Take the columns from the motion of the identified model, and solve again, until nothing changes.

    The last rows are about the last motion, so that they hold the final estimate's covariance.
    """
    first, last = (runs, rows), None
    sensitivities: list[Array | None] = [None] * len(runs)
    for _ in range(MAX_REFINEMENTS if method.refine else 0):
        try:
            motions = [_motion(run, active, near) for run, near in zip(runs, sensitivities, strict=True)]
        except SimulationError:
            break
        runs, sensitivities = tuple(run for run, _ in motions), [near for _, near in motions]
        if any(_slipped(run) for run in runs):
            break
        rows = _weak_rows(runs, operators)
        solution = solve(rows, runs[0], active, constraints)
        after = _after(runs, solution)
        change = _common_values(after) - _common_values(runs)
        step = change / _still_counts(after, rows, solution)
        if np.all(np.abs(step) <= 1.0):
            return runs, rows, True
        ahead = _extrapolation(step, last)
        last = None if ahead else step
        runs = _further(after, ahead * change, constraints)
    return (*first, False)


def _slipped(run: RunRegression) -> bool:
    residual = run.problem.angle - run.estimate.offset - run.reference.x
    return bool(np.sqrt(np.mean(residual**2)) > SLIPPED * np.sqrt(np.mean(run.problem.angle**2)))


def _common_values(runs: Runs) -> Array:
    """Coefficients and reference frequency."""
    return np.append(runs[0].estimate.coefficients, runs[0].estimate.frequency)


def _still_counts(runs: Runs, rows: Rows, solution: Solution) -> Array:
    """Smallest change of coefficients and frequency that still counts."""
    # Without noise there are no errors to settle within, but rounding, of forces as parts of the swing.
    swing = root_mean_square([np.sqrt(np.mean(run.reference.x**2)) for run in runs])
    smallest = SETTLED_WITHOUT_NOISE * np.append(swing / rows.scale, runs[0].estimate.frequency)
    return 0.02 * np.sqrt(np.diag(solution.covariance)) + smallest


def _further(runs: Runs, by: Array, constraints: ConstraintMap) -> Runs:
    common = _common_values(runs) + by
    coefficients, frequency = constraints.impose(common[:-1]), float(common[-1])
    return tuple(
        replace(run, estimate=replace(run.estimate, coefficients=coefficients, frequency=frequency))
        for run in runs
    )


def _extrapolation(step: Array, last: Array | None) -> float:
    """How many times a step is still to come, where steps shrink in one direction (Aitken's delta-squared).

    Jumps at v = 0 are distributed in the operator, so that it converges at a rate: slowly if forces that
    nearly cancel hold large jumps.
    """
    if last is None:
        return 0.0
    rate = float(step @ last / (last @ last))
    parallel = float(np.linalg.norm(step - rate * last)) < 0.3 * float(np.linalg.norm(step))
    return rate / (1.0 - rate) if parallel and 0.4 < rate < 0.95 else 0.0


def _motion(run: RunRegression, active: Mask, sensitivity: Array | None) -> tuple[RunRegression, Array]:
    """Motion of the present model, its start fitted to the record."""
    problem, estimate = run.problem, run.estimate
    pairs = zip(problem.library.symbols, estimate.coefficients.tolist(), active, strict=True)
    model = Model(problem.library, {s: c for s, c, kept in pairs if kept}, estimate.frequency, problem.shapes)
    motion = fit_start(
        model, problem.time, problem.angle, estimate.start, offset=estimate.offset, sensitivity=sensitivity
    )
    features = problem.features(estimate.frequency)
    columns = features.evaluate(problem.elapsed, motion.x, motion.v, motion.hidden)
    estimate = replace(estimate, start=(motion.angle, motion.rate), offset=motion.offset)
    reference = ReferenceTrajectory(motion.x, motion.v, columns, exact=True)
    return RunRegression(problem, estimate, reference), motion.sensitivity
