"""How far a random force lets a motion wander: linear response to white acceleration, many draws at once."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulated_motion import SimulatedMotion
from sysid_trib.state_space.kalman import LinearModel
from sysid_trib.state_space.linearised import Derivatives, linearised_about


def wander(
    model: Model,
    time: Array,
    motion: SimulatedMotion,
    per_tau: float,
    normal: np.random.Generator,
    draws: int,
) -> Array:
    """Draw what a random force adds to the angle of a free motion.

    Parameters
    ----------
    model : Model
    time : (sample,) array of float, s
    motion : SimulatedMotion
        The model's free motion at these times.
    per_tau : float, rad^2
        Growth of the variance of v in a unit of tau (see `RandomForce.per_tau`).
    normal : Generator
    draws : int

    Returns
    -------
    (draw, sample) array of float, rad

    Raises
    ------
    SimulationError
        The motion between two samples cannot be computed.

    Notes
    -----
    Deviations obey z[k+1] = F[k] z[k] + e[k] with the transitions F of the exact steps and the covariance
    per_tau D[k] of e[k]: the linear model of the filter, computed once for all draws.
    """
    path = np.stack(
        [motion.position, motion.rate / model.reference_frequency, *motion.hidden.values()], axis=1
    )
    at_start = np.array([motion.position[0], motion.rate[0], 0.0])
    linear = linearised_about(model, time, motion.angle, path, at_start, Derivatives((), frequency=False))
    return wander_about(linear, per_tau, normal, draws).T


def wander_about(linear: LinearModel, per_tau: float, normal: np.random.Generator, draws: int) -> Array:
    """Draw what a random force of this size adds to a record about its path, (sample, draw)."""
    variance, axes = np.linalg.eigh(per_tau * linear.steps.diffusion)
    # A part that friction holds has no variance; rounding makes it negative.
    root = axes * np.sqrt(np.maximum(variance, 0.0))[:, None, :]
    samples, size = linear.path.shape
    source = np.zeros((samples, size, draws))
    source[1:] = root @ normal.standard_normal((samples - 1, size, draws))
    deviations = linear.recursion(np.zeros((samples, size)), source)
    return np.asarray(np.einsum("na,nad->nd", linear.observed, deviations))
