"""Direct identification of Eq. 1: weak form, whitened, with refined instrumental variables."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from sysid_trib.averaging.identifiability import dependent_columns
from sysid_trib.decays.half_sines import usable_half_periods
from sysid_trib.errors import DecayError, SimulationError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.to_identify import forces_to_identify
from sysid_trib.methods.scope import MethodScope
from sysid_trib.methods.strong_form import strong_form
from sysid_trib.noise.smoothing import smooth
from sysid_trib.records.runs import Decays, as_runs, root_mean_square
from sysid_trib.regression.rows import (
    Guess,
    Linearised,
    Mask,
    Path,
    Problem,
    Rows,
    Run,
    averaged_columns,
    covariance,
    force_columns,
    least_squares,
    linearised,
    moved,
    together,
    whitened_rows,
)
from sysid_trib.regression.selection import by_optimizer, significant, solved_by
from sysid_trib.regression.weak_form import build_weak_form
from sysid_trib.results.per_run import run_noise, start_variables
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.simulation.model import Model
from sysid_trib.trajectory_fit.initial_conditions import fit_start

Array = NDArray[np.float64]

MAX_REFINEMENTS = 25
MAX_SELECTIONS = 5
# A simulated motion this far from the record (RMS, of the record's) has slipped out of phase.
SLIPPED = 0.3
ROUNDING = 1e-10


@dataclass(frozen=True)
class Direct:
    """Regression of Eq. 1 on its force columns (Le Bot et al. 2019, Eq. 1), solved by a pysindy optimiser.

    Parameters
    ----------
    reference_frequency : w in rad/s, held; the library's force of formula `x` is then an unknown.
        Without it w is fitted and that force is absent.
    optimizer : a pysindy optimiser, which chooses the forces that are kept; their coefficients are then
        refined. Columns are scaled to their RMS force, so that a threshold is a force in rad. Default:
        `STLSQ(threshold=0, alpha=0)`, least squares, which keeps every force.
    significance : family-wise level of error at which a force is kept; None keeps every force.
    form : `weak`, or `strong`: `pysindy.SINDy` on derivatives of the smoothed record.
    refine : whether the nonlinear columns are taken from the motion of the identified model (refined
        instrumental variables, Young 2011), which removes the bias of smoothed columns.
    shapes : values of shape parameters, which are held.

    Notes
    -----
    At convergence the residual angle is orthogonal to the sensitivities of the motion: the estimate has
    the variance of maximum likelihood in white noise.
    """

    scope: ClassVar = MethodScope(
        label="direct",
        assumes="the forces offered are all there are",
        family="direct",
        # pysindy.SINDy on derivatives of the smoothed record, as it is commonly used.
        variants={"strong form": {"form": "strong"}},
    )

    reference_frequency: float | None = None
    optimizer: Any = None
    significance: float | None = None
    form: Literal["weak", "strong"] = "weak"
    refine: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.form not in ("weak", "strong"):
            raise UsageError(f"form='{self.form}' is neither 'weak' nor 'strong'.")
        if self.significance is not None and not 0.0 < self.significance < 1.0:
            raise UsageError(f"significance={self.significance} must lie between 0 and 1, such as 0.01.")

    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several runs.

        Returns
        -------
        Dataset (see `identify`); a force that was not kept has `active` False, coefficient 0 and the standard
        error it would have had. Besides: `birge_ratio`, the in-band residual over the noise; `start_angle`
        (rad), `start_rate` (rad/s) and `offset` (rad) of the model's motion, `(run)` where there are several.
        attrs: `refined`, whether the columns are from that motion; `correlation_lags`, over which the errors
        allow for correlation.

        Raises
        ------
        DecayError
            The decay cannot support the request: too short, or forces that are the same on it.
        """
        asked = forces_to_identify(library, self.reference_frequency)
        runs = _begin(self, as_runs(decay), asked)
        rows, _ = _regressed(runs)
        runs = moved(runs, *least_squares(rows, np.ones(len(asked), bool)))
        refined = False
        if self.form == "strong":
            runs, rows, active = strong_form(runs, partial(_selected, self))
        else:
            runs, rows, active, refined = _weak_form(self, runs, asked)
        spread, in_band, lags = covariance(runs[0], rows, active)
        noises = [run.problem.noise for run in runs]
        noise = root_mean_square(noises)
        guesses = [run.guess for run in runs]
        extra: dict[str, tuple[ArrayLike, str, str]] = {
            "birge_ratio": (in_band / noise, "1", "in-band residual over the noise of the record"),
            **run_noise(noises),
            **start_variables([guess.start for guess in guesses], [guess.offset for guess in guesses]),
        }
        estimate = Estimate(guesses[0].coefficients, spread, guesses[0].frequency, noise, extra)
        result = identification(self, decay, asked, estimate, offered=library, active=active)
        return result.assign_attrs(refined=str(refined), correlation_lags=lags)


