"""Fast values of a history-dependent force along a motion for many values of its shapes.

A single state may have any rate: the rate is linearised along the whole motion, and solved again until it
converges if it is not linear. Several states are solved one after another if their rates are linear with
constant coefficients. In both cases each state is a scalar recurrence, a triangular banded system.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly
from scipy.linalg import get_lapack_funcs, schur
from scipy.ndimage import uniform_filter1d

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force
from sysid_trib.forces.formulas import Names
from sysid_trib.simulation.internal_states import is_linear, is_stepped

# Relative increase of the motion for derivatives of a force by its size.
LARGER = 1e-5
# Radau's method of order 3 (Hairer and Wanner 1996, IV.5), with stages at a third and at the end of a step.
# It is stiffly accurate: it also follows a state that reacts at once.
RADAU_STAGES = (1.0 / 3.0, 1.0)
RADAU_WEIGHTS = ((5.0 / 12.0, -1.0 / 12.0), (3.0 / 4.0, 1.0 / 4.0))
# Newton's iteration ends if its last change of the state is below this fraction of the state's size; the
# error of the steps is larger.
NEWTON_TOLERANCE, MAX_NEWTON = 1e-6, 60
# LAPACK's solvers of banded triangular systems of real and of complex numbers.
TRIANGULAR_SOLVERS = {kind: get_lapack_funcs("tbtrs", dtype=kind) for kind in "dD"}


class GivenMotion:
    """A motion made continuous by cubics, and its reversals.

    Parameters
    ----------
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau.
    time : (sample,) array of float, s
        The `t` of formulas.
    """

    def __init__(self, tau: Array, x: Array, v: Array, time: Array) -> None:
        self.tau, self.time = tau, time
        self.x, self.v = CubicHermiteSpline(tau, x, v), CubicSpline(tau, v)
        zeros = np.sort(_zeros(self.v))
        # Exclude the release, where the start values apply. A reversal at a sample is found in both steps.
        self.reversals = zeros[np.diff(zeros, prepend=tau[0]) > 1e-9]
        # Cache of forces along this motion, by the values of their shape parameters.
        self.followed: dict[tuple[Force, tuple[float, ...]], Array] = {}

    @cached_property
    def larger(self) -> "GivenMotion":
        """A motion larger by the fraction `LARGER`, with the same reversals."""
        x, v = ((1.0 + LARGER) * self.at_samples[name] for name in "xv")
        return GivenMotion(self.tau, x, v, self.time)

    def names(self, tau: Array) -> dict[str, Any]:
        """Return the variables of the formulas that follow from the motion."""
        return {"x": self.x(tau), "v": self.v(tau), "t": np.interp(tau, self.tau, self.time)}

    @cached_property
    def at_samples(self) -> dict[str, Any]:
        """Variables at the samples, (sample,)."""
        return self.names(self.tau)

    @cached_property
    def at_stages(self) -> dict[str, Any]:
        """Variables at the stages of steps from sample to sample, (stage, step)."""
        return self.names(self.tau[:-1] + np.outer(RADAU_STAGES, np.diff(self.tau)))


def _zeros(spline: PPoly) -> Array:
    """Return the zeros of a continuous spline of cubics, (zero,), between its ends.

    Zeros are searched only in steps where the Bernstein coefficients of the spline differ in sign, because
    the spline lies between them. Along a densely sampled motion this is one step in dozens.
    """
    length = np.diff(spline.x)
    cubic, square, slope, value = spline.c * length ** np.arange(3, -1, -1)[:, None]
    bounds = [value, value + slope / 3.0, value + (2.0 * slope + square) / 3.0]
    bounds.append(value + slope + square + cubic)
    at = np.flatnonzero((np.min(bounds, axis=0) <= 0.0) & (np.max(bounds, axis=0) >= 0.0))
    # Steps of unit length side by side, separated by values without a zero.
    parts = np.zeros((4, 2 * len(at)))
    parts[:, ::2], parts[-1, 1::2] = [cubic[at], square[at], slope[at], value[at]], 1.0
    zeros = PPoly(parts, np.arange(2.0 * len(at) + 1.0)).roots(False, False) if len(at) else np.empty(0)
    zeros = zeros[np.isfinite(zeros)]
    step = np.minimum((zeros // 2.0).astype(int), len(at) - 1)
    return np.asarray(spline.x[at[step]] + (zeros - 2.0 * step) * length[at[step]])


def values_along(motion: GivenMotion, force: Force, shapes: Sequence[Mapping[str, float]]) -> Array | None:
    """Return values of a history-dependent force along a motion for many values of its shapes.

    Parameters
    ----------
    motion : GivenMotion
        A densely sampled motion: each sample is a step.
    force : Force
        A force with states or memory.
    shapes : sequence of mapping of str to float
        Values of its shape parameters, as `{"dahl.s": 0.02}`, for each column.

    Returns
    -------
    (sample, column) array of float, or None
        None unless `is_stepped(force)`. A column is not finite if it cannot be computed.
    """
    if not is_stepped(force):
        return None
    keys = [(force, tuple(force.shape_values(column).values())) for column in shapes]
    # Cache forces with few values of the shapes, which a fit needs again. The many values of a screen would
    # take too much memory.
    followed = motion.followed if len(shapes) <= 4 else dict(motion.followed)
    missing = [key for key in dict.fromkeys(keys) if key not in followed]
    if missing:
        values = dict(zip(force.shape, np.array([key[1] for key in missing]).T, strict=True))
        with np.errstate(all="ignore"):
            memory = _memory(motion, force, values, len(missing))
            # Solve column by column: a column that is not finite does not affect the others.
            for i, key in enumerate(missing):
                column, held = ({k: q[i] for k, q in values.items()}, {k: m[:, i] for k, m in memory.items()})
                followed[key] = _stepped_value(motion, force, column, held)
    return np.stack([followed[key] for key in keys]).T


def tangent_along(motion: GivenMotion, force: Force, shapes: Mapping[str, float]) -> tuple[Array, Array]:
    """Return the derivatives of a history-dependent force by the angle and its rate, (sample,) each.

    Parameters
    ----------
    motion : GivenMotion
        A densely sampled motion.
    force : Force
        The derivatives of a force that is not `is_stepped` are zero.
    shapes : mapping of str to float

    Notes
    -----
    The derivatives follow from a motion that is slightly larger, and from one that is slightly ahead: only
    these two changes of a swing last. A state depends on the history of the motion and is not a spring. A
    linear force may oscillate without excitation; then means over a period are taken.
    """
    x, v, still = motion.at_samples["x"], motion.at_samples["v"], np.zeros_like(motion.tau)
    linear, values = is_linear(force), values_along(motion, force, [shapes])
    # A linear force is proportional to the motion, and needs no second motion.
    of_larger = values if linear else values_along(motion.larger, force, [shapes])
    if values is None or of_larger is None:
        return still, still
    here = values[:, 0]
    by_size = here if linear else (of_larger[:, 0] - here) / LARGER
    by_advance = np.gradient(here, motion.tau)
    # A larger motion changes angle and rate by x and v, a motion ahead by v and -x (w = 1).
    square = x**2 + v**2 + np.finfo(float).tiny
    along, across = x * by_size + v * by_advance, v * by_size - x * by_advance
    if linear:
        period = min(1 + int(2.0 * np.pi / np.median(np.diff(motion.tau))), len(x))
        square, along, across = (
            uniform_filter1d(part, period, mode="nearest") for part in (square, along, across)
        )
    of_x, of_v = along / square, across / square
    return np.nan_to_num(of_x, posinf=0.0, neginf=0.0), np.nan_to_num(of_v, posinf=0.0, neginf=0.0)


def _start_of(motion: GivenMotion, force: Force, shapes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the states and memory of a force at the first sample."""
    return force.start_values({k: value[0] for k, value in motion.at_samples.items()} | dict(shapes))


