"""Weak rows of Eq. 1 along a reference trajectory: regression with whitened noise, and its covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from sysid_trib.averaging.internal_states import states_along
from sysid_trib.forces.force import Force
from sysid_trib.noise.smoothing import KNOTS_PER_PERIOD
from sysid_trib.regression.weak_form import WeakForm, noise_operator, whiten, whitener
from sysid_trib.simulation.model import rescaling_factors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Width, in units of the local amplitude, over which the noise feels a jump of a force at zero.
REACH = 0.8


@dataclass(frozen=True)
class Problem:
    """What is held fixed of one record: the data, the test functions and the forces offered.

    Time of the weak form is tau = `nominal` * t; `free` says whether the reference frequency is an unknown;
    `noise` is that of one sample (rad).
    """

    time: Array
    angle: Array
    form: WeakForm
    forces: tuple[Force, ...]
    shapes: Mapping[str, float]
    nominal: float
    free: bool
    noise: float


@dataclass(frozen=True)
class Guess:
    """The present estimate: coefficients at `frequency`, zero of the sensor, start of the motion."""

    coefficients: Array
    frequency: float
    offset: float = 0.0
    start: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Path:
    """Reference trajectory: theta (rad), v = theta'/w (rad) and the forces along it, (sample, force)."""

    x: Array
    v: Array
    columns: Array
    exact: bool


@dataclass(frozen=True)
class Run:
    """One record on its way to an estimate. Coefficients and frequency of the guess are those of all runs."""

    problem: Problem
    guess: Guess
    path: Path


@dataclass(frozen=True)
class Linearised:
    """Operator of small deviations on the samples, (row, sample), and the factor that whitens its rows."""

    operator: sp.csr_matrix
    factor: tuple[Array, int]


@dataclass(frozen=True)
class Rows:
    """Whitened rows ``y = columns @ coefficients + nuisances @ steps + white noise``.

    Attributes
    ----------
    y : (row,); columns : (row, force), each divided by its `scale`, the RMS force (rad).
    nuisances : (row, runs or runs + 1), the sensor's zero in each run and, where the frequency is free, the
        stiffness.
    lags : rows of two periods, over which residuals may be correlated.
    """

    y: Array
    columns: Array
    nuisances: Array
    scale: Array
    lags: int = 2 * KNOTS_PER_PERIOD


def force_columns(
    problem: Problem, frequency: float, x: Array, v: Array, known: Mapping[str, Array] | None = None
) -> Array:
    """Every force along a trajectory, (sample, force); states and memory are `known` or carried along."""
    t = problem.time - problem.time[0]
    columns = []
    for force in problem.forces:
        names = (*force.state, *force.memory)
        hidden = {
            k: (known or {})[f"{force.symbol}.{k}"] for k in names if f"{force.symbol}.{k}" in (known or {})
        }
        if len(hidden) < len(names):
            hidden = states_along(force, frequency * t, x, v, problem.shapes, time=t)
        columns.append(force.value(x, v, t, shapes=problem.shapes, hidden=hidden))
    return np.stack(columns, axis=1) if columns else np.zeros((len(x), 0))


def averaged_columns(problem: Problem, frequency: float, x: Array, v: Array, acceleration: Array) -> Array:
    """`force_columns` averaged over each sample's cell: sign(v) turns where v does, not at a sample."""
    step = frequency * np.gradient(problem.time)
    t = problem.time - problem.time[0]
    columns = force_columns(problem, frequency, x, v)
    for j, force in enumerate(problem.forces):
        # What a force remembers is continuous, and costly to carry along.
        if not force.memoryless or not force.surfaces:
            continue
        parts = (-0.375 * step, -0.125 * step, 0.125 * step, 0.375 * step)
        near = [
            force.value(x + s * v, v + s * acceleration, t + s / frequency, shapes=problem.shapes)
            for s in parts
        ]
        columns[:, j] = np.mean(near, axis=0)
    return columns


