"""Motion of a model that is pushed, by a known input or at random: step by step, exact in each."""

from functools import cache

import numpy as np

from sysid_trib.errors import SimulationError
from sysid_trib.forces.force import Force
from sysid_trib.forces.formulas import parse
from sysid_trib.simulation.engines import engine_of, has_heyoka
from sysid_trib.simulation.equations import Vector
from sysid_trib.simulation.integrate import integrate
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulated_motion import SimulatedMotion, shown

# Kicks a period of a motion that is pushed at random: their law is then right to a percent.
KICKS_PER_PERIOD = 40


@cache
def input_forces() -> tuple[Force, Force]:
    """A constant and one in proportion to time: their coefficients, set in each interval, make the input."""
    names = frozenset("xvt")
    constant, slope = (parse(text, names, frozenset(), "known input") for text in ("1", "t"))
    return Force("known input", "known input", constant), Force("its slope", "slope of the input", slope)


def stepped_trajectory(
    model: Model, time: Vector, start: tuple[float, float], random_force: float = 0.0, seed: int = 0
) -> SimulatedMotion:
    """Motion of a model that is pushed: exact from step to step of a known input, and between random kicks.

    Parameters
    ----------
    model : Model
    time : (sample,) array of float, s
    start : (float, float), rad and rad/s
        Angle and rate at time[0].
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of the acceleration; at least `KICKS_PER_PERIOD` a period make it.
    seed : int

    Returns
    -------
    SimulatedMotion
        What pushes may move a body that friction holds: it never stops for good.

    Notes
    -----
    Over an interval h of tau a white acceleration adds to (x, v) a Gaussian vector of covariance
    per_tau [[h^3/3, h^2/2], [h^2/2, h]] to lowest order in h; per_tau = density/(2 w^3).
    """
    w = model.reference_frequency
    if time.ndim != 1 or len(time) < 2 or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0.0):
        raise SimulationError("A motion that is pushed wants two or more times that increase.")
    tau = w * (time - time[0])
    instants = _instants(model, tau, KICKS_PER_PERIOD if random_force else 0)
    forces = model.forces if model.known_input is None else (*model.forces, *input_forces())
    engine = "heyoka" if has_heyoka() else "scipy"
    compiled = engine_of(engine, forces, 1e-12)
    y, p = compiled.motion.start(model, start[0], start[1] / w)
    pushes = _known_pushes(model, instants)
    kicks = _kicks(np.diff(instants), 0.5 * random_force / w**3, seed)
    rows, paths = [y], []
    with compiled.lock:
        for at in range(len(instants) - 1):
            p[len(model.forces) : len(forces)] = pushes[at]
            path = integrate(compiled, y, p, instants[at : at + 2])
            y = path.y[-1].copy()
            y[:2] += kicks[at]
            rows.append(y)
            paths.append(path)
    samples = np.searchsorted(instants, tau)
    states = np.array(rows)[samples]
    hidden = {
        name: np.array([q.hidden[name][-1] for q in (paths[0], *paths)])[samples] for name in paths[0].hidden
    }
    x, v = states[:, 0], states[:, 1]
    angle = shown(model, x, v, time - time[0])
    return SimulatedMotion(angle, x, w * v, float("nan"), np.empty(0), hidden, engine)


def _instants(model: Model, tau: Vector, per_period: int) -> Vector:
    """Where a step ends: at the samples, between them at so many a period, where a known input bends."""
    parts = np.maximum(1, np.ceil(np.diff(tau) * per_period / (2.0 * np.pi))).astype(int)
    fractions = np.concatenate([np.arange(count) / count for count in parts])
    instants = np.append(tau[:-1].repeat(parts) + fractions * np.diff(tau).repeat(parts), tau[-1])
    if model.known_input is None:
        return instants
    bends = model.reference_frequency * model.known_input.elapsed
    return np.union1d(instants, bends[(bends > tau[0]) & (bends < tau[-1])])


def _known_pushes(model: Model, instants: Vector) -> Vector:
    """Coefficients of `input_forces` in each step, (step, 2); of none without a known input."""
    if model.known_input is None:
        return np.empty((len(instants) - 1, 0))
    w = model.reference_frequency
    at, elapsed = model.known_input.over_stiffness(instants, w), instants / w
    slope = np.diff(at) / np.diff(elapsed)
    # A force stands on the left side of the equation.
    return -np.stack([at[:-1] - slope * elapsed[:-1], slope], axis=1)


def _kicks(h: Vector, per_tau: float, seed: int) -> Vector:
    """What a random force adds to x and v by the end of each step, (step, 2)."""
    if not per_tau:
        return np.zeros((len(h), 2))
    # A stream of its own: noise that is added with the same seed is independent of it.
    random = np.random.default_rng([seed, 1]).standard_normal((2, len(h)))
    kick_v = np.sqrt(per_tau * h) * random[0]
    # Of the variance h^3/3 of x three quarters are by what v gains, a quarter is its own.
    kick_x = 0.5 * h * kick_v + np.sqrt(per_tau * h**3 / 12.0) * random[1]
    return np.stack([kick_x, kick_v], axis=1)
