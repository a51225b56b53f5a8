"""Motion of a model at given times, driven by its inputs and by a random force, without labels."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid_trib.errors import SimulationError
from sysid_trib.simulation.model import Model, Vector
from sysid_trib.simulation.motions import STEPS_A_PERIOD, Forcing, SimulatedMotion, integrate
from sysid_trib.simulation.program import FORCING_NUMBERS
from sysid_trib.simulation.under_way import STATE_PART


def trajectory(
    model: Model,
    time: Vector,
    angle: float = 0.3,
    rate: float = 0.0,
    *,
    by: Sequence[str] = (),
    most_steps: int = STEPS_A_PERIOD,
    accuracy: float = STATE_PART,
) -> SimulatedMotion:
    """Simulate without labels, which is faster for repeated use (see `simulate`).

    Parameters
    ----------
    model, time, angle, rate
        See `simulate`.
    by : sequence of str
        Parameters of the derivatives: symbols of forces, `dahl.s`, and the names in `integrate`.
    most_steps : int
        Largest number of steps per period; a stiff state may need thousands.
    accuracy : float
        See `integrate`.

    Returns
    -------
    SimulatedMotion

    Notes
    -----
    Repeated calls may change coefficients, shapes and frequency of the same forces without a new program.
    Forces with coefficient zero remain in the model: their states and memory are computed.
    """
    tau, w = checked_start(model, time, angle, rate), model.reference_frequency
    forcing = forcing_of(model, tau)
    motion = integrate(
        model, tau, (angle, rate / w), by=by, forcing=forcing, most_steps=most_steps, accuracy=accuracy
    )
    return replace(motion, start=float(time[0]))


def checked_start(model: Model, time: Vector, angle: float, rate: float) -> Vector:
    """Return the times of a simulation as w t from the first; raise an error if it cannot start."""
    if time.ndim != 1 or not len(time) or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0.0):
        raise SimulationError(
            "The times of a simulation must be finite and increase; sort them, drop repeats."
        )
    if not (np.isfinite(angle) and np.isfinite(rate)):
        raise SimulationError(f"A motion cannot start from angle {angle} rad and rate {rate} rad/s.")
    return model.reference_frequency * (time - float(time[0]))


# Number of impulses per period of a motion with a random force: their distribution is correct to a percent.
INCREMENTS_PER_PERIOD = 40


def forcing_of(model: Model, tau: Vector, random_force: float = 0.0, seed: int = 0) -> Forcing | None:
    """Return the forcing of a model: its inputs, exact between their samples, and a random force.

    Parameters
    ----------
    model : Model
    tau : (sample,) array of float
        w t from 0.
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of the acceleration; it consists of at least `INCREMENTS_PER_PERIOD` impulses per
        period.
    seed : int

    Notes
    -----
    Over an interval h of tau, a white acceleration adds to (x, v) a Gaussian vector of covariance per_tau
    [[h^3/3, h^2/2], [h^2/2, h]] to lowest order in h; per_tau = density/(2 w^3).
    """
    w = model.reference_frequency
    if not random_force and not any(channel.input in model.inputs for channel in model.driven):
        return None
    if len(tau) < 2:
        raise SimulationError("A motion with a random force needs two or more increasing times.")
    ends, added = tau[:1], np.zeros((1, 2))
    if random_force:
        ends, added = _impulses(tau, 0.5 * random_force / w**3, seed)
    bends = w * bends_of(model)
    knots = np.union1d(ends, bends[(bends > tau[0]) & (bends < tau[-1])])
    increments = np.zeros((len(knots), 2))
    increments[np.searchsorted(knots, ends)] = added
    return Forcing(knots, polynomials_of(model, knots), increments)


def _impulses(tau: Vector, per_tau: float, seed: int) -> tuple[Vector, Vector]:
    """Return times at and between the samples, and the increments of x and v due to a random force."""
    parts = np.maximum(1, np.ceil(np.diff(tau) * INCREMENTS_PER_PERIOD / (2.0 * np.pi))).astype(int)
    fractions = np.concatenate([np.arange(count) / count for count in parts])
    instants = np.append(tau[:-1].repeat(parts) + fractions * np.diff(tau).repeat(parts), tau[-1])
    h = np.diff(instants)
    # Use a separate random stream: noise that is added with the same seed is independent of it.
    of_v, of_x = np.random.default_rng([seed, 1]).standard_normal((2, len(h)))
    increment_v = np.sqrt(per_tau * h) * of_v
    # Three quarters of the variance h^3/3 of x are due to the gain of v, a quarter is independent.
    increment_x = 0.5 * h * increment_v + np.sqrt(per_tau * h**3 / 12.0) * of_x
    # No increment at the start, and none at the end, where it has no effect.
    added = np.pad(np.stack([increment_x, increment_v], axis=1), ((1, 0), (0, 0)))
    return instants[:-1], added[:-1]


def bends_of(model: Model) -> Vector:
    """Return the times at which an input changes its polynomial, (knot,), s."""
    names = {channel.input for channel in model.driven} & {*model.inputs}
    return np.unique(np.concatenate([*(model.inputs[name].bends for name in names), []]))


def polynomials_of(model: Model, knots: Vector) -> Vector:
    """Return the inputs after each knot (tau) as polynomials in tau since then, (knot, channel, power)."""
    w, channels = model.reference_frequency, model.driven
    polynomials = np.zeros((len(knots), len(channels), FORCING_NUMBERS))
    for at, channel in enumerate(channels):
        if channel.input in model.inputs:
            given = model.inputs[channel.input].polynomials(knots, w, channel.order)
            polynomials[:, at, : given.shape[1]] = given / w**channel.power
    powers = np.flatnonzero(polynomials.any(axis=(0, 1)))
    return polynomials[:, :, : powers.max(initial=0) + 1]
