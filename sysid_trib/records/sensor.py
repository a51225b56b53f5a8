"""Step of a sensor, and its rounding error if the step is coarse compared with noise and motion."""

from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr
from numpy.polynomial.legendre import legvander

from sysid_trib.arrays import Array

# Largest number of values and of candidate steps that are tested.
MOST_VALUES = 20_000
# Largest spacing that counts, in steps: beyond it the step itself is too uncertain.
MOST_STEPS = 20.0
# Distance from a whole number of steps that counts as rounding, and the fraction of spacings it must explain.
# By chance it explains a fifth.
ROUNDED = 0.1


def sensor_step(signal: Array) -> float:
    """Return the largest spacing that explains the values of a sensor.

    Parameters
    ----------
    signal : (sample,) array of float
        Signal as it was measured, in any unit.

    Returns
    -------
    float
        Step in the unit of the signal; nan for values that lie on no lattice.

    Notes
    -----
    Repeated values are tested first: if the record was interpolated to a uniform clock, only they come from
    the sensor. A step divides nearly all spacings between neighbouring values.
    """
    held = np.unique(signal[1:][np.diff(signal) == 0.0])
    every = np.unique(signal)
    # If values repeat twenty times on average, two spacings are enough.
    fewest = 12 if 20 * every.size > signal.size else 2
    for values in (held, every):
        step = _lattice(values, fewest)
        if np.isfinite(step):
            return step
    return float("nan")


def _lattice(values: Array, fewest: int) -> float:
    """Return the largest spacing that explains sorted values; nan if none does."""
    first = max(0, (values.size - MOST_VALUES) // 2)
    values = values[first : first + MOST_VALUES]
    spacing = np.diff(values)
    # Below this fraction of the range, two values are equal up to rounding.
    spacing = np.sort(spacing[spacing > 1e-12 * np.ptp(values)]) if values.size > 1 else spacing
    if spacing.size < fewest:
        return float("nan")
    shortest = spacing[np.linspace(0, spacing.size - 1, min(200, spacing.size)).astype(int)]
    # Neighbours may never be one step apart, but two and three steps.
    for step in np.sort(np.concatenate([shortest, shortest / 2.0, shortest / 3.0]))[::-1]:
        if _explains(step, spacing, fewest):
            count = np.round(spacing / step)
            near = (count > 0.0) & (count <= MOST_STEPS)
            return float(np.median(spacing[near] / count[near]))
    return float("nan")


def _explains(step: float, spacing: Array, fewest: int) -> bool:
    count = spacing[: np.searchsorted(spacing, MOST_STEPS * step)] / step
    whole = np.abs(count - np.round(count)) < ROUNDED
    return count.size >= fewest and bool(np.mean(whole & (count > ROUNDED)) >= 0.9)


# Number of motions that are rounded to simulate the rounding error.
ROUNDED_MOTIONS = 40


def coarse_step(decay: xr.Dataset, noise: float) -> float:
    """Return the sensor's step if its rounding is not like white noise; 0 otherwise, or if integrated.

    Parameters
    ----------
    decay : Dataset
        `angle(time)`.
    noise : float, rad
        Noise of a sample.

    Notes
    -----
    Rounding is white noise if other noise, or the motion from one sample to the next, has the size of a step
    (Widrow and Kollar 2008). It is not if it is the larger part of the noise, and most samples are within a
    step of the last one.
    """
    if int(decay.attrs.get("integrations", 0)):
        return 0.0
    signal = decay.angle.values.astype(float)
    # Most values of a fine sensor differ from the last by more than the largest possible spacing.
    if not np.any(np.diff(signal) == 0.0):
        return 0.0
    step = sensor_step(signal)
    rounds = step**2 / 12.0 > noise**2 / 2.0
    slow = np.median(np.abs(np.diff(signal))) < 1.5 * step
    return float(step) if rounds and slow else 0.0


def rounded_noise(motion: Array, step: float, noise: float) -> Iterator[Array]:
    """Yield the error of a rounded, noisy record of a motion, (sample,), `ROUNDED_MOTIONS` times.

    The zero of the sensor is drawn at random between two of its steps.
    """
    random = np.random.default_rng(0)
    rest = np.sqrt(max(0.0, noise**2 - step**2 / 12.0))
    for _ in range(ROUNDED_MOTIONS):
        exact = motion + random.uniform(-0.5, 0.5) * step
        yield step * np.round((exact + rest * random.standard_normal(len(motion))) / step) - exact


def slow_part(x: Array, v: Array) -> tuple[int, Callable[[Array], float]]:
    """Return the part of noise that slowly changes amplitude and phase of a motion (x, v).

    Return the number of parameters of this part, and the function that gives its sum of squares from noise:
    for white noise of unit variance, a chi-square with this number of degrees of freedom.
    """
    # Degree of the polynomials in time by which slow noise changes amplitude and phase.
    polynomials = legvander(np.linspace(-1.0, 1.0, len(x)), 7)
    size = np.maximum(np.hypot(x, v), 1e-300)
    columns = np.hstack([polynomials * (part / size)[:, None] for part in (x, v)])
    products = columns.T @ columns

    def square(noise: Array) -> float:
        moments = columns.T @ noise
        return float(moments @ np.linalg.lstsq(products, moments, rcond=1e-10)[0])

    return len(products), square
