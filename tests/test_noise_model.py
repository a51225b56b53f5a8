"""Drawings of a noise."""

import numpy as np
import pytest
from helpers import rms, rms_range

from sysid_trib.likelihood.sensor_noise import NoiseModel, fractional_difference, whitened


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
