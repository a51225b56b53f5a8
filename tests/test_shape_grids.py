"""Grids of shape parameters: what lies between two of their values is seen."""

import numpy as np
import pytest
from discovery import EFFECTS, start_model, with_effect

from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.screen import screen
from sysid_trib.discovery.shapes import HALVINGS
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.trials import TrialEffect, to_unit


def seen(symbol, shapes, coefficient, seed):
    """Screening of one candidate where it is hidden, and its exact fit from the truth."""
    start = start_model([with_effect({symbol: coefficient}, shapes=shapes, seed=seed)])
    force = EFFECTS[symbol]
    fitted = Fits(start).of(start, (), [TrialEffect(force, shapes)])
    return screen(start, [force]), start.deviance - fitted.deviance


@pytest.mark.parametrize("gap", [0.043, 0.071, 0.125])
def test_a_narrow_shape_is_seen_between_the_values_of_its_grid(gap):
    screening, gain = seen("freeplay", {"freeplay.g": gap}, 0.002, 0)
    assert gain > 30.0
    assert screening.gains.max() > (1.0 - 2.0 * DEFAULTS.slack) * gain


@pytest.mark.parametrize("symbol", ["freeplay", "wall", "jenkins", "dahl", "stribeck"])
def test_neighbours_are_alike_or_as_near_as_they_come(symbol):
    (force,) = EFFECTS.select([symbol])
    (name,) = force.shape
    screening = screen(start_model([with_effect({}, seed=1)]), [force])
    places = np.array([to_unit(force.shape[name], t.shapes[f"{symbol}.{name}"]) for t in screening.trials])
    order = np.argsort(places)
    assert len(order) > DEFAULTS.shape_values
    cell = np.diff(np.sort(places)).max() / 2.0**HALVINGS
    near, far = order[:-1], order[1:]
    alike = screening.correlation[near, far] > 1.0 - 2.0 * DEFAULTS.slack - 1e-6
    tested = np.maximum(screening.outside[near], screening.outside[far]) >= DEFAULTS.testable
    assert np.all(alike | ~tested | (np.diff(places[order]) < 1.01 * cell))


def test_a_grid_that_serves_stays_as_it_is():
    (force,) = EFFECTS.select(["log_friction"])
    assert (
        len(screen(start_model([with_effect({}, seed=1)]), [force]).trials)
        == (DEFAULTS.shape_values + 1) // 2
    )
