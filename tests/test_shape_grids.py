"""Grids of shape parameters: what lies between two of their values is seen."""

import pytest
from discovery import EFFECTS, start_model, with_effect

from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.screen import screen
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.trials import TrialEffect


def seen(symbol, shapes, coefficient, seed):
    """Screening of one candidate where it is hidden, and its exact fit from the truth."""
    start = start_model([with_effect({symbol: coefficient}, shapes=shapes, seed=seed)])
    force = EFFECTS[symbol]
    fitted = Fits(start).of(start, (), [TrialEffect(force, shapes)])
    return screen(start, [force]), start.deviance - fitted.deviance


@pytest.mark.parametrize("gap", [0.043, 0.125])
def test_a_narrow_shape_is_seen_between_the_values_of_its_grid(gap):
    screening, gain = seen("freeplay", {"freeplay.g": gap}, 0.002, 0)
    assert gain > 30.0
    assert screening.gains.max() > (1.0 - 2.0 * DEFAULTS.slack) * gain
