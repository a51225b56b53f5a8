"""Noise of a record whose model is not known: what slowly modulated harmonics of the motion do not follow."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.interpolate import BSpline
from scipy.ndimage import binary_dilation, median_filter
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.signal.windows import tukey

from sysid_trib.arrays import Array, Mask
from sysid_trib.noise.autoregression import (
    MAX_ORDER,
    autoregression_of,
    fractional_difference,
    memory_samples,
    warm_up_samples,
)
from sysid_trib.noise.level import swing_frequency
from sysid_trib.noise.smoothing import clamped_knots, smooth

# Harmonics of the motion that any force may leave, each with an amplitude that changes over so many periods.
NOISE_HARMONICS = 6
PERIODS_PER_KNOT = 4.0
ENVELOPE_DEGREE = 3
# Lines of the spectrum that keep less than this part of the noise are taken from this many neighbours.
KEPT_PART = 0.3
WIDE = 15
# A line beside a gap so many times the median of those apart is not noise: one in 250 is that high.
BESIDE = 8.0
# Part of the record over which it is tapered, at both ends together.
TAPER = 0.2
# A line so many times the median of its neighbours is vibration: one in 2^14 lines of noise is that high.
LINE = 14.0
LINES = 4
# The d of noise whose spectrum rises to low frequencies as 1/f^(2 d): white, 1/f noise is 0.5, a walk is 1.
FRACTIONAL_ORDERS = np.linspace(0.0, 1.0, 21)
# What the criterion must gain by a power law: very strong evidence (Kass and Raftery 1995).
WORTH = 10.0


@dataclass(frozen=True)
class NoiseModel:
    """Noise of one run.

    Attributes
    ----------
    innovation : float, rad
        Standard deviation of the innovations.
    filter_ : (tap,) array of float
        Whitens the noise; [1] if it is white.
    """

    innovation: float
    filter_: Array

    @property
    def warm_up(self) -> int:
        """First samples that cannot be whitened."""
        return warm_up_samples(self.filter_)

    @property
    def standard_deviation(self) -> float:
        """Standard deviation of a sample, rad."""
        # Lines of a record: 1/f noise has more the longer it lasts.
        lines = len(self.filter_) if self.warm_up < len(self.filter_) - 1 else 4096
        power = np.abs(np.fft.rfft(self.filter_, lines)[1:]) ** 2
        return self.innovation * float(np.sqrt(np.mean(1.0 / power)))

    def of_every(self, step: int, samples: int) -> "NoiseModel":
        """The noise of every `step`-th sample, of so many that are kept: again taken as an autoregression."""
        if step == 1 or len(self.filter_) == 1:
            return self
        lags = step * MAX_ORDER + 1
        # The autocovariance of the series of innovations' responses, long enough to have died away.
        response = lfilter([1.0], self.filter_, np.eye(1, lags + 2 * memory_samples(self.filter_))[0])
        size = len(response)
        covariance = np.array([response[lag:] @ response[: size - lag] for lag in range(0, lags, step)])
        filter_, variance = autoregression_of(covariance, samples)
        return NoiseModel(self.innovation * float(np.sqrt(variance)), filter_)

    def draws(self, samples: int, count: int) -> Array:
        """Realisations of such noise, (count, samples), rad, of mean zero; always the same."""
        lines = np.fft.rfft(np.random.default_rng(0).standard_normal((count, samples)))
        response = np.fft.rfft(self.filter_, samples)
        # A walk has no mean to come back to.
        lines[:, 0], response[0] = 0.0, 1.0
        return np.asarray(np.fft.irfft(self.innovation * lines / response, samples))


def modulated_harmonics(decay: xr.Dataset) -> Array:
    """Orthonormal basis of slowly modulated harmonics of a motion.

    Parameters
    ----------
    decay : Dataset
        With `angle(time)`. Phase and frequency are the record's own, so that no model is needed.

    Returns
    -------
    (sample, column) array of float
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    tau = swing_frequency(decay) * (time - time[0])
    x, v, _, _ = smooth(tau, angle)
    phase = np.unwrap(np.arctan2(-v, x))
    knots = max(1, round((tau[-1] - tau[0]) / (2.0 * np.pi * PERIODS_PER_KNOT)))
    # As many columns as the record can bear.
    knots = min(knots, max(1, len(time) // (8 * (2 * NOISE_HARMONICS + 1))))
    slow = BSpline.design_matrix(tau, clamped_knots(tau, knots, ENVELOPE_DEGREE), ENVELOPE_DEGREE).toarray()
    columns = [slow]
    for m in range(1, NOISE_HARMONICS + 1):
        columns += [slow * np.cos(m * phase)[:, None], slow * np.sin(m * phase)[:, None]]
    basis, _ = np.linalg.qr(np.concatenate(columns, axis=1))
    return np.asarray(basis)


def estimate_noise(residual: Array, basis: Array, lines: int = LINES) -> NoiseModel:
    """Level and colour of the noise in a residual.

    Parameters
    ----------
    residual : (sample,) array of float, rad
    basis : (sample, column) array of float
        Slowly modulated harmonics, which are no noise (see `modulated_harmonics`).
    lines : int
        So many lines of the spectrum at most are taken for vibration, which is no noise either.

    Returns
    -------
    NoiseModel

    Notes
    -----
    Projecting the harmonics out leaves gaps in the spectrum: each line is divided by the part of white noise
    that it keeps, and where it keeps little its neighbours replace it.

    An autoregression, its order by the Bayesian information criterion, of noise of which, where the lines ask
    for it, a power law 1/f^(2 d) is taken first (Granger and Joyeux 1980; Hosking 1981): an autoregression
    cannot follow noise that rises towards frequencies far below the swing's, where slow effects are sought.
    The exponent is by the same criterion, with Whittle's likelihood.
    """
    n = len(residual)
    remainder = residual - basis @ (basis.T @ residual)
    # Without a taper a strong line that dies away would leak into all others.
    taper = tukey(n, TAPER)
    whole = float(taper @ taper)
    power = np.abs(np.fft.rfft(taper * remainder)) ** 2 / whole
    kept = 1.0 - np.sum(np.abs(np.fft.rfft(taper[:, None] * basis, axis=0)) ** 2, axis=1) / whole
    good = kept > KEPT_PART
    good[0] = False
    if not good.any():
        return NoiseModel(float(np.sqrt(remainder @ remainder / max(1, n - basis.shape[1]))), np.ones(1))
    power = np.where(good, power / np.where(good, kept, 1.0), 0.0)
    if lines and (line := _highest(power, good)):
        return estimate_noise(residual, _with_line(basis, remainder, line), lines - 1)
    # What stands out beside a harmonic is no noise but a swing that changes faster than the basis.
    apart = good & ~_beside(good)
    if apart.any():
        # In a short record harmonics are so close that nothing lies apart.
        judged = binary_dilation(apart, iterations=WIDE)
        good &= apart | ~judged | (power < BESIDE * _usual(power, apart))
        power = np.where(good, power, 0.0)
    order = _fractional_order(power, good, n)
    filter_, variance = _autoregression(power, good, n, order)
    if order:
        filter_ = np.convolve(fractional_difference(order, n), filter_)[:n]
    return NoiseModel(float(np.sqrt(variance)), filter_)


def _highest(power: Array, good: Mask) -> int:
    """The line that stands out most of its neighbours, 0 if none does."""
    usual = _usual(power, good)
    apart = good & ~binary_dilation(~good, iterations=WIDE // 2)
    over = np.divide(power, usual, out=np.zeros_like(power), where=apart & (usual > 0.0))
    return int(np.argmax(over)) if over.max() > LINE else 0


def _beside(good: Mask) -> Mask:
    """Lines in and beside the gaps of the harmonics; not beside the first gap, that of slow changes."""
    gaps = ~good
    gaps[: np.argmax(good)] = False
    return np.asarray(binary_dilation(gaps, iterations=WIDE // 2))


def _usual(power: Array, good: Mask) -> Array:
    """Median of the lines around each, of the good ones."""
    lines = np.arange(len(power))
    return np.interp(lines, lines[good], median_filter(power[good], 2 * WIDE + 1, mode="nearest"))


def _with_line(basis: Array, remainder: Array, line: int) -> Array:
    """The basis with a vibration of constant amplitude, its frequency found within the line."""
    n = len(remainder)
    turns = 2.0j * np.pi * np.arange(n) / n

    def beside(k: float) -> Array:
        wave = np.exp(k * turns)
        columns = np.stack([wave.real, wave.imag], axis=1)
        return np.linalg.qr(columns - basis @ (basis.T @ columns))[0]

    minimum = minimize_scalar(
        lambda k: -float(np.sum((beside(k).T @ remainder) ** 2)),
        bounds=(line - 1.0, line + 1.0),
        options={"xatol": 1e-4},
    )
    return np.concatenate([basis, beside(minimum.x)], axis=1)


def _fractional_order(power: Array, good: Mask, n: int) -> float:
    """The d of noise whose spectrum rises as 1/f^(2 d) beside an autoregression, 0 if it need not.

    The lines below the swing must not speak against it: what rises towards the swing is no power law.
    """
    below = good.copy()
    first = int(np.argmax(good))
    below[first + max(0, int(np.argmin(good[first:])) - WIDE // 2) :] = False

    def costs(d: float) -> tuple[float, float]:
        filter_, variance = _autoregression(power, good, n, d)
        density = variance / (_power_law(n, d) * np.abs(np.fft.rfft(filter_, n)) ** 2)
        terms = 2.0 * (np.log(density) + power / density)
        parameters = len(filter_) - 1 + (d > 0.0)
        return float(np.sum(terms[good]) + parameters * np.log(n)), float(np.sum(terms[below]))

    every = np.array([costs(d) for d in FRACTIONAL_ORDERS])
    best = int(np.argmin(every[:, 0]))
    whole, low = every[0] - every[best]
    return float(FRACTIONAL_ORDERS[best]) if whole > WORTH and low > -WORTH else 0.0


def _power_law(n: int, d: float) -> Array:
    """What flattens the lines (n // 2 + 1,) of a spectrum of 1/f^(2 d): its filter's response, squared."""
    lines = np.arange(n // 2 + 1)
    # No line at zero: the mean is an unknown.
    return np.asarray((2.0 * np.sin(np.pi * np.maximum(lines, 1) / n)) ** (2.0 * d))


def _autoregression(power: Array, good: Mask, n: int, d: float) -> tuple[Array, float]:
    """Autoregression of noise after its power law, and the variance of its innovations."""
    flat = power * _power_law(n, d)
    # Neighbours on both sides, averaged: a single line scatters as much as it is high.
    near = np.convolve(flat, np.ones(WIDE), "same")
    near /= np.maximum(np.convolve(good.astype(float), np.ones(WIDE), "same"), 1e-9)
    usable = np.convolve(good.astype(float), np.ones(WIDE), "same") > 0.5
    lines = np.arange(len(flat))
    spectrum = np.where(good, flat, np.interp(lines, lines[usable], near[usable]))
    return autoregression_of(np.fft.irfft(spectrum, n)[: n // 2], n)
