"""Steady motion under a harmonic drive: describing functions of all forces, amplitudes where they balance it.

x = a cos phi, phi = W t + theta, r = W/w. What forces average to over that cycle balances a drive f cos W t,
to first order (Krylov and Bogoliubov; Nayfeh and Mook 1979, section 4.1):

    a (1 - r^2) + 2 <h cos phi> = f cos theta,    -2 <h sin phi> = -f sin theta.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import Force, ShapeValues

# Amplitudes between which a balance is looked for; the least one is so small a part of what the drive would
# do at rest.
AMPLITUDES_TRIED, LEAST_TRIED = 400, 1e-3
# A force whose dependence on the frequency is no power is averaged at so many, a polynomial between them.
NODES = 5
# Newton's steps to an amplitude, and the part of it over which slopes are taken.
NEWTON_STEPS, SLOPE_PART = 4, 1e-6


class Balance(NamedTuple):
    """Steady motions, (motion,) each.

    Number of the frequency, amplitude, theta (rad), whether it is stable, and the amplitude by lines between
    those of the grid.
    """

    frequency: Index
    amplitude: Array
    phase: Array
    stable: Mask
    by_lines: Array


@dataclass(frozen=True)
class DescribingFunctions:
    """Averages of forces over a cycle, at some frequencies.

    Parameters
    ----------
    forces : sequence of Force
    shapes : mapping of str to float
    ratio : (frequency,) array of float
        W/w, increasing.
    """

    forces: Sequence[Force]
    shapes: ShapeValues
    ratio: Array

    @cached_property
    def _parts(self) -> list[tuple[list[Force], Array]]:
        """Forces that act at some ratios of frequencies, and their weights at each, (frequency, node)."""
        parts = []
        for force in self.forces:
            power = force.speed_degree if force.memoryless else None
            if power is not None:
                parts.append(([force], self.ratio[:, None] ** power))
                continue
            middle, half = float(np.mean(self.ratio[[0, -1]])), 0.5 * float(np.ptp(self.ratio))
            nodes, weights = np.array([middle]), np.ones((len(self.ratio), 1))
            if half:
                nodes = middle + half * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
                weights = np.asarray(BarycentricInterpolator(nodes, np.eye(NODES))(self.ratio))
            parts.append(([_at_rate(force, node) for node in nodes.tolist()], weights))
        return parts

    def over(self, amplitude: Array) -> Array:
        """2 <h sin phi> and 2 <h cos phi> of each force, (force, 2, frequency, amplitude)."""
        return self._sums(amplitude, "fn,nka->kfa", np.arange(len(self.ratio)))

    def at(self, frequency: Index, amplitude: Array) -> Array:
        """Describing functions at amplitudes, each at the frequency of a number, (force, 2, amplitude)."""
        return self._sums(amplitude, "an,nka->ka", frequency)

    def _sums(self, amplitude: Array, how: str, frequency: Index) -> Array:
        sums = []
        for nodes, weights in self._parts:
            means = np.array([averages(force, amplitude, self.shapes) for force in nodes])
            sums.append(2.0 * np.einsum(how, weights[frequency], means))
        return np.array(sums)

    def grid(self, coefficients: Array, drive: Array) -> Array:
        """Amplitudes between which every balance is, (amplitude,), by the drive's sizes (frequency,).

        Raises
        ------
        DecayError
            Nothing bounds the response.
        """
        top = 4.0 * float(np.max(drive))
        for _ in range(40):
            sine, cosine = np.einsum("i,ikfa->kfa", coefficients, self.over(np.array([top])))[:, :, 0]
            along = top * (1.0 - self.ratio**2) + cosine
            if np.all(np.abs(sine) > drive) or np.all(np.hypot(along, sine) > 4.0 * drive):
                return np.geomspace(LEAST_TRIED * float(np.min(drive)), top, AMPLITUDES_TRIED)
            top *= 2.0
        raise DecayError("No damping bounds this response; a model with a force that damps has one.")

    def balances(self, coefficients: Array, drive: Array, amplitude: Array) -> Balance:
        """The steady motions, by coefficients (force,), a complex drive (frequency,) and the grid."""
        over_grid = excess(self.over(amplitude), coefficients, self.ratio, drive, amplitude)
        frequency, guess = crossings(over_grid, amplitude)

        def sums(a: Array) -> tuple[Array, Array]:
            sine, cosine = np.einsum("i,ika->ka", coefficients, self.at(frequency, a))
            return sine, a * (1.0 - self.ratio[frequency] ** 2) + cosine

        def surplus(a: Array) -> Array:
            sine, along = sums(a)
            return np.asarray(along**2 + sine**2 - np.abs(drive[frequency]) ** 2)

        def slope(of: Array, further: Array, a: Array) -> Array:
            return np.asarray((further - of) / (2.0 * SLOPE_PART * a))

        a, spacing = guess, amplitude[1] / amplitude[0]
        for _ in range(NEWTON_STEPS):
            rise = slope(surplus(a * (1.0 - SLOPE_PART)), surplus(a * (1.0 + SLOPE_PART)), a)
            step = np.divide(surplus(a), rise, out=np.zeros_like(a), where=rise != 0.0)
            a = np.clip(a - step, guess / spacing, guess * spacing)
        sine, along = sums(a)
        rise = slope(surplus(a * (1.0 - SLOPE_PART)), surplus(a * (1.0 + SLOPE_PART)), a)
        # Of the averaged equations: a determinant that is not negative, and damping of small deviations.
        damping = slope(sums(a * (1.0 - SLOPE_PART))[0], sums(a * (1.0 + SLOPE_PART))[0], a) + sine / a
        phase = np.angle(drive[frequency]) - np.angle(along - 1j * sine)
        phase = np.angle(np.exp(1j * phase))
        return Balance(frequency, a, phase, (rise > 0.0) & (damping < 0.0), guess)


def excess(sums: Array, coefficients: Array, ratio: Array, drive: Array, amplitude: Array) -> Array:
    """What the square of the forces exceeds that of the drive by, (frequency, amplitude)."""
    sine, cosine = np.einsum("i,ikfa->kfa", coefficients, sums)
    along = amplitude * (1.0 - ratio[:, None] ** 2) + cosine
    return np.asarray(along**2 + sine**2 - np.abs(drive[:, None]) ** 2)


def crossings(values: Array, amplitude: Array) -> tuple[Index, Array]:
    """Rows and amplitudes where values (row, amplitude) change sign, by lines between those of the grid."""
    row, at = np.nonzero(np.signbit(values[:, :-1]) != np.signbit(values[:, 1:]))
    low, high = values[row, at], values[row, at + 1]
    return row, amplitude[at] + (amplitude[at + 1] - amplitude[at]) * low / (low - high)


def sweeps(count: int, frequency: Index, amplitude: Array, stable: Mask) -> Index:
    """Numbers of the motions in a sweep up, in one down, and of an unstable one, (3, frequency); -1 of none.

    A sweep begins with the smallest stable motion, and goes on with the nearest one.
    """
    of_each = np.split(np.arange(len(frequency)), np.searchsorted(frequency, np.arange(1, count)))
    chosen = np.full((3, count), -1)
    for row, order in enumerate((range(count), range(count - 1, -1, -1))):
        before = 0.0
        for at in order:
            there = of_each[at][stable[of_each[at]]]
            if len(there):
                chosen[row, at] = there[np.argmin(np.abs(amplitude[there] - before))]
                before = amplitude[chosen[row, at]]
    for at, every in enumerate(of_each):
        if len(unstable := every[~stable[every]]):
            chosen[2, at] = unstable[-1]
    return chosen


def picked(values: Array, numbers: Index) -> Array:
    """Values (motion,) by their numbers, nan where that is -1."""
    return np.asarray(np.append(values, np.nan)[numbers])


def _at_rate(force: Force, ratio: float) -> Force:
    """The force with a time that runs faster: its v is `ratio` times that of the cycle."""
    faster = f"{ratio!r}*v"
    return replace(
        force,
        formula=force.formula.with_instead("v", faster),
        state={name: formula.with_instead("v", faster, ratio) for name, formula in force.state.items()},
        memory={name: formula.with_instead("v", faster) for name, formula in force.memory.items()},
    )
