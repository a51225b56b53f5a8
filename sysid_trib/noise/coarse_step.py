"""A sensor whose step is coarse beside its noise and the motion: what rounding leaves is not white."""

from collections.abc import Iterator

import numpy as np
import xarray as xr
from numpy.polynomial.legendre import legvander

from sysid_trib.arrays import Array
from sysid_trib.noise.sensor_step import sensor_step

# Motions that are rounded to know what rounding leaves.
ROUNDED_MOTIONS = 40
# Degree of the polynomials in time by which slow noise changes amplitude and phase.
SLOW_DEGREE = 7


def coarse_step(decay: xr.Dataset, noise: float) -> float:
    """Step of a sensor whose rounding shows; 0 where it is as good as white noise, or was integrated.

    Parameters
    ----------
    decay : Dataset
        `angle(time)`.
    noise : float, rad
        Of a sample.

    Notes
    -----
    Rounding is white noise where other noise, or the motion from one sample to the next, is of the size of a
    step (Widrow and Kollar 2008). It shows where it is the larger part of the noise, and most samples are
    within a step of the last.
    """
    if int(decay.attrs.get("integrations", 0)):
        return 0.0
    signal = decay.angle.values.astype(float)
    # Most values of a fine sensor differ from the last by more than what their spacing could be.
    if not np.any(np.diff(signal) == 0.0):
        return 0.0
    step = sensor_step(signal)
    rounds = step**2 / 12.0 > noise**2 / 2.0
    slow = np.median(np.abs(np.diff(signal))) < 1.5 * step
    return float(step) if rounds and slow else 0.0


def rounded_noise(motion: Array, step: float, noise: float) -> Iterator[Array]:
    """What rounding and the rest of the noise leave of a motion, (sample,), `ROUNDED_MOTIONS` times.

    The zero of the sensor lies anywhere between two of its steps.
    """
    random = np.random.default_rng(0)
    rest = np.sqrt(max(0.0, noise**2 - step**2 / 12.0))
    for _ in range(ROUNDED_MOTIONS):
        exact = motion + random.uniform(-0.5, 0.5) * step
        yield step * np.round((exact + rest * random.standard_normal(len(motion))) / step) - exact


class SlowPart:
    """The part of noise that changes amplitude and phase of a motion (x, v) little by little."""

    def __init__(self, x: Array, v: Array) -> None:
        polynomials = legvander(np.linspace(-1.0, 1.0, len(x)), SLOW_DEGREE)
        size = np.maximum(np.hypot(x, v), 1e-300)
        self.columns = np.hstack([polynomials * (part / size)[:, None] for part in (x, v)])
        self.products = self.columns.T @ self.columns

    @property
    def numbers(self) -> int:
        """How many numbers describe it."""
        return len(self.products)

    def square(self, noise: Array) -> float:
        """Sum of its squares: of white noise of one, a chi square of `numbers`."""
        moments = self.columns.T @ noise
        return float(moments @ np.linalg.lstsq(self.products, moments, rcond=1e-10)[0])
