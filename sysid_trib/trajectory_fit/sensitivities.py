"""How a small force moves a motion: variation of constants along the model's own motion.

With the fundamental matrix Phi of small deviations, a force -h of unit strength moves the state by
``Phi(tau) int Phi^-1 (0, -h) dtau``: two cumulative sums for each force, whatever their number.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import FAST, trajectory

# The motion is followed at so many points a period: sums over them are exact to 1e-4 for smooth forces, and
# to one in so many for forces that switch.
POINTS_PER_PERIOD = 150
# Starts are moved by this part of the swing, both ways.
REACH = 1e-6


@dataclass(frozen=True)
class Tangent:
    """A motion and its small deviations, on points between the samples too.

    Attributes
    ----------
    time : s, from the first sample; tau : w t; x, v : rad; (point,) each.
    fundamental : (point, 2, 2), derivative of (x, v) by (x, v) at the start.
    every : points from one sample to the next; samples : number of samples in the record. The points end at
        the stop, if there is one.
    """

    time: Array
    tau: Array
    x: Array
    v: Array
    fundamental: Array
    every: int
    samples: int

    @property
    def phase(self) -> Array:
        """phi with x = a cos phi, v = -a sin phi (rad), not unwrapped."""
        return np.arctan2(-self.v, self.x)

    @property
    def amplitude(self) -> Array:
        """Distance from the equilibrium in the phase plane (rad)."""
        return np.hypot(self.x, self.v)

    def at_samples(self, values: Array) -> Array:
        """Values at the record's samples, (sample, ...); after the stop the last one holds."""
        found = values[:: self.every]
        lost = self.samples - len(found)
        return found if lost <= 0 else np.concatenate([found, np.repeat(found[-1:], lost, axis=0)])


def tangent(model: Model, time: Array, angle: float, rate: float) -> Tangent:
    """Follow a motion and its small deviations.

    Parameters
    ----------
    time : (sample,) s; angle, rate : start, rad and rad/s.

    Raises
    ------
    SimulationError
        The motion cannot be computed.
    DecayError
        It stops at once.
    """
    w = model.reference_frequency
    step = float(np.median(np.diff(time)))
    every = max(1, int(np.ceil(POINTS_PER_PERIOD * w * step / (2.0 * np.pi))))
    count = (len(time) - 1) * every + 1
    points = np.interp(np.arange(count) / every, np.arange(len(time)), time)
    motion = trajectory(model, points, angle, rate, engine=FAST)
    if np.isfinite(motion.stop_time):
        count = int(np.searchsorted(points, motion.stop_time))
    if count < 2 * every:
        raise DecayError("The model's motion stops at once; no force can be told from it.")
    size = float(np.max(np.abs(motion.position)))
    columns = []
    for unit in np.array([[REACH * size, 0.0], [0.0, REACH * size * w]]):
        ahead, behind = (
            trajectory(model, points, angle + s * unit[0], rate + s * unit[1], engine=FAST)
            for s in (1.0, -1.0)
        )
        columns.append(
            np.stack([ahead.position - behind.position, (ahead.rate - behind.rate) / w], axis=1)
            / (2.0 * REACH * size)
        )
    x, v = motion.position[:count], motion.rate[:count] / w
    since = points[:count] - points[0]
    return Tangent(since, w * since, x, v, np.stack(columns, axis=2)[:count], every, len(time))


def responses(about: Tangent, forces: Array) -> Array:
    """Derivative of the angle by the coefficient of each force, (sample, force).

    `forces` : (point, force), their values along the motion.
    """
    a, b = about.fundamental[:, 0, 0], about.fundamental[:, 0, 1]
    c, d = about.fundamental[:, 1, 0], about.fundamental[:, 1, 1]
    inverse = 1.0 / (a * d - b * c)
    left = cumulative_trapezoid(forces * (b * inverse)[:, None], about.tau, axis=0, initial=0.0)
    right = cumulative_trapezoid(forces * (-a * inverse)[:, None], about.tau, axis=0, initial=0.0)
    return about.at_samples(a[:, None] * left + b[:, None] * right)
