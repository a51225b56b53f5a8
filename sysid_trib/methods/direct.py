"""Direct identification of Eq. 1: weak form, whitened, with refined instrumental variables."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.decays.half_sines import usable_half_periods
from sysid_trib.errors import DecayError, SimulationError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods.strong_form import strong_form
from sysid_trib.methods.unknowns import unknown_forces
from sysid_trib.model import Model
from sysid_trib.regression.rows import (
    Guess,
    Linearised,
    Mask,
    Path,
    Problem,
    Rows,
    averaged_columns,
    covariance,
    force_columns,
    least_squares,
    linearised,
    moved,
    whitened_rows,
)
from sysid_trib.regression.selection import by_optimizer, significant, solved_by
from sysid_trib.regression.weak_form import build_weak_form, smooth
from sysid_trib.results import Estimate, identification
from sysid_trib.start import fit_start
from sysid_trib.ties import dependent_columns

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

    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`.

        Returns
        -------
        Dataset (see `identify`); a force that was not kept has `active` False, coefficient 0 and the standard
        error it would have had. Scalars besides: `misfit`, the in-band residual over the noise; `start_angle`
        (rad), `start_rate` (rad/s) and `offset` (rad) of the model's motion. attrs: `refined`, whether the
        columns are from that motion; `correlation_lags`, over which the errors allow for correlation.

        Raises
        ------
        DecayError
            The decay cannot support the request: too short, or forces that are the same on it.
        """
        asked = unknown_forces(library, self.reference_frequency)
        problem, guess, path, noise = _begin(self, decay, asked)
        rows, _ = _regressed(problem, guess, path)
        guess = moved(problem, guess, *least_squares(rows, np.ones(len(asked), bool)))
        refined = False
        if self.form == "strong":
            guess, rows, active = strong_form(problem, guess, path, partial(_selected, self))
        else:
            guess, rows, active, refined = _weak_form(self, problem, guess, path, asked)
        spread, in_band, lags = covariance(problem, rows, guess, active)
        extra = {
            "misfit": (in_band / noise, "1", "in-band residual over the noise of the record"),
            "start_angle": (guess.start[0], "rad", "angle of the model at the first sample"),
            "start_rate": (guess.start[1], "rad/s", "rate of the model at the first sample"),
            "offset": (guess.offset, "rad", "zero of the sensor about the decay's equilibrium"),
        }
        estimate = Estimate(guess.coefficients, spread, guess.frequency, noise, extra)
        result = identification(self, decay, asked, estimate, offered=library, active=active)
        return result.assign_attrs(refined=str(refined), correlation_lags=lags)


def _begin(method: Direct, decay: xr.Dataset, library: ForceLibrary) -> tuple[Problem, Guess, Path, float]:
    """Weak form, and the smoothed record as the first reference trajectory; noise in rad."""
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    halves = usable_half_periods(time, angle, str(decay.attrs.get("source", "decay")))
    # A scale of time, to two digits: the same for records that differ by noise, and so their weak form.
    nominal = method.reference_frequency or float(f"{np.pi / np.median(halves.duration):.2g}")
    form = build_weak_form(nominal * (time - time[0]))
    free = method.reference_frequency is None
    problem = Problem(time, angle, form, library.forces, dict(method.shapes), nominal, free)
    if form.rows < len(library) + 4:
        raise DecayError(f"{form.rows} rows cannot decide {len(library)} forces; give a longer record.")
    x, v, acceleration, noise = smooth(form, angle)
    columns = averaged_columns(problem, nominal, x, v, acceleration)
    same = dependent_columns(np.column_stack([columns, x] if free else [columns]))
    if same:
        names = [(*library.symbols, "the frequency")[i] for i in same[0]]
        raise DecayError(
            f"On this record {' and '.join(names)} are the same force; leave one out (--forces)."
        )
    guess = Guess(np.zeros(len(library)), nominal, 0.0, (float(x[0]), float(v[0] * nominal)))
    return problem, guess, Path(x, v, columns, exact=False), noise


def _regressed(problem: Problem, guess: Guess, path: Path) -> tuple[Rows, Linearised]:
    about = linearised(problem, guess, path)
    return whitened_rows(problem, guess, path, about), about


