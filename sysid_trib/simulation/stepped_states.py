"""Internal states of a force along a motion that is given: by the compiled engine, or by linear steps.

The force itself does not act: what pushes the engine's body is what leads it along the given path.

One state may have any rate: its whole course is linearised, and where the rate is not linear solved again
until it settles. Several states follow one after another where their rates are linear with constant
coefficients. Either way each is a scalar recurrence, a triangular banded system.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import get_lapack_funcs, schur

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError, SimulationError
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues
from sysid_trib.forces.formulas import Formula, Names, parse
from sysid_trib.simulation.forcing import UNFORCED, Forcing
from sysid_trib.simulation.integrate import integrate
from sysid_trib.simulation.model import Model

NO_FORCE = parse("0", frozenset(), frozenset(), "no force")
# rad/s; at such a frequency `t` stands still, whatever the length of the motion.
FROZEN = 1e300


def watched(force: Force, shapes: ShapeValues | None, frequency: float) -> Model:
    """A model in which a force has its history and does not act; `t` counts tau over this frequency."""
    idle = replace(force, formula=NO_FORCE, kind="force")
    values = {f"{force.symbol}.{k}": value for k, value in force.shape_values(shapes).items()}
    return Model(ForceLibrary("watched", (idle,)), {force.symbol: 0.0}, frequency, values)


def begun_with(force: Force, values: Mapping[str, float]) -> Force:
    """A force that begins with these states and memory."""
    nothing = frozenset[str]()
    starts = {name: parse(repr(value), nothing, nothing, force.symbol) for name, value in values.items()}
    return replace(force, start=starts)


def leading(tau: Array, x: Array, v: Array) -> Forcing:
    """What leads a body without forces along the cubics through angles and rates (Hermite), from tau = 0."""
    h, rise = np.diff(tau), np.diff(x)
    square = (3.0 * rise / h - 2.0 * v[:-1] - v[1:]) / h
    cube = (v[:-1] + v[1:] - 2.0 * rise / h) / h**2
    # x'' + x of each cubic.
    forcing = np.stack([x[:-1] + 2.0 * square, v[:-1] + 6.0 * cube, square, cube], axis=1)
    return Forcing(tau[:-1] - tau[0], forcing[:, None], np.zeros((len(h), 2)), forced=True)


def history_along(
    force: Force, tau: Array, x: Array, v: Array, shapes: ShapeValues | None, elapsed: Array
) -> dict[str, Array]:
    """States and memory of a force along a given motion.

    Parameters
    ----------
    force : Force
        One that depends on history; its `t` counts from the first sample.
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau; between samples a cubic.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`.
    elapsed : (sample,) array of float, s
        The `t` of formulas, in proportion to tau from the first sample on, or at rest.

    Returns
    -------
    dict of str to (sample,) array
        By their names in the force.

    Raises
    ------
    LibraryError
        They are not finite along this motion, or cannot be followed.
    """
    span = float(elapsed[-1] - elapsed[0])
    frequency = float(tau[-1] - tau[0]) / span if span > 0.0 else FROZEN
    model = watched(force, shapes, frequency)
    return _of(force, model, tau - tau[0], (float(x[0]), float(v[0])), leading(tau, x, v))


def history_on_cycle(force: Force, phase: Array, a: float, shapes: ShapeValues | None) -> dict[str, Array]:
    """States along x = a cos phi, v = -a sin phi, (phase,) in order, with `t` at rest."""
    start = a * float(np.cos(phase[0])), -a * float(np.sin(phase[0]))
    return _of(force, watched(force, shapes, FROZEN), phase - phase[0], start, UNFORCED)


def _of(
    force: Force, model: Model, grid: Array, start: tuple[float, float], forcing: Forcing
) -> dict[str, Array]:
    try:
        motion = integrate(model, grid, start, forcing=forcing)
    except SimulationError:
        raise LibraryError(
            f"Force '{force.symbol}': its states could not be followed along the motion."
        ) from None
    if not all(np.all(np.isfinite(values)) for values in motion.hidden.values()):
        raise LibraryError(f"Force '{force.symbol}': its states or memory are not finite along the motion.")
    return {name.removeprefix(f"{force.symbol}."): values for name, values in motion.hidden.items()}


# Radau's method of order 3 (Hairer and Wanner 1996, IV.5): stages at a third and at the end of a step. It is
# stiffly accurate: a state that follows at once is followed.
RADAU_STAGES = (1.0 / 3.0, 1.0)
RADAU_WEIGHTS = ((5.0 / 12.0, -1.0 / 12.0), (3.0 / 4.0, 1.0 / 4.0))
# Newton's iteration ends where what is not linear moves the state by less than this part of its size; the
# steps themselves are not as good.
NEWTON_TOLERANCE, MAX_NEWTON = 1e-6, 60
# LAPACK's, of banded triangular systems of real and of complex numbers.
TRIANGULAR_SOLVERS = {kind: get_lapack_funcs("tbtrs", dtype=kind) for kind in "dD"}


@lru_cache(maxsize=1024)
def is_stepped(force: Force) -> bool:
    """True if `stepped_states` can follow a force, by its formulas.

    It has no memory that depends on a state, and one state, or several with constant coefficients.
    """
    if any(f.names & set(force.state) for f in force.memory.values()):
        return False
    return len(force.state) < 2 or _slopes_are_constant(force, [*force.state.values()], [*force.state])


@lru_cache(maxsize=1024)
def is_linear(force: Force) -> bool:
    """True if a force follows the motion as springs and dashpots do: in proportion, constant coefficients."""
    formulas, names = [force.formula, *force.state.values()], ["x", "v", "t", *force.state]
    at_rest = force.test_points | dict.fromkeys(names, 0.0)
    with np.errstate(all="ignore"):
        values = [formula.evaluate(at_rest) for formula in (*formulas, *force.start.values())]
    vanishes = all(np.all(value == 0.0) for value in values)
    return not force.memory and vanishes and _slopes_are_constant(force, formulas, names)


def _slopes_are_constant(force: Force, formulas: Sequence[Formula], names: Sequence[str]) -> bool:
    with np.errstate(all="ignore"):
        slopes = [formula.derivative(force.test_points, name) for formula in formulas for name in names]
    return all(np.allclose(slope, np.ravel(slope)[0], rtol=1e-9, atol=1e-12) for slope in slopes)


def stepped_states(force: Force, step: Array, names: Names, start: Mapping[str, float]) -> dict[str, Array]:
    """States of a force at the samples of a motion.

    Parameters
    ----------
    force : Force
        One that `is_stepped`.
    step : (step,) array of float
        Differences of tau.
    names : mapping of str to array of float
        x, v, t and memory at the stages of each step, (stage, step); shape parameters.
    start : mapping of str to float
        First value of each state.

    Returns
    -------
    dict of str to (sample,) array
        Not finite where the states could not be followed.
    """
    if not force.state:
        return {}
    with np.errstate(all="ignore"):
        states = (_single if len(force.state) == 1 else _triangular)(force, step, names, start)
    return dict(zip(force.state, states, strict=True))


def _single(force: Force, step: Array, names: Names, start: Mapping[str, float]) -> Array:
    """The only state, (1, sample): in one go, or by Newton's iteration on its whole course."""
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
    """States with constant coefficients, (state, sample).

    Schur's form is triangular, so that the last follows alone and each other one is driven by those after it;
    unlike eigenvectors it serves where two eigenvalues are equal, as at critical damping.
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
    # Of so few states sums are faster than products of matrices.
    forcing = np.stack([sum(c * part for c, part in zip(row, forcing, strict=True)) for row in inverse])
    first = inverse @ [start[k] for k in rates]
    states, stages = np.zeros((len(rates), count + 1), complex), np.zeros_like(forcing)
    # Where all steps are alike, so is what each does.
    # Steps that differ by no more than this part of themselves differ by rounding.
    step = np.asarray(np.mean(step)) if np.ptp(step) <= 1e-9 * abs(step[0]) else step
    for i in reversed(range(len(rates))):
        length = step * _stretch(step * triangle[i, i])
        driven = forcing[i] + sum(triangle[i, j] * stages[j] for j in range(i + 1, len(rates)))
        states[i], stages[i] = _radau_steps(first[i], length * driven, length * triangle[i, i])
    return np.asarray((vectors @ states).real)


def _stretch(pull: Array) -> Array:
    """What a step is to be multiplied by, so that y' = pull y is multiplied by exp(pull) exactly.

    Such nonstandard steps (Mickens 1994) keep the frequency and the damping of every resonance; Radau's own
    damp it by abs(pull)**4 / 72 at each step. Where a step is too long to resolve the decay they are better.
    """
    end = np.exp(pull)
    # Radau's factor (1 + q / 3) / (1 - 2 q / 3 + q**2 / 6) is exp(pull): the root q that vanishes with pull.
    root = 6.0 * np.expm1(pull) / (1.0 + 2.0 * end + np.sqrt(1.0 + (10.0 - 2.0 * end) * end))
    fine = (pull != 0.0) & (np.abs(pull) < 1.0)
    return np.asarray(np.where(fine, root / np.where(fine, pull, 1.0), 1.0))


def _radau_steps(start: complex, forcing: Array, pull: Array) -> tuple[Array, Array]:
    """y at the samples and, (stage, step), at the stages, where step times rate is push + pull y.

    `forcing` : (stage, step); `pull` : (stage, step), (step,), or one for all.
    """
    (a, b), (c, d) = RADAU_WEIGHTS
    early, late = pull if np.ndim(pull) == 2 else (pull, pull)
    first, second = a * forcing[0] + b * forcing[1], c * forcing[0] + d * forcing[1]
    # The rates of both stages hold both: two equations in two values, of which the second ends the step.
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
