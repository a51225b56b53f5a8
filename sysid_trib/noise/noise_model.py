"""The noise of a run: its level and the filter that whitens it."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from sysid_trib.arrays import Array
from sysid_trib.noise.autoregression import MAX_ORDER, autoregression_of, memory_samples, warm_up_samples


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
