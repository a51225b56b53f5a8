"""Noise of a record whose model is not known: its level, its colour, drawings of it."""

import numpy as np
import pytest
from helpers import FIVE, NOISE, correlated_noise, decay, paper_run, rms, rms_range

from sysid_trib.noise.autoregression import fractional_difference, whitened
from sysid_trib.noise.residual_noise import NoiseModel, estimate_noise, modulated_harmonics

RUN = paper_run(FIVE)


@pytest.mark.parametrize(("correlation", "order"), [(0.0, 0), (0.6, 1)])
def test_noise_is_found_without_a_model(correlation, order):
    levels, orders = [], []
    for seed in range(12):
        added = correlated_noise(len(RUN.time), seed, correlation)
        run = decay(RUN.time, RUN.angle + added)
        # A wrong model leaves an oscillation a thousand times the noise.
        wrong = 0.1 * RUN.angle * np.cos(0.2 * RUN.time)
        found = estimate_noise(added + wrong, modulated_harmonics(run))
        levels.append(found.innovation / (NOISE * np.sqrt(1.0 - correlation**2)))
        orders.append(len(found.filter_) - 1)
    assert np.mean(levels) == pytest.approx(1.0, abs=0.02)
    assert np.median(orders) == order


def pink_noise(count, seed):
    """Noise of unit standard deviation whose spectrum falls as 1/f."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(2 * count))
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
    values = np.fft.irfft(spectrum)[:count]
    return (values - values.mean()) / values.std()


@pytest.mark.parametrize("filter_", [[1.0], [1.0, -0.8], fractional_difference(0.5, 2000), [1.0, -1.0]])
def test_drawn_noise_is_whitened_by_its_filter(filter_):
    drawn = NoiseModel(0.01, np.asarray(filter_)).draws(2000, 20)
    assert drawn.shape == (20, 2000)
    assert abs(drawn.mean()) < 1e-12
    # The first samples of a long filter have no past; its end would see the beginning again.
    white = whitened(drawn.T, np.asarray(filter_))[500:]
    low, high = rms_range(white.size)
    assert low < rms(white.ravel()) / 0.01 < high
    neighbours = np.mean(white[1:] * white[:-1]) / np.mean(white**2)
    assert abs(neighbours) < 5.0 / np.sqrt(white.size)


def test_noise_that_rises_to_low_frequencies_is_whitened_there_too():
    """Slow effects live below the swing's frequency, where an autoregression of short memory sees little."""
    basis, low = modulated_harmonics(RUN.decay(0)), []
    for seed in range(12):
        added = NOISE * pink_noise(len(RUN.time), seed)
        found = estimate_noise(added, basis)
        white = whitened(added, found.filter_) / found.innovation
        power = np.abs(np.fft.rfft(white)) ** 2 / len(white)
        # The swing has some forty periods: lines far below it, and the mean of all.
        low.append(np.mean(power[1:12]))
        assert np.mean(power[12:]) == pytest.approx(1.0, abs=0.1)
    # 132 lines of an exponential distribution; without the power law they have 3 to 8.
    assert np.mean(low) == pytest.approx(1.0, abs=0.4)


def test_a_line_of_vibration_is_no_noise():
    quiet = correlated_noise(len(RUN.time), 1, 0.0)
    line = 3.0 * NOISE * np.sin(5.7 * RUN.time)
    basis = modulated_harmonics(RUN.decay(1))
    assert estimate_noise(quiet + line, basis).standard_deviation == pytest.approx(
        estimate_noise(quiet, basis).standard_deviation, rel=0.03
    )
