"""Whitening filters of the noise of a sensor."""

import numpy as np
import pytest

from sysid_trib.likelihood.colour import of_order

# Of noise that swings, as of a sensor with a resonance.
SWINGING = np.array([1.0, -1.7, 0.9])


@pytest.mark.parametrize("order", range(4))
def test_a_filter_of_any_order_has_a_memory_that_ends(order):
    """The first taps of a longer filter alone need not: 1 - 1.7 B grows for ever."""
    shorter = of_order(SWINGING, order)
    assert len(shorter) == order + 1
    assert np.all(np.abs(np.roots(shorter)) < 1.0)


def test_a_longer_filter_is_the_same_and_a_shorter_one_predicts_best():
    np.testing.assert_allclose(of_order(SWINGING, 3), [*SWINGING, 0.0])
    # Yule and Walker: of one tap it is the correlation of neighbours.
    np.testing.assert_allclose(of_order(SWINGING, 1), [1.0, -1.7 / 1.9])
