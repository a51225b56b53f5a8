"""What moves a model besides its forces: a known input, and random kicks."""

from dataclasses import dataclass

import numpy as np

from sysid_trib.errors import SimulationError
from sysid_trib.records.inputs import KnownInput
from sysid_trib.simulation.equations import Vector
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.program import PUSH_NUMBERS

# Kicks a period of a motion that is pushed at random: their law is then right to a percent.
KICKS_PER_PERIOD = 40


@dataclass(frozen=True)
class Pushes:
    """What moves a model besides its forces, in tau.

    Attributes
    ----------
    knots : (knot,) array of float
        Increasing, the first at the start.
    polynomials : (knot, PUSH_NUMBERS) array of float
        From each knot on, an acceleration over w^2 (rad), by powers of tau since it.
    kicks : (knot, 2) array of float
        What is added to x and v there, but at the start.
    """

    knots: Vector
    polynomials: Vector
    kicks: Vector


UNPUSHED = Pushes(np.empty(0), np.zeros((0, PUSH_NUMBERS)), np.zeros((0, 2)))


def pushes_of(model: Model, tau: Vector, random_force: float = 0.0, seed: int = 0) -> Pushes:
    """What pushes a model: its known input, exact between its samples, and a random force.

    Parameters
    ----------
    model : Model
    tau : (sample,) array of float
        w t from 0.
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of the acceleration; at least `KICKS_PER_PERIOD` a period make it.
    seed : int

    Notes
    -----
    Over an interval h of tau a white acceleration adds to (x, v) a Gaussian vector of covariance
    per_tau [[h^3/3, h^2/2], [h^2/2, h]] to lowest order in h; per_tau = density/(2 w^3).
    """
    known, w = model.known_input, model.reference_frequency
    if known is None and not random_force:
        return UNPUSHED
    if len(tau) < 2:
        raise SimulationError("A motion that is pushed wants two or more times that increase.")
    knots = _instants(tau, KICKS_PER_PERIOD) if random_force else tau[[0, -1]]
    kicks = np.zeros((len(knots), 2))
    if random_force:
        kicks[1:] = _kicks(np.diff(knots), 0.5 * random_force / w**3, seed)
    if known is None:
        return Pushes(knots, polynomials_of(None, knots, w), kicks)
    bends = w * known.elapsed
    instants = np.union1d(knots, bends[(bends > tau[0]) & (bends < tau[-1])])
    all_kicks = np.zeros((len(instants), 2))
    all_kicks[np.searchsorted(instants, knots)] = kicks
    return Pushes(instants, polynomials_of(known, instants, w), all_kicks)


def polynomials_of(known: KnownInput | None, knots: Vector, frequency: float) -> Vector:
    """A known input over w^2 (rad) from each knot (tau) on, by powers of tau since it, (knot, power)."""
    polynomials = np.zeros((len(knots), PUSH_NUMBERS))
    if known is not None:
        given = known.polynomials(knots, frequency)
        polynomials[:, : given.shape[1]] = given
    return polynomials


def _instants(tau: Vector, per_period: int) -> Vector:
    """Where a step ends: at the samples, and between them at so many a period."""
    parts = np.maximum(1, np.ceil(np.diff(tau) * per_period / (2.0 * np.pi))).astype(int)
    fractions = np.concatenate([np.arange(count) / count for count in parts])
    return np.append(tau[:-1].repeat(parts) + fractions * np.diff(tau).repeat(parts), tau[-1])


def _kicks(h: Vector, per_tau: float, seed: int) -> Vector:
    """What a random force adds to x and v by the end of each step, (step, 2)."""
    # A stream of its own: noise that is added with the same seed is independent of it.
    random = np.random.default_rng([seed, 1]).standard_normal((2, len(h)))
    kick_v = np.sqrt(per_tau * h) * random[0]
    # Of the variance h^3/3 of x three quarters are by what v gains, a quarter is its own.
    kick_x = 0.5 * h * kick_v + np.sqrt(per_tau * h**3 / 12.0) * random[1]
    return np.stack([kick_x, kick_v], axis=1)