def _weak_form(
    method: Direct, problem: Problem, guess: Guess, path: Path, library: ForceLibrary
) -> tuple[Guess, Rows, Mask, bool]:
    """Choose forces and refine them in turn, until the choice stands; whether the refinement settled."""
    rows, about = _regressed(problem, guess, path)
    chosen = _selected(method, rows)
    # About the motion of the kept forces alone the choice is better founded than about all of them.
    for _ in range(MAX_SELECTIONS):
        active = chosen
        guess = moved(problem, guess, *least_squares(rows, active))
        if not active.all():
            about = linearised(problem, guess, path)
        guess, rows, refined = _refined(method, problem, guess, rows, about, active, library)
        chosen = _selected(method, rows)
        if np.array_equal(chosen, active):
            break
    return _finally(problem, guess, rows, active), rows, active, refined


def _selected(method: Direct, rows: Rows) -> Mask:
    """Forces that are kept, by significance and by the optimiser."""
    active = np.ones(rows.columns.shape[1], bool)
    if method.significance is not None:
        active &= significant(rows, method.significance)
    if method.optimizer is not None:
        active &= by_optimizer(rows, method.optimizer)
    return active


def _finally(problem: Problem, guess: Guess, rows: Rows, active: Mask) -> Guess:
    """The kept forces' coefficients by a pysindy optimiser without threshold."""
    if not active.any():
        return guess
    from pysindy.optimizers import STLSQ

    kept = replace(rows, columns=rows.columns[:, active], scale=rows.scale[active])
    coefficients, steps = least_squares(rows, active)
    coefficients[active] = solved_by(kept, STLSQ(threshold=0.0, alpha=0.0)) / kept.scale
    return moved(problem, guess, coefficients, steps)


def _refined(
    method: Direct,
    problem: Problem,
    guess: Guess,
    rows: Rows,
    about: Linearised,
    active: Mask,
    library: ForceLibrary,
) -> tuple[Guess, Rows, bool]:
    """Take the columns from the motion of the identified model, and solve again, until nothing moves.

    The last rows are about the last motion, so that they hold the final estimate's covariance.
    """
    first, sensitivity, last = (guess, rows), None, None
    for _ in range(MAX_REFINEMENTS if method.refine else 0):
        try:
            guess, path, sensitivity = _motion(problem, guess, library, active, sensitivity)
        except SimulationError:
            return (*first, False)
        gap = problem.angle - guess.offset - path.x
        if np.sqrt(np.mean(gap**2)) > SLIPPED * np.sqrt(np.mean(problem.angle**2)):
            return (*first, False)
        rows = whitened_rows(problem, guess, path, about)
        after = moved(problem, guess, *least_squares(rows, active))
        spread, _, _ = covariance(problem, rows, guess, active)
        moved_by = np.append(after.coefficients - guess.coefficients, after.frequency - guess.frequency)
        # Without noise there are no errors to settle within, but rounding, of forces as parts of the swing.
        smallest = ROUNDING * np.append(np.sqrt(np.mean(path.x**2)) / rows.scale, after.frequency)
        step = moved_by / (0.02 * np.sqrt(np.diag(spread)) + smallest)
        if np.all(np.abs(step) <= 1.0):
            return guess, rows, True
        ahead = _extrapolation(step, last)
        last = None if ahead else step
        guess = replace(
            after,
            coefficients=after.coefficients + ahead * moved_by[:-1],
            frequency=after.frequency + ahead * moved_by[-1],
        )
    return (*first, False)


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


def _motion(
    problem: Problem, guess: Guess, library: ForceLibrary, active: Mask, sensitivity: Array | None
) -> tuple[Guess, Path, Array]:
    """Motion of the present model, its start fitted to the record."""
    pairs = zip(library.symbols, guess.coefficients.tolist(), active, strict=True)
    model = Model(library, {s: c for s, c, kept in pairs if kept}, guess.frequency, problem.shapes)
    motion = fit_start(
        model, problem.time, problem.angle, guess.start, offset=guess.offset, sensitivity=sensitivity
    )
    columns = force_columns(problem, guess.frequency, motion.x, motion.v, motion.hidden)
    guess = replace(guess, start=(motion.angle, motion.rate), offset=motion.offset)
    return guess, Path(motion.x, motion.v, columns, exact=True), motion.sensitivity
