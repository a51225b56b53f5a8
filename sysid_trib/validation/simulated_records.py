"""Records drawn from an identified model: its motion, what a random force adds, and noise of the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.noise.random_force import random_force_of
from sysid_trib.results.per_run import noise_of_run
from sysid_trib.results.schema import model_of
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.state_space.wander import wander
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion

# Samples a period for the statistics of the difference: more would cost time and change nothing.
SAMPLES_PER_PERIOD = 60


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
    wander : (draw, sample) array of float, rad, or None
        What a random force adds in each draw.
    """

    time: Array
    angle: Array
    noise: float
    wander: Array | None = None

    def record(self, random: np.random.Generator, draw: int | None) -> xr.Dataset:
        """The record of a draw; without noise where that is None."""
        noise = self.noise * random.standard_normal(len(self.angle))
        angle = self.angle + (0.0 if draw is None else 1.0) * noise
        if self.wander is not None and draw is not None:
            angle = angle + self.wander[draw]
        return xr.Dataset({"angle": ("time", angle)}, {"time": self.time})


def simulated_runs(
    runs: Sequence[xr.Dataset],
    result: xr.Dataset,
    motions: Sequence[FittedMotion],
    *,
    draws: int,
    seed: int,
) -> list[SimulatedRun]:
    """Motion, noise and wander of an identified model in each run; with fewer samples, of less noise.

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
    pushes = np.random.default_rng([seed, 1])
    for at, (run, motion) in enumerate(zip(runs, motions, strict=True)):
        time, noise = run.time.values.astype(float), noise_of_run(result, at)
        most = int(SAMPLES_PER_PERIOD * (time[-1] - time[0]) / period) + 2
        if len(time) > most:
            noise *= np.sqrt(most / len(time))
            time = np.linspace(time[0], time[-1], most)
        free, force = trajectory(model, time, motion.angle, motion.rate), random_force_of(result, at)
        per_tau = force.per_tau(model.reference_frequency)
        pushed = wander(model, time, free, per_tau, pushes, draws) if force else None
        simulated.append(SimulatedRun(time, free.angle, noise, pushed))
    return simulated