def _memory(motion: GivenMotion, force: Force, shapes: Mapping[str, Any], count: int) -> dict[str, Array]:
    """Return memory that depends on no state, (sample, column), for `count` values of the shapes."""
    tau, start = motion.reversals, _start_of(motion, force, shapes)
    held = {k: np.empty((1 + tau.size, count)) for k in force.memory}
    for k, values in held.items():
        values[0] = start[k]
    given = motion.names(tau) | {"v": np.zeros(tau.size)}
    for i in range(tau.size):
        here = {k: value[i] for k, value in (given | held).items()} | dict(shapes)
        for k, formula in force.memory.items():
            held[k][i + 1] = formula.evaluate(here)
    segment = np.searchsorted(tau, motion.tau)
    return {k: values[segment] for k, values in held.items()}


def _stepped_value(
    motion: GivenMotion, force: Force, shapes: Mapping[str, Any], memory: Mapping[str, Array]
) -> Array:
    """Return the force at the samples, with its states integrated from sample to sample."""
    # A step lies between two reversals, except the one that contains a reversal; there the new memory
    # applies.
    names = motion.at_stages | dict(shapes) | {k: m[1:] for k, m in memory.items()}
    start, step, states = _start_of(motion, force, shapes), np.diff(motion.tau), {}
    if force.state:
        follow = _single if len(force.state) == 1 else _triangular
        states = dict(zip(force.state, follow(force, step, names, start), strict=True))
    here = motion.at_samples | dict(shapes) | dict(memory) | states
    return np.broadcast_to(force.formula.evaluate(here), motion.tau.shape)