def _begin(method: Direct, decays: Sequence[xr.Dataset], library: ForceLibrary) -> tuple[Run, ...]:
    """Weak forms, and the smoothed records as the first reference trajectories."""
    records, durations = [], []
    for decay in decays:
        time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
        halves = usable_half_periods(time, angle, str(decay.attrs.get("source", "decay")))
        records.append((time, angle))
        durations.append(float(np.median(halves.duration)))
    # A scale of time, to two digits: the same for records that differ by noise, and so their weak form.
    nominal = method.reference_frequency or float(f"{np.pi / np.median(durations):.2g}")
    runs = tuple(_first_run(method, time, angle, library, nominal) for time, angle in records)
    rows = sum(run.problem.form.rows for run in runs)
    if rows < len(library) + 3 + len(runs):
        raise DecayError(f"{rows} rows cannot decide {len(library)} forces; give a longer record.")
    columns = np.concatenate([run.path.columns for run in runs])
    x = np.concatenate([run.path.x for run in runs])
    same = dependent_columns(np.column_stack([columns, x] if runs[0].problem.free else [columns]))
    if same:
        names = [(*library.symbols, "the frequency")[i] for i in same[0]]
        raise DecayError(
            f"On this record {' and '.join(names)} are the same force; leave one out (--forces)."
        )
    return runs


def _first_run(method: Direct, time: Array, angle: Array, library: ForceLibrary, nominal: float) -> Run:
    form = build_weak_form(nominal * (time - time[0]))
    x, v, acceleration, noise = smooth(form.tau, angle)
    free = method.reference_frequency is None
    problem = Problem(time, angle, form, library.forces, dict(method.shapes), nominal, free, noise)
    columns = averaged_columns(problem, nominal, x, v, acceleration)
    guess = Guess(np.zeros(len(library)), nominal, 0.0, (float(x[0]), float(v[0] * nominal)))
    return Run(problem, guess, Path(x, v, columns, exact=False))


def _regressed(runs: Sequence[Run]) -> tuple[Rows, list[Linearised]]:
    about = [linearised(run.problem, run.guess, run.path) for run in runs]
    return _rows(runs, about), about


def _rows(runs: Sequence[Run], about: Sequence[Linearised]) -> Rows:
    """The regression of all runs about their paths."""
    each = [
        whitened_rows(run.problem, run.guess, run.path, near) for run, near in zip(runs, about, strict=True)
    ]
    return together(each, [run.problem.noise for run in runs])


def _weak_form(
    method: Direct, runs: tuple[Run, ...], library: ForceLibrary
) -> tuple[tuple[Run, ...], Rows, Mask, bool]:
    """Choose forces and refine them in turn, until the choice stands; whether the refinement settled."""
    rows, about = _regressed(runs)
    chosen = _selected(method, rows)
    smoothed = [run.path for run in runs]
    # About the motion of the kept forces alone the choice is better founded than about all of them.
    for _ in range(MAX_SELECTIONS):
        active = chosen
        runs = moved(runs, *least_squares(rows, active))
        if not active.all():
            about = [
                linearised(run.problem, run.guess, path) for run, path in zip(runs, smoothed, strict=True)
            ]
        runs, rows, refined = _refined(method, runs, rows, about, active, library)
        chosen = _selected(method, rows)
        if np.array_equal(chosen, active):
            break
    return _finally(runs, rows, active), rows, active, refined


def _selected(method: Direct, rows: Rows) -> Mask:
    """Forces that are kept, by significance and by the optimiser."""
    active = np.ones(rows.columns.shape[1], bool)
    if method.significance is not None:
        active &= significant(rows, method.significance)
    if method.optimizer is not None:
        active &= by_optimizer(rows, method.optimizer)
    return active