def partial_derivatives(problem: Problem, guess: Guess, path: Path) -> tuple[Array, Array]:
    """1 + sum c dh/dx and sum c dh/dv along a path, a jump at zero spread over `REACH`.

    A force that jumps with v, as sign(v), damps the noise by a spike at each reversal. The test functions
    see no spike, but its mean: a sharper one would whiten away what they can see.
    """
    t = problem.time - problem.time[0]
    amplitude = np.hypot(path.x, path.v) + 1e-12
    found = [np.ones_like(path.x), np.zeros_like(path.x)]
    for force, coefficient in zip(problem.forces, guess.coefficients, strict=True):
        if not force.memoryless or coefficient == 0.0:
            continue
        for i, (name, along) in enumerate((("x", path.x), ("v", path.v))):
            if name not in force.formula.names:
                continue

            def h(value: Array, force: Force = force, i: int = i) -> Array:
                point = (value, path.v) if i == 0 else (path.x, value)
                return force.value(*point, t, shapes=problem.shapes)

            # A step in proportion never crosses zero, where the jump is.
            step = 1e-5 * np.where(along == 0.0, 1.0, along)
            slope = (h(along + step) - h(along)) / step
            jump = h(np.full_like(along, 1e-12)) - h(np.full_like(along, -1e-12))
            near = np.clip(1.0 - (along / (REACH * amplitude)) ** 2, 0.0, None)
            slope = slope + jump * near**2 * 15.0 / (16.0 * REACH * amplitude)
            found[i] = found[i] + coefficient * slope
    return found[0], found[1]


def linearised(problem: Problem, guess: Guess, path: Path) -> Linearised:
    """The operator of small deviations about a path, and what whitens its rows."""
    k = (guess.frequency / problem.nominal) ** 2
    stiffness, damping = partial_derivatives(problem, guess, path)
    operator = noise_operator(problem.form, k * stiffness, np.sqrt(k) * damping)
    return Linearised(operator, whitener(operator))


def whitened_rows(problem: Problem, guess: Guess, path: Path, about: Linearised) -> Rows:
    """Rows of the regression about a path.

    With L the operator of small deviations, ``A x + k value (H c) + L (angle - offset - x) = L noise``,
    k = (frequency/nominal)^2. Along an exact solution the first part vanishes, so that errors of quadrature
    cannot bias the result.
    """
    form, k = problem.form, (guess.frequency / problem.nominal) ** 2
    residual = about.operator @ (problem.angle - guess.offset - path.x)
    columns = k * (form.value @ path.columns)
    if not path.exact:
        residual = (
            residual + form.curvature @ path.x + k * (form.value @ path.x) + columns @ guess.coefficients
        )
    nuisances = [-(about.operator @ np.ones_like(path.x))]
    if problem.free:
        nuisances.append(k * (form.value @ path.x))
    scale = rms_forces(path)
    white = whiten(about.factor, np.column_stack([-residual, columns / scale, *nuisances]))
    count = columns.shape[1]
    y = white[:, 0] + white[:, 1 : count + 1] @ (scale * guess.coefficients)
    return Rows(y, white[:, 1 : count + 1], white[:, count + 1 :], scale)


def together(rows: Sequence[Rows], noise: Sequence[float]) -> Rows:
    """Rows of several runs as one regression: shared coefficients and stiffness, a zero of its own for each.

    Each run counts by its noise (rad), relative to their RMS.
    """
    if len(rows) == 1:
        return rows[0]
    weights = np.sqrt(np.mean(np.square(noise))) / np.asarray(noise)
    samples = np.array([len(one.y) for one in rows])
    scale = np.sqrt(samples @ np.stack([one.scale**2 for one in rows]) / samples.sum())
    columns = [w * one.columns * (one.scale / scale) for one, w in zip(rows, weights, strict=True)]
    zeros = scipy.linalg.block_diag(*(w * one.nuisances[:, :1] for one, w in zip(rows, weights, strict=True)))
    stiffness = np.concatenate([w * one.nuisances[:, 1:] for one, w in zip(rows, weights, strict=True)])
    y = np.concatenate([w * one.y for one, w in zip(rows, weights, strict=True)])
    return Rows(y, np.concatenate(columns), np.column_stack([zeros, stiffness]), scale, rows[0].lags)


def rms_forces(path: Path) -> Array:
    """RMS of each force along a path (rad): a coefficient in units of it is a force."""
    scale = np.sqrt(np.mean(path.columns**2, axis=0))
    return np.where(scale > 0, scale, 1.0)


