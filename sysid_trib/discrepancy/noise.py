"""Noise of a record whose model is not known: what no slowly changing oscillation can follow."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from sysid_trib.coloured_noise import autoregression, whitened
from sysid_trib.decays.half_sines import usable_half_periods
from sysid_trib.regression.weak_form import build_weak_form, smooth

Array = NDArray[np.float64]

# Harmonics of the motion that any force may leave, each with an amplitude that changes over so many periods.
HARMONICS = 6
PERIODS_PER_KNOT = 4.0
DEGREE = 3


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

    The order of the autoregression is by the Bayesian information criterion.
    """
    left = residual - basis @ (basis.T @ residual)
    filter_ = autoregression(left)
    white = whitened(left, filter_)
    freedom = max(1, len(white) - basis.shape[1])
    return Noise(float(np.sqrt(white @ white / freedom)), filter_)