def _finally(runs: tuple[Run, ...], rows: Rows, active: Mask) -> tuple[Run, ...]:
    """The kept forces' coefficients by a pysindy optimiser without threshold."""
    if not active.any():
        return runs
    from pysindy.optimizers import STLSQ

    kept = replace(rows, columns=rows.columns[:, active], scale=rows.scale[active])
    coefficients, steps = least_squares(rows, active)
    coefficients[active] = solved_by(kept, STLSQ(threshold=0.0, alpha=0.0)) / kept.scale
    return moved(runs, coefficients, steps)


def _refined(
    method: Direct,
    runs: tuple[Run, ...],
    rows: Rows,
    about: Sequence[Linearised],
    active: Mask,
    library: ForceLibrary,
) -> tuple[tuple[Run, ...], Rows, bool]:
    """Take the columns from the motion of the identified model, and solve again, until nothing moves.

    The last rows are about the last motion, so that they hold the final estimate's covariance.
    """
    first, last = (runs, rows), None
    slopes: list[Array | None] = [None] * len(runs)
    for _ in range(MAX_REFINEMENTS if method.refine else 0):
        try:
            moving = [_motion(run, library, active, slope) for run, slope in zip(runs, slopes, strict=True)]
        except SimulationError:
            return (*first, False)
        runs, slopes = tuple(run for run, _ in moving), [slope for _, slope in moving]
        if any(_slipped(run) for run in runs):
            return (*first, False)
        rows = _rows(runs, about)
        after = moved(runs, *least_squares(rows, active))
        step, moved_by = _steps(runs, after, rows, active)
        if np.all(np.abs(step) <= 1.0):
            return runs, rows, True
        ahead = _extrapolation(step, last)
        last = None if ahead else step
        runs = tuple(_further(run, ahead * moved_by) for run in after)
    return (*first, False)


def _slipped(run: Run) -> bool:
    gap = run.problem.angle - run.guess.offset - run.path.x
    return bool(np.sqrt(np.mean(gap**2)) > SLIPPED * np.sqrt(np.mean(run.problem.angle**2)))


def _steps(runs: Sequence[Run], after: Sequence[Run], rows: Rows, active: Mask) -> tuple[Array, Array]:
    """How far (coefficients, frequency) moved, in what still counts, and in their own units."""
    here, there = runs[0].guess, after[0].guess
    moved_by = np.append(there.coefficients - here.coefficients, there.frequency - here.frequency)
    spread, _, _ = covariance(runs[0], rows, active)
    # Without noise there are no errors to settle within, but rounding, of forces as parts of the swing.
    swing = root_mean_square([np.sqrt(np.mean(run.path.x**2)) for run in runs])
    smallest = ROUNDING * np.append(swing / rows.scale, there.frequency)
    return moved_by / (0.02 * np.sqrt(np.diag(spread)) + smallest), moved_by


def _further(run: Run, by: Array) -> Run:
    guess = run.guess
    return replace(
        run,
        guess=replace(guess, coefficients=guess.coefficients + by[:-1], frequency=guess.frequency + by[-1]),
    )


def _extrapolation(step: Array, last: Array | None) -> float:
    """How many times a step is still to come, where steps shrink in one direction (Aitken's delta-squared).

    Jumps at v = 0 are spread in the operator, so that it converges at a rate: slowly if forces that nearly
    cancel hold large jumps.
    """
    if last is None:
        return 0.0
    rate = float(step @ last / (last @ last))
    parallel = float(np.linalg.norm(step - rate * last)) < 0.3 * float(np.linalg.norm(step))
    return rate / (1.0 - rate) if parallel and 0.4 < rate < 0.95 else 0.0


def _motion(run: Run, library: ForceLibrary, active: Mask, sensitivity: Array | None) -> tuple[Run, Array]:
    """Motion of the present model, its start fitted to the record."""
    problem, guess = run.problem, run.guess
    pairs = zip(library.symbols, guess.coefficients.tolist(), active, strict=True)
    model = Model(library, {s: c for s, c, kept in pairs if kept}, guess.frequency, problem.shapes)
    motion = fit_start(
        model, problem.time, problem.angle, guess.start, offset=guess.offset, sensitivity=sensitivity
    )
    columns = force_columns(problem, guess.frequency, motion.x, motion.v, motion.hidden)
    guess = replace(guess, start=(motion.angle, motion.rate), offset=motion.offset)
    return Run(problem, guess, Path(motion.x, motion.v, columns, exact=True)), motion.sensitivity
