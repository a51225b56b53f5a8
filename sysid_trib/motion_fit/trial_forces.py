"""Accelerations that depend on angle, speed, amplitude or time, as columns of a record about its path."""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Legendre, legendre

from sysid_trib.arrays import Array
from sysid_trib.motion_fit.kalman import LinearModel

# Degrees in the amplitude of the resonant harmonic, and of the others (the mean force is of order zero).
RESONANT_DEGREES = 3
OTHER_DEGREES = 2
HARMONICS = (2, 3)
# Of the amplitude over time.
TREND_DEGREE = 5
# Steps longer than this (rad of tau) are gaps: no path is known within them.
LONGEST_STEP = 1.6
# Of the diffusion of a free step: below it friction holds the body, and no force moves it.
HELD = 1e-9


@dataclass(frozen=True)
class TrialForces:
    """Accelerations along a path, and what they do within each step.

    Attributes
    ----------
    by_column : (step, 2, column) array of float
        What each adds to x and v by the end of a step.
    stiffness : (step, 2, 1) array of float
        The same of the acceleration -x: as a change of the frequency does, but what pushes the motion within
        a step has no part in it.
    on : (column,) array of str
        What each depends on: `angle` in phase with the angle (a stiffness), `speed` in phase with the speed
        (a friction), `time` at the same amplitude.
    """

    by_column: Array
    stiffness: Array
    on: Array


def trial_forces(linear: LinearModel, tau: Array) -> TrialForces:
    """Harmonics of the motion's phase times polynomials of its amplitude, the resonant one drifting too.

    Parameters
    ----------
    linear : LinearModel
        About the path, x = a cos(phase), v = -a sin(phase).
    tau : (sample,) array of float
        Instants, reference frequency times time.

    Notes
    -----
    A force f(x, v) of a motion that decays is such a series, its Fourier series on the cycle: the describing
    function is its resonant part. What acts within a step is Simpson's mean, moved on by the free oscillator.
    """
    step = np.diff(tau)
    # The motion from each sample without the push of the step: with it, columns would hold what they explain.
    first, last = _polar(linear.path[:-1]), _polar(linear.steps.end)
    last[0] = first[0] + (last[0] - first[0] + np.pi) % (2.0 * np.pi) - np.pi
    # A slow trend stands for the amplitude: its wander is what the random force has made.
    trend = Legendre.fit(tau[:-1], first[1], TREND_DEGREE)
    span = trend(tau).min(), trend(tau).max()

    def at(polar: Array, when: Array) -> tuple[Array, list[str]]:
        return _series(polar, _scaled(trend(when), span), _scaled(when, (tau[0], tau[-1])))

    start, on = at(first, tau[:-1])
    middle, _ = at(0.5 * (first + last), 0.5 * (tau[:-1] + tau[1:]))
    end, _ = at(last, tau[1:])
    weight = step[:, None] / 6.0
    by_x = weight * (np.sin(step)[:, None] * start + 4.0 * np.sin(0.5 * step)[:, None] * middle)
    by_v = weight * (np.cos(step)[:, None] * start + 4.0 * np.cos(0.5 * step)[:, None] * middle + end)
    moves = linear.steps.diffusion[:, 1, 1] > HELD * step
    by_column = np.stack([by_x, by_v], axis=1) * (moves & (step < LONGEST_STEP))[:, None, None]
    return TrialForces(by_column, -by_column[:, :, :1], np.array(on))


def _polar(states: Array) -> Array:
    """Phase and amplitude of states, (2, state)."""
    return np.stack([np.arctan2(-states[:, 1], states[:, 0]), np.hypot(states[:, 0], states[:, 1])])


def _series(polar: Array, size: Array, elapsed: Array) -> tuple[Array, list[str]]:
    """The accelerations at some instants, (instant, column), and what each depends on.

    `polar` holds phase and amplitude; `size` and `elapsed` are amplitude and time from -1 to 1.
    """
    phase, amplitude = polar
    degrees = legendre.legvander(size, RESONANT_DEGREES - 1).T
    cosine, sine = amplitude * np.cos(phase), amplitude * np.sin(phase)
    columns = [(part * degree, on) for degree in degrees for part, on in ((cosine, "angle"), (sine, "speed"))]
    columns += [(part * elapsed, "time") for part in (cosine, sine)]
    for degree in degrees[:OTHER_DEGREES]:
        columns.append((degree, "angle"))
        for m in HARMONICS:
            columns += [(degree * np.cos(m * phase), "angle"), (degree * np.sin(m * phase), "speed")]
    values, on = zip(*columns, strict=True)
    return np.stack(values, axis=1), list(on)


def _scaled(values: Array, limits: tuple[float, float]) -> Array:
    """From -1 at the lower limit to 1 at the upper."""
    low, high = limits
    return (2.0 * values - low - high) / max(high - low, 1e-12 * max(1.0, abs(high)))