def _single(force: Force, step: Array, names: Names, start: Mapping[str, float]) -> Array:
    """Compute a single state, (1, sample), directly or by Newton's iteration along the whole motion."""
    ((name, rate),) = force.state.items()

    def change_and_pull(stages: Any) -> tuple[Array, Array]:
        value, slope = rate.with_derivative({**names, name: stages}, name)
        return step * np.broadcast_to(value, (2, step.size)), step * slope

    if rate.order_in(name) <= 1.0:
        return _radau_steps(start[name], *change_and_pull(0.0))[0][None]
    stages = np.full((2, step.size), start[name])
    change, pull = change_and_pull(stages)
    for _ in range(MAX_NEWTON):
        state, new = _radau_steps(start[name], change - pull * stages, pull)
        linear, slope = change + pull * (new - stages), 1.0 + np.abs(pull)
        stages, (change, pull) = new, change_and_pull(new)
        rest = np.sum(np.abs(change - linear) / slope, axis=-1).max()
        if rest <= NEWTON_TOLERANCE * np.abs(new).max():
            return state[None]
        if not np.isfinite(rest):
            break
    return np.full((1, step.size + 1), np.nan)


def _triangular(force: Force, step: Array, names: Names, start: Mapping[str, float]) -> Array:
    """Return states with constant coefficients, (state, sample).

    Schur's form is triangular: the last state is solved by itself, and drives those before it. Unlike
    eigenvectors it exists for two equal eigenvalues, as at critical damping.
    """
    rates, count = force.state, step.size
    rest: dict[str, Any] = {**names, **dict.fromkeys(rates, 0.0)}
    here = {k: np.ravel(value)[0] for k, value in rest.items()}
    jacobian = np.array([[f.derivative(here, k) for k in rates] for f in rates.values()])
    if not np.all(np.isfinite(jacobian)):
        return np.full((len(rates), count + 1), np.nan)
    triangle, vectors = schur(jacobian, output="complex")
    inverse = vectors.conj().T
    forcing = np.stack([np.broadcast_to(f.evaluate(rest), (2, count)) for f in rates.values()])
    # For so few states sums are faster than matrix products.
    forcing = np.stack([sum(c * part for c, part in zip(row, forcing, strict=True)) for row in inverse])
    first = inverse @ [start[k] for k in rates]
    states, stages = np.zeros((len(rates), count + 1), complex), np.zeros_like(forcing)
    # Equal steps have equal effects. Relative differences of this size are rounding errors of equal steps.
    step = np.asarray(np.mean(step)) if np.ptp(step) <= 1e-9 * abs(step[0]) else step
    for i in reversed(range(len(rates))):
        length = step * _stretch(step * triangle[i, i])
        driven = forcing[i] + sum(triangle[i, j] * stages[j] for j in range(i + 1, len(rates)))
        states[i], stages[i] = _radau_steps(first[i], length * driven, length * triangle[i, i])
    return np.asarray((vectors @ states).real)


def _stretch(pull: Array) -> Array:
    """Return the factor by which a step is stretched so that y' = pull y gives exp(pull) exactly.

    Such nonstandard steps (Mickens 1994) keep the frequency and the damping of every resonance. Radau's own
    steps damp it by abs(pull)**4 / 72 each, and are better where a step is too long to resolve the decay.
    """
    end = np.exp(pull)
    # Radau's factor (1 + q / 3) / (1 - 2 q / 3 + q**2 / 6) is exp(pull): the root q that vanishes with pull.
    root = 6.0 * np.expm1(pull) / (1.0 + 2.0 * end + np.sqrt(1.0 + (10.0 - 2.0 * end) * end))
    fine = (pull != 0.0) & (np.abs(pull) < 1.0)
    return np.asarray(np.where(fine, root / np.where(fine, pull, 1.0), 1.0))


def _radau_steps(start: complex, forcing: Array, pull: Array) -> tuple[Array, Array]:
    """Return y at the samples and at the stages, (stage, step), where step times rate is push + pull y.

    `forcing` : (stage, step); `pull` : (stage, step), (step,), or one for all.
    """
    (a, b), (c, d) = RADAU_WEIGHTS
    early, late = pull if np.ndim(pull) == 2 else (pull, pull)
    first, second = a * forcing[0] + b * forcing[1], c * forcing[0] + d * forcing[1]
    # The rate of each stage contains both values: two equations in two values; the second ends the step.
    diagonal, below = 1.0 - a * early, c * early
    determinant = diagonal * (1.0 - d * late) - b * late * below
    factor = (diagonal + below) / determinant
    added = (diagonal * second + below * first) / determinant
    # y[n + 1] - factor[n] y[n] = added[n]
    band = np.ones((2, added.size + 1), added.dtype)
    band[1, :-1] = -factor
    solve = TRIANGULAR_SOLVERS[band.dtype.char]
    y = np.asarray(solve(band, np.append(start, added)[:, None], uplo="L", diag="U")[0][:, 0])
    return y, np.stack([(y[:-1] + first + b * late * y[1:]) / diagonal, y[1:]])