def least_squares(rows: Rows, active: Mask) -> tuple[Array, Array]:
    """Coefficients (force,), zero where not active, and the steps of the nuisances."""
    design = np.column_stack([rows.columns[:, active], rows.nuisances])
    solution, *_ = np.linalg.lstsq(design, rows.y, rcond=None)
    count = int(np.sum(active))
    coefficients = np.zeros(len(active))
    coefficients[active] = solution[:count] / rows.scale[active]
    return coefficients, np.asarray(solution[count:], dtype=float)


def moved(runs: Sequence[Run], coefficients: Array, steps: Array) -> tuple[Run, ...]:
    """The runs with the next guess; a fitted stiffness is turned into the reference frequency.

    `steps` : the zeros of all runs, and the stiffness where the frequency is free.
    """
    problem, guess = runs[0].problem, runs[0].guess
    frequency = guess.frequency
    if problem.free:
        frequency = guess.frequency * np.sqrt(max(0.25, 1.0 + steps[-1]))
        factors = rescaling_factors(problem.forces, guess.frequency, frequency)
        # A force without a degree in v keeps its size at least: w^2 c stays.
        coefficients = coefficients * np.where(np.isnan(factors), (guess.frequency / frequency) ** 2, factors)
    return tuple(
        replace(
            run,
            guess=replace(
                run.guess,
                coefficients=coefficients,
                frequency=float(frequency),
                offset=run.guess.offset + float(step),
            ),
        )
        for run, step in zip(runs, steps, strict=False)
    )


def covariance(run: Run, rows: Rows, active: Mask) -> tuple[Array, float, int]:
    """Covariance of (coefficients, reference frequency), noise (rad), lags of correlation allowed for.

    `run` : any of those in the rows.

    Of white rows it is sigma^2 (X' X)^-1. Where the model leaves something in the residual, its rows are
    correlated: then the sandwich of Newey and West (1987) over two periods. A force that is not active has
    the variance that it would have if it were added to the others.
    """
    whole, noise, lags = _spread(run, rows, active)
    for j in np.flatnonzero(~active):
        added = active.copy()
        added[j] = True
        whole[j, j] = _spread(run, rows, added)[0][j, j]
    return whole, noise, lags


def _spread(run: Run, rows: Rows, active: Mask) -> tuple[Array, float, int]:
    problem, guess = run.problem, run.guess
    design = np.column_stack([rows.columns[:, active], rows.nuisances])
    solution, *_ = np.linalg.lstsq(design, rows.y, rcond=None)
    residual = rows.y - design @ solution
    freedom = max(1, len(residual) - design.shape[1])
    noise = float(np.sqrt(residual @ residual / freedom))
    inverse = np.linalg.pinv(design.T @ design)
    lags = rows.lags if _correlated(residual) else 0
    meat = noise**2 * design.T @ design
    if lags:
        scores = design * residual[:, None]
        meat = scores.T @ scores
        for lag in range(1, lags + 1):
            cross = scores[lag:].T @ scores[:-lag]
            meat = meat + (1.0 - lag / (lags + 1)) * (cross + cross.T)
    # Back to the coefficients' own units, and from the stiffness to the frequency: w sqrt(1 + alpha).
    count, kept = len(active), int(np.sum(active))
    jacobian = np.zeros((count + 1, design.shape[1]))
    jacobian[np.flatnonzero(active), np.arange(kept)] = 1.0 / rows.scale[active]
    if problem.free:
        degrees = np.array([2.0 if f.speed_degree is None else f.speed_degree for f in problem.forces])
        jacobian[:count, -1] = -0.5 * (2.0 - degrees) * guess.coefficients * active
        jacobian[count, -1] = 0.5 * guess.frequency
    return jacobian @ inverse @ meat @ inverse @ jacobian.T, noise, lags


def _correlated(residual: Array) -> bool:
    """Whether neighbouring rows' residuals are correlated: Ljung and Box (1978) over 12 lags at 1e-4."""
    from scipy.stats import chi2

    n, total = len(residual), float(residual @ residual)
    lags = [lag for lag in range(1, 13) if lag < n // 2]
    if not lags or total == 0.0:
        return False
    statistic = n * (n + 2) * sum(float(residual[k:] @ residual[:-k] / total) ** 2 / (n - k) for k in lags)
    return bool(chi2.sf(statistic, len(lags)) < 1e-4)
