"""Records drawn from an identified model: its motion, what a random force adds, and noise of the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.linearised import Derivatives, linearised_along
from sysid_trib.results.schema import model_of
from sysid_trib.results.variables import noise_of_run
from sysid_trib.simulation.initial_conditions import FittedMotion
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.motions import SimulatedMotion
from sysid_trib.simulation.simulate import trajectory


def random_walk(
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
    linear = linearised_along(model, time, motion, Derivatives((), frequency=False))
    return random_walk_about(linear, per_tau, normal, draws).T


def random_walk_about(linear: LinearModel, per_tau: float, normal: np.random.Generator, draws: int) -> Array:
    """Draw what a random force of this size adds to a record about its path, (sample, draw)."""
    variance, axes = np.linalg.eigh(per_tau * linear.steps.diffusion)
    # A part that friction holds has no variance; rounding makes it negative.
    root = axes * np.sqrt(np.maximum(variance, 0.0))[:, None, :]
    samples, size = linear.path.shape
    source = np.zeros((samples, size, draws))
    source[1:] = root @ normal.standard_normal((samples - 1, size, draws))
    deviations = linear.recursion(np.zeros((samples, size)), source)
    return np.asarray(np.einsum("na,nad->nd", linear.observed, deviations))


@dataclass(frozen=True)
class SimulatedRun:
    """A run of a known model, from which records are drawn.

    Attributes
    ----------
    time : (sample,) array of float, s
    angle : (sample,) array of float, rad
        The model's motion.
    noise : float, rad
        Standard deviation of a sample.
    random_walk : (draw, sample) array of float, rad, or None
        What a random force adds in each draw.
    """

    time: Array
    angle: Array
    noise: float
    random_walk: Array | None = None

    def record(self, random: np.random.Generator, draw: int | None) -> xr.Dataset:
        """The record of a draw; without noise where that is None."""
        noise = self.noise * random.standard_normal(len(self.angle))
        angle = self.angle + (0.0 if draw is None else 1.0) * noise
        if self.random_walk is not None and draw is not None:
            angle = angle + self.random_walk[draw]
        return xr.Dataset({"angle": ("time", angle)}, {"time": self.time})


def simulated_runs(
    runs: Sequence[xr.Dataset], result: xr.Dataset, motions: Sequence[FittedMotion], *, draws: int, seed: int
) -> list[SimulatedRun]:
    """Motion, noise and random walk of an identified model in each run; with fewer samples, of less noise.

    Parameters
    ----------
    runs : sequence of Dataset
        `angle(time)`, whose times are taken.
    result : Dataset
        The identification.
    motions : sequence of FittedMotion
        Of its model, in each run.
    draws, seed : int
        Number of draws, and the seed of the random force in them.

    Raises
    ------
    SimulationError
        The motion of the model cannot be computed.
    """
    model, simulated = model_of(result), []
    period = 2.0 * np.pi / result.asymptotic_frequency.item()
    # A stream of its own: the sensor's noise is the same with a random force and without.
    forcing = np.random.default_rng([seed, 1])
    for at, (run, motion) in enumerate(zip(runs, motions, strict=True)):
        time, noise = run.time.values.astype(float), noise_of_run(result, at)
        # Samples a period for the statistics of the difference: more would cost time and change nothing.
        most = int(60 * (time[-1] - time[0]) / period) + 2
        if len(time) > most:
            noise *= np.sqrt(most / len(time))
            time = np.linspace(time[0], time[-1], most)
        free, force = trajectory(model, time, motion.angle, motion.rate), random_force_of(result, at)
        per_tau = force.per_tau(model.reference_frequency)
        stochastic = random_walk(model, time, free, per_tau, forcing, draws) if force else None
        simulated.append(SimulatedRun(time, free.angle, noise, stochastic))
    return simulated
