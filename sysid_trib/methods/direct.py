"""Direct identification of Eq. 1: weak form, whitened, with refined instrumental variables."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.forces import ForceLibrary
from sysid_trib.half_periods import dominant_period
from sysid_trib.model import Model
from sysid_trib.regression import (
    Guess,
    Path,
    Problem,
    Rows,
    averaged_columns,
    covariance,
    force_columns,
    moved,
    whitened_rows,
)
from sysid_trib.results import Estimate, identification
from sysid_trib.start import fit_start
from sysid_trib.weak_form import build_weak_form, smooth

Array = NDArray[np.float64]

MAX_REFINEMENTS = 12
# A simulated motion this far from the record (RMS, of the record's) has slipped out of phase.
SLIPPED = 0.3


@dataclass(frozen=True)
class Direct:
    """Regression of Eq. 1 on its force columns (Le Bot et al. 2019, Eq. 1), solved by a pysindy optimiser.

    Parameters
    ----------
    reference_frequency : w in rad/s, held; the library's force of formula `x` is then an unknown.
        Without it w is fitted and that force is absent.
    optimizer : a pysindy optimiser. Columns are scaled to their RMS force, so that a threshold is a force
        in rad. Default: least squares, which keeps every force.
    significance : level of a family-wise error at which a force is kept; None keeps every force.
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
    refine: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)

    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`."""
        stiffness = library.role("x")
        asked = library
        if self.reference_frequency is None and stiffness is not None:
            asked = library.select(s for s in library.symbols if s != stiffness.symbol)
        problem, guess, path = _begin(decay, asked, self)
        for _ in range(2):
            rows = whitened_rows(problem, guess, path)
            guess = _solved(self, problem, guess, rows)
        refined = False
        if self.refine:
            guess, rows, refined = _refined(self, problem, guess, rows, asked)
        spread, in_band, lags = covariance(problem, rows, guess)
        noise = smooth(problem.nominal * problem.time, problem.angle)[3]
        extra = {
            "start_angle": (guess.start[0], "rad", "angle of the model at the first sample"),
            "start_rate": (guess.start[1], "rad/s", "rate of the model at the first sample"),
            "misfit": (in_band / noise, "1", "noise of the whitened rows over the noise of the record"),
            "offset": (guess.offset, "rad", "zero of the sensor about the decay's equilibrium"),
        }
        estimate = Estimate(guess.coefficients, spread, guess.frequency, noise, extra)
        result = identification(self, decay, asked, estimate, offered=library)
        return result.assign_attrs(refined=str(refined), correlation_lags=lags)

    def quick(self) -> "Direct":
        """The same without its iterations, for the statistics of many records."""
        return replace(self, refine=False)


def _begin(decay: xr.Dataset, library: ForceLibrary, method: Direct) -> tuple[Problem, Guess, Path]:
    """Weak form, and the smoothed record as the first reference trajectory."""
    time = decay.time.values.astype(float)
    angle = decay.angle.values.astype(float)
    nominal = method.reference_frequency or 2.0 * np.pi / _period(time, angle)
    tau = nominal * (time - time[0])
    form = build_weak_form(tau)
    problem = Problem(
        time, angle, form, library.forces, dict(method.shapes), nominal, method.reference_frequency is None
    )
    x, v, acceleration, _ = smooth(tau, angle)
    columns = averaged_columns(problem, nominal, x, v, acceleration)
    guess = Guess(np.zeros(len(library)), nominal, 0.0, (float(x[0]), float(v[0] * nominal)))
    return problem, guess, Path(x, v, columns, exact=False)


def _period(time: Array, angle: Array) -> float:
    period = dominant_period(time, angle)
    if period is None:
        raise DecayError("The record shows no oscillation; give a decay of at least three periods.")
    return period


def _solved(method: Direct, problem: Problem, guess: Guess, rows: Rows) -> Guess:
    """Solve the whitened rows with the optimiser; offset and frequency are never thresholded."""
    basis, triangle = np.linalg.qr(rows.nuisances)
    columns = rows.columns - basis @ (basis.T @ rows.columns)
    y = rows.y - basis @ (basis.T @ rows.y)
    scaled = _optimizer(method).fit(columns, y[:, None]).coef_[0] if columns.size else np.zeros(0)
    steps = np.linalg.solve(triangle, basis.T @ (rows.y - rows.columns @ scaled))
    return moved(problem, guess, scaled / rows.scale, steps)


def _optimizer(method: Direct) -> Any:
    if method.optimizer is not None:
        from sklearn.base import clone

        return clone(method.optimizer)
    from pysindy.optimizers import STLSQ

    return STLSQ(threshold=0.0, alpha=0.0)


def _refined(
    method: Direct, problem: Problem, guess: Guess, rows: Rows, library: ForceLibrary
) -> tuple[Guess, Rows, bool]:
    """Take the columns from the motion of the identified model, and solve again, until nothing moves."""
    for _ in range(MAX_REFINEMENTS):
        try:
            guess, path = _motion(problem, guess, library)
        except SimulationError:
            return guess, rows, False
        gap = problem.angle - guess.offset - path.x
        if np.sqrt(np.mean(gap**2)) > SLIPPED * np.sqrt(np.mean(problem.angle**2)):
            return guess, rows, False
        rows = whitened_rows(problem, guess, path)
        before = guess
        guess = _solved(method, problem, guess, rows)
        spread, _, _ = covariance(problem, rows, guess)
        step = np.append(guess.coefficients - before.coefficients, guess.frequency - before.frequency)
        error = np.sqrt(np.maximum(np.diag(spread), 1e-300))
        if np.all(np.abs(step) < 0.02 * error + 1e-12 * np.abs(np.append(guess.coefficients, guess.frequency))):
            return guess, rows, True
    return guess, rows, False


def _motion(problem: Problem, guess: Guess, library: ForceLibrary) -> tuple[Guess, Path]:
    """Motion of the present model, its start fitted to the record."""
    coefficients = dict(zip(library.symbols, guess.coefficients.tolist(), strict=True))
    model = Model(library, coefficients, guess.frequency, problem.shapes)
    motion = fit_start(model, problem.time, problem.angle, guess.start, offset=guess.offset)
    columns = force_columns(problem, guess.frequency, motion.x, motion.v)
    guess = replace(guess, start=(motion.angle, motion.rate), offset=motion.offset)
    return guess, Path(motion.x, motion.v, columns, exact=True)
