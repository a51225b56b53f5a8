"""Colour of the noise of a record that was integrated from one with white noise."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.likelihood.sensor_noise import MAX_ORDER, NoiseModel, autoregression_of_order
from sysid_trib.records import smoothing
from sysid_trib.records.integration import as_position
from sysid_trib.records.signal import NOISE_IS_WHITE_IN

# Periods around a sample in which its noise enters the integral.
PERIODS_OF_RESPONSE = 64
SPECTRAL_LINES = 4096


def integrated_noise(run: xr.Dataset) -> NoiseModel | None:
    """Return the noise of a record that was integrated from white noise; None for another record.

    Parameters
    ----------
    run : Dataset
        ``angle(time)``, and what was measured with the attribute `NOISE_IS_WHITE_IN`, as `one_mode` and
        `free_decay` return it.

    Notes
    -----
    The integral is a linear filter of what was measured: its response to one sample gives the spectrum of the
    noise. It is an autoregression of order 20 (Yule and Walker), within 10 % of that spectrum. Below its
    largest line, where the drift was removed, the autoregression keeps the level of that line: an
    autoregression has no lines of zero power. The noise is there less than stated.
    """
    measured_in = run.attrs.get(NOISE_IS_WHITE_IN)
    if not measured_in or measured_in not in run or not int(run.attrs.get("integrations", 0)):
        return None
    w, times = smoothing.swing_frequency(run), int(run.attrs["integrations"])
    step = float(np.median(np.diff(run.measured_time.values)))
    every = max(1, round(float(np.median(np.diff(run.time.values))) / step))
    # The level over the frequency for each integration, as `sensor_noise` states it.
    response = w**times * _response(2.0 * np.pi / w, step, run)
    covariance = _autocovariance(response)[::every]
    filter_, variance = autoregression_of_order(covariance, MAX_ORDER)
    return NoiseModel(smoothing.sensor_noise(run) * float(np.sqrt(variance)), filter_)


def _response(period: float, step: float, run: xr.Dataset) -> Array:
    """Return the integral of one sample of unit size in the middle of many zeros, (sample,)."""
    count = int(PERIODS_OF_RESPONSE * period / step)
    impulse = np.zeros(count)
    impulse[count // 2] = 1.0
    time = np.arange(count, dtype=float) * step
    return as_position(time, impulse, period, run.attrs)


def _autocovariance(response: Array) -> Array:
    """Return the autocovariance of white noise after a filter, its spectrum level below the largest line."""
    power = np.abs(np.fft.rfft(response, max(SPECTRAL_LINES, 2 * len(response)))) ** 2
    largest = int(np.argmax(power))
    power[:largest] = power[largest]
    return np.asarray(np.fft.irfft(power))[: len(response)]
