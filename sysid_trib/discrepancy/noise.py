"""Noise of a record whose model is not known: what no slowly changing oscillation can follow."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from sysid_trib.coloured_noise import autoregression_of
from sysid_trib.decays.half_sines import usable_half_periods
from sysid_trib.regression.weak_form import build_weak_form, smooth

Array = NDArray[np.float64]

# Harmonics of the motion that any force may leave, each with an amplitude that changes over so many periods.
HARMONICS = 6
PERIODS_PER_KNOT = 4.0
DEGREE = 3
# Lines of the spectrum that keep less than this part of the noise are taken from this many neighbours.
KEPT = 0.3
WIDE = 15


@dataclass(frozen=True)
class Noise:
    """Noise of one run.

    Attributes
    ----------
    level : standard deviation of the innovations, rad; `filter_` : (order + 1,) whitens it, [1] if white.
    """

    level: float
    filter_: Array

    @property
    def order(self) -> int:
        """Order of the autoregression, 0 if white."""
        return len(self.filter_) - 1


def oscillations(decay: xr.Dataset) -> Array:
    """Slowly changing harmonics of the motion, orthonormal, (sample, column).

    Phase and frequency are the record's own, so that no model is needed.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    halves = usable_half_periods(time, angle, str(decay.attrs.get("source", "decay")))
    frequency = float(np.pi / np.median(halves.duration))
    tau = frequency * (time - time[0])
    x, v, _, _ = smooth(build_weak_form(tau), angle)
    phase = np.unwrap(np.arctan2(-v, x))
    knots = max(1, round((tau[-1] - tau[0]) / (2.0 * np.pi * PERIODS_PER_KNOT)))
    # As many columns as the record can bear.
    knots = min(knots, max(1, len(time) // (8 * (2 * HARMONICS + 1))))
    inner = np.linspace(tau[0], tau[-1], knots + 1)
    sequence = np.concatenate([np.full(DEGREE, tau[0]), inner, np.full(DEGREE, tau[-1])])
    slow = BSpline.design_matrix(tau, sequence, DEGREE).toarray()
    columns = [slow]
    for m in range(1, HARMONICS + 1):
        columns += [slow * np.cos(m * phase)[:, None], slow * np.sin(m * phase)[:, None]]
    basis, _ = np.linalg.qr(np.concatenate(columns, axis=1))
    return np.asarray(basis)


def noise_of(residual: Array, basis: Array) -> Noise:
    """Level and colour of what a residual has beside slowly changing oscillations (rad).

    Taking the oscillations out leaves gaps in the spectrum: each line is divided by the part of white noise
    that it keeps, and where it keeps little its neighbours stand in for it. The order of the autoregression
    is by the Bayesian information criterion.
    """
    n = len(residual)
    left = residual - basis @ (basis.T @ residual)
    power = np.abs(np.fft.rfft(left)) ** 2 / n
    kept = 1.0 - np.sum(np.abs(np.fft.rfft(basis, axis=0)) ** 2, axis=1) / n
    good = kept > KEPT
    good[0] = False
    if not good.any():
        return Noise(float(np.sqrt(left @ left / max(1, n - basis.shape[1]))), np.ones(1))
    lines = np.arange(len(power))
    # Neighbours on both sides, averaged: a single line scatters as much as it is high.
    near = np.convolve(np.where(good, power / np.where(good, kept, 1.0), 0.0), np.ones(WIDE), "same")
    near /= np.maximum(np.convolve(good.astype(float), np.ones(WIDE), "same"), 1e-9)
    usable = np.convolve(good.astype(float), np.ones(WIDE), "same") > 0.5
    filled = np.interp(lines, lines[usable], near[usable])
    spectrum = np.where(good, power / np.where(good, kept, 1.0), filled)
    covariance = np.fft.irfft(spectrum, n)[: n // 2]
    filter_, variance = autoregression_of(covariance, n)
    return Noise(float(np.sqrt(variance)), filter_)
