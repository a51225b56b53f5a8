"""The part of a motion that a spline is too coarse for: where forces switch or turn within a sample."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid_trib.arrays import Array


@dataclass(frozen=True)
class FineMotion:
    """A motion from rest whose acceleration is constant within cells.

    Attributes
    ----------
    tau : (cell,) array of float
        Where each begins, increasing; the last has no end.
    acceleration : (cell,) array of float, rad
        Second derivative by tau.
    """

    tau: Array
    acceleration: Array

    @cached_property
    def _at_begin(self) -> tuple[Array, Array]:
        """Motion and its derivative where each cell begins, (cell,) each."""
        steps, bend = np.diff(self.tau), self.acceleration[:-1]
        speed = np.concatenate([[0.0], np.cumsum(bend * steps)])
        place = np.concatenate([[0.0], np.cumsum(speed[:-1] * steps + 0.5 * bend * steps**2)])
        return place, speed

    def value(self, tau: Array, order: int = 0) -> Array:
        """The motion or its derivative, (point,), rad; as it begins before the first cell."""
        if not len(self.tau):
            return np.zeros(len(tau))
        cell = np.clip(np.searchsorted(self.tau, tau, side="right") - 1, 0, None)
        since, bend = tau - self.tau[cell], self.acceleration[cell]
        place, speed = (values[cell] for values in self._at_begin)
        return np.asarray(speed + bend * since if order else place + speed * since + 0.5 * bend * since**2)

    def rescaled(self, part: float) -> "FineMotion":
        """The same over a time that runs faster by `part`."""
        return FineMotion(part * self.tau, self.acceleration / part**2)


NO_FINE_MOTION = FineMotion(np.empty(0), np.empty(0))


def fine_motion(tau: Array, acceleration: Array) -> FineMotion:
    """Motion of accelerations that are the means of cells about points, (point,) each."""
    return FineMotion(np.concatenate([tau[:1], 0.5 * (tau[1:] + tau[:-1])]), acceleration)
