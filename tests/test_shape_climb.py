"""Candidates of several shapes: they are seen and fitted though no value of their grids is near."""

import pytest
from discovery import EFFECTS, W, start_model, with_effect

from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.screen import screen
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.trials import TrialEffect

LUGRE, DAHL = EFFECTS.select(["lugre", "dahl"])
SHAPES = {"lugre.s": 0.008, "lugre.r": 1.5, "lugre.u": 0.04}


def screened(seed):
    return screen(start_model([with_effect({"lugre": 0.01}, shapes=SHAPES, seed=seed)]), [LUGRE, DAHL])


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.in_full)])
def test_a_fit_of_three_shapes_settles_at_the_truth(seed):
    screening = screened(seed)
    fits = Fits(screening.model)
    trial_of = {screening.trials[at].force.symbol: screening.trials[at] for at in screening.best()}
    found, dahl = (fits.of(screening.model, (), [trial_of[name]]) for name in ("lugre", "dahl"))
    assert found.deviance < dahl.deviance - DEFAULTS.far
    # The start model's frequency is higher, by the bristles.
    truth = TrialEffect(LUGRE, SHAPES).referred(found.rows[0].path.frequency / W).shapes
    errors = found.shape_errors()
    for name, value in found.trials[-1].shapes.items():
        assert abs(value - truth[name]) < 4.0 * errors[name], name
