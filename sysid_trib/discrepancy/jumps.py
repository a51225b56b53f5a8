"""Jumps of the acceleration along a path: where dry friction turns, a spline alone would turn late."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize.elementwise import find_root

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.trials import TrialEffect

# Part of the motion's speed by which the states just before and just after a surface differ from it.
ASIDE = 1e-6
# Part of the distance of two points to which a crossing between them is found.
CROSSING = 1e-7


@dataclass(frozen=True)
class Jumps:
    """A motion whose acceleration is constant but for jumps.

    Attributes
    ----------
    tau : (jump,) array of float
        Increasing.
    size : (jump,) array of float, rad
        By which the second derivative rises at each.
    """

    tau: Array
    size: Array

    def value(self, tau: Array, order: int = 0) -> Array:
        """The motion, or a derivative: at rest until the first jump, (point,), rad."""
        if not len(self.tau):
            return np.zeros(len(tau))
        rise = np.cumsum(self.size)
        steps = np.diff(self.tau)
        speed = np.concatenate([[0.0], np.cumsum(rise[:-1] * steps)])
        place = np.concatenate([[0.0], np.cumsum(speed[:-1] * steps + 0.5 * rise[:-1] * steps**2)])
        last = np.searchsorted(self.tau, tau, side="right") - 1
        since = np.where(last >= 0, tau - self.tau[last], 0.0)
        acceleration = np.where(last >= 0, rise[last], 0.0)
        if order == 2:
            return acceleration
        speeds = np.where(last >= 0, speed[last], 0.0)
        if order == 1:
            return speeds + acceleration * since
        return np.where(last >= 0, place[last], 0.0) + speeds * since + 0.5 * acceleration * since**2


NO_JUMPS = Jumps(np.empty(0), np.empty(0))


def jumps_along(
    tau: Array,
    motion: Callable[[Array, int], Array],
    elapsed: Callable[[Array], Array],
    trials: Sequence[TrialEffect],
    coefficients: Array,
    known: tuple[Array, Array, Array],
) -> Jumps:
    """Jumps that forces give a motion where it crosses their switching surfaces.

    Parameters
    ----------
    tau : (point,) array of float
        Between which no surface is crossed twice.
    motion : callable
        The motion or a derivative, of tau and order.
    elapsed : callable
        The `t` of formulas, s, of tau.
    trials : sequence of TrialEffect
    coefficients : (trial,) array of float
        Of each trial; forces with states or memory do not jump.
    known : tuple of (point,) array of float
        Motion, its derivative and the `t` of formulas at the points.
    """
    switching = [
        (trial, float(c))
        for trial, c in zip(trials, coefficients, strict=True)
        if trial.force.kind == "force" and trial.force.memoryless and trial.force.surfaces
    ]
    # Many forces switch with the same speed: each surface is followed once.
    surfaces = {key: surface for trial, _ in switching for key, surface in trial.surfaces().items()}

    def along(surface: Callable[[Array, Array, Array], Array]) -> Callable[[Array], Array]:
        return lambda at: surface(motion(at, 0), motion(at, 1), elapsed(at))

    places = [_crossings(tau, surface(*known), along(surface)) for surface in surfaces.values()]
    crossed = np.unique(np.concatenate(places)) if places else np.empty(0)
    if not len(crossed):
        return NO_JUMPS
    x, v, a = (motion(crossed, order) for order in range(3))
    time, size = elapsed(crossed), np.zeros(len(crossed))
    for trial, c in switching:
        after, before = (
            trial.force.value(x + side * v, v + side * a, time, shapes=trial.shapes)
            for side in (ASIDE, -ASIDE)
        )
        size -= c * (after - before)
    return Jumps(crossed, size)


def _crossings(tau: Array, values: Array, surface: Callable[[Array], Array]) -> Array:
    """Where a surface along a motion has its zeros, (crossing,), by its values at points."""
    at = np.flatnonzero(np.diff(np.sign(values)) != 0.0)
    # In brackets: the jump of another round may bend the motion between two points, which misleads secants.
    tolerances = {"xatol": CROSSING * float(np.max(np.diff(tau)))}
    return np.asarray(find_root(surface, (tau[at], tau[at + 1]), tolerances=tolerances).x)
